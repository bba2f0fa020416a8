"""Drives that follow a set point with an inner loop: servos, motor controllers in position or speed mode.

The loop is a cascade, as in industrial drives and ODrive: a proportional loop of the position commands a
speed, and a proportional-integral loop of the speed commands the torque u of the motor shaft. With the set
point r, the position q and the speed v of the coordinate and the gear ratio N,

    w = r for a drive of speeds, otherwise clip(position_gain (r - q), -speed_limit, speed_limit)
    u = clip(speed_gain N (w - v + integral_rate z), -torque_limit, torque_limit),    dz/dt = w - v

The integral z is held while it would drive the torque further beyond its limit (conditional integration).
Without the integral, the drive of positions is a proportional-derivative loop, as in hobby servos, with the
stiffness position_gain speed_gain N^2.

References:
    Ellis (2012), Control System Design Guide, chapters 6 and 17. Astrom and Hagglund (2006), Advanced PID
    Control, section 3.5 (windup).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

from typing_extensions import override

from ..dynamics.elementwise import absolute, copysign, maximum, minimum, where
from ..machine import DRIVE_KINDS, DriveKind, Effect, EffectParameter

UNLIMITED = 1e9  # m/s or rad/s, of a speed that no drive reaches
_SMALLEST_DIVISOR = 1e-30

_SPEED_LOOP = (
    EffectParameter("speed_gain", "Nms", 1e-12, 1e9, scale=1.0),
    EffectParameter("integral_rate", "1/s", 0.0, 1e6, scale=10.0),
    EffectParameter("torque_limit", "torque", 1e-12, 1e9, scale=1.0),
)


def _limited(value: Any, limit: Any) -> Any:
    """Return a value within [-limit, limit]."""
    return minimum(maximum(value, -limit), limit)


def _limited_mean(first: Any, last: Any, limit: Any) -> Any:
    """Return the mean of a value within [-limit, limit] while the unlimited value changes linearly.

    A step in which the limit is reached or left has another mean than its middle has value: at 0.25 ms, that
    shook a printer's tool by 0.07 m/s^2, half of an accelerometer's noise.
    """
    mean = 0.5 * (first + last)
    for direction in (1.0, -1.0):
        excess = [direction * value - limit for value in (first, last)]
        beyond = sum(maximum(value, 0.0) for value in excess)
        mean = mean - direction * 0.5 * beyond * beyond / maximum(
            sum(map(absolute, excess)), _SMALLEST_DIVISOR
        )
    return mean


def _wanted_torque(error: Any, z: Any, N: Any, speed_gain: Any, integral_rate: Any) -> Any:
    """Return the torque of the motor shaft that the loop of the speed wants for an error of the speed, Nm."""
    return speed_gain * N * (error + integral_rate * z)


def _next_integral(
    w: tuple[Any, Any, Any],
    z: Any,
    dq: Any,
    dt: Any,
    dv: Any,
    N: Any,
    speed_gain: Any,
    integral_rate: Any,
    torque_limit: Any,
) -> Any:
    """Return the speed error's integral, m or rad, after the time dt; w: begin, middle and end of the step.

    The wanted torque is taken as linear within the step. The integral grows in the part of the step in which
    the torque is within its limit; otherwise the time at which it is held would be known to a step only.
    """
    first, middle, last = w
    v = dq / maximum(dt, _SMALLEST_DIVISOR)
    change = middle * dt - dq
    direction = copysign(1.0, change)
    excess = [
        direction * _wanted_torque(error, integral, N, speed_gain, integral_rate) - torque_limit
        for error, integral in ((first - v + 0.5 * dv, z), (last - v - 0.5 * dv, z + change))
    ]
    within = sum(maximum(-value, 0.0) for value in excess)
    return z + change * within / maximum(sum(map(absolute, excess)), _SMALLEST_DIVISOR)


def _initial_spread(level, N, speed_gain, integral_rate):  # type: ignore[no-untyped-def]
    """Return the standard deviation of the integral at a run's start: it may hold against dry friction."""
    rate = speed_gain * N * N * integral_rate
    return where(integral_rate > 0.0, level / maximum(rate, _SMALLEST_DIVISOR), 0.0)


def _speed_torque(V, v, dv, z, N, speed_gain, integral_rate, torque_limit):  # type: ignore[no-untyped-def]
    """Return the mean torque of the motor shaft, Nm, of a drive that follows the speed V, m/s or rad/s."""
    first, last = (_wanted_torque(V - v - part * dv, z, N, speed_gain, integral_rate) for part in (-0.5, 0.5))
    return _limited_mean(first, last, torque_limit)


def _next_speed_integral(z, V, dq, dt, dv, N, speed_gain, integral_rate, torque_limit):  # type: ignore[no-untyped-def]
    """Return the integral of V - v, m or rad, after the time dt, s, and the travel dq, m or rad."""
    return _next_integral((V, V, V), z, dq, dt, dv, N, speed_gain, integral_rate, torque_limit)


def _position_torque(  # type: ignore[no-untyped-def]
    V, q, v, dq, dv, z, N, position_gain, speed_limit, speed_gain, integral_rate, torque_limit
):
    """Return the mean torque of the motor shaft, Nm, of a drive that follows the position V, m or rad."""

    def wanted(part: float) -> Any:
        w = _limited(position_gain * (V - q - part * dq), speed_limit)
        return _wanted_torque(w - v - part * dv, z, N, speed_gain, integral_rate)

    return _limited_mean(wanted(-0.5), wanted(0.5), torque_limit)


def _next_position_integral(  # type: ignore[no-untyped-def]
    z, V, q, dq, dt, dv, N, position_gain, speed_limit, speed_gain, integral_rate, torque_limit
):
    """Return the speed error's integral, m or rad, after the time dt, s, and the travel dq, m or rad."""
    w = tuple(_limited(position_gain * (V - q - part * dq), speed_limit) for part in (-0.5, 0.0, 0.5))
    return _next_integral(w, z, dq, dt, dv, N, speed_gain, integral_rate, torque_limit)


class _SetPointDrive(DriveKind):
    """What drives with an inner loop have in common: the torque is that of the motor shaft, without Kt."""

    fixed: ClassVar[Mapping[str, float]] = {"Kt": 1.0, "Ke": 0.0, "resistance": 1.0}
    largest = "torque_limit"
    unit_of_force = "speed_gain"

    @classmethod
    @override
    def damping(cls, gear_ratio: Any, law_parameters: Mapping[str, Any]) -> Any:
        return law_parameters["speed_gain"] * gear_ratio * gear_ratio


@DRIVE_KINDS.register("speed")
class SpeedDrive(_SetPointDrive):
    """A drive that follows a commanded speed of its coordinate, m/s or rad/s, by a PI loop."""

    command = "speed"
    defaults: ClassVar[Mapping[str, float]] = {"integral_rate": 0.0}
    law = Effect(
        name="speed_loop",
        family="drive_law",
        site="drive",
        formula="u = clip(speed_gain N (r - v + integral_rate z), +-torque_limit), dz/dt = r - v",
        source="Ellis 2012, Control System Design Guide, chapter 6",
        current=_speed_torque,
        next_state=_next_speed_integral,
        initial_spread=_initial_spread,
        signal_order=-1,
        parameters=_SPEED_LOOP,
    )


@DRIVE_KINDS.register("position")
class PositionDrive(_SetPointDrive):
    """A drive that follows a commanded position of its coordinate, m or rad, by a cascade of two loops."""

    command = "position"
    defaults: ClassVar[Mapping[str, float]] = {"integral_rate": 0.0, "speed_limit": UNLIMITED}
    law = Effect(
        name="position_loop",
        family="drive_law",
        site="drive",
        formula="w = clip(position_gain (r - q), +-speed_limit), then as for a speed w",
        source="Ellis 2012, Control System Design Guide, chapter 17",
        current=_position_torque,
        next_state=_next_position_integral,
        initial_spread=_initial_spread,
        signal_order=-1,
        parameters=(
            EffectParameter("position_gain", "1/s", 1e-9, 1e9, scale=10.0),
            EffectParameter("speed_limit", "speed", 1e-9, UNLIMITED, scale=1.0),
            *_SPEED_LOOP,
        ),
    )
