"""Find outliers in a recording: samples of a sensor that leave the motion around them and return to it.

Outliers become NaN (not measured); no substitute is invented.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from ..arrays import Array
from ..machine import Machine
from .quantization import quantum_of
from .recording import Recording

Mask = NDArray[np.bool_]

_LONGEST_OUTLIER = 5  # samples; a longer departure may be a motion
_MIN_SAMPLES = 30  # measured samples of a channel that give a scale
_TYPICAL_FACTOR = 12.0  # times the median departure from a smooth motion
_LARGE_FACTOR = 4.0  # times the departure that _LARGE_PERCENT of the samples do not exceed
_LARGE_PERCENT = 98.0
_NEIGHBORS = 8  # samples on each side whose speeds are compared
_IGNORED_SPEEDS = 2  # smallest and largest speeds that are ignored, because another outlier may be near
# Times the distance that the change of speed around it explains. Measured runs with steps, shocks and Coulomb
# stops reach 0.26.
_SPEED_FACTOR = 1.0
_NOISE_FACTOR = 8.0  # times the declared noise
_RESOLUTION_FACTOR = 4.0  # times the resolution
# Times the largest regular step; the first and the last sample have neighbors on one side only.
_EDGE_FACTOR = 5.0


def outlier_mask(recording: Recording, machine: Machine) -> Mask:
    """Find outliers: up to five consecutive samples of a sensor that leave the motion and return to it.

    The departure of a group of samples is its smallest distance from three straight lines: through the two
    samples before it, through the two after it, and between its neighbors. A kink or step of a real motion
    (end stop, Coulomb friction) lies on one of these lines, so it is kept, and so are samples of a move that
    begins or ends there. The departure of an outlier exceeds all of these: 12 times the median and 4 times
    the 98th percentile of the sensor's departures in this run; 8 times the noise; 4 times the resolution; and
    the distance that a change of speed explains. The first and the last measurement are outliers if the step
    to their neighbor exceeds 5 times the largest other step, 8 times the noise and 4 times the resolution.

    Args:
        machine: Machine that was recorded; declares noise and resolution. A coarser resolution in the run
            replaces it.

    Returns:
        True where a measurement is an outlier, shape (n, sensors); False at empty cells, for a sensor with
        fewer than 30 measurements, and for one that measures an acceleration or a current.
    """
    mask = np.zeros(recording.outputs.shape, np.bool_)
    for j, sensor in enumerate(machine.sensors):
        rows = np.flatnonzero(np.isfinite(recording.outputs[:, j]))
        # A step of the voltage moves accelerations and currents at once, so that lines do not continue them.
        if len(rows) < _MIN_SAMPLES or sensor.quantity not in ("position", "speed"):
            continue
        values = recording.outputs[rows, j]
        resolution = max(sensor.resolution, quantum_of(values))
        floor = max(_NOISE_FACTOR * sensor.noise, _RESOLUTION_FACTOR * resolution)
        mask[rows, j] = _isolated_samples(recording.time_s[rows], values, floor)
    return mask


def without_outliers(recording: Recording, machine: Machine) -> Recording:
    """Copy a recording, with NaN (not measured) for its outliers.

    Outliers are up to five consecutive samples of a sensor that leave the motion around them and return to
    it, by much more than noise, resolution and the changes of speed explain. Kinks and steps of a real motion
    are kept. `outlier_mask` describes the criterion.

    Returns:
        Copy; the same object if there are no outliers.
    """
    mask = outlier_mask(recording, machine)
    if not mask.any():
        return recording
    return dataclasses.replace(recording, outputs=np.where(mask, np.nan, recording.outputs))


def _isolated_samples(time_s: Array, values: Array, floor: float) -> Mask:
    """Return the mask of outliers among a channel's measured samples, which depart by more than `floor`.

    Short departures are removed first, so that a second one nearby does not spoil the scale of a longer one.
    """
    outliers = np.zeros(len(values), np.bool_)
    for length in range(1, _LONGEST_OUTLIER + 1):
        kept = np.flatnonzero(~outliers)
        if len(kept) < _MIN_SAMPLES:
            break
        for first in _isolated_segments(time_s[kept], values[kept], length, floor):
            outliers[kept[first : first + length]] = True
    kept = np.flatnonzero(~outliers)
    for edge, neighbor in ((kept[0], kept[1]), (kept[-1], kept[-2])):
        regular = np.abs(np.diff(values[kept[1:-1]])).max(initial=0.0)
        outliers[edge] = abs(values[edge] - values[neighbor]) > max(_EDGE_FACTOR * regular, floor)
    return outliers


def _isolated_segments(time_s: Array, values: Array, length: int, floor: float) -> NDArray[np.int_]:
    """Return the first indices of the segments of a length that depart from motion before and after."""
    departures = _departures(time_s, values, length)
    typical = float(np.median(departures))
    large = float(np.percentile(departures, _LARGE_PERCENT))
    threshold = max(floor, _TYPICAL_FACTOR * typical, _LARGE_FACTOR * large)
    # Across longer time steps a regular motion departs more, with the square of the time.
    duration = time_s[length + 3 :] - time_s[: -length - 3]
    stretch = np.maximum(duration / np.median(duration), 1.0) ** 2
    candidates = np.flatnonzero(departures > threshold * stretch).tolist()
    isolated = [
        i
        for i in candidates
        if not _begins_or_ends_move(values, i + 2, length, floor)
        and departures[i] > _SPEED_FACTOR * _speed_change(time_s, values, i + 2, length)
    ]
    return np.array(isolated, int) + 2  # two samples precede the first segment


def _begins_or_ends_move(values: Array, first: int, length: int, floor: float) -> bool:
    """Return whether samples lead from one neighbor to the other where a sensor rests before or after them.

    In a slow log, a move from rest to rest has a few samples. Where the sensor rests (changes below `floor`)
    before and after them, at two places, they may also turn back in between, as a drive that overshoots or
    sticks does.
    """
    before = values[max(first - _NEIGHBORS, 0) : first]
    after = values[first + length : first + length + _NEIGHBORS]
    rests = [len(side) > 1 and float(np.median(np.abs(np.diff(side)))) <= floor for side in (before, after)]
    steps = np.diff(values[first - 1 : first + length + 1])
    if np.all(steps > 0.0) or np.all(steps < 0.0):
        return any(rests)
    low, high = sorted((float(np.median(before)), float(np.median(after))))
    segment = values[first : first + length]
    return all(rests) and low < float(segment.min()) and float(segment.max()) < high


def _speed_change(time_s: Array, values: Array, first: int, length: int) -> float:
    """Return how far a segment could move by the change of speed around it, in the unit of the values.

    A shock or a voltage step moves the samples after it too, so the speeds before and after it differ.
    """
    before = slice(max(first - _NEIGHBORS, 0), first)
    after = slice(first + length, first + length + _NEIGHBORS)
    speeds = np.sort(
        np.concatenate([np.diff(values[rows]) / np.diff(time_s[rows]) for rows in (before, after)])
    )
    # Near an end of the run one side has few speeds, which would all be ignored.
    ignored = _IGNORED_SPEEDS if len(speeds) == 2 * (_NEIGHBORS - 1) else 0
    change = float(speeds[-1 - ignored] - speeds[ignored])
    return change * float(time_s[first + length] - time_s[first - 1]) / 2


def _departures(time_s: Array, values: Array, length: int) -> Array:
    """Return how far each segment is from the motion around, shape (n - length - 3,), from sample 2 on.

    It is the smallest distance of its samples from three straight lines: through the two samples before it,
    through the two samples after it, and from the last sample before it to the first one after it.
    """
    # (length + 4, segments): two before, the segment, two after
    t = sliding_window_view(time_s, length + 4).T
    y = sliding_window_view(values, length + 4).T
    slope_before = (y[1] - y[0]) / (t[1] - t[0])
    slope_after = (y[-1] - y[-2]) / (t[-1] - t[-2])
    slope_across = (y[-2] - y[1]) / (t[-2] - t[1])
    smallest = np.full(y.shape[1], np.inf)
    for time, value in zip(t[2:-2], y[2:-2], strict=True):
        for slope, anchor in ((slope_before, 1), (slope_after, -2), (slope_across, 1)):
            np.minimum(smallest, np.abs(value - y[anchor] - slope * (time - t[anchor])), out=smallest)
    return smallest
