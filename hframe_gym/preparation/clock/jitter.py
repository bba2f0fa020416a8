"""Estimate the jitter of the clock: random errors of sampling times, which falsify measurements in motion."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.signal import savgol_filter

from ...arrays import Array, Measurements, Times

_SPEED_ROWS, MIN_JITTER_ROWS = 11, 50  # samples that a speed is computed from; measured rows of a run
# Largest jitter, in sampling periods. Times that err uniformly over a whole period have a standard deviation
# of 0.29; much larger errors would exchange the order of the samples. What looks like more has another cause,
# such as a sensor that is slower than the log, and must not be taken for noise.
_LARGEST_JITTER = 0.5
# Variance of fifth differences of white noise with variance 1: the sum of the squared binomial coefficients.
_FIFTH_DIFFERENCE_VARIANCE = 252.0


def clock_jitter(times: Sequence[Array], channel: Sequence[Array], noise: float) -> float:
    """Estimate the jitter of the clock, random errors of sampling times, from a channel during fast motion.

    A measurement that is late by dt has an error of dt * speed. During fast motion, the standard deviation s
    of the measurements is therefore given by s^2 = noise^2 + jitter^2 * speed^2. s is computed from fifth
    differences, which smooth motion hardly changes. Only the fastest quarter of the rows is used. Rows in
    which the sensor moves by less than sqrt(12) * noise per row are left out, because rounding errors of
    successive measurements then depend on each other.

    Args:
        times: Sample times by run, s, shape (n,) each.
        channel: Measurements of the sensor by run, m or rad, shape (n,) each, NaN where not measured.
        noise: Standard deviation of the sensor's noise at rest, m or rad.

    Returns:
        Standard deviation of the sampling time, s. 0 if there are no fast rows or no run of 50 measurements,
        if s^2 is at most 2 * noise^2, because vibrations may cause such a value, or if it would exceed half a
        sampling period.
    """
    squares, speeds, travels = [], [], []
    for time_s, values in zip(times, channel, strict=True):
        measured = np.isfinite(values)
        if np.count_nonzero(measured) < MIN_JITTER_ROWS:
            continue
        found = _fast_errors(time_s[measured], values[measured])
        squares.append(found.errors**2)
        speeds.append(np.abs(found.speeds))
        travels.append(speeds[-1] * np.median(np.diff(time_s[measured])))  # per row
    if not squares:
        return 0.0
    square, speed = np.concatenate(squares), np.concatenate(speeds)
    fast = (speed > np.percentile(speed, 75)) & (np.concatenate(travels) > math.sqrt(12.0) * noise)
    if not fast.any():
        return 0.0
    # The median is robust against shocks; that of a squared Gaussian variable is 0.455 of its variance.
    variance = float(np.median(square[fast])) / 0.455 - noise**2
    jitter = math.sqrt(variance / float(np.median(speed[fast] ** 2))) if variance > noise**2 else 0.0
    period = float(np.median(np.concatenate([np.diff(time_s) for time_s in times])))
    return jitter if jitter <= _LARGEST_JITTER * period else 0.0


def shared_jitter(times: Sequence[Array], first: Sequence[Array], second: Sequence[Array]) -> float:
    """Estimate the jitter of the clock from what two encoders of different motions show in the same rows.

    A row that was sampled late by dt has errors of dt * speed at both encoders. The product of these errors
    has the sign of the product of the speeds, where the encoders turn alike and where they turn against each
    other. Vibrations and forces that a model lacks have no such sign in both cases, so that the smaller one
    of two estimates counts. Errors are fifth differences, as in `clock_jitter`.

    Args:
        times: Sample times by run, s, shape (n,) each.
        first: Measurements of an encoder by run, rad or m, shape (n,) each, NaN where not measured.
        second: Those of another encoder by run, rad or m, shape (n,) each.

    Returns:
        Standard deviation of the sampling time, s. 0 if the encoders do not show one, or if there are fewer
        than 50 fast rows of either kind.
    """
    errors, speeds = [], []
    for time_s, *values in zip(times, first, second, strict=True):
        measured = np.isfinite(values).all(axis=0)
        if np.count_nonzero(measured) < MIN_JITTER_ROWS:
            continue
        found = [_fast_errors(time_s[measured], value[measured]) for value in values]
        errors.append(found[0].errors * found[1].errors)
        speeds.append(found[0].speeds * found[1].speeds)
    if not errors:
        return 0.0
    error, speed = np.concatenate(errors), np.concatenate(speeds)
    variances = []
    for rows in (np.flatnonzero(speed > 0.0), np.flatnonzero(speed < 0.0)):
        fast = rows[np.abs(speed[rows]) > np.percentile(np.abs(speed[rows]), 75)] if len(rows) else rows
        if len(fast) < MIN_JITTER_ROWS:
            return 0.0
        variances.append(float(error[fast] @ speed[fast] / (speed[fast] @ speed[fast])))
    return math.sqrt(max(min(variances), 0.0))


class _FastErrors(NamedTuple):
    """Errors of measurements that smooth motion does not have, and the speeds there.

    Attributes:
        errors: Fifth differences with the variance of the measurements, m or rad, shape (n - 5,).
        speeds: Speeds at the middle of six samples, m/s or rad/s, shape (n - 5,).
    """

    errors: Array
    speeds: Array


def _fast_errors(time_s: Array, values: Array) -> _FastErrors:
    """Return the errors of a channel at equal steps, and its speeds."""
    speed = smooth_speed(time_s, values)
    regular = np.linspace(time_s[0], time_s[-1], len(speed))
    at_regular_times = values + speed * (regular - time_s)
    return _FastErrors(np.diff(at_regular_times, n=5) / math.sqrt(_FIFTH_DIFFERENCE_VARIANCE), speed[2:-3])


def noise_by_row(time_s: Times, outputs: Measurements, noise: Array, jitter: float) -> Array:
    """Return the standard deviation of every measurement from the sensor's noise and the jitter of the clock.

    Args:
        noise: Standard deviations of the sensors' noise at rest, in the sensors' units, shape (sensors,).
        jitter: Standard deviation of the sampling time, s.

    Returns:
        sqrt(noise^2 + (jitter * speed)^2), in the sensors' units, shape (n, sensors). The speed of a sensor
        is the slope of a parabola over 11 of its measurements. Only the noise where a sensor did not measure,
        or has fewer than 11 measurements.
    """
    by_row = np.tile(noise, (len(time_s), 1))
    for j, values in enumerate(outputs.T):
        measured = np.isfinite(values)
        if jitter > 0.0 and np.count_nonzero(measured) >= _SPEED_ROWS:
            by_row[measured, j] = np.hypot(
                noise[j], jitter * smooth_speed(time_s[measured], values[measured])
            )
    return by_row


def smooth_speed(time_s: Times, values: Array) -> Array:
    """Return the speed of a channel, m/s or rad/s, shape (n,): the slope of a parabola over 11 samples.

    Args:
        time_s: Times of at least 11 samples; equal steps are assumed.
        values: Measurements without gaps (NaN), m or rad, shape (n,).
    """
    period = float(time_s[-1] - time_s[0]) / (len(time_s) - 1)
    return np.asarray(savgol_filter(values, _SPEED_ROWS, 2, deriv=1, delta=period))
