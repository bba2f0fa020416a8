"""The effect of a controller's jittering clock on the voltages of a slow log.

A controller that reads a moving sensor late finds it farther on, and brakes; reading early, it drives. A late
voltage also ends sooner than usual, and an early one lasts longer, because the next one comes at its own
time. The braking voltages are therefore the shorter ones, and on average the drive gets a voltage in the
direction of its motion. Rows that contain all voltages show it. Between the rows of a slow log, interpolation
does not know it, and a fit takes it for a smaller back-EMF: 117 us in steps of 1 ms change that of a stage by
2 %, which left 20 times the noise in the runs of another controller.

The voltage of a row also answers the jitter of that row. Interpolation spreads this answer over the rows
beside, while the controller took it back one of its periods later: it is removed before voltages are
interpolated, and acts from the row until the voltage changes.

The log contains all that is needed: the jitter in its stamps, the speeds, and the answer, volts per angle or
length, in the voltages of its rows, which vary with stamp times speed.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.signal import savgol_filter

from ...arrays import Array, Times
from ...robust_statistics import std_by_median
from .interpolated_voltages import Interpolation, updated_inputs

_DIFFERENCES = 3  # order; a motion hardly has third differences from row to row, jitter has the largest
_VARIANCE_OF_DIFFERENCES = 20.0  # of third differences of independent values over their own: 1 + 9 + 9 + 1
_SPEED_ROWS = 9  # of the cubic whose slope is the speed; the speed of a stage changes more slowly
_MIN_ROWS = 100  # of changing voltages; they tell an answer within a few percent
# Robust standard deviations beyond which a third difference is a jump of the program or a gap, and rounds
# until the rows that are left no longer change.
_JUMP, _ROUNDS = 4.0, 10
# Rows of the cubic that stands for a regular clock: it follows a clock that drifts, and 2 % of the variance
# of jitter.
_CLOCK_ROWS = 99
_WANDERS = 2.0  # variance of the stamps around it / that of jitter, beyond which the steps are not regular
# Equal steps scatter by 0.3 of the spacing of floating-point numbers; more than this multiple of it is
# jitter.
_ROUNDING = 4.0


class ClockVoltages(NamedTuple):
    """Changes of the voltages of a run of n rows by the jitter of the controller's clock.

    Attributes:
        impulses: Mean change by jitter of the time integral of a voltage from one change to the next, V s,
            shape (n, drives).
        answers: Part of a row's voltage with which the controller answers that the row was read late or
            early, V, shape (n, drives).
    """

    impulses: Array
    answers: Array

    def rows(self, chosen: slice) -> ClockVoltages:
        """Return the changes for some of the rows.

        Args:
            chosen: Slice of the rows of the run.
        """
        return ClockVoltages(self.impulses[chosen], self.answers[chosen])


def clock_voltages(time_s: Array, inputs: Array, outputs: Array) -> ClockVoltages:
    """Estimate the changes of the voltages by the jitter of the controller's clock.

    Reading late by d, the controller answers with h * speed * d, where h is the change of its voltage per
    measured position, and this voltage lasts shorter by d: the mean of the product is -h * speed * variance
    of d.

    Args:
        time_s: Times of the rows as stamped, s, shape (n,).
        inputs: Voltages, V, shape (n, drives).
        outputs: Positions that the sensors measure, m or rad, NaN where not measured, shape (n, sensors).

    Returns:
        Impulses and answers; 0 where rows are too few or steps are equal.
    """
    found = ClockVoltages(np.zeros_like(inputs), np.zeros_like(inputs))
    measured = [values for values in outputs.T if np.isfinite(values).sum() >= _MIN_ROWS]
    if not measured or len(time_s) < _MIN_ROWS:
        return found
    speeds = np.column_stack([_speed(time_s, values) for values in measured])
    lateness, changes = np.diff(time_s, _DIFFERENCES), np.diff(inputs, _DIFFERENCES, axis=0)
    even = _without_jumps(lateness, np.ones(len(lateness), np.bool_))
    variance = float(np.mean(lateness[even] ** 2)) / _VARIANCE_OF_DIFFERENCES if even.any() else 0.0
    if variance <= (_ROUNDING * float(np.spacing(np.abs(time_s).max()))) ** 2:
        return found
    late = _lateness(time_s, variance)
    read = speeds[1 : 1 + len(lateness)] * lateness[:, None]  # what the controller reads too far, differenced
    for drive, of_drive in enumerate(changes.T):
        used = _without_jumps(of_drive, even & (of_drive != 0.0))
        if used.sum() >= _MIN_ROWS:
            # The answer to each sensor, V/m or V/rad.
            answer, *_ = np.linalg.lstsq(read[used], of_drive[used], rcond=None)
            found.impulses[:, drive] = -variance * (speeds @ answer)
            found.answers[:, drive] = late * (speeds @ answer)
    return found


def updated_inputs_of_clock(
    time_s: Times,
    inputs: Array,
    clock: ClockVoltages | None,
    updates: int,
    interpolation: Interpolation = "akima",
) -> Array:
    """Interpolate inputs to the times at which a controller with a jittering clock changes them.

    Inputs are corrected before the interpolation (`with_clock_voltages`). The controller's answer to the
    jitter of a row is not interpolated: it acts from this row until the next change only.

    Args:
        inputs: Inputs in the rows, V, shape (..., n, drives).
        clock: What the jitter adds to the inputs of these rows; None without jitter.
        updates: How often the inputs change from one row to the next, at least once.
        interpolation: "akima" (piecewise cubic), "straight" (lines) or "spline" (cubic).

    Returns:
        Inputs at `update_times`, V, shape (..., (n - 1) * `updates` + 1, drives).
    """
    if clock is None or updates == 1:
        return updated_inputs(time_s, inputs, updates, interpolation)
    rows = with_clock_voltages(inputs, clock, time_s, updates)
    changing = updated_inputs(time_s, rows, updates, interpolation)
    changing[..., ::updates, :] += clock.answers
    return changing


def with_clock_voltages(inputs: Array, voltages: ClockVoltages, time_s: Times, updates: int) -> Array:
    """Correct the rows' voltages for the jitter of the controller's clock, before interpolation.

    The answers to the jitter of the rows are removed. Each of the `updates` changes per row adds its impulse,
    divided by the time between rows. The answer of a row, which acts from its late or early stamp on, already
    contains 1 / `updates` of one impulse.

    Args:
        inputs: Voltages in the rows, V, shape (..., n, drives).
        voltages: What the jitter adds to the voltages of these rows.
        updates: How often the voltages change from one row to the next; with 1, no correction is needed.

    Returns:
        Voltages, V, shape (..., n, drives).
    """
    if updates == 1:
        return inputs
    missing = updates - 1.0 / updates  # impulses from row to row
    means = voltages.impulses * (missing / float(np.median(np.diff(time_s))))
    return np.asarray(inputs - voltages.answers + means)


def _lateness(time_s: Array, variance: float) -> Array:
    """Return how much later each row was read than a regular clock says, s, shape (n,); 0 without."""
    late = np.asarray(time_s - savgol_filter(time_s, _CLOCK_ROWS, 3))
    late[np.abs(late) > _JUMP * np.sqrt(variance)] = 0.0  # a gap is no jitter
    regular = np.mean(late**2) <= _WANDERS * variance
    return late if regular else np.zeros_like(late)


def _speed(time_s: Array, values: Array) -> Array:
    """Return the speed that a sensor shows, m/s or rad/s, shape (n,)."""
    measured = np.isfinite(values)
    complete = np.interp(time_s, time_s[measured], values[measured])
    # A difference of two rows divided by their time does not contain the jitter of the stamps.
    steps = np.gradient(complete, time_s)
    return np.asarray(savgol_filter(steps, _SPEED_ROWS, 2))


def _without_jumps(differences: Array, candidates: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return which of some third differences are no jumps, shape (n,)."""
    kept = candidates
    for _ in range(_ROUNDS):
        deviation = float(std_by_median(differences[kept])) if kept.any() else 0.0
        before, kept = kept, candidates & (np.abs(differences) <= _JUMP * deviation)
        if np.array_equal(before, kept):
            break
    return np.asarray(kept)
