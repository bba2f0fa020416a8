"""Find defects of single samples in a recording: dropped samples, repeated measurements, silences, and outliers.

Defective measurements become NaN (not measured); no substitute is invented. `bridge_blanks` interpolates, but only for
comparisons between channels.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from ..arrays import Array
from ..machine import Machine
from .quantization import exact_quantum, quantum_of
from .recording import Recording

Mask = NDArray[np.bool_]

GAP_PERIODS = 1.5  # a longer step, in median sampling periods, means that samples were lost

_LONGEST_OUTLIER = 5  # samples; a longer departure may be a motion
_MIN_SAMPLES = 30  # measured samples of a channel that give a scale
_TYPICAL_FACTOR = 12.0  # times the median departure from a smooth motion
_LARGE_FACTOR = 4.0  # times the departure that _LARGE_PERCENT of the samples do not exceed
_LARGE_PERCENT = 98.0
_SLOWEST_INTERVAL = 0.25  # s between measurements; the speed of a sensor that is slower still is not compared
_INTERVAL_PERCENT = 95.0  # of the intervals; longer ones are pauses of the sensor
_NEIGHBORS = 8  # samples on each side whose speeds are compared
_IGNORED_SPEEDS = 2  # smallest and largest speeds that are ignored, because another outlier may be near
# Times the distance that the change of speed around it explains. Measured runs with steps, shocks and Coulomb stops
# reach 0.26.
_SPEED_FACTOR = 1.0
_NOISE_FACTOR = 8.0  # times the declared noise
_RESOLUTION_FACTOR = 4.0  # times the resolution
_MIN_CHANGES = 20  # changes of a channel that show whether it is measured in every row
_LARGE_CHANGE = 3.0  # quantization steps; slow motion says nothing
_SMALL_CHANGE = 1.5  # quantization steps; a change of one step
# Fraction of the rows in motion; single repetitions have other causes, such as a late message.
_LEAST_REPEATED = 0.05
_NOISY = 0.5  # changes of one step per repetition; noise makes two, a sensor that is held none
# Ratio of the 90th to the 10th percentile: intervals of a held sensor are alike at any speed, and its changes are not.
_LARGEST_RATIO = 2.0
_SILENCE = 5.0  # times the usual time between new values, from which on a sensor may have been silent
# Fraction of the distance at the speeds before and after a silence; a machine that stops covers 1 / _SILENCE at most.
_CONTINUED = 0.5
_CATCH_UP = 3.0  # times the largest step around a silence
# Times the largest regular step; the first and the last sample have neighbors on one side only.
_EDGE_FACTOR = 5.0


def fill_gaps(recording: Recording) -> Recording:
    """Copy a recording and insert rows into each gap, a time step of more than 1.5 median sampling periods.

    Without inserted rows, a simulation would hold the last voltage before a gap over the complete gap. The inserted
    rows have linearly interpolated voltages, and NaN (not measured) for all measurements.

    Args:
        recording: Run with or without gaps.

    Returns:
        Copy in which each gap is divided into equal time steps of about the median sampling period; the same object if
        there are no gaps.
    """
    time_s = recording.time_s
    steps = np.diff(time_s)
    period = float(np.median(steps)) if len(steps) else 1.0
    # Rows that are missing in each step, shape (n - 1,).
    lost = np.where(steps > GAP_PERIODS * period, np.rint(steps / period) - 1, 0).astype(int)
    if not lost.any():
        return recording
    gaps = np.flatnonzero(lost)
    inserted = np.concatenate([np.linspace(time_s[i], time_s[i + 1], lost[i] + 2)[1:-1] for i in gaps])
    grid = np.concatenate([time_s, inserted])
    order = np.argsort(grid, kind="stable")
    inputs = np.column_stack([np.interp(grid, time_s, values) for values in recording.inputs.T])
    unmeasured = np.full((len(inserted), recording.outputs.shape[1]), np.nan)
    outputs = np.concatenate([recording.outputs, unmeasured])
    return Recording(recording.name, grid[order], inputs[order], outputs[order])


def comparison_window(outputs: Array, time_s: Array, shortest: float) -> float:
    """Return the length of a time window in which usually every channel, even a slow one, has a measurement.

    Args:
        outputs: Measurements, m or rad, shape (n, sensors), NaN where not measured.
        time_s: Sample times, s, shape (n,).
        shortest: Smallest length of the window, s; it is returned if all sensors measure often enough.

    Returns:
        Length, s: the largest of `shortest` and the typical measuring intervals of the channels. An interval of more
        than 0.25 s is ignored; windows then need not contain a measurement of that channel.
    """
    window = shortest
    for values in outputs.T:
        intervals = np.diff(time_s[np.isfinite(values)])
        if len(intervals):
            # 1 % longer, so that rounded intervals count as equal
            typical = 1.01 * float(np.percentile(intervals, _INTERVAL_PERCENT))
            window = max(window, typical) if typical <= _SLOWEST_INTERVAL else window
    return window


def bridge_blanks(outputs: Array, time_s: Array, longest_gap: float) -> Array:
    """Copy measurements and interpolate where a sensor did not measure, to compare channels row by row.

    Only such comparisons use the result; fits and estimates of the noise use the measured cells alone.

    Args:
        outputs: Measurements, m or rad, shape (n, sensors), NaN where not measured.
        time_s: Sample times, s, shape (n,).
        longest_gap: Longest time between successive measurements of a sensor over which values are interpolated, s.

    Returns:
        Copy with linearly interpolated values between measurements, shape (n, sensors); still NaN in longer gaps, and
        before a sensor's first and after its last measurement.
    """
    bridged = outputs.copy()
    rows = np.arange(len(time_s))
    for values in bridged.T:
        measured = np.flatnonzero(np.isfinite(values))
        if 1 < len(measured) < len(values):
            # Index of the measurement that follows each row, among the measured ones.
            following = np.clip(np.searchsorted(measured, rows), 1, len(measured) - 1)
            gap = time_s[measured[following]] - time_s[measured[following - 1]]  # s, around each row
            bridgeable = (
                np.isnan(values) & (rows > measured[0]) & (rows < measured[-1]) & (gap <= longest_gap)
            )
            values[bridgeable] = np.interp(time_s[bridgeable], time_s[measured], values[measured])
    return bridged


def repetitions(values: Array) -> float:
    """Estimate in how many successive rows a log repeats each measurement of a sensor.

    A sensor that measures less often than a row is logged changes by several quantization steps in one row and not at
    all in the next. A sensor that measures in every row does not do this: its motion does not stop for one row, and
    noise that makes two measurements equal makes them differ by a single step about twice as often.

    Args:
        values: Measurements of one channel, m or rad, shape (n,), NaN where not measured.

    Returns:
        Rows per measurement during motion, dimensionless: their median, or their mean if the median is one row. 1 for a
        sensor that measures in every row, or with fewer than 20 pairs of successive changes of at least three
        quantization steps.
    """
    measured = values[np.isfinite(values)]
    changes = np.abs(np.diff(measured))
    changed = np.flatnonzero(changes)
    if len(changed) < _MIN_CHANGES:
        return 1.0
    quantum = exact_quantum(measured)
    sizes, intervals = changes[changed], np.diff(changed)
    large = sizes >= _LARGE_CHANGE * quantum
    of_motion = intervals[large[:-1] & large[1:]]  # rows between two large changes
    repeated = int(np.count_nonzero(of_motion > 1))
    if len(of_motion) < _MIN_CHANGES or repeated < max(_MIN_CHANGES, _LEAST_REPEATED * len(of_motion)):
        return 1.0
    if quantum > 0.0:
        small = (sizes <= _SMALL_CHANGE * quantum)[1:-1] & large[:-2] & large[2:]
        if np.count_nonzero(small & (intervals[:-1] == 1) & (intervals[1:] == 1)) > _NOISY * repeated:
            return 1.0
    elif not _held_regularly(sizes, intervals):
        return 1.0
    middle = float(np.median(of_motion))
    return middle if middle > 1.0 else float(np.mean(of_motion))


def _held_regularly(sizes: Array, intervals: NDArray[np.int_]) -> bool:
    """Return whether changes of a channel without a quantum come at regular intervals, whatever their size is.

    Steps of a sensor that are not equal are not recognized as a quantum either. In slow motion, they come at intervals
    that depend on the speed and differ from step to step, and their sizes are similar. Intervals of a sensor that is
    held may differ by one row, because its period is no whole number of rows.
    """
    shortest, longest = np.percentile(intervals, [10, 90])
    smallest, largest = np.percentile(sizes, [10, 90])
    varying = longest <= _LARGEST_RATIO * shortest and largest > _LARGEST_RATIO * smallest
    return bool(shortest > 1 and (longest <= shortest + 1 or varying))


def without_repetitions(recording: Recording) -> Recording:
    """Copy a recording, with NaN (not measured) for values that repeat the last measurement of a slow sensor.

    A slow sensor measures less often than a row is logged. `repetitions` detects it and estimates its number of rows
    per measurement.

    Args:
        recording: Run as logged, with n rows.

    Returns:
        Copy with measurements, m or rad, shape (n, sensors); the same object if no sensor is slow. Each row in which
        the value of a slow sensor changes is kept. While the value is constant (machine at rest), one row per measuring
        interval is kept, from the second interval after the last change on.
    """
    outputs = recording.outputs.copy()
    for values in outputs.T:
        rows, measured = repetitions(values), np.flatnonzero(np.isfinite(values))
        if rows > 1:
            count = round(rows)
            changed = np.append(True, np.diff(values[measured]) != 0.0)
            last_change = np.maximum.accumulate(np.where(changed, np.arange(len(measured)), 0))
            # A sensor at rest measures the same value again after as many rows, give or take some.
            since_change = np.arange(len(measured)) - last_change
            again = (since_change >= 2 * count) & (since_change % count == 0)
            values[measured[~changed & ~again]] = np.nan
    unchanged = np.array_equal(outputs, recording.outputs, equal_nan=True)
    return recording if unchanged else dataclasses.replace(recording, outputs=outputs)


def outlier_mask(recording: Recording, machine: Machine) -> Mask:
    """Find outliers: up to five consecutive samples of a sensor that leave the motion around them and return to it.

    The departure of a group of samples is its smallest distance from three straight lines: through the two samples
    before it, through the two after it, and between its neighbors. A kink or step of a real motion (end stop, Coulomb
    friction) lies on one of these lines, so it is kept, and so are samples of a move that begins or ends there.
    The departure of an outlier exceeds all of these: 12 times the median and 4 times the 98th percentile of the
    sensor's departures in this run; 8 times the noise; 4 times the resolution; and the distance that a change of speed
    explains. The first and the last measurement are outliers if the step to their neighbor exceeds 5 times the largest
    other step, 8 times the noise and 4 times the resolution.

    Args:
        recording: Run to examine, with n rows.
        machine: Machine that was recorded; declares noise and resolution. A coarser resolution in the run replaces it.

    Returns:
        True where a measurement is an outlier, shape (n, sensors); False at empty cells, for a sensor with fewer than
        30 measurements, and for one that measures an acceleration or a current.
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

    Outliers are up to five consecutive samples of a sensor that leave the motion around them and return to it, by much
    more than noise, resolution and the changes of speed explain. Kinks and steps of a real motion are kept.
    `outlier_mask` describes the criterion.

    Returns:
        Copy; the same object if there are no outliers.
    """
    mask = outlier_mask(recording, machine)
    if not mask.any():
        return recording
    return dataclasses.replace(recording, outputs=np.where(mask, np.nan, recording.outputs))


def without_silences(recording: Recording) -> Recording:
    """Copy a recording, with NaN (not measured) where a log repeats a value because the sensor sent no new one.

    A machine that stops and goes on leaves a rest by one small step. After a lost connection, the next value is where
    the motion has arrived meanwhile. The repetitions between two values are removed if

    - their time is at least five times as long as usual between the new values before and after,
    - the motion has the same direction before, across and after it, and
    - its step is more than three times as large as each one before and after, as no quantization step is, and at least
      half of what the slower of the speeds before and after makes of this time.

    Args:
        recording: Run without outliers: a connection that returns may send its late values all at once.

    Returns:
        Copy; the same object if no sensor was silent.
    """
    outputs = recording.outputs.copy()
    for values in outputs.T:
        measured = np.flatnonzero(np.isfinite(values))
        new = measured[np.append(True, np.diff(values[measured]) != 0.0)] if len(measured) else measured
        if len(new) < 2 * _NEIGHBORS:
            continue
        steps, spans = np.diff(values[new]), np.diff(recording.time_s[new])
        long = spans[1:-1] >= _SILENCE * np.minimum(spans[:-2], spans[2:])
        for i in (np.flatnonzero(long) + 1).tolist():
            if _goes_on(steps, spans, i):
                values[new[i] + 1 : new[i + 1]] = np.nan
    unchanged = np.array_equal(outputs, recording.outputs, equal_nan=True)
    return recording if unchanged else dataclasses.replace(recording, outputs=outputs)


def _goes_on(steps: Array, spans: Array, i: int) -> bool:
    """Return whether the motion around a long time between new values goes on during it.

    Args:
        steps: Differences of successive new values, shape (k,).
        spans: Times between them, s, shape (k,).
        i: Index of the long one, neither the first nor the last.
    """
    sides = slice(max(i - _NEIGHBORS, 0), i), slice(i + 1, i + 1 + _NEIGHBORS)
    usual = max(float(np.median(spans[side])) for side in sides)
    largest = max(float(np.abs(steps[side]).max()) for side in sides)
    distances = [float(steps[side].sum() / spans[side].sum() * spans[i] / steps[i]) for side in sides]
    caught_up = 0.0 < _CONTINUED * min(distances) <= 1.0
    return bool(caught_up and spans[i] >= _SILENCE * usual and abs(steps[i]) > _CATCH_UP * largest)


def _isolated_samples(time_s: Array, values: Array, floor: float) -> Mask:
    """Return the mask of the outliers among the measured samples of one channel, shape (n,).

    Short departures are removed first, so that a second one nearby does not spoil the scale of a longer one.

    Args:
        time_s: Sample times, s, strictly increasing, shape (n,).
        values: Finite measurements, shape (n,).
        floor: Departure below which no sample is an outlier, in the unit of the values.
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
    """Return the first indices of the segments of a length that depart from the motion before and after them."""
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

    In a slow log, a move from rest to rest has a few samples.

    Args:
        values: Measurements, shape (n,).
        first: Index of the segment's first sample.
        length: Number of samples of the segment.
        floor: Change below which a sensor rests, in the unit of the values.
    """
    steps = np.diff(values[first - 1 : first + length + 1])
    if not (np.all(steps > 0.0) or np.all(steps < 0.0)):
        return False
    sides = values[max(first - _NEIGHBORS, 0) : first], values[first + length : first + length + _NEIGHBORS]
    return any(len(side) > 1 and float(np.median(np.abs(np.diff(side)))) <= floor for side in sides)


def _speed_change(time_s: Array, values: Array, first: int, length: int) -> float:
    """Return how far a segment could move by the change of speed around it, in the unit of the values.

    A shock or a voltage step moves the samples after it too, so the speeds before and after it differ.

    Args:
        time_s: Sample times, s, shape (n,).
        values: Measurements, shape (n,).
        first: Index of the segment's first sample.
        length: Number of samples of the segment.
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
    """Return how far each segment departs from the motion around it, shape (n - length - 3,).

    Args:
        time_s: Sample times, s, shape (n,).
        values: Measurements, shape (n,).
        length: Number of samples of a segment; the first segment begins at sample 2, the last ends at sample n - 3.

    Returns:
        Smallest distance of the segment's samples from three straight lines: through the two samples before it, through
        the two samples after it, and from the last sample before it to the first one after it.
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


def peak_to_peak(outputs: Array) -> Array:
    """Compute the difference between the largest and the smallest measurement of each channel.

    Args:
        outputs: Measurements, m or rad, NaN where not measured, shape (n, sensors), or (n,) of one sensor.

    Returns:
        Differences in the same units, 0 where nothing was measured, shape (sensors,), or a scalar for one sensor.
    """
    return np.nan_to_num(np.fmax.reduce(outputs) - np.fmin.reduce(outputs))
