"""At rest belts and dry friction hold what pulls at the carriage: where that puts the pulleys."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..machine import Machine, rest_state
from ..machine.linearization import stiffness_matrix
from .effect_perturbation import MotionRecord, effects_force

Array = NDArray[np.float64]
_ROW_S = 1e-3


def static_equilibrium(machine: Machine, start: Array) -> Array:
    """Positions (coordinates,) at rest with the tool at `start`, under what the machine's effects do there.

    start: positions of the machine's first coordinates, the linear ones among them.  What friction alone can hold has
    not stretched the belts; by what it cannot the carriage has swung, as far beyond where the belts hold the rest as
    before, or until they hold all of it.
    """
    names = machine.coordinate_names
    linear = np.array([c.kind == "linear" for c in machine.coordinates])
    known = start[: len(names)]
    position = rest_state(machine, known[linear[: len(known)]])[: len(names)]
    if not any(e.definition.force for e in machine.effects):
        return position
    force = _at_rest(machine, position)[linear]
    friction = np.array([c.coulomb for c in machine.coordinates])[linear]
    rotary = ~linear & ~np.isin(names, machine.sprung)
    pull = stiffness_matrix(machine, position)[np.ix_(linear, rotary)]
    held = np.sign(force) * np.clip(2.0 * (np.abs(force) - friction), 0.0, np.abs(force))
    position[rotary] += np.linalg.lstsq(pull, held, rcond=None)[0]
    return position


def _at_rest(machine: Machine, position: Array) -> Array:
    """Force of the effects on each coordinate (coordinates,) of a machine that stands still, own units."""
    still = np.tile(position, (2, 1))
    at_rest = MotionRecord(
        np.array([0.0, _ROW_S]),
        np.zeros((2, len(machine.drives))),
        still,
        np.zeros_like(still),
        np.zeros((2, len(machine.sensors))),
    )
    return effects_force(machine, at_rest)[0]
