"""Does identification hold on the rigs of somebody else's simulator? Names, and errors on unseen runs.

    python -m benchmarks.other_simulator_rigs                       # all fourteen
    python -m benchmarks.other_simulator_rigs --only 1 7 --log      # some of them; nothing is written

benchmarks/data/other_simulator/README.md describes the rigs. `TRUTH` translates what they hide to the
library's names. Results are cached in out/other_simulator_rigs as those of benchmarks.random_rigs are.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from benchmarks.results_file import write_results
from benchmarks.rig_score import identify_rig, unseen_errors
from benchmarks.row_cache import RowCache, source_key
from hframe_gym.machine import BUILTIN_MACHINES
from tests.rigs.random_effects import DrawnEffect
from tests.rigs.random_rigs import describe_effects
from tools.command_line import add_rig_options, command_line
from tools.repository import ROOT

DATA = ROOT / "benchmarks" / "data" / "other_simulator"
CACHE = Path("out/other_simulator_rigs")
_SOURCES = ("benchmarks/other_simulator_rigs.py", "benchmarks/rig_score.py", "benchmarks/scoring.py")
_WARM_UP = ("friction_warm_up@machine", *(f"smooth_friction[time]@{c}" for c in ("x", "y", "phi1", "phi2")))


def _unchanged(rig: Any, sensors: Any) -> Any:
    """Return a rig and its sensors as they are: these effects are in the data already."""
    return rig, sensors


def hidden(label: str, *accepted: str, absorbed: bool = False) -> DrawnEffect:
    """Return a hidden effect; `accepted` labels identify one outside the library, besides `unexplained`."""
    name, site = label.split("@")
    outside = (*accepted, "") if accepted else ()
    return DrawnEffect(name, site, 1.0, _unchanged, {}, {}, accepted=outside, absorbed=absorbed)


TRUTH: dict[int, tuple[DrawnEffect, ...]] = {
    1: (),
    2: (),
    3: (hidden("stribeck_friction@y"),),
    4: (hidden("gain_mismatch@motor2", absorbed=True), hidden("voltage_offset@motor1")),
    5: (hidden("cogging@motor1"),),
    # Coulomb friction that differs by direction is a constant force beside the mean friction.
    6: (hidden("input_delay@drives"), hidden("constant_force@x")),
    7: (hidden("bridge_yaw@machine"),),
    8: (hidden("cable with memory@x", "presliding@x", "*hysteresis*@x", "*memory*@x", "*dahl*@x"),),
    9: (hidden("frame resonance@x_m", "*frame*", "*mode*", "*resonance*"),),
    10: (hidden("sensor_range@x_m"), hidden("sensor_range@y_m"), hidden("eccentric_pulley@motor2")),
    11: (hidden("belt_play@belts"), hidden("stribeck_friction@x")),
    12: (hidden("quadratic_drag@x"), hidden("voltage_offset@motor2")),
    13: (hidden("magnetic catch@x", "smooth_force[position of x]@x"),),
    14: (hidden("warm-up@machine", *_WARM_UP),),
}


def run_rig(number: int, *, log: bool = False) -> dict[str, Any]:
    """Identify and score a rig.

    Args:
        number: Number of the rig, from 1.
        log: Whether to print the progress of the identification.
    """
    declared = BUILTIN_MACHINES["hframe"]()
    answer = identify_rig(DATA / f"rig_{number:02d}", declared, TRUTH[number], log=log)
    return {
        **answer.row,
        "truth": describe_effects(TRUTH[number]),
        "unseen": {name: unseen_errors(machine, answer.unseen) for name, machine in answer.machines.items()},
        "seconds": answer.seconds,
    }


def show(console: Console, rows: list[dict[str, Any]]) -> None:
    """Print the table of all rigs."""
    table = Table("rig", "hidden", "residue", "named", "", "unseen / noise", "s", "cpu s")
    for r in rows:
        marks = ("" if r["complete"] else "missed ") + ("extra" if r["extra"] else "")
        table.add_row(
            r["rig"],
            r["hidden"],
            "yes" if r["residue"] else "",
            " + ".join(r["named"]) or r["verdict"],
            marks or "right",
            f"{r['unseen']['before']['mean']:.3g} -> {r['unseen']['after']['mean']:.3g}",
            *(f"{r['seconds'][clock]:.0f}" for clock in ("wall", "cpu")),
        )
    console.print(table)


def main() -> None:
    """Identify the rigs that the command line names, print the table and write the results."""
    parser = command_line(__doc__)
    parser.add_argument("--only", type=int, nargs="+", metavar="NUMBER", choices=tuple(TRUTH))
    add_rig_options(parser)
    arguments = parser.parse_args()
    console, rows = Console(width=170), []
    rigs = {f"rig_{number:02d}": number for number in arguments.only or TRUTH}
    cache = RowCache(CACHE, source_key(*_SOURCES))
    for row in cache.complete(partial(run_rig, log=arguments.log), rigs, jobs=arguments.jobs):
        print(f"{row['rig']}: {row['truth']} -> {' + '.join(row['named']) or row['verdict']}", flush=True)
        rows.append(row)
    show(console, rows)
    if not arguments.only:
        write_results("other_simulator_rigs", {"rigs": rows}, seed=None)


if __name__ == "__main__":
    main()
