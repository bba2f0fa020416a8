"""Which settling times does physics allow in a protocol's moves? With free and 10 ms held voltages.

    python -m benchmarks.protocol_bounds reach-v1 --draws 128
    python -m benchmarks.protocol_bounds hard-v1 --draws 128

The bounds are stored in the package (hframe_gym/evaluation/bound_times_data/PROTOCOL.json), a few draws at a
time; stored ones are not computed again. Draws are taken in order from the first one, whatever their bounds.
A draw with an effect that the optimization does not support (docs/bound.md) has no bound, and the file says
why.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

import hframe_gym.evaluation
from benchmarks.held_voltages import HeldVoltageReach
from hframe_gym.controllers.planning.time_optimal import TimeOptimalReach
from hframe_gym.errors import InputError
from hframe_gym.evaluation import (
    BANDS,
    BOUND_BAND,
    EpisodeConditions,
    Protocol,
    acting_effects,
    episode_conditions,
    get_protocol,
    stored_bounds,
)
from hframe_gym.files import write_text
from hframe_gym.machine import Machine
from tools.command_line import command_line

FOLDER = Path(hframe_gym.evaluation.__file__).parent / "bound_times_data"
WRITE_EVERY = 4  # draws
Solvers = tuple[TimeOptimalReach | None, HeldVoltageReach]


def bounds(protocol: Protocol, count: int) -> list[dict[str, Any]]:
    """Compute and store the bounds of the first draws of a protocol.

    Args:
        protocol: Protocol with the part "reach".
        count: Number of draws.

    Returns:
        One row per draw: its number, `free_s` and `held_s`, s, or None with the reason in `status`.
    """
    file = FOLDER / f"{protocol.name}.json"
    rows = {row["draw"]: row for row in json.loads(file.read_text())["draws"]} if file.exists() else {}
    scenario = protocol.scenario("reach")
    conditions = episode_conditions(scenario)
    stored = stored_bounds(scenario).times_s
    solvers: dict[str, Solvers] = {}
    for draw in range(count):
        if draw in rows:
            continue
        known = None if stored is None or np.isnan(stored[draw]) else float(stored[draw])
        rows[draw] = {"draw": draw} | _bound(conditions, draw, known, solvers)
        print(json.dumps(rows[draw]), flush=True)
        if draw % WRITE_EVERY == WRITE_EVERY - 1 or draw == count - 1:
            _write(file, protocol, list(rows.values()))
    return list(rows.values())


def _bound(
    conditions: EpisodeConditions, draw: int, known: float | None, solvers: dict[str, Solvers]
) -> dict[str, Any]:
    """Return the bounds of a draw; `solvers` holds those of machines without effects of their own."""
    machine, values = conditions.machine, conditions.parameters[draw]
    if machine.effects:
        machine = acting_effects(machine, values)
        values = np.array(list(machine.parameters.values()))
    try:
        free, held = solvers.get(machine.name if not machine.effects else "", (None, None))
        held = held or HeldVoltageReach(machine, band=BANDS[BOUND_BAND])
        if known is None:
            free = free or _free(machine)
            motion = free.solve(conditions.start[draw], conditions.goal[draw], values)
            if not motion.solved:
                return {"free_s": None, "held_s": None, "status": motion.status}
            known = motion.time_s
    except InputError as error:
        return {"free_s": None, "held_s": None, "status": str(error).partition(": ")[2].partition(";")[0]}
    if not machine.effects:
        solvers[machine.name] = (free, held)
    motion = held.solve(conditions.start[draw], conditions.goal[draw], values, known)
    return {
        "free_s": round(known, 7),
        "held_s": round(motion.time_s, 7) if motion.solved else None,
        "status": motion.status,
    }


def _free(machine: Machine) -> TimeOptimalReach:
    """Return the solver with free voltages."""
    return TimeOptimalReach(machine, band=BANDS[BOUND_BAND])


def _write(file: Path, protocol: Protocol, rows: list[dict[str, Any]]) -> None:
    """Write the rows, completely or not at all."""
    lines = ",\n".join(json.dumps(row) for row in sorted(rows, key=lambda row: row["draw"]))
    head = {"schema": 1, "protocol": protocol.name, "digest": protocol.digest, "band_m": BANDS[BOUND_BAND]}
    write_text(file, f'{json.dumps(head)[:-1]}, "draws": [\n{lines}\n]}}\n')


def main() -> None:
    """Compute the bounds and print their means."""
    parser = command_line(__doc__)
    parser.add_argument("protocol")
    parser.add_argument("--draws", type=int, default=128)
    arguments = parser.parse_args()
    protocol = get_protocol(arguments.protocol)
    protocol.check()
    both = [row for row in bounds(protocol, arguments.draws) if row["held_s"] is not None]
    free, held = (float(np.mean([row[kind] for row in both])) for kind in ("free_s", "held_s"))
    print(
        f"{len(both)} draws with both bounds: free {free:.4f} s, held {held:.4f} s, ratio {held / free:.4f}"
    )


if __name__ == "__main__":
    main()
