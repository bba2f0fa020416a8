"""Find defects of the sampling in a recording: dropped samples, repeated measurements, and silent sensors.

Defective measurements become NaN (not measured); no substitute is invented. `bridge_blanks` interpolates, but
only for comparisons between channels.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from ..arrays import Array, Measurements, Times
from ..machine import Machine
from .quantization import exact_quantum
from .recording import Recording

GAP_PERIODS = 1.5  # a longer step, in usual ones (`usual_step`), means that samples were lost

# Fraction of the steps that are shorter than half of the median. Steps of a clock are alike, so that it is 0
# in all recordings of the benchmarks; where values are logged as they arrive, as by callbacks of several
# messages, it is 0.35 to 0.37 (two drives of a crane). A log whose stamps scatter by a third of its period
# has 0.07.
_EVENTS_FRACTION = 0.25
_EVENTS_PERCENT = 95.0  # of the steps between events; longer ones are pauses of the logger

_SLOWEST_INTERVAL = 0.25  # s between measurements; the speed of a sensor that is slower still is not compared
_INTERVAL_PERCENT = 95.0  # of the intervals; longer ones are pauses of the sensor
_NEIGHBORS = 8  # new values on each side of a silence that show the usual time between them
_MIN_CHANGES = 20  # changes of a channel that show whether it is measured in every row
_LARGE_CHANGE = 3.0  # quantization steps; slow motion says nothing
_SMALL_CHANGE = 1.5  # quantization steps; a change of one step
# Fraction of the rows in motion; single repetitions have other causes, such as a late message.
_LEAST_REPEATED = 0.05
_NOISY = 0.5  # changes of one step per repetition; noise makes two, a sensor that is held none
# Ratio of the 90th to the 10th percentile: intervals of a held sensor are alike at any speed, and its changes
# are not.
_LARGEST_RATIO = 2.0
_SILENCE = 5.0  # times the usual time between new values, from which on a sensor may have been silent
# Fraction of the distance at the slower of the speeds before and after a silence, since a machine that stops
# covers 1 / _SILENCE at most; and the reciprocal, of that at the faster one, since a step of the command
# covers far more.
_CONTINUED = 0.5
_CATCH_UP = 3.0  # times the largest step around a silence


def usual_step(time_s: Times) -> float:
    """Return the usual time between two rows, by which gaps are recognized, s.

    Returns:
        The sampling period (median step), s. A log of events has none, because a row is written whenever a
        value arrives; there it is the 95th percentile of the steps. Infinite with fewer than two rows.
    """
    steps = np.diff(time_s)
    if not len(steps):
        return np.inf
    period = float(np.median(steps))
    of_events = np.mean(steps < 0.5 * period) > _EVENTS_FRACTION
    return max(period, float(np.percentile(steps, _EVENTS_PERCENT))) if of_events else period


def missing_rows(time_s: Times) -> NDArray[np.int_]:
    """Count the rows that are missing in each gap, a step of more than 1.5 usual steps (`usual_step`).

    Returns:
        Number of missing rows between each row and the next one, shape (n - 1,); 0 where there is no gap.
    """
    steps, usual = np.diff(time_s), usual_step(time_s)
    return np.where(steps > GAP_PERIODS * usual, np.rint(steps / usual) - 1, 0).astype(int)


def fill_gaps(recording: Recording) -> Recording:
    """Copy a recording and insert rows into each gap, a step of more than 1.5 usual ones (`missing_rows`).

    Inserted rows are about a usual step apart; without them, a simulation would hold the last voltage over
    the gap. They have linearly interpolated voltages, and NaN (not measured) for all measurements. Without
    gaps, the same object is returned.
    """
    time_s = recording.time_s
    lost = missing_rows(time_s)
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


def comparison_window(outputs: Measurements, time_s: Times, shortest: float) -> float:
    """Return the length of a time window in which usually every channel, even a slow one, has a measurement.

    Args:
        shortest: Smallest length of the window, s; it is returned if all sensors measure often enough.

    Returns:
        Length, s: the largest of `shortest` and, of each channel, the 95th percentile of the times between
        its measurements, plus 1 %. If this exceeds 0.25 s, the channel is ignored; windows then need not
        contain a measurement of it.
    """
    window = shortest
    for values in outputs.T:
        intervals = np.diff(time_s[np.isfinite(values)])
        if len(intervals):
            # 1 % longer, so that rounded intervals count as equal
            typical = 1.01 * float(np.percentile(intervals, _INTERVAL_PERCENT))
            window = max(window, typical) if typical <= _SLOWEST_INTERVAL else window
    return window


def bridge_blanks(outputs: Measurements, time_s: Times, longest_gap: float) -> Array:
    """Copy measurements and interpolate where a sensor did not measure, to compare channels row by row.

    Only such comparisons use the result; fits and estimates of the noise use the measured cells alone.

    Args:
        longest_gap: Longest time between successive measurements of a sensor over which values are
            interpolated, s.

    Returns:
        Copy with linearly interpolated values between measurements, shape (n, sensors); still NaN in longer
        gaps, and before a sensor's first and after its last measurement.
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

    A sensor that measures less often than a row is logged changes by several quantization steps in one row
    and not at all in the next. A sensor that measures in every row does not do this: its motion does not stop
    for one row, and noise that makes two measurements equal makes them differ by a single step about twice as
    often.

    Args:
        values: Measurements of one channel, m or rad, shape (n,), NaN where not measured.

    Returns:
        Rows per measurement during motion, dimensionless: their median, or their mean if the median is one
        row. 1 for a sensor that measures in every row, or with fewer than 20 pairs of successive changes of
        at least three quantization steps.
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
    """Return whether changes of a channel without a quantum come at regular intervals, whatever their size.

    Unequal steps of a sensor are no quantum either; in slow motion their intervals depend on the speed, and
    their sizes are similar. Intervals of a held sensor may differ by one row, because its period is no whole
    number of rows.
    """
    shortest, longest = np.percentile(intervals, [10, 90])
    smallest, largest = np.percentile(sizes, [10, 90])
    varying = longest <= _LARGEST_RATIO * shortest and largest > _LARGEST_RATIO * smallest
    return bool(shortest > 1 and (longest <= shortest + 1 or varying))


def without_repetitions(recording: Recording) -> Recording:
    """Copy a recording, with NaN (not measured) for values that repeat the last measurement of a slow sensor.

    A slow sensor measures less often than a row is logged. `repetitions` detects it and estimates its number
    of rows per measurement.

    Returns:
        Copy with measurements, in the sensors' units, shape (n, sensors); the same object if no sensor is
        slow. Each row in which the value of a slow sensor changes is kept. While the value is constant
        (machine at rest), one row per measuring interval is kept, from the second interval after the last
        change on.
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


def without_silences(recording: Recording, machine: Machine) -> Recording:
    """Copy a recording, with NaN (not measured) where the log repeats a value because the sensor sent none.

    A machine that stops and goes on leaves a rest by one small step. After a lost connection, the next value
    is where the motion has arrived meanwhile. The repetitions between two values are removed if

    - they last at least five times as long as the usual time between new values before and after,
    - the motion has the same direction before, across and after them, and
    - the step across them is more than three times as large as each step before and after, which excludes
      quantization, and fits the speeds: at least half of what the slower of the speeds before and after gives
      in this time, and at most twice what the faster one gives.

    A current or an acceleration jumps with the command and is constant at standstill, so that its sensor is
    never silent by this rule.

    Args:
        recording: Run without outliers: a connection that returns may send its late values all at once.

    Returns:
        Copy; the same object if no sensor was silent.
    """
    outputs = recording.outputs.copy()
    for sensor, values in zip(machine.sensors, outputs.T, strict=True):
        if sensor.sensed.jumps:
            continue
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
    """Return whether the motion around a long time between new values, spans[i] in s, goes on during it."""
    sides = slice(max(i - _NEIGHBORS, 0), i), slice(i + 1, i + 1 + _NEIGHBORS)
    usual = max(float(np.median(spans[side])) for side in sides)
    largest = max(float(np.abs(steps[side]).max()) for side in sides)
    distances = [float(steps[side].sum() / spans[side].sum() * spans[i] / steps[i]) for side in sides]
    caught_up = 0.0 < _CONTINUED * min(distances) <= 1.0 and max(distances) >= _CONTINUED
    return bool(caught_up and spans[i] >= _SILENCE * usual and abs(steps[i]) > _CATCH_UP * largest)


def peak_to_peak(outputs: Array) -> Array:
    """Compute the difference between the largest and the smallest measurement of each channel.

    Args:
        outputs: Measurements, in the sensors' units, NaN where not measured, shape (n, sensors), or (n,) of
            one sensor.

    Returns:
        Differences in the same units, 0 where nothing was measured, shape (sensors,), or a scalar for one
        sensor.
    """
    return np.nan_to_num(np.fmax.reduce(outputs) - np.fmin.reduce(outputs))
