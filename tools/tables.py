"""Write the tables of the documentation from benchmarks/results/*.json, and other pages from the library.

    python -m tools.tables            # write
    python -m tools.tables --check    # write nothing; fail if a page is out of date

The text of a page between `<!-- table: NAME -->` and `<!-- end -->` is replaced by the table of that name.
docs/effects.md, docs/machine.schema.json and the field tables of docs/machine.md are generated from the package, the
tables of docs/leaderboard.md and docs/bound.md from benchmarks/leaderboard/*.json and the stored bounds.
"""

from __future__ import annotations

import argparse
import html
import importlib
import inspect
import itertools
import json
import re
import statistics
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

from benchmarks.results_file import RESULTS, ROOT
from hframe_gym.atomic_files import write_text
from hframe_gym.effects import EFFECTS
from hframe_gym.machine import Effect
from tools.leaderboard import PAGES as LEADERBOARD_PAGES
from tools.leaderboard import leaderboard_page
from tools.leaderboard import results as leaderboard_results
from tools.machine_page import field_tables, schema_text

PAGES = (
    "README.md",
    "RESULTS.md",
    "docs/agents.md",
    "docs/differentiable.md",
    "docs/gap.md",
    "docs/identification_results.md",
    "docs/scaling.md",
    "docs/trust.md",
)
STAGES = ("declared", "before", "after")
RANDOM_RIGS = "random_rigs_20270501"  # that is: of this seed, which was run once, for the published results
RANDOM_RIGS_CLOSED = "random_rigs_closed_20270126"


def markdown(header: Sequence[str], rows: Iterable[Sequence[str]], others: str = "---:") -> str:
    """Format a Markdown table.

    Args:
        header: Titles of the columns.
        rows: Cells of the rows.
        others: Alignment of all columns but the first. Default: right.

    Returns:
        The table as lines of text.
    """
    lines = [header, ["---", *[others] * (len(header) - 1)], *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _codes(words: Iterable[str]) -> str:
    """Format words as code, separated by commas."""
    return ", ".join(f"`{word}`" for word in words)


def _correct(row: dict[str, Any]) -> str:
    """Return whether an identification named all effects and no other: "yes", or what is wrong."""
    wrong = [*(["missed"] if not row["complete"] else []), *(["extra"] if row["extra"] else [])]
    return ", ".join(wrong) or "yes"


def identify_examples(results: dict[str, Any]) -> str:
    """Format the held-out errors of the shipped rigs by channel."""
    rows = []
    for rig in ("rig_a", "rig_b"):
        for channel in results[rig]["after"]["held_out"]:
            ratios = [results[rig][s]["held_out"][channel]["noise_ratio"] for s in STAGES]
            rows.append([f"`{rig}` ({results[rig]['verdict']}), {channel}", *(f"{r:.3g}" for r in ratios)])
    return markdown(["rig and channel", "declared", "before: refitted", "after"], rows)


def real_machines_emps(results: dict[str, Any]) -> str:
    """Format the relative force errors of both EMPS records."""
    rows = [
        [name, *(f"{100 * e[k]:.2f} %" for k in ("train", "test"))]
        for name, e in results["force_error"].items()
    ]
    return markdown(["EMPS", "first record (fitted)", "second record (held out)"], rows)


def identification(results: dict[str, Any]) -> str:
    """Format the summaries of all sets of rigs, one per row."""
    rows = []
    for name, summary in results["sets"].items():
        median, parameters = summary["median"], summary["parameters"]
        rows.append(
            [
                *(
                    name,
                    f"{summary['rigs']}",
                    f"{summary['scores']['right']}",
                    f"{summary['named_not_there']}",
                ),
                *(f"{median['before']:.3g}", f"{median['after']:.3g}", f"{summary['to_noise']}"),
                f"{parameters['within']} of {parameters['rigs']}" if parameters["rigs"] else "",
                *(f"{median['um_after']:.2g}", f"{median['seconds']:.1f}", f"{summary['most_seconds']:.0f}"),
            ]
        )
    header = [
        "set",
        "rigs",
        "right",
        "false effects",
        "before",
        "after",
        "after <= 1.1",
        "parameters within 2 %",
    ]
    return markdown([*header, "tool error, um", "s", "slowest, s"], rows)


def real_machines_ced(results: dict[str, Any]) -> str:
    """Format the simulation errors of the CED records, relative to their standard deviation."""
    rows = [[name, *(f"{100 * e:.0f} %" for e in by.values())] for name, by in results["nrmse"].items()]
    return markdown(["CED", *next(iter(results["nrmse"].values()))], rows)


def real_machines_xl330(results: dict[str, Any]) -> str:
    """Format the simulation errors of the XL330 logs, rad rms."""
    rows = [[name, *(f"{e:.3g} rad" for e in by.values())] for name, by in results["rms_rad"].items()]
    return markdown(["XL330", *next(iter(results["rms_rad"].values()))], rows)


def formulas(results: dict[str, Any]) -> str:
    """Format the rigs with a force or friction outside the library: table and proposed formula."""
    rows = []
    for name, rig in results["rigs"].items():
        if "formula" not in rig:
            rows.append([name, ", ".join(rig["tables"]) or "no table", *[""] * 5])
            continue
        seconds = f"{rig['seconds']['formulas']:.0f} s"
        errors = (f"{rig[key]:.3g}" for key in ("table_error", "formula_error"))
        rows.append([name, f"`{rig['tables'][0]}`", rig["terms"], f"{rig['complexity']}", *errors, seconds])
    header = [
        "hidden",
        "table",
        "formula",
        "parameters",
        "error: table",
        "error: formula",
        "time for formulas",
    ]
    return markdown(header, rows)


def other_simulator_rigs(results: dict[str, Any]) -> str:
    """Format the fourteen rigs of another simulator: truth, named effects, errors on unseen runs and time."""
    rows = []
    for r in results["rigs"]:
        errors = (f"{r['unseen'][machine]['mean']:.3g}" for machine in ("before", "after"))
        residue = "yes" if r["residue"] else ""
        named = _codes(r["named"]) or r["verdict"]
        rows.append([r["hidden"], residue, named, _correct(r), *errors, f"{r['seconds']['wall']:.0f} s"])
    header = ["hidden", "residue", "named", "right", "unseen runs: before", "after", "time"]
    return markdown(header, rows)


def closed_loop_rigs(results: dict[str, Any]) -> str:
    """Format the eight rigs with a position controller: truth, verdict, what is left, hint and time."""
    rows = []
    for r in results["rigs"]:
        hint = "" if r["hint"] is None else f"{r['hint']['component']}: {r['hint']['variable']}"
        errors = (f"{r['unseen'][machine]:.3g}" for machine in ("declared", "before", "after"))
        answer = _codes(r["named"] or [r["verdict"]])
        rows.append([r["hidden"], answer, _correct(r), hint, *errors, f"{r['cpu_seconds']:.0f} s"])
    header = [
        "hidden",
        "verdict",
        "right",
        "hint",
        "unseen runs: declared",
        "before",
        "after",
        "processor time",
    ]
    return markdown(header, rows)


def public_axes(results: dict[str, Any]) -> str:
    """Format the public recordings of motors and axes: errors of the machines, the fit to beat, verdict and time."""
    rows = []
    for r in results["sets"]:
        stages = ("declared", "plain", "before", "after", "reference")
        errors = ("-" if r["errors"][s] is None else f"{r['errors'][s]:.3g} {r['unit']}" for s in stages)
        ratio = "-" if r["ratio"] is None else f"{r['ratio']:.2f}"
        answer = _codes(r["named"] or [r["verdict"]])
        rows.append([f"{r['machine']} ({r['source']})", answer, *errors, ratio, f"{r['cpu_seconds']:.0f} s"])
    machines = ["declared", "plain fit", "refitted", "delivered", "to beat"]
    return markdown(["recordings", "verdict", *machines, "ratio", "processor time"], rows)


def outside_library(results: dict[str, Any]) -> str:
    """Format the rigs with an effect outside the library: names, errors on unseen runs, hints and time."""
    rows = []
    for r in results["rigs"]:
        hint = r["hint"]
        answer = _codes(r["named"] or [r["verdict"]])
        false = _codes(r["false"]) or ("verdict" if r["false_verdict"] else "")
        right = "right" if hint["right"] else "component" if hint["right_component"] else "wrong"
        text = f"{hint['component']}: {hint['variable']}" if hint["component"] else "none"
        errors = (f"{r['unseen'][machine]:.3g}" for machine in ("before", "after", "true"))
        loop = "closed" if r["closed_loop"] else "open"
        rows.append([r["hidden"], loop, answer, false, *errors, text, right, f"{r['cpu_seconds']:.0f} s"])
    header = [
        "hidden",
        "loop",
        "named",
        "false",
        "unseen runs: before",
        "after",
        "true",
        "hint",
        "",
        "processor time",
    ]
    content = results["summary"]
    counts = [
        ["rigs; families", f"{content['rigs']}; {content['families']}"],
        ["false names", f"{content['false_names']} on {content['rigs_with_false_names']} rigs"],
        ["`no_effect` above twice the noise", str(content["false_verdicts"])],
        ["hint at the right component", f"{content['hints_at_component']} of {content['rigs']}"],
        ["hint at the right component and variable", f"{content['hints_right']} of {content['rigs']}"],
        ["within 120 s of processor time", f"{content['within_budget']} of {content['rigs']}"],
    ]
    return f"{markdown(header, rows)}\n\n{markdown(['measure', 'value'], counts)}"


def random_rigs(results: dict[str, Any]) -> str:
    """Format names, errors, standard deviations and time on rigs that were drawn at random, in open or closed loop."""
    content = results["summary"]
    rows = []
    titles = {
        "clean": "library effects or none",
        "residue": "the same, with a residue",
        "off_form": "effects 10 to 20 % off the library's form",
        "outside": "effects outside the library",
    }
    for key, title in titles.items():
        names, false = content["names"][key], content["false_names"][key]
        found = f"{names['identified']} of {names['effects']}" if names["effects"] else ""
        rows.append([title, str(names["rigs"]), str(names["right"]), found, str(false["with_false_name"])])
    table = markdown(["rigs", "number", "right", "effects identified", "rigs with a false name"], rows)
    above, unseen, seconds = content["names"]["above_detection"], content["unseen"], content["seconds"]["cpu"]
    intervals = content["coverage"]
    measures = [
        ["clean rigs: effects above the family's median detection size that are identified", ratio(above)],
        *(
            [f"{text}: median; 95 % quantile; share within {unseen[key]['limit']}", quantiles(unseen[key])]
            for key, text in (
                ("clean_over_noise", "clean rigs: error on unseen runs over the noise"),
                (
                    "residue_over_truth",
                    "rigs with a residue: error on unseen runs over that of the true machine",
                ),
            )
        ),
        *(
            [
                f"coverage of the 95 % intervals, {name}",
                f"{100 * found['95']:.0f} % of {found['parameters']} values",
            ]
            for name, found in intervals.items()
            if found["parameters"]
        ),
        ["written machine stable under random rated voltages", f"{content['stable']} of {content['rigs']}"],
        ["`hframe simulate` within 5 % of the report", f"{content['consistent']} of {content['rigs']}"],
        [
            "processor time of an identification: median; slowest",
            f"{seconds['median']:.0f} s; {seconds['most']:.0f} s",
        ],
    ]
    if content.get("logs"):
        measures[1:1] = _closed_loop_measures(content)
    if again := content.get("repeated_seconds", {}).get("cpu"):
        measures += [
            [
                "the same with compiled code, in a new process",
                f"{again['median']:.0f} s; {again['most']:.0f} s",
            ],
            ["report of the second identification is equal", f"{content['repeatable']} of {content['rigs']}"],
        ]
    return f"{table}\n\n{markdown(['measure', 'value'], measures)}"


def _closed_loop_measures(content: dict[str, Any]) -> list[list[str]]:
    """Return the rows of random rigs that only those in closed loop have."""
    above, errors = content["names"]["above_median_size"], content["unseen"]["over_truth"]
    size, within = f"{100 * above['size']:.0f} %", errors["limit"]
    text = "error on unseen runs over that of the true machine: median; 95 % quantile; share within"
    rows = [
        [
            f"all rigs with library effects: effects with a trace, larger than {size} (the median), identified",
            ratio(above),
        ],
        [
            "effects without a trace in the runs, which no method can find",
            str(content["names"]["without_trace"]["effects"]),
        ],
        [
            f"rigs with library effects, each with a trace, or without effects: {text} {within}",
            quantiles(errors),
        ],
    ]
    for name, found in content["logs"].items():
        rows.append(
            [f"log with {name} changes of the voltages a row: right", f"{found['right']} of {found['rigs']}"]
        )
        if found["over_truth"]["rigs"]:
            rows.append([f"the same: {text} {within}", quantiles(found["over_truth"])])
    return rows


def ratio(counts: dict[str, int]) -> str:
    """Format how many effects were identified."""
    return f"{counts['identified']} of {counts['effects']}"


def quantiles(values: dict[str, float]) -> str:
    """Format median, 95 % quantile and the fraction within the limit."""
    return f"{values['median']:.3g}; {values['p95']:.3g}; {100 * values['within']:.0f} %"


def identification_set(results: dict[str, Any]) -> str:
    """Format the rigs of a set: hidden effects, identified effects, errors and time."""
    rows = [
        [
            *(r["rig"], r["hides"] or "nothing", r["found"] or r["verdict"], "yes" if r["hit"] else "**no**"),
            *(f"{r['before']:.3g}", f"{r['after']:.3g}", f"{r['seconds']:.1f}"),
        ]
        for r in results["rigs"]
    ]
    return markdown(["rig", "hidden", "identified", "right", "before", "after", "s"], rows)


def paper(results: dict[str, Any]) -> str:
    """Format the statements of the paper beside the values of the models."""
    rows = [list(row.values()) for row in results["statements"]]
    return markdown(["where", "the paper says", "the models give", "agrees"], rows)


def accuracy(results: dict[str, Any]) -> str:
    """Format the tool errors of the kernel, and of MuJoCo with its best settings at the same step."""
    rows = []
    for voltage, errors in results["against_reference"].items():
        constant = results["constant_stiffness"].get(voltage, {}).get("median_errors_m")
        for step, error in errors["errors_m"].items():
            cells = [f"{1e6 * error[k]:.3g}" for k in ("median", "p95", "max")]
            if constant:
                rival = min(values[step] for name, values in constant.items() if name != "this kernel")
                cells += [f"{1e6 * rival:.4g}", f"{rival / constant['this kernel'][step]:.0f}"]
            else:
                cells += ["", ""]
            rows.append([f"+-{voltage}, {step}", *cells])
    header = ["voltages, step", "median um", "p95 um", "max um", "MuJoCo's median um, best settings", "ratio"]
    return markdown(header, rows)


def throughput(results: dict[str, Any]) -> str:
    """Format the steps per second of the kernel and of MuJoCo's rollout."""
    rows = [
        [
            name,
            *(f"{1e-6 * r[k]:.3g}" for k in ("ours_steps_per_s", "theirs_steps_per_s")),
            f"{r['ratio']:.0f} ({r['spread'][0]:.0f} to {r['spread'][1]:.0f})",
        ]
        for name, r in results["mujoco"].items()
        if "ratio" in r
    ]
    return markdown(["stage; MuJoCo's settings; cores", "kernel, M/s", "MuJoCo, M/s", "ratio"], rows)


def env_speed(results: dict[str, Any]) -> str:
    """Format the environment's speed relative to other environments, and the fraction of the kernel in a step."""
    rows = []
    for name, result in results.items():
        if name.startswith(("over EnvPool", "single over")):
            low, high = result["spread"]
            rows.append([name, f"{result['ratio']:.2f} ({low:.2f} to {high:.2f})"])
        elif name.startswith("share of"):
            fractions = (
                f"{100 * result[clock]['share']:.0f} % of {clock} time" for clock in ("processor", "wall")
            )
            rows.append(
                [
                    name.replace("share of the bare kernel", "fraction of the bare kernel"),
                    ", ".join(fractions),
                ]
            )
    return markdown(["measure", "value"], rows)


def differentiable(results: dict[str, Any]) -> str:
    """Format the speed of differentiated steps, and their errors."""
    rows = []
    for row in results["rates"]:
        low, high = row["spread"]
        rows.append(
            [
                row["machine"],
                row["friction"],
                "state, voltages" + (", parameters" if row["by_parameters"] else ""),
                f"{row['ours_steps_per_s']:.0f}",
                f"{1.0 / row['ratio']:.1f} ({1.0 / high:.1f} to {1.0 / low:.1f})",
            ]
        )
    header = ["machine", "friction", "with respect to", "differentiated steps/s", "cost in simulated steps"]
    errors = [
        [name, f"{e['median']:.1e}", f"{100 * e['fraction_below_1e-6']:.1f} %"]
        for name, e in results["errors"].items()
    ]
    compared = markdown(
        ["machine", "median relative error against central differences", "below 1e-6"], errors
    )
    return f"{markdown(header, rows)}\n\n{compared}"


def her(results: dict[str, Any]) -> str:
    """Format the results of SAC with hindsight on the sparse reward."""
    rows = [
        [
            f"seed {r['seed']}",
            *(
                f"{100 * r['success_5mm']:.1f} %",
                f"{r['steps']}",
                f"{r['steps_to_bar']}",
                f"{r['cpu_s']:.0f}",
            ),
        ]
        for r in results["runs"]
    ]
    return markdown(["SAC + HER", "within 5 mm", "steps", "steps to 90 %", "processor s"], rows)


def bound(results: dict[str, Any]) -> str:
    """Format the controllers' settling times relative to the bound."""
    rows = []
    for name, c in results["controllers"].items():
        pairs = [c["ratio_of_means"], c["mean_of_ratios"]]
        ratios = [f"{r['mean']:.3f} ({r['ci95'][0]:.3f} to {r['ci95'][1]:.3f})" for r in pairs]
        rows.append([name, f"{100 * c['success']:.1f} %", f"{c['mean_s']:.3f}", *ratios])
    return markdown(
        ["controller", "within 0.2 mm", "settling time, s", "ratio of means", "mean of ratios"], rows
    )


def controllers(results: dict[str, Any]) -> str:
    """Format the contour errors of the controllers along paths, mm."""
    tasks = [t for t in results["tasks"] if t != "reach"]
    rows = []
    for name in results["tasks"][tasks[0]]:
        errors = [results["tasks"][t][name]["contour_mm"] for t in tasks]
        rows.append([name, *(f"{e['rms']['mean']:.3f} / {e['max']['mean']:.3f}" for e in errors)])
    return markdown(["rms / maximum contour error, mm", *tasks], rows)


def agents(results: dict[str, Any]) -> str:
    """Format the scores of the shipped agents relative to the physical bound (reach) and to the PID (track)."""
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
            f"{result[name]['scores']['contour_mm']['rms']['mean']:.4f} mm, {_ratio(result[name], 'over_pid')}"
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


def agent_ablation(results: dict[str, Any]) -> str:
    """Format the scores of short trainings with one part of the recipe changed each."""
    return _trainings(results["variants"])


def agent_off_policy(results: dict[str, Any]) -> str:
    """Format the scores of trainings with SAC, TQC and CrossQ."""
    return _trainings(results["off_policy"])


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


def _by_agent(task: dict[str, Any], name: str) -> Iterable[tuple[str, dict[str, Any]]]:
    """Yield the agents of a task with their scores in one scenario and their ratios."""
    for agent, result in task["agents"].items():
        recipe, _, seed = agent.partition("-seed")
        ratios = {over: r["by_seed"][int(seed or 0)] for over, r in task["compared"][name][recipe].items()}
        yield agent, {"scores": result["scores"][name], **ratios}


def _ratio(result: dict[str, Any], over: str) -> str:
    """Format a ratio with its interval."""
    mean, (low, high) = result[over]["mean"], result[over]["ci95"]
    return f"{mean:.3f} ({low:.3f} to {high:.3f})"


def closed_loop(results: dict[str, Any]) -> str:
    """Format the number of rigs on which the corrected machine's controller is better, and the scores by rig."""
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


IDENTIFICATION_SETS = (
    "library_full",
    "library_small",
    "pairs",
    "triples",
    "four_runs",
    "order20",
    "none",
    "outside",
)


def gap(results: dict[str, Any]) -> str:
    """Format the scores of the entries of gap-v1, sorted by settling time over the bound."""

    def number(value: Sequence[float], digits: int) -> str:
        return f"{value[0]:.{digits}f} ({value[1]:.{digits}f} to {value[2]:.{digits}f})"

    rows = [
        [
            f"`{name}`",
            s["track"],
            s["knowledge"],
            f"{s['plants']}",
            f"{s['seeds']}" if s["learned"] else "",
            number(s["over_bound"], 3),
            number(s["settling_s"], 3),
            f"{100 * s['success'][0]:.1f} %",
            number([1e3 * v for v in s["circle_mm"]], 0),
            number([1e3 * v for v in s["square_mm"]], 0),
            f"{s['belt_force_N']:.0f}",
            f"{100 * s['saturated'][0]:.1f} %",
            f"{100 * s['left'][0]:.1f} %",
            f"{s['prepare_cpu_s'][0]:.0f}",
            f"{s['control_us'][0]:.0f}",
        ]
        for name, s in results["entries"].items()
    ]
    header = [
        "entry",
        "track",
        "knows",
        "plants",
        "seeds",
        "moves: over the bound",
        "until 0.2 mm, s",
        "within 0.2 mm",
    ]
    header += ["circle, um rms", "square, um rms"]
    header += ["largest belt force, N", "at the limit", "left the workspace", "preparation, s", "control, us"]
    return markdown(header, rows)


def gap_steps(results: dict[str, Any]) -> str:
    """Format how often each model of the plant is better than the declared one in gap-v1."""
    rows = []
    for name, parts in results["steps"].items():
        cells = []
        for c in parts.values():
            mean, low, high = c["ratio"]
            cells.append(f"{c['better']} ({c['clearly_better']}), {c['worse']} ({c['clearly_worse']})")
            cells.append(f"{mean:.3f} ({low:.3f} to {high:.3f})")
        rows.append([f"`{name}`", f"{parts['reach']['plants']}", *cells])
    titles = [
        title for part in ("moves", "circle", "square") for title in (f"{part}: better, worse", "ratio")
    ]
    return markdown(["entry, against its declared model", "plants", *titles], rows)


def gap_learned(results: dict[str, Any]) -> str:
    """Format the best learned entry of gap-v1 against the best other one, by track and task."""
    rows = []
    for track, parts in results["learned"].items():
        for part, c in parts.items():
            mean, low, high = c["ratio"]
            rows.append(
                [
                    track,
                    {"reach": "moves"}.get(part, part),
                    f"`{c['learned']}`",
                    f"`{c['other']}`",
                    f"{c['plants']}",
                    f"{c['better']} ({c['clearly_better']}), {c['worse']} ({c['clearly_worse']})",
                    f"{mean:.3f} ({low:.3f} to {high:.3f})",
                ]
            )
    header = ["track", "task", "best learned entry", "best other entry", "plants", "better, worse", "ratio"]
    return markdown(header, rows)


def gap_plants(results: dict[str, Any]) -> str:
    """Format what each plant of gap-v1 hides, what was identified, and settling times of two controllers."""
    names = [
        f"{base}{step}"
        for base in ("pid", "predictive")
        for step in ("", "-refitted", "-corrected", "-online")
    ]
    names = [name for name in names if name in results["entries"]]
    rows = []
    for plant in results["plants"]:
        found = " + ".join(plant.get("found", ())) or plant.get("verdict", "")
        times = [plant["settling_s"].get(name) for name in names]
        rows.append(
            [f"{plant['plant']}: {plant['hides']}", found, *("" if t is None else f"{t:.3f}" for t in times)]
        )
    return markdown(["plant", "identified", *(f"`{name}`" for name in names)], rows)


def faults(results: dict[str, Any]) -> str:
    """Format what was tried to break the commands, how often, and how often something was lost."""
    rows = [
        [r["group"], r["what"], f"{r['tried']}", f"**{r['failed']}**" if r["failed"] else "0", r["note"]]
        for group in results["groups"].values()
        for r in group
    ]
    return markdown(["", "tried", "times", "failed", "result"], rows, "---")


def first_step(results: dict[str, Any]) -> str:
    """Format the processor time to the first step of an environment."""
    rows = [
        [f"`{name}`", *(f"{times[key]:.1f} s" for key in ("empty_s", "filled_s"))]
        for name, times in results["cases"].items()
    ]
    return markdown(["`gym.make` with", "empty cache", "filled cache"], rows)


def fuzzing(results: dict[str, Any]) -> str:
    """Format how many damaged files each reader got, how many it refused, and what they cost."""
    header = [
        "files",
        "mutated",
        "refused",
        "tracebacks and the like",
        "crashes and hangs",
        "longest, processor s",
        "MB",
    ]
    readers = results["readers"]
    rows = [
        [
            *(name, f"{r['cases']}", f"{r['refused']}", f"{r['failures']}", f"{r['hangs_or_crashes']}"),
            *(f"{r['slowest_cpu_s']:.1f}", f"{r['peak_MB']:.0f}"),
        ]
        for name, r in readers.items()
    ]
    sums = [
        f"{sum(r[key] for r in readers.values())}"
        for key in ("cases", "refused", "failures", "hangs_or_crashes")
    ]
    largest = [
        f"{max(r['slowest_cpu_s'] for r in readers.values()):.1f}",
        f"{max(r['peak_MB'] for r in readers.values()):.0f}",
    ]
    return markdown(header, [*rows, ["all", *sums, *largest]])


def env_soak(results: dict[str, Any]) -> str:
    """Format the extremes of the long runs of the environment."""
    parts = {
        name: part for name, part in results.items() if isinstance(part, dict) and "largest_energy_J" in part
    }
    rows = [
        [
            *(
                name,
                f"{part['steps']:.3g}",
                f"{part['not_finite']}",
                f"{1e3 * part['furthest_beyond_m']:.1f}",
            ),
            f"{part['largest_energy_J']:.1f} of {part['energy_bound_J']:.0f}",
            f"{part['memory']['last_MB'] - part['memory']['first_MB']:+.0f}",
        ]
        for name, part in parts.items()
    ]
    total = sum(part["steps"] for part in parts.values())
    rows.append(["all", f"{total:.3g}", f"{sum(part['not_finite'] for part in parts.values())}", "", "", ""])
    header = [
        "machines",
        "steps",
        "not finite",
        "furthest beyond the workspace, mm",
        "largest energy, J",
        "memory, MB",
    ]
    return markdown(header, rows)


def ray_scaling(results: dict[str, Any]) -> str:
    """Format the time of a plain run over that of two workers of Ray, and what a task takes."""
    rows = []
    for name in ("training", "identification"):
        r = results[name]
        low, high = r["spread"]
        seconds = (f"{statistics.median(r[key]):.0f} s" for key in ("plain_s", "ray_s"))
        ratio_cell = f"{r['ratio']:.2f} ({low:.2f} to {high:.2f})"
        equal = f"{r['equal']} of {r['compared']}"
        costs = f"{r['cpu_s_per_task']:.1f} s", f"{r['worker_memory_MB']:.0f} MB"
        rows.append([f"{r['tasks']} tasks of {name}", *seconds, ratio_cell, equal, *costs])
    header = [
        "work",
        "plain run",
        "two workers",
        "ratio",
        "results equal",
        "processor time of a task",
        "worker's memory",
    ]
    note = f"Ray and its workers were ready after {results['start_s']:.0f} s, which the times do not contain."
    return f"{markdown(header, rows)}\n\n{note} Load of the machine before the run: {results['load']:.1f}."


PLANNED_CORES = (2, 16, 64, 256)


def cluster_plan(results: dict[str, Any]) -> str:
    """Calculate core hours, memory and times on clusters from measured costs of tasks."""
    cards = [
        json.loads(path.read_text("utf-8"))
        for path in sorted(ROOT.glob("agents/shipped/reach/ppo-*/card.json"))
    ]
    ppo_s = statistics.mean(card["curve"][-1]["cpu_s"] for card in cards)
    rigs = [row["seconds"]["cpu"] for row in _results(RANDOM_RIGS)["rigs"]]
    training, speed = results["training"], results["training"]["steps_per_s_per_core"]
    plan = [  # work, kind of its tasks, number of tasks, mean and longest processor time of a task, s
        ("PPO on reach as shipped, 3 seeds", "training", 3, ppo_s, ppo_s),
        ("PPO on reach as shipped, 100 seeds", "training", 100, ppo_s, ppo_s),
        ("9 agents of 100 million steps", "training", 9, 1e8 / speed, 1e8 / speed),
        ("sweep of 256 trials of 300 000 steps", "training", 256, 3e5 / speed, 3e5 / speed),
        ("300 random rigs", "identification", 300, statistics.mean(rigs), max(rigs)),
        ("10 000 rigs", "identification", 10_000, statistics.mean(rigs), max(rigs)),
    ]
    rows = []
    for work, kind, count, mean_s, longest_s in plan:
        per_worker = min(1.0, results[kind]["ratio"] / results["workers"])
        hours = [max(count * mean_s / cores, longest_s) / per_worker / 3600.0 for cores in PLANNED_CORES]
        rows.append([work, f"{count * mean_s / 3600.0:.3g}", *map(_duration, hours)])
    header = ["work", "core hours", *(f"{cores} cores" for cores in PLANNED_CORES)]
    memory = max(results[kind]["worker_memory_MB"] for kind in ("training", "identification"))
    figures = [
        ["environment steps of a training (PPO on reach), per second and core", f"{speed:.0f}"],
        [
            "processor time of a shipped PPO agent (1.5 million steps)",
            f"{ppo_s:.0f} s = {ppo_s / 3600.0:.3g} core hours",
        ],
        [
            f"processor time of a random rig: mean; longest of {len(rigs)}",
            f"{statistics.mean(rigs):.0f} s; {max(rigs):.0f} s",
        ],
        ["memory of a worker, at most", f"{memory:.0f} MB"],
        [f"memory of workers on {PLANNED_CORES[-2]} cores", f"{1e-3 * PLANNED_CORES[-2] * memory:.0f} GB"],
        [
            "work of one of two workers, in multiples of a plain run's (training)",
            f"{training['ratio'] / 2:.2f}",
        ],
        ["start of Ray and two workers", f"{results['start_s']:.0f} s"],
    ]
    return f"{markdown(['measured', 'value'], figures)}\n\n{markdown(header, rows)}"


def _duration(hours: float) -> str:
    """Format a duration in hours, minutes or seconds."""
    return (
        f"{hours:.3g} h"
        if hours >= 1.0
        else f"{60 * hours:.0f} min"
        if hours >= 1 / 60
        else f"{3600 * hours:.0f} s"
    )


def _results(name: str) -> dict[str, Any]:
    """Return the content of a results file."""
    content: dict[str, Any] = json.loads((RESULTS / f"{name}.json").read_text("utf-8"))
    return content


TABLES: dict[str, Callable[[dict[str, Any]], str]] = {
    "paper": paper,
    "accuracy": accuracy,
    "throughput": throughput,
    "identify_examples": identify_examples,
    "identification": identification,
    **{f"identification_{name}": identification_set for name in IDENTIFICATION_SETS},
    "formulas": formulas,
    "other_simulator_rigs": other_simulator_rigs,
    "closed_loop_rigs": closed_loop_rigs,
    "public_axes": public_axes,
    RANDOM_RIGS: random_rigs,
    RANDOM_RIGS_CLOSED: random_rigs,
    "outside_library_3": outside_library,
    "first_step": first_step,
    "env_speed": env_speed,
    "differentiable": differentiable,
    "env_soak": env_soak,
    "faults": faults,
    "fuzzing": fuzzing,
    "her": her,
    "bound": bound,
    "controllers": controllers,
    "agents": agents,
    "agent_ablation": agent_ablation,
    "agent_off_policy": agent_off_policy,
    "agent_seeds": agent_seeds,
    "library_programs": library_programs,
    "closed_loop": closed_loop,
    "gap": gap,
    "gap_steps": gap_steps,
    "gap_learned": gap_learned,
    "gap_plants": gap_plants,
    "ray_scaling": ray_scaling,
    "cluster_plan": cluster_plan,
    "real_machines_emps": real_machines_emps,
    "real_machines_ced": real_machines_ced,
    "real_machines_xl330": real_machines_xl330,
}
SOURCES = {
    "cluster_plan": "ray_scaling",
    "agent_off_policy": "agent_ablation",
    "gap_steps": "gap",
    "gap_learned": "gap",
    "gap_plants": "gap",
}  # of tables not named after their file


def surroundings(results: dict[str, Any]) -> str:
    """Return one line with the versions, cores and seed of a measurement."""
    versions = ", ".join(f"{k} {v}" for k, v in results["versions"].items())
    seed = "" if results["seed"] is None else f", seed {results['seed']}"
    return f"Python {results['python']}, {results['machine']['cores']} cores, {versions}{seed}."


def filled(path: Path) -> str:
    """Return the text of a page with the tables for which there are results."""

    def table(match: re.Match[str]) -> str:
        name = match[1]
        source = SOURCES.get(name, name)
        if not (RESULTS / f"{source}.json").is_file():
            return match[0]
        results = _results(source)
        note = "" if path.name == "README.md" else f"\n\n{surroundings(results)}"
        return f"<!-- table: {name} -->\n{TABLES[name](results)}{note}\n<!-- end -->"

    return re.sub(r"<!-- table: (\w+) -->.*?<!-- end -->", table, path.read_text("utf-8"), flags=re.DOTALL)


_EFFECTS_HEAD = """# Effect library

Generated from `hframe_gym/effects/` by `python -m tools.tables`. An effect is a physical phenomenon that the basic
model ([physics](physics.md)) lacks. It acts at a site of a machine: a coordinate, a drive and its motor, the belts, a
sensor, or the machine as a whole. `hframe identify` tries every effect at every site;
[Extending](extending.md#an-effect) shows how to add one.

Units in words depend on the site: a force is in N at x and in Nm at a motor. Bounds are in SI units. An effect vanishes
where its amplitude is zero.

"""
_EFFECTS_TAIL = """
## Tables

`smooth_force[VARIABLE]` and `smooth_friction[VARIABLE]` represent forces that no formula of the library explains:
piecewise linear functions, with two dozen knots, of a position, a velocity, the distance traveled, or time.
"""


def effects_page() -> str:
    """Return docs/effects.md: the library as a table, then one section per effect."""
    rows = [[f"[`{e.name}`](#{e.name})", e.site, _code_cell(e.formula)] for e in EFFECTS.values()]
    table = markdown(["effect", "site", "formula"], rows, "---")
    return f"{_EFFECTS_HEAD}{table}\n{''.join(map(_section, EFFECTS.values()))}{_EFFECTS_TAIL}"


def _code_cell(text: str) -> str:
    """Return code for a cell of a table, in which the sign | would begin the next cell."""
    return (
        f"<code>{html.escape(text, quote=False).replace('|', '&#124;')}</code>"
        if "|" in text
        else f"`{text}`"
    )


def _section(effect: Effect) -> str:
    """Return the section of an effect: description, formula, parameters, and equivalent effects."""
    text = inspect.getdoc(importlib.import_module(f"hframe_gym.effects.{effect.name}"))
    rows = [[f"`{p.name}`", p.unit, f"{p.lower:g} to {p.upper:g}", p.role] for p in effect.parameters]
    family = "" if effect.family == effect.name else f" Family: {effect.family}."
    equivalent = (
        f"\n\nEquivalent in every recording: {', '.join(effect.equivalent)}." if effect.equivalent else ""
    )
    table = markdown(["parameter", "unit", "bounds", "kind"], rows, "---")
    return (
        f"\n## {effect.name}\n\n{text}\n\nSite: {effect.site}.{family} Source: {effect.source}.\n\n"
        f"```text\n{effect.formula}\n```\n\n{table}{equivalent}\n"
    )


def with_field_tables(text: str) -> str:
    """Replace the field tables of docs/machine.md by the present ones."""
    tables = f"<!-- fields -->\n{field_tables()}\n<!-- end -->"
    return re.sub(r"<!-- fields -->.*?<!-- end -->", lambda _: tables, text, flags=re.DOTALL)


def pages() -> dict[Path, str]:
    """Return the text of all pages with generated parts by path."""
    docs = ROOT / "docs"
    return (
        {ROOT / page: filled(ROOT / page) for page in PAGES}
        | {
            docs / "effects.md": effects_page(),
            docs / "machine.md": with_field_tables((docs / "machine.md").read_text("utf-8")),
            docs / "machine.schema.json": schema_text(),
        }
        | {
            page: leaderboard_page(page.read_text("utf-8"), leaderboard_results())
            for page in LEADERBOARD_PAGES
        }
    )


def main() -> None:
    """Write all pages, or check that they are up to date."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--check", action="store_true", help="write nothing; fail if a page is out of date")
    check = parser.parse_args().check
    texts = pages()
    outdated = [path for path, text in texts.items() if not path.is_file() or path.read_text("utf-8") != text]
    if check and outdated:
        names = ", ".join(str(path.relative_to(ROOT)) for path in outdated)
        raise SystemExit(f"{names}: generated parts are out of date; run `make tables`")
    for path in outdated:
        write_text(path, texts[path])


if __name__ == "__main__":
    main()
