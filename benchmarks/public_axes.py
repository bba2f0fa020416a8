"""Is a user with real logs ever worse off than with a plain fit? Public recordings of motors and axes.

    python -m benchmarks.public_axes                          # all four
    python -m benchmarks.public_axes --only odrive --log      # some of them; nothing is written

The recordings are those of $HFRAME_DATA/public_axes; without them, the benchmark says so and ends. Each folder has
``runs`` and the ``machine.json`` that a newcomer wrote. The error to beat is that of an inverse-dynamics fit, refined
as an output-error fit of inertia, viscous and dry friction and an offset, which somebody else computed on the same
held-out runs. No licenses permit shipping the recordings.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.results_file import data_root, write_results
from hframe_gym.identification import identify
from hframe_gym.identification.validate.machine_errors import ModelEvaluation
from hframe_gym.recordings import load_machine, load_recordings


class PublicSet(NamedTuple):
    """A set of recordings.

    Attributes:
        machine: What was recorded.
        source: Where it was published.
        held_out: Runs to evaluate on; empty for the default.
        plain_error: Error of the fit to beat on these runs, in the unit of the sensor.
    """

    machine: str
    source: str
    held_out: tuple[str, ...]
    plain_error: float


SETS = {
    "swerve": PublicSet("drive of a swerve robot", "Eaglestrike/2023-RobotCode", (), 0.0142),
    "odrive": PublicSet(
        "motor at an ODrive", "labmrd/odrive-with-motor-characterization", ("chirp4", "step4"), 0.73
    ),
    "measured_current": PublicSet("motor with measured current", "lvjonok/mujoco-sysid", ("traj_4",), 17.6),
    "l298": PublicSet(
        "geared motor at an L298N",
        "Piyushiitk24/dc-motor-signed-bias-deadzone-id-control",
        ("run_minimal_05", "run_minimal_07"),
        7.46,
    ),
}


def run_set(folder: Path, public: PublicSet, *, log: bool = False) -> dict[str, Any]:
    """Identify one set.

    Args:
        folder: Folder with machine.json and runs.
        public: The set.
        log: Whether to print the progress of the identification, with the processor time.

    Returns:
        The row of the results, as plain data.
    """
    declared = load_machine(str(folder / "machine.json"))
    recordings = load_recordings(folder / "runs", declared)
    began = time.process_time()

    def print_line(line: str) -> None:
        print(f"{time.process_time() - began:7.1f} {line}", flush=True)

    result = identify(recordings, declared, held_out=public.held_out, log=print_line if log else None)
    seconds = time.process_time() - began
    report = result.as_json()
    after = _error(result.after)
    return {
        "set": folder.name,
        "machine": public.machine,
        "source": public.source,
        "unit": next(iter(declared.output_channels)).rpartition("_")[2],
        "held_out": [run.name for run in result.held_out.runs],
        "verdict": result.verdict,
        "named": [f"{e['name']}@{e['site']}" for e in report["effects"]],
        "hint": report["hint"],
        "unfinished": report["unfinished"],
        "errors": {
            "declared": _error(result.declared),
            "plain": None if result.plain is None else _error(result.plain.evaluation),
            "before": _error(result.before),
            "after": after,
            "reference": public.plain_error,
        },
        "plain_delivered": bool(result.plain and result.plain.delivered),
        "ratio": None if after is None else after / public.plain_error,
        "cpu_seconds": round(seconds, 1),
    }


def _error(evaluation: ModelEvaluation) -> float | None:
    """Return the simulation error on the held-out runs, m or rad; None if the machine diverges."""
    (error,) = evaluation.held_out.channels.values()  # each of these machines has one sensor
    return error.rmse


def show(console: Console, rows: list[dict[str, Any]]) -> None:
    """Print the table of all sets."""
    stages = ("declared", "plain", "before", "after", "reference")
    table = Table("set", "verdict", "named", *stages, "ratio", "cpu s")
    for r in rows:
        errors = (
            "-" if r["errors"][stage] is None else f"{r['errors'][stage]:.3g} {r['unit']}" for stage in stages
        )
        ratio = "-" if r["ratio"] is None else f"{r['ratio']:.2f}"
        table.add_row(
            r["set"], r["verdict"], ", ".join(r["named"]), *errors, ratio, f"{r['cpu_seconds']:.0f}"
        )
    console.print(table)
    ratios = [np.inf if r["ratio"] is None else r["ratio"] for r in rows]
    console.print(
        f"error over that of the fit to beat: median {np.median(ratios):.2f}, largest {max(ratios):.2f}"
    )


def main() -> None:
    """Identify the sets that the command line names, print the table and write the results."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", nargs="+", metavar="SET", choices=tuple(SETS))
    parser.add_argument("--log", action="store_true", help="print the progress of each identification")
    arguments = parser.parse_args()
    data = data_root() / "public_axes"
    if not data.is_dir():
        sys.exit("skipped: no folder public_axes in $HFRAME_DATA")
    console, rows = Console(width=170), []
    for name in arguments.only or SETS:
        rows.append(run_set(data / name, SETS[name], log=arguments.log))
        console.print(json.dumps(rows[-1]), highlight=False, markup=False, soft_wrap=True)
    show(console, rows)
    if not arguments.only:
        write_results("public_axes", {"sets": rows}, seed=None)


if __name__ == "__main__":
    main()
