"""Equal time steps for logs whose stamps jitter although the machine was sampled regularly.

A controller measures and commands at equal steps; its messages are stamped when they arrive. A stamp that is late by
0.1 ms at 0.5 m/s looks like an error of 50 um, many times the resolution of an encoder. Motion is smooth, so that the
measurements tell which times are true: those at which their fifth differences are smaller.
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np

from ..arrays import Array
from ..machine import Machine
from ..recordings import Recording
from .clock_jitter import MIN_JITTER_ROWS, smooth_speed

# Mean squared fifth difference at the stamps / that at equal steps, of the sensor that shows the difference best. Only
# noise is left where stamps are as good as equal steps (1); 100 us of jitter reach 100 with the encoders of a stage.
_ROUGHER = 2.0
_FAST = 75.0  # percentile of the speed beyond which errors of the times show
# Sampling periods; stamps that are farther from equal steps have another cause, such as a slow clock.
_FARTHEST = 0.5


class RegularClock(NamedTuple):
    """Times of a run whose stamps jitter.

    Attributes:
        time_s: Times in equal steps, s, shape (n,).
        jitter_s: Standard deviation of the stamps around them, s.
    """

    time_s: Array
    jitter_s: float


def with_regular_clock(recording: Recording, machine: Machine) -> tuple[Recording, float]:
    """Replace stamps that jitter by equal steps, if the motion is smoother at these.

    Args:
        recording: Run as logged.

    Returns:
        Copy with other times, s, shape (n,), or the same object; and the standard deviation of the stamps, s, 0 if they
        are kept.
    """
    regular = _equal_steps(recording.time_s)
    if regular is None:
        return recording, 0.0
    ratios = [
        _roughness_ratio(recording.time_s, regular.time_s, values)
        for values, sensor in zip(recording.outputs.T, machine.sensors, strict=True)
        if sensor.of_position
    ]
    # Sensors agree: none may be as much smoother at the stamps.
    if not ratios or max(ratios) < _ROUGHER or min(ratios) < 1.0 / _ROUGHER:
        return recording, 0.0
    return dataclasses.replace(recording, time_s=regular.time_s), regular.jitter_s


def _equal_steps(time_s: Array) -> RegularClock | None:
    """Return equal steps through the stamps, with gaps of whole steps; None if the stamps are no such steps."""
    if len(time_s) < MIN_JITTER_ROWS:
        return None
    steps = np.diff(time_s)
    numbers = np.concatenate([[0.0], np.cumsum(np.rint(steps / np.median(steps)))])
    if not np.all(np.diff(numbers) >= 1.0):
        return None
    period, first = np.polyfit(numbers, time_s - time_s[0], 1)
    regular = time_s[0] + first + period * numbers
    errors = time_s - regular
    if np.abs(errors).max() > _FARTHEST * period:
        return None
    return RegularClock(regular, float(errors.std()))


def _roughness_ratio(stamps: Array, regular: Array, values: Array) -> float:
    """Return how much rougher fast motion of a sensor is if the stamps are true than if the steps are equal."""
    measured = np.isfinite(values)
    if np.count_nonzero(measured) < MIN_JITTER_ROWS:
        return 1.0
    values, stamps, regular = values[measured], stamps[measured], regular[measured]
    speed = smooth_speed(regular, values)
    fast = np.abs(speed[2:-3]) > np.percentile(np.abs(speed), _FAST)
    if not fast.any():
        return 1.0
    at_stamps, at_steps = (
        float(np.median(np.diff(candidate, n=5)[fast] ** 2))
        for candidate in (values + speed * (regular - stamps), values)
    )
    return at_stamps / at_steps if at_steps > 0.0 else 1.0
