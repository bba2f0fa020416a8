"""Former place of effects along a motion, until all packages use `hframe_gym.dynamics.effect_forces`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..dynamics import effect_forces
from ..machine import Effect, Machine

Array = NDArray[np.float64]


class MotionRecord(NamedTuple):
    """Motion of a machine: arguments of `dynamics.effect_forces` and the measurements."""

    time_s: Array
    inputs: Array
    positions: Array
    velocities: Array
    measurements: Array


def effects_force(machine: Machine, motion: MotionRecord) -> Array:
    """Call `dynamics.effect_forces` instead."""
    return effect_forces(machine, motion.time_s, motion.positions, motion.velocities, motion.inputs)


def variable(machine: Machine, definition: Effect, motion: MotionRecord) -> Array:
    """Return the variable of a tabulated effect along a motion, shape (n,)."""
    what, _, coordinate = definition.against.partition(" of ")
    if what in ("", "time"):
        return motion.time_s
    i = machine.coordinate_names.index(coordinate)
    if what == "velocity":
        return motion.velocities[:, i]
    if what == "path":
        return np.concatenate([[0.0], np.cumsum(np.abs(np.diff(motion.positions[:, i])))])
    return motion.positions[:, i]
