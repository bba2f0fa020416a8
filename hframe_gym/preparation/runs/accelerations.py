"""How much of the acceleration of a session each run has."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...arrays import Array
from ...machine import Machine
from ...recordings import Recording, without_outliers
from ..sensors.noise import difference_noise

# Parts of the longest run. A start is over in a few of them, and its acceleration counts whatever it lasts;
# noise, which each difference divides by their duration, stays small.
_PARTS = 64
_FEWEST_ROWS = 3  # of a part
_ORDERS = {"position": 2, "speed": 1}  # differences that are accelerations, by what a sensor measures
_VARIANCES = {1: 2.0, 2: 6.0}  # of such a difference of independent values, over the variance of one


def acceleration_fractions(recordings: Sequence[Recording], machine: Machine) -> Array:
    """Return each run's fraction of all squared acceleration, of the sensor where it is largest.

    The squared acceleration, added up over time, is the information about inertia. It follows from
    differences between means over parts of equal duration, minus what the noise of the sensor contributes.
    Sensors in which it is not larger than that do not count.

    Returns:
        Fractions, dimensionless, shape (runs,); 0 where no sensor shows an acceleration.
    """
    longest = max(float(recording.time_s[-1] - recording.time_s[0]) for recording in recordings)
    period = max(float(np.median(np.diff(recording.time_s))) for recording in recordings)
    part_s = max(longest / _PARTS, _FEWEST_ROWS * period)
    recordings = [without_outliers(recording, machine) for recording in recordings]
    fractions = np.zeros(len(recordings))
    for j, sensor in enumerate(machine.sensors):
        order = _ORDERS.get(sensor.quantity)
        if order is None:
            continue
        noise = difference_noise([recording.outputs[:, j] for recording in recordings])
        squares, expected = np.zeros((2, len(recordings)))
        for i, recording in enumerate(recordings):
            accelerations, count = _accelerations(recording, j, part_s, order)
            squares[i] = accelerations @ accelerations
            expected[i] = len(accelerations) * _VARIANCES[order] * noise**2 / count / part_s ** (2 * order)
        if squares.sum() > 2.0 * expected.sum():
            excess = np.maximum(squares - expected, 0.0)
            fractions = np.maximum(fractions, excess / excess.sum())
    return fractions


def _accelerations(recording: Recording, sensor: int, part_s: float, order: int) -> tuple[Array, float]:
    """Return accelerations between parts of a run, and how many measurements a part has (median)."""
    measured = np.isfinite(recording.outputs[:, sensor])
    values, time_s = recording.outputs[measured, sensor], recording.time_s[measured]
    if not len(values):
        return np.zeros(0), 1.0
    part = ((time_s - recording.time_s[0]) / part_s).astype(int)
    groups = np.flatnonzero(np.diff(part, prepend=-1))[1:]
    counts = np.diff(groups, prepend=0, append=len(values))
    count = float(np.median(counts))
    whole = counts >= count / 2.0  # the last part may be short, and single values have much more noise
    times = np.array([np.mean(group) for group in np.split(time_s, groups)])[whole]
    changes = np.array([np.mean(group) for group in np.split(values, groups)])[whole]
    for _ in range(order):
        changes, times = np.diff(changes) / np.diff(times), (times[1:] + times[:-1]) / 2.0
    return changes, count
