"""Tables of what the commands withstand (faults, damaged files), and of their cost on clusters."""

from __future__ import annotations

import json
import statistics
from typing import Any

from tools.repository import ROOT
from tools.tables.identification import RANDOM_RIGS
from tools.tables.result_tables import load_results, markdown, table, with_interval


@table("faults")
def faults(results: dict[str, Any]) -> str:
    """Format what was tried to break the commands, how often, and how often something was lost."""
    rows = [
        [r["group"], r["what"], f"{r['tried']}", f"**{r['failed']}**" if r["failed"] else "0", r["note"]]
        for group in results["groups"].values()
        for r in group
    ]
    return markdown(["", "tried", "times", "failed", "result"], rows, "---")


@table("fuzzing")
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
            name,
            f"{r['cases']}",
            f"{r['refused']}",
            f"{r['failures']}",
            f"{r['hangs_or_crashes']}",
            f"{r['slowest_cpu_s']:.1f}",
            f"{r['peak_MB']:.0f}",
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


PLANNED_CORES = (2, 16, 64, 256)


@table("ray_scaling")
def ray_scaling(results: dict[str, Any]) -> str:
    """Format the time of a plain run over that of two workers of Ray, and what a task takes."""
    rows = []
    for name in ("training", "identification"):
        r = results[name]
        seconds = (f"{statistics.median(r[key]):.0f} s" for key in ("plain_s", "ray_s"))
        ratio_cell = with_interval(r["ratio"], *r["spread"], decimals=2)
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


@table("cluster_plan", source="ray_scaling")
def cluster_plan(results: dict[str, Any]) -> str:
    """Calculate core hours, memory and times on clusters from measured costs of tasks."""
    cards = [
        json.loads(path.read_text("utf-8"))
        for path in sorted(ROOT.glob("agents/shipped/reach/ppo-*/card.json"))
    ]
    ppo_s = statistics.mean(card["curve"][-1]["cpu_s"] for card in cards)
    rigs = [row["seconds"]["cpu"] for row in load_results(RANDOM_RIGS)["rigs"]]
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
