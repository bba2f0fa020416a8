"""Do verdicts hold on rigs under a position controller? Names, errors on unseen runs, and time.

    python -m benchmarks.closed_loop_rigs                       # all eight
    python -m benchmarks.closed_loop_rigs --only 1 3 --log      # some of them; nothing is written

The recordings are those of $HFRAME_DATA/closed_loop_rigs; without them, the benchmark says so and ends. They
come from a simulator that shares no code with this package: a controller follows machine programs, and its
voltages saturate and pass a 12-bit converter. Each folder has ``runs`` to identify, ``unseen`` runs in open
loop to judge by, the declared ``machine.json``, and ``truth.json`` in words.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.other_simulator_rigs import hidden
from benchmarks.results_file import data_root, write_results
from benchmarks.rig_score import identify_rig, root_mean_square
from hframe_gym.arrays import Array
from hframe_gym.machine import Machine
from hframe_gym.parallel import map_tasks
from hframe_gym.recordings import Recording, load_machine
from tests.rigs.random_effects import DrawnEffect
from tools.command_line import add_rig_options, command_line

# What the rigs hide, in the names of the library. What it lacks has no right name: `unexplained`, or a table.
TRUTH: dict[int, tuple[DrawnEffect, ...]] = {
    1: (),
    2: (),
    3: (hidden("torque_saturation@drives"),),
    4: (),
    5: (hidden("input_delay@motor1"), hidden("input_delay@motor2")),
    6: (hidden("gear_backlash@motor1"), hidden("gear_backlash@motor2")),
    7: (hidden("dwell_friction@x"),),
    8: (hidden("stribeck_friction@x"),),
}


def run_rig(number: int, data: Path, *, log: bool = False) -> dict[str, Any]:
    """Identify a rig and compare the result with the truth.

    Args:
        number: Number of the rig, from 1.
        log: Whether to print the progress of the identification, with the processor time.
    """
    folder = data / f"rig_{number:02d}"
    declared = load_machine(str(folder / "machine.json"))
    answer = identify_rig(folder, declared, TRUTH[number], log=log)
    estimated = answer.result.held_out.noise
    noise = np.array([s.noise or value for s, value in zip(declared.sensors, estimated, strict=True)])
    report = answer.result.as_json()
    return {
        **answer.row,
        "hint": report.get("hint"),
        "unseen": {
            name: _mean_ratio(machine, answer.unseen, noise) for name, machine in answer.machines.items()
        },
        "unfinished": report.get("unfinished"),
        "cpu_seconds": round(answer.seconds["cpu"], 1),
    }


def _mean_ratio(machine: Machine, recordings: Sequence[Recording], noise: Array) -> float:
    """Return the simulation error over the sensors' noise, as declared if it is; mean over the channels."""
    return float(min(np.mean(root_mean_square(machine, recordings) / noise), 1e9))


def show(console: Console, rows: list[dict[str, Any]]) -> None:
    """Print the table of all rigs."""
    table = Table("rig", "hidden", "verdict", "named", "", "left", "unseen / noise", "cpu s")
    for r in rows:
        marks = ("" if r["complete"] else "missed ") + ("false name" if r["extra"] else "")
        table.add_row(
            r["rig"],
            r["hidden"],
            r["verdict"],
            " + ".join(r["named"]),
            marks or "right",
            "diverges" if r["left"] is None else f"{r['left']:.3g}",
            " -> ".join(f"{r['unseen'][stage]:.3g}" for stage in ("before", "after")),
            f"{r['cpu_seconds']:.0f}",
        )
    console.print(table)


def main() -> None:
    """Identify the rigs that the command line names, print the table and write the results."""
    parser = command_line(__doc__)
    parser.add_argument("--only", type=int, nargs="+", metavar="NUMBER", choices=tuple(TRUTH))
    add_rig_options(parser)
    arguments = parser.parse_args()
    data = data_root() / "closed_loop_rigs"
    if not data.is_dir():
        sys.exit("skipped: no folder closed_loop_rigs in $HFRAME_DATA")
    console, rows = Console(width=170), []
    run = partial(run_rig, data=data, log=arguments.log)
    for row in map_tasks(run, arguments.only or list(TRUTH), jobs=arguments.jobs):
        print(json.dumps(row), flush=True)
        rows.append(row)
    show(console, rows)
    if not arguments.only:
        write_results("closed_loop_rigs", {"rigs": rows}, seed=None)


if __name__ == "__main__":
    main()
