"""The shortest possible times of the moves of `gap-v1`, on the plants.

    python -m benchmarks.gap bounds

The time-optimal control problem is solved for the machine of the package with the true parameters of the
plant and those of its undeclared effects that the problem supports (docs/bound.md); other effects and the
residue are left out. Such an effect changes what is possible by little against what controllers lose, but a
bound without it is an approximation: the file names what is left out. Moves that are not solved have no
bound.
"""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.gap.plants import GapPlant
from hframe_gym.errors import InputError
from hframe_gym.evaluation import BANDS, BOUND_BAND
from hframe_gym.files import write_text
from hframe_gym.machine import Machine
from tests.reference_simulator import Array
from tests.rigs.outside_effects import OutsideEffect

MOVES = 4  # of each plant, the first ones, whose bounds are computed: each takes half a second or more
FOLDER = Path(__file__).parent / "bounds"


@cache
def stored_bounds(seed: int) -> dict[int, Array]:
    """Load the shortest possible times of a set of plants.

    Returns:
        Times of the moves, s, NaN where unknown, shape (B,), by the number of the plant.
    """
    return {row["plant"]: np.array(row["times_s"], np.float64) for row in rows(seed)}


def rows(seed: int) -> list[dict[str, Any]]:
    """Load what `compute` has returned for a set of plants.

    Returns:
        Results by plant; empty if there are none.
    """
    file = FOLDER / f"{seed}.json"
    return list(json.loads(file.read_text("utf-8"))["plants"]) if file.is_file() else []


def compute(plant: GapPlant, start: Array, goal: Array) -> dict[str, Any]:
    """Compute the bounds of the first `MOVES` moves on a plant.

    Args:
        start: Starts, m, shape (B, 2).
        goal: Goals, m, shape (B, 2).

    Returns:
        By key: "plant", "left_out" (labels of effects) and "times_s" (None where unknown), as plain data.
    """
    from hframe_gym.controllers.planning.time_optimal import TimeOptimalReach

    solver, machine = None, plant.near_machine
    while solver is None:
        try:
            solver = TimeOptimalReach(machine, band=BANDS[BOUND_BAND])
        except InputError:
            machine = without_unsupported(machine)
    present = {effect.name for effect in machine.effects}
    left_out = [e.label for e in plant.effects if isinstance(e, OutsideEffect) or e.name not in present]
    motions = [solver.solve(a, b) for a, b in zip(start[:MOVES], goal[:MOVES], strict=True)]
    times = [round(m.time_s, 6) if m.solved else None for m in motions]
    times += [None] * (len(start) - len(times))
    return {"plant": plant.index, "left_out": left_out, "times_s": times}


def without_unsupported(machine: Machine) -> Machine:
    """Return a machine without one effect: one that the solver does not support.

    Args:
        machine: Machine with effects that are not supported.

    Raises:
        InputError: If the machine has no effect.
    """
    from hframe_gym.controllers.models.casadi_model import check_supported

    if not machine.effects:
        raise InputError(f"machine {machine.name!r} is not supported without effects either")
    for effect in reversed(machine.effects):
        reduced = machine.replace(effects=tuple(e for e in machine.effects if e is not effect))
        try:
            check_supported(reduced)
        except InputError:
            continue
        return reduced
    return machine.replace(effects=machine.effects[:-1])  # several are not supported


def write(seed: int, plants: list[dict[str, Any]]) -> None:
    """Write the bounds of a set of plants.

    Args:
        plants: Results of `compute`.
    """
    lines = ",\n".join(json.dumps(row) for row in sorted(plants, key=lambda row: row["plant"]))
    write_text(FOLDER / f"{seed}.json", f'{{"band_m": {BANDS[BOUND_BAND]}, "plants": [\n{lines}\n]}}\n')
