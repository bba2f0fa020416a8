"""What does identification say of machines with effects outside the library? False names, errors, hints.

    python -m benchmarks.outside_library --seed 1 --only 3 7 --log   # some rigs; nothing is written
    python -m benchmarks.outside_library --seed 1                    # all twenty

The rigs come from `tests.rigs.outside_rigs` and an independent simulator: every family that the library
lacks, half of the rigs recorded in open loop and half under a position controller. Seed 1 is for development.
No effect of the library is right here:

- A name is **false** if it is not a neighbor in kind of what the rig hides (same component, and same variable
  or mechanism: `OutsideEffect.neighbors`), or if the machine with it leaves most of the error, which any name
  would hide: more than 10 times the noise on unseen runs and more than 10 % of what the refitted machine
  leaves beyond the noise.
- `no_effect` is false above twice the noise on unseen runs.
- The **hint** is the first entry of `residual.depends_on` in report.json, or `hint` where the report has one;
  a neighbor that is named and not false is a hint as well. Its component and its variable are scored.

Results of single rigs are cached in out/outside_library as those of benchmarks.random_rigs are.
"""

from __future__ import annotations

import json
from fnmatch import fnmatch
from functools import partial
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.random_rigs import RIG_SOURCES
from benchmarks.results_file import write_results
from benchmarks.rig_score import NOISE, unseen_errors
from benchmarks.row_cache import Row, RowCache, source_key
from benchmarks.timed_identification import timed_identification
from hframe_gym.identification import IdentificationResult
from hframe_gym.machine import BUILTIN_MACHINES
from tests.rigs.outside_effects import OutsideEffect
from tests.rigs.outside_rigs import COUNT, OutsideSession, draw_rig
from tools.command_line import add_rig_options, command_line

CACHE = Path("out/outside_library")
MUCH_LEFT = 10.0  # times the noise
MUCH_OF_EXCESS = 0.1  # of the squared error beyond the noise that the refitted machine leaves
NO_EFFECT_LEFT = 2.0  # times the noise, above which `no_effect` is false
BUDGET_CPU_S = 120.0  # processor time of one identification that is asked for


def false_names(effect: OutsideEffect, named: list[str], before: float, after: float) -> list[str]:
    """Return the names that are false.

    Args:
        effect: What the rig hides.
        named: Labels, name@site, of the identified effects.
        before: Error of the refitted machine on unseen runs, times the noise.
        after: Error of the machine with these effects on unseen runs, times the noise.
    """
    most_is_left = after > MUCH_LEFT and after**2 - 1.0 > MUCH_OF_EXCESS * (before**2 - 1.0)
    return [label for label in named if most_is_left or not any(fnmatch(label, n) for n in effect.neighbors)]


def score_hint(effect: OutsideEffect, report: Row, acceptable: list[str]) -> Row:
    """Return the hint of a report and whether component and variable are right.

    Args:
        effect: What the rig hides.
        report: Content of report.json.
        acceptable: Labels that are named and not false.
    """
    component, variable = "", ""
    if hint := report.get("hint"):
        component, variable = hint["component"], hint["variable"]
    elif depends_on := report["residual"]["depends_on"]:
        component = depends_on[0].get("component") or depends_on[0]["coordinate"]
        variable = depends_on[0]["variable"]
    right_component = component in effect.components or bool(acceptable)
    right_variable = any(fnmatch(variable, pattern) for pattern in effect.variables) or bool(acceptable)
    return {
        "component": component,
        "variable": variable,
        "right_component": right_component,
        "right": right_component and right_variable,
    }


def score_rig(session: OutsideSession, result: IdentificationResult, seconds: float) -> Row:
    """Return the row of a rig in the results.

    Args:
        seconds: Processor time of the identification, s.
    """
    rig, report = session.rig, json.loads(json.dumps(result.as_json()))
    before, after = (
        unseen_errors(m, session.unseen)["mean"] for m in (result.before.machine, result.after.machine)
    )
    truth = np.concatenate(
        [recording.outputs - session.truth[recording.name] for recording in session.unseen]
    )
    named = [f"{e['name']}@{e['site']}" for e in report["effects"]]
    wrong = false_names(rig.effect, named, before, after)
    return {
        "rig": rig.name,
        "family": rig.effect.family,
        "site": rig.effect.site,
        "hidden": f"{rig.effect.label}: {rig.effect.note}",
        "closed_loop": rig.closed_loop,
        "verdict": result.verdict,
        "named": named,
        "rivals": {f"{e['name']}@{e['site']}": e["rivals"] for e in report["effects"]},
        "false": wrong,
        "false_verdict": result.verdict == "no_effect" and after > NO_EFFECT_LEFT,
        "unseen": {
            "before": before,
            "after": after,
            "true": float(np.mean(np.sqrt(np.mean(truth**2, axis=0)) / NOISE)),
        },
        "left": report["left"],
        "hint": score_hint(rig.effect, report, [label for label in named if label not in wrong]),
        "depends_on": report["residual"]["depends_on"],
        "sensors": report["residual"]["sensors"],
        "cpu_seconds": round(seconds, 1),
    }


def run_rig(index: int, *, seed: int, log: bool = False) -> Row:
    """Record, identify and score a rig.

    Args:
        index: Number of the rig in the set.
        log: Whether to print the progress of the identification.
    """
    session = draw_rig(seed, index).record()
    result, seconds = timed_identification(session.recordings, BUILTIN_MACHINES["hframe"](), log=log)
    return score_rig(session, result, seconds["cpu"])


def summary(rows: list[Row]) -> Row:
    """Count false names and right hints."""
    return {
        "rigs": len(rows),
        "families": len({row["family"] for row in rows}),
        "false_names": sum(len(row["false"]) for row in rows),
        "rigs_with_false_names": sum(bool(row["false"]) for row in rows),
        "false_verdicts": sum(row["false_verdict"] for row in rows),
        "hints_at_component": sum(row["hint"]["right_component"] for row in rows),
        "hints_right": sum(row["hint"]["right"] for row in rows),
        "within_budget": sum(row["cpu_seconds"] <= BUDGET_CPU_S for row in rows),
        "cpu_seconds": {
            "median": float(np.median([row["cpu_seconds"] for row in rows])),
            "most": max(row["cpu_seconds"] for row in rows),
        },
    }


def show(console: Console, rows: list[Row]) -> None:
    """Print the table of all rigs and the counts."""
    table = Table("rig", "hidden", "loop", "verdict", "false", "unseen / noise", "hint", "", "cpu s")
    for row in rows:
        hint = row["hint"]
        table.add_row(
            row["rig"],
            row["hidden"],
            "closed" if row["closed_loop"] else "open",
            " + ".join(row["named"]) or row["verdict"],
            " + ".join(row["false"]) or ("verdict" if row["false_verdict"] else ""),
            f"{row['unseen']['before']:.3g} -> {row['unseen']['after']:.3g}",
            f"{hint['component']}: {hint['variable']}",
            "right" if hint["right"] else "component" if hint["right_component"] else "WRONG",
            f"{row['cpu_seconds']:.0f}",
        )
    console.print(table)
    console.print(summary(rows))


def main() -> None:
    """Identify the rigs that the command line names, print the table and write the results."""
    parser = command_line(__doc__)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=COUNT, help="number of rigs of the set")
    parser.add_argument(
        "--only", type=int, nargs="+", metavar="INDEX", help="only these rigs; nothing is written"
    )
    add_rig_options(parser)
    arguments = parser.parse_args()
    indices = arguments.only or list(range(arguments.count))
    console, rows = Console(width=200), []
    rigs = {draw_rig(arguments.seed, index).name: index for index in indices}
    cache = RowCache(CACHE, source_key(*RIG_SOURCES, "benchmarks/outside_library.py"))
    run = partial(run_rig, seed=arguments.seed, log=arguments.log)
    for row in cache.complete(run, rigs, jobs=arguments.jobs):
        print(f"{row['rig']} {row['hidden']} -> {' + '.join(row['named']) or row['verdict']}", flush=True)
        rows.append(row)
    show(console, rows)
    if not arguments.only:
        content = {"summary": summary(rows), "rigs": rows}
        write_results(f"outside_library_{arguments.seed}", content, seed=arguments.seed)


if __name__ == "__main__":
    main()
