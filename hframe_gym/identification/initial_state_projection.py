"""What of a residual an unknown start explains: the stretch that friction holds in the belts when a run begins.

Encoders behind belts do not tell it beyond their quantum, and in free run it stays in the motion.  Its effect on the
readings is one column for each such coordinate and run; with a prior of the size that friction can hold, it is taken
out of residuals and Jacobians alike (variable projection, Golub and Pereyra 1973).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..machine import Machine
from .dataset import Dataset, PreparedRecording
from .prediction import Mode, initial_state_of_run, predict, residuals

Array = NDArray[np.float64]
# Share of the motors' Coulomb level that typically stays in the belts.
_HELD = 0.1


class Projection(NamedTuple):
    """Takes the columns' directions (m, k) out of residuals, each by its weight (k,) between 0 and 1."""

    directions: Array
    weights: Array

    def __call__(self, left: Array) -> Array:
        """Residuals (B, m) whose squares are the costs with the best start."""
        return left - (left @ self.directions) * self.weights @ self.directions.T


def held_stretch(machine: Machine) -> dict[str, float]:
    """By rotary coordinate with a sensor: the angle that friction typically holds in the belts, rad."""
    if not machine.belts:
        return {}
    stiffness = float(np.mean([b.EA / b.rest_length for b in machine.belts]))
    seen = {s.coordinate for s in machine.sensors}
    return {
        c.name: max(_HELD * c.coulomb / c.radius**2 / stiffness, 1e-6)
        for c in machine.coordinates
        if c.kind == "rotary" and c.name in seen and c.name not in machine.sprung
    }


def projection(
    machine: Machine, run: PreparedRecording, data: Dataset, mode: Mode, longest_step: float, rows: int = 1
) -> Projection | None:
    """The projection of a run in free run; None where the start is forgotten or known.  rows: as of the residuals."""
    stretch = held_stretch(machine) if mode == "free" else {}
    if not stretch:
        return None
    start = initial_state_of_run(machine, run)
    starts = np.tile(start, (len(stretch) + 1, 1))
    for k, (name, size) in enumerate(stretch.items(), start=1):
        starts[k, machine.coordinate_names.index(name)] += size
    motion = predict(machine, run, mode, period=data.period, start=starts, longest_step=longest_step)
    left = residuals(run, data, motion.readings, rows)
    columns = (left[1:] - left[0]).T
    if not np.all(np.isfinite(columns)):
        return None
    directions, sizes, _ = np.linalg.svd(columns, full_matrices=False)
    return Projection(directions, 1.0 - 1.0 / np.sqrt(1.0 + sizes**2))
