"""Equal time steps for logs whose stamps jitter although the machine was sampled regularly.

A controller measures and commands at equal steps; its messages are stamped when they arrive. A stamp that is
late by 0.1 ms at 0.5 m/s looks like an error of 50 um, many times the resolution of an encoder. Motion is
smooth, so that the measurements tell which times are true: those at which their fifth differences are
smaller.

Stamps in whole milliseconds err by their rounding. Where they scatter around equal steps hardly more than
rounding lets them, equal steps are true, whatever the motion shows: with a period of 3.003 ms, one step of
333 is 4 ms instead of 3 ms, which changes few fifth differences, but moves the voltages before and after by
up to half a millisecond.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from ...arrays import Array
from ...machine import Machine
from ...recordings import Recording
from .jitter import MIN_JITTER_ROWS, smooth_speed

# Mean squared fifth difference at the stamps / that at equal steps, of the sensor that shows the difference
# best. Only noise is left where stamps are as good as equal steps (1); 100 us of jitter reach 100 with the
# encoders of a stage.
_ROUGHER = 2.0
_FAST = 75.0  # percentile of the speed beyond which errors of the times show
# Sampling periods; stamps that are farther from equal steps have another cause, such as a slow clock.
_FARTHEST = 0.5
_LONGEST_ROUNDED = (
    2.0  # periods; a longer step between rounded stamps, which err by half a period each, has lost rows
)


# Sampling periods; a rounding that is finer moves voltages and measurements too little to be seen, and equal
# steps would only change the times of every log with few decimals.
_COARSE = 0.01
_NUMBER_ERRORS = 8.0  # units in the last place by which steps between stamps differ from what was printed


class RegularClock(NamedTuple):
    """Times of a run whose stamps jitter.

    Attributes:
        time_s: Times in equal steps, s, shape (n,).
        jitter_s: Standard deviation of the stamps around them, s.
        numbers: Numbers of the rows, with those that are missing, shape (n,).
    """

    time_s: Array
    jitter_s: float
    numbers: Array


def with_regular_clock(recording: Recording, machine: Machine) -> tuple[Recording, float]:
    """Replace jittering time stamps by equal steps, if this makes the motion smoother.

    The stamps must be within half a period of equal steps, between which rows may be missing. A motion is
    smoother if the fifth differences of a position sensor, in the fastest quarter of the rows, have at most
    half of the mean square, and no other sensor contradicts. Stamps that are only rounded are replaced as
    well.

    Args:
        recording: Run as logged.

    Returns:
        Copy with other times, s, shape (n,), or the same object; and the standard deviation of the stamps, s,
        0 if they are kept.
    """
    positions = [
        values
        for values, sensor in zip(recording.outputs.T, machine.sensors, strict=True)
        if sensor.of_position
    ]
    clocks = list(_possible_clocks(recording.time_s))
    smoothest, clock = _ROUGHER, None
    for regular in clocks:
        ratios = [_roughness_ratio(recording.time_s, regular.time_s, values) for values in positions]
        # Sensors agree: none may be as much smoother at the stamps.
        if not ratios or min(ratios) < 1.0 / _ROUGHER:
            continue
        if max(ratios) >= smoothest:
            smoothest, clock = max(ratios), regular
        elif clock is None and _are_rounded(recording.time_s, positions, clocks):
            clock = regular
    if clock is None:
        return recording, 0.0
    return dataclasses.replace(recording, time_s=clock.time_s), clock.jitter_s


def _possible_clocks(time_s: Array) -> Iterator[RegularClock]:
    """Yield equal steps through the stamps, with gaps of whole steps, if the stamps are near such steps.

    A step of 2 ms among steps of 1 ms is a missing row, or the clock counts milliseconds and the period is
    longer than one. Both are possible.
    """
    if len(time_s) < MIN_JITTER_ROWS:
        return
    steps = np.diff(time_s)
    rounded = np.rint(steps / np.median(steps))
    mean = float(steps[steps <= _LONGEST_ROUNDED * np.median(steps)].mean())
    none_missing = np.where(steps <= _LONGEST_ROUNDED * mean, 1.0, np.rint(steps / mean))
    for step_numbers in (rounded, none_missing):
        if not np.all(step_numbers >= 1.0):
            continue
        numbers = np.concatenate([[0.0], np.cumsum(step_numbers)])
        period, first = np.polyfit(numbers, time_s - time_s[0], 1)
        regular = time_s[0] + first + period * numbers
        errors = time_s - regular
        if np.abs(errors).max() <= _FARTHEST * period:
            yield RegularClock(regular, float(errors.std()), numbers)


def stamp_quantum(time_s: Array) -> float:
    """Return the step to which stamps are rounded, s: steps between rows are whole multiples of it.

    Args:
        time_s: Stamps, s, shape (n,).

    Returns:
        0 if the steps are all equal, or no multiples of the smallest difference between two of them.
    """
    # Stamps that are printed in decimals differ from these by rounding errors of the numbers.
    error = _NUMBER_ERRORS * float(np.spacing(np.abs(time_s).max()))
    steps = np.sort(np.diff(time_s))
    differences = np.diff(steps)
    differences = differences[differences > error]
    if not len(differences):
        return 0.0
    quantum = float(differences.min())
    multiples = np.rint(steps / quantum)
    quantum = float(steps @ multiples / (multiples @ multiples))  # without the errors of single numbers
    return quantum if np.all(np.abs(steps - quantum * multiples) <= error) else 0.0


def _are_rounded(time_s: Array, positions: Sequence[Array], clocks: Sequence[RegularClock]) -> bool:
    """Return whether stamps err more by their rounding than the samples do around equal steps.

    Which rows are missing must be certain, and the rounding coarse. The variance around equal steps is that
    of the rounding and that of the samples; the stamps are better if the latter is larger. The motion where
    they change most against equal steps must not contradict: a controller may really skip a cycle.
    """
    quantum = stamp_quantum(time_s)
    if quantum <= _COARSE * float(np.median(np.diff(time_s))):
        return False
    if any(not np.array_equal(clock.numbers, clocks[0].numbers) for clock in clocks):
        return False
    of_rounding = quantum**2 / 12.0
    if not clocks[0].jitter_s ** 2 - of_rounding < of_rounding:
        return False
    regular = clocks[0].time_s
    ratios = [_roughness_ratio(time_s, regular, values, where_they_differ=True) for values in positions]
    return min(ratios) >= 1.0 / _ROUGHER


def _roughness_ratio(
    stamps: Array, regular: Array, values: Array, *, where_they_differ: bool = False
) -> float:
    """Return how much rougher a sensor's fast motion is if the stamps are true than if steps are equal.

    With `where_they_differ`, the motion around the largest changes between these times counts instead.
    """
    measured = np.isfinite(values)
    if np.count_nonzero(measured) < MIN_JITTER_ROWS:
        return 1.0
    values, stamps, regular = values[measured], stamps[measured], regular[measured]
    speed = smooth_speed(regular, values)
    if where_they_differ:
        changes = np.abs(np.diff(regular - stamps, n=5))
        chosen = changes > 0.5 * changes.max()
    else:
        chosen = np.abs(speed[2:-3]) > np.percentile(np.abs(speed), _FAST)
    if not chosen.any():
        return 1.0
    at_stamps, at_steps = (
        float(np.median(np.diff(candidate, n=5)[chosen] ** 2))
        for candidate in (values + speed * (regular - stamps), values)
    )
    return at_stamps / at_steps if at_steps > 0.0 else 1.0
