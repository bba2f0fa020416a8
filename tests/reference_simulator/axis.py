"""Simulate one driven axis with dry friction in steps of 10 us, with what its drive and its sensors do.

It shares no code with `hframe_gym`. The impulse of dry friction in a step is the one, at most h F, that
brings the speed closest to zero, so that the axis sticks and slides without events. The error is of first
order in the step.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from tests.reference_simulator.rig import Array

STEP_S = 1e-5


@dataclass(frozen=True)
class Servo:
    """A position controller (0: none) around a PI speed controller, which stops its integral in saturation.

    Attributes:
        position_gain: Commanded speed per error of the position, 1/s; 0 if the command is a speed, rad/s.
        largest_speed: Limit of that speed, rad/s.
        speed_gain: Torque of the motor per error of its speed, Nms.
        reset_time: Integral time of the PI controller, s.
        largest_torque: Of the motor, Nm.
        gear: Turns of the motor per turn of the axis.
        dead_band: Half the width of the range in which errors of the position hardly count, rad.
    """

    position_gain: float = 0.0
    largest_speed: float = float("inf")
    speed_gain: float = 0.01
    reset_time: float = float("inf")
    largest_torque: float = float("inf")
    gear: float = 1.0
    dead_band: float = 0.0

    def torque(self, command: float, q: float, v: float, integral: float) -> tuple[float, float]:
        """Return the torque of the motor, Nm, and the rate of the integral, rad/s."""
        target = command
        if self.position_gain:
            missing = command - q
            if self.dead_band:
                missing -= self.dead_band * math.tanh(missing / self.dead_band)
            target = max(-self.largest_speed, min(self.largest_speed, self.position_gain * missing))
        error = target - v
        wanted = self.gear * self.speed_gain * (error + integral / self.reset_time)
        given = max(-self.largest_torque, min(self.largest_torque, wanted))
        return given, error if given == wanted or wanted * error <= 0.0 else 0.0


@dataclass(frozen=True)
class Stepper:
    """A stepper motor with 200 full steps per turn.

    Attributes:
        holding: Holding torque, Nm.
        gear: Turns of the motor per turn of the axis.
    """

    holding: float
    gear: float = 1.0

    def torque(self, command: float, q: float, v: float, integral: float) -> tuple[float, float]:
        """Return the torque of the motor, Nm, and zero, because nothing is integrated."""
        full_steps = self.gear * (command - q) * 200.0 / (2.0 * np.pi)
        return self.holding * float(np.sin(0.5 * np.pi * full_steps)), 0.0


@dataclass(frozen=True)
class Gap:
    """A load behind the gap of a gear; the axis's inertia and friction are then those before the gap, SI.

    Attributes:
        half: Half the gap, rad.
        stiffness: Of the teeth, Nm/rad.
        damping: Of the teeth where they touch, Nms; they never pull.
        inertia: Of the load, kg m^2.
        viscous: Viscous friction of the load, Nms.
        coulomb: Dry friction of the load, Nm.
    """

    half: float
    stiffness: float
    damping: float
    inertia: float
    viscous: float
    coulomb: float

    def torque(self, twist: float, rate: float) -> float:
        """Return the teeth's torque on the load, Nm, for a twist, motor - load, rad, and its rate, rad/s."""
        pressed = abs(twist) - self.half
        if pressed <= 0.0:
            return 0.0
        side = 1.0 if twist > 0.0 else -1.0
        return side * max(self.stiffness * pressed + self.damping * side * rate, 0.0)


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
        servo: Servo or stepper motor that follows the command, in place of the motor and its amplifier.
        gap: Gap of a gear between the axis and its load.
    """

    inertia: float = 2e-4
    viscous: float = 1e-4
    coulomb: float = 0.004
    torque_constant: float = 0.03
    resistance: float = 1.5
    bandwidth_hz: float = 0.0
    limit_A: float = float("inf")
    servo: Servo | Stepper | None = None
    gap: Gap | None = None


class Record(NamedTuple):
    """What happens at the rows of a record, just before the command of the row acts; shape (n,) each.

    Attributes:
        time_s: Times, s.
        command: Command that is held until the next row, V, A, or rad or rad/s for a servo.
        position: Angle, rad.
        speed: rad/s.
        acceleration: rad/s^2.
        current: A; with a servo, the torque of the motor, Nm.
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
    q = v = sent = acceleration = lagged = integral = 0.0
    load_q = load_v = teeth = 0.0
    torque_per_amp = axis.servo.gear if axis.servo else axis.torque_constant
    decay = np.exp(-2.0 * np.pi * axis.bandwidth_hz * h)
    table = np.empty((rows, 5))

    def amps() -> float:
        """Return the current of the motor, A, or the torque of a servo's motor, Nm."""
        if axis.servo:
            return axis.servo.torque(sent, q, v, integral)[0]
        if axis.bandwidth_hz:
            return min(max(lagged, -axis.limit_A), axis.limit_A)
        return (sent - axis.torque_constant * v) / axis.resistance

    for row in range(rows):
        current = amps()
        force = torque_per_amp * current - axis.viscous * v - teeth
        if row:
            held = min(max(force, -axis.coulomb), axis.coulomb) if v == 0.0 else np.copysign(axis.coulomb, v)
            acceleration = (force - held) / axis.inertia
        sent = command(row)
        table[row] = sent, q, v, acceleration, current
        for _ in range(steps):
            lagged = sent + (lagged - sent) * decay
            torque = torque_per_amp * amps() - axis.viscous * v
            if axis.servo:
                integral += h * axis.servo.torque(sent, q, v, integral)[1]
            if gap := axis.gap:
                # In the middle of the step, so that the teeth neither gain nor lose energy.
                teeth = gap.torque(q - load_q + 0.5 * h * (v - load_v), v - load_v)
                torque -= teeth
                load_after = braked(
                    load_v + h * (teeth - gap.viscous * load_v) / gap.inertia, h * gap.coulomb / gap.inertia
                )
                load_q += h * 0.5 * (load_v + load_after)
                load_v = load_after
            after = braked(v + h * torque / axis.inertia, h * axis.coulomb / axis.inertia)
            q += h * 0.5 * (v + after)
            v = after
    return Record(np.arange(rows) * period_s, *table.T)


def braked(speed: float, change: float) -> float:
    """Return a speed after dry friction, which changes it by at most `change` and not beyond zero."""
    return speed - change if speed > change else speed + change if speed < -change else 0.0


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
