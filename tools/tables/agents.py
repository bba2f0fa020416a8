"""Tables of controllers and agents: scores, trainings, and control with identified machines."""

from __future__ import annotations

import itertools
import statistics
from collections.abc import Iterable
from typing import Any

from tools.tables.result_tables import load_results, markdown, table, with_interval


@table("controllers")
def controllers(results: dict[str, Any]) -> str:
    """Format the contour errors of the controllers along paths, mm."""
    tasks = [t for t in results["tasks"] if t != "reach"]
    rows = []
    for name in results["tasks"][tasks[0]]:
        errors = [results["tasks"][t][name]["contour_mm"] for t in tasks]
        rows.append([name, *(f"{e['rms']['mean']:.3f} / {e['max']['mean']:.3f}" for e in errors)])
    return markdown(["rms / maximum contour error, mm", *tasks], rows)


@table("bound")
def bound(results: dict[str, Any]) -> str:
    """Format the controllers' settling times relative to the bound."""
    rows = []
    for name, c in results["controllers"].items():
        ratios = [_ratio(c, over) for over in ("ratio_of_means", "mean_of_ratios")]
        rows.append([name, f"{100 * c['success']:.1f} %", f"{c['mean_s']:.3f}", *ratios])
    return markdown(
        ["controller", "within 0.2 mm", "settling time, s", "ratio of means", "mean of ratios"], rows
    )


@table("plain_ppo")
def plain_ppo(results: dict[str, Any]) -> str:
    """Format the ends of trainings with PPO's default hyperparameters, and with one setting changed."""
    others = {
        "-": "plain_ppo_envs_1",
        "learning rate 1e-3": "plain_ppo_learning_rate_0.001",
        "reward `dense`": "plain_ppo_reward_dense",
    }
    trainings = [("-", results), *((changed, load_results(name)) for changed, name in others.items())]
    rows = []
    for changed, content in trainings:
        for run in content["runs"]:
            last = run["curve"][-1]
            below = [row["cpu_s"] for row in run["curve"] if row["median_mm"] < content["bar_mm"]]
            rows.append(
                [
                    f"{content['envs']}",
                    changed,
                    f"{run['seed']}",
                    f"{last['steps']}",
                    f"{last['median_mm']:.2f} mm",
                    f"{100 * last['within_1mm']:.0f} %",
                    f"{below[0]:.0f} s" if below else "-",
                ]
            )
    header = ["environments", "changed", "seed", "steps", "median", "within 1 mm", "below 1 mm first after"]
    return markdown(header, rows)


@table("agents")
def agents(results: dict[str, Any]) -> str:
    """Format the shipped agents' scores relative to the physical bound (reach) and to the PID (track)."""
    tasks = results["tasks"]
    rows = []
    for name, result in _by_agent(tasks["reach"], "reach"):
        success = result["scores"]["success"]
        rates = [f"{100 * success[band]:.1f} %" for band in ("1mm", "0.2mm", "0.05mm")]
        rows.append(
            [
                name,
                *rates,
                f"{result['scores']['settling_s']['0.2mm']['mean']:.3f}",
                _ratio(result, "over_bound"),
            ]
        )
    reach = markdown(
        [
            "agent",
            "within 1 mm",
            "within 0.2 mm",
            "within 0.05 mm",
            "settling to 0.2 mm, s",
            "over the bound",
        ],
        rows,
    )
    paths = list(tasks["track"]["compared"])
    by_path = [dict(_by_agent(tasks["track"], path)) for path in paths]
    rows = []
    for name in by_path[0]:
        cells = [
            f"{result[name]['scores']['contour_mm']['rms']['mean']:.4f} mm, "
            f"{_ratio(result[name], 'over_pid')}"
            for result in by_path
        ]
        rows.append([name, *cells])
    for recipe, result in tasks["track"]["compared"][paths[0]].items():
        if len(result["over_pid"]["by_seed"]) == 1:
            continue
        cells = [
            _ratio({"over_pid": tasks["track"]["compared"][path][recipe]["over_pid"]}, "over_pid")
            for path in paths
        ]
        rows.append([f"**{recipe}, all seeds**", *(f"**{cell}**" for cell in cells)])
    track = markdown(["agent", *(f"{path}: rms contour error, over the PID's" for path in paths)], rows)
    return f"{reach}\n\n{track}"


def _by_agent(task: dict[str, Any], name: str) -> Iterable[tuple[str, dict[str, Any]]]:
    """Yield the agents of a task with their scores in one scenario and their ratios."""
    for agent, result in task["agents"].items():
        recipe, _, seed = agent.partition("-seed")
        ratios = {over: r["by_seed"][int(seed or 0)] for over, r in task["compared"][name][recipe].items()}
        yield agent, {"scores": result["scores"][name], **ratios}


@table("agent_ablation")
def agent_ablation(results: dict[str, Any]) -> str:
    """Format the scores of short trainings with one part of the recipe changed each."""
    return _trainings(results["variants"])


@table("agent_off_policy", source="agent_ablation")
def agent_off_policy(results: dict[str, Any]) -> str:
    """Format the scores of trainings with SAC, TQC and CrossQ."""
    return _trainings(results["off_policy"])


def _trainings(variants: dict[str, Any]) -> str:
    """Format the costs and scores of trainings, given as runs by name."""
    rows = []
    for name, runs in variants.items():
        for r in runs:
            rates = [f"{100 * r['success'][band]:.1f} %" for band in ("0.2mm", "0.05mm")]
            rows.append(
                [name, str(r["seed"]), str(r["steps"]), f"{r['cpu_s']:.0f}", *rates, _ratio(r, "over_bound")]
            )
    header = ["training", "seed", "steps", "processor s", "within 0.2 mm", "within 0.05 mm", "over the bound"]
    return markdown(header, rows)


@table("agent_seeds")
def agent_seeds(results: dict[str, Any]) -> str:
    """Format the scores of recipes over the seeds of their trainings."""
    rows = []
    for name, result in results["recipes"].items():
        agents, by_seed = result["agents"], [r["mean"] for r in result["over_bound"]["by_seed"]]
        precise = [100 * agent["success"]["0.05mm"] for agent in agents]
        rows.append(
            [
                f"`{name}`",
                str(len(agents)),
                f"{agents[0]['steps']}",
                f"{statistics.mean(agent['cpu_s'] for agent in agents):.0f}",
                _ratio(result, "over_bound"),
                f"{max(by_seed):.3f}",
                f"{statistics.mean(precise):.1f} %",
                f"{min(precise):.1f} %",
            ]
        )
    header = ["recipe", "seeds", "steps", "processor s", "over the bound", "slowest seed"]
    return markdown([*header, "within 0.05 mm", "least precise seed"], rows)


@table("library_programs")
def library_programs(results: dict[str, Any]) -> str:
    """Format what the programs of other libraries reach with their largest number of steps."""
    rows = []
    for section, result in results["programs"].items():
        steps = max(run["steps"] for run in result["runs"])
        last = [run for run in result["runs"] if run["steps"] == steps]
        medians = [run["median_mm"] for run in last]
        rows.append(
            [
                section,
                str(len(last)),
                str(steps),
                f"{statistics.mean(run['cpu_s'] for run in last):.0f}",
                f"{statistics.mean(medians):.2f} mm",
                f"{max(medians):.2f} mm",
                f"{100 * statistics.mean(run['within_0.2mm'] for run in last):.0f} %",
            ]
        )
    header = ["library", "seeds", "steps", "processor s", "median error", "worst seed", "within 0.2 mm"]
    return markdown(header, rows)


def _ratio(result: dict[str, Any], over: str) -> str:
    """Format a ratio with its interval."""
    return with_interval(result[over]["mean"], *result[over]["ci95"])


@table("her")
def her(results: dict[str, Any]) -> str:
    """Format the results of SAC with hindsight on the sparse reward."""
    rows = [
        [
            f"seed {r['seed']}",
            f"{100 * r['success_5mm']:.1f} %",
            f"{r['steps']}",
            f"{r['steps_to_bar']}",
            f"{r['cpu_s']:.0f}",
        ]
        for r in results["runs"]
    ]
    return markdown(["SAC + HER", "within 5 mm", "steps", "steps to 90 %", "processor s"], rows)


@table("corrected_control")
def corrected_control(results: dict[str, Any]) -> str:
    """Format the number of rigs where the corrected machine's controller is better, and the scores by rig."""
    rigs, decides, header = results["rigs"], results["decides"], ["declared", "refitted", "corrected"]
    rows = []
    for (who, label), over in itertools.product(decides.items(), ("declared", "refitted")):
        gains = [result[who]["gain"][over][label] for result in rigs.values() if who in result]
        better = len(results["better"][f"{who} over {over}"])
        worse = sum(gain["ci95"][0] > 0.0 for gain in gains)
        rows.append(
            [f"{who} ({label}), over {over}", f"{better}", f"{worse}", f"{len(gains) - better - worse}"]
        )
    counts = markdown(["controller (score), comparison", "better", "worse", "not significant"], rows)
    rows = []
    for rig, result in rigs.items():
        for who, label in decides.items():
            if who not in result:
                continue
            scores = result[who]["scores"]
            success = {m: scores[m].get("success_0.2mm") for m in header}
            cells = [
                f"{scores[m][label]['mean']:.3f}" + (f", {100 * rate['mean']:.0f} %" if rate else "")
                for m, rate in success.items()
            ]
            low, high = result[who]["gain"]["declared"][label]["ci95"]
            rows.append([f"{rig}, {who}", *cells, f"{low:+.3f} to {high:+.3f}"])
    return f"{counts}\n\n{markdown(['rig', *header, 'corrected minus declared'], rows)}"
