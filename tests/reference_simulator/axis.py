"""Simulate one driven axis with dry friction in steps of 10 us, with what its drive and its sensors do.

It shares no code with `hframe_gym`. The impulse of dry friction in a step is the one, at most h F, that brings the
speed closest to zero, so that the axis sticks and slides without events. The error is of first order in the step.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from tests.reference_simulator.rig import Array

STEP_S = 1e-5


@dataclass(frozen=True)
class Axis:
    """Parameters of the axis and of its drive, SI; positions in rad.

    Attributes:
        inertia: Moment of inertia, kg m^2.
        viscous: Viscous friction, Nms.
        coulomb: Dry friction, Nm.
        torque_constant: Nm/A; also the back-EMF constant, Vs/rad.
        resistance: Of the motor, ohm.
        bandwidth_hz: Of an amplifier that controls the current; 0 for one that applies the commanded voltage.
        limit_A: Largest current of such an amplifier.
    """

    inertia: float = 2e-4
    viscous: float = 1e-4
    coulomb: float = 0.004
    torque_constant: float = 0.03
    resistance: float = 1.5
    bandwidth_hz: float = 0.0
    limit_A: float = float("inf")


class Record(NamedTuple):
    """What happens at the rows of a record, just before the command of the row acts; shape (n,) each.

    Attributes:
        time_s: Times, s.
        command: Command that is held until the next row, V or A.
        position: Angle, rad.
        speed: rad/s.
        acceleration: rad/s^2.
        current: A.
    """

    time_s: Array
    command: Array
    position: Array
    speed: Array
    acceleration: Array
    current: Array


def record(axis: Axis, command: Callable[[int], float], rows: int, period_s: float) -> Record:
    """Record an axis that is at rest at first.

    Args:
        axis: The axis.
        command: Function from the number of a row to the command that is held until the next row, V or A.
        rows: Number of rows.
        period_s: Time between two rows, s; a multiple of 10 us.
    """
    steps, h = round(period_s / STEP_S), STEP_S
    q = v = sent = acceleration = lagged = 0.0
    decay = np.exp(-2.0 * np.pi * axis.bandwidth_hz * h)
    table = np.empty((rows, 5))

    def amps() -> float:
        """Return the current of the motor, A."""
        if axis.bandwidth_hz:
            return min(max(lagged, -axis.limit_A), axis.limit_A)
        return (sent - axis.torque_constant * v) / axis.resistance

    for row in range(rows):
        current = amps()
        force = axis.torque_constant * current - axis.viscous * v
        if row:
            held = min(max(force, -axis.coulomb), axis.coulomb) if v == 0.0 else np.copysign(axis.coulomb, v)
            acceleration = (force - held) / axis.inertia
        sent = command(row)
        table[row] = sent, q, v, acceleration, current
        for _ in range(steps):
            lagged = sent + (lagged - sent) * decay
            torque = axis.torque_constant * amps() - axis.viscous * v
            free = v + h * torque / axis.inertia
            impulse = h * axis.coulomb / axis.inertia
            after = free - impulse if free > impulse else free + impulse if free < -impulse else 0.0
            q += h * 0.5 * (v + after)
            v = after
    return Record(np.arange(rows) * period_s, *table.T)


def held_levels(seed: int, rows: int, hold: int, largest: float, at_rest: int = 50) -> Callable[[int], float]:
    """Return a command of random levels that are held for some rows, after rows of zero at the beginning.

    Args:
        seed: Seed of the levels.
        rows: Number of rows.
        hold: Number of rows for which a level is held.
        largest: Largest magnitude of a level.
        at_rest: Number of rows of zero at the beginning.
    """
    levels = np.random.default_rng(seed).uniform(-largest, largest, rows // hold + 1)
    return lambda row: 0.0 if row < at_rest else float(levels[(row - at_rest) // hold])
