"""Estimate the jitter of the clock: random errors of the sampling times, which are errors of measurements in motion."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.signal import savgol_filter

from ..arrays import Array

_SPEED_ROWS, MIN_JITTER_ROWS = 11, 50  # samples that a speed is computed from; measured rows of a run
# Largest jitter, in sampling periods. Times that err uniformly over a whole period have a standard deviation of 0.29;
# much larger errors would exchange the order of the samples. What looks like more has another cause, such as a sensor
# that is slower than the log, and must not be taken for noise.
_LARGEST_JITTER = 0.5
# Variances that white noise of variance 1 has after two filters over seven rows: sums of their squared coefficients.
# Both remove smooth motion by fifth differences. Differences of these pass the fastest alternation from row to row,
# sums of neighbors what alternates at about three quarters of this frequency.
_DIFFERENCES_VARIANCE, _SUMS_VARIANCE = 924.0, 84.0
# What forces cause between the rows has at least twice the variance in the sums: 2.1 times for forces that are white,
# 4.7 times for voltages that change in every row and are held until the next.
_MOTION_RATIO = 2.0
# Least part of the fastest alternation that is white where the clock jitters: the larger one. In simulated stages
# with jitter of 10 to 22 us, 0.88 and more are white in logs of 250 Hz to 1 kHz, 0.59 and more in logs of 100 Hz.
# Forces alone leave up to 0.34 by chance (random forces on a mass).
_LEAST_WHITE_PART = 0.5
# The part of the rows with the smaller mean squares, which shocks do not reach. White noise of variance 1 has these
# means there, by a simulation of 8 million rows.
_KEPT, _DIFFERENCES_KEPT, _SUMS_KEPT = 0.75, 0.541, 0.611
_STEP_ROWS = 5  # over which squares are averaged: those that one voltage step reaches in either filter


def clock_jitter(times: Sequence[Array], channel: Sequence[Array], noise: float) -> float:
    """Estimate the jitter of the clock, the random error of the sampling times, from a channel during fast motion.

    A measurement that is late by dt has an error of dt * speed. During fast motion, the standard deviation s of the
    measurements is therefore given by s^2 = noise^2 + jitter^2 * speed^2. Only the fastest quarter of the rows is used.
    Rows in which the sensor moves by less than sqrt(12) * noise per row are left out, because rounding errors of
    successive measurements then depend on each other.

    s is the part of the error that is white from row to row. Voltage steps bend the motion within a row as well, of
    a light motor by more than the noise, but the motor's inertia makes slower alternation larger than the fastest one.
    The variances at two frequencies tell these parts apart.

    Args:
        times: Sample times by run, s, shape (n,) each.
        channel: Measurements of the sensor by run, m or rad, shape (n,) each, NaN where not measured.
        noise: Standard deviation of the sensor's noise at rest, m or rad.

    Returns:
        Standard deviation of the sampling time, s. 0 if there are no fast rows or no run of 50 measurements, if most of
        the fast alternation is motion, if s^2 is at most 2 * noise^2, because vibrations may cause such a value, or if
        it would exceed half a sampling period.
    """
    differences, sums, speeds, travels = [], [], [], []
    for time_s, values in zip(times, channel, strict=True):
        measured = np.isfinite(values)
        if np.count_nonzero(measured) < MIN_JITTER_ROWS:
            continue
        speed = smooth_speed(time_s[measured], values[measured])
        regular = np.linspace(time_s[measured][0], time_s[measured][-1], len(speed))
        fifth = np.diff(values[measured] + speed * (regular - time_s[measured]), n=5)
        differences.append(_mean_squares(fifth[1:] - fifth[:-1]) / _DIFFERENCES_VARIANCE)
        sums.append(_mean_squares(fifth[1:] + fifth[:-1]) / _SUMS_VARIANCE)
        speeds.append(np.abs(speed[3:-3]))  # at the middle of seven samples
        travels.append(speeds[-1] * np.median(np.diff(time_s[measured])))  # per row
    if not speeds:
        return 0.0
    speed = np.concatenate(speeds)
    fast = (speed > np.percentile(speed, 75)) & (np.concatenate(travels) > math.sqrt(12.0) * noise)
    if not fast.any():
        return 0.0
    fastest = _mean_of_kept(np.concatenate(differences)[fast]) / _DIFFERENCES_KEPT
    slower = _mean_of_kept(np.concatenate(sums)[fast]) / _SUMS_KEPT
    white = (_MOTION_RATIO * fastest - slower) / (_MOTION_RATIO - 1.0)
    if white < _LEAST_WHITE_PART * fastest:
        return 0.0
    variance = white - noise**2
    jitter = math.sqrt(variance / float(np.median(speed[fast] ** 2))) if variance > noise**2 else 0.0
    period = float(np.median(np.concatenate([np.diff(time_s) for time_s in times])))
    return jitter if jitter <= _LARGEST_JITTER * period else 0.0


def _mean_squares(values: Array) -> Array:
    """Return the mean square of the values around each one, shape (n,)."""
    return np.asarray(uniform_filter1d(values**2, _STEP_ROWS))


def _mean_of_kept(mean_squares: Array) -> float:
    """Return the mean of those mean squares that shocks do not reach."""
    return float(np.mean(np.sort(mean_squares)[: math.ceil(_KEPT * len(mean_squares))]))


def noise_by_row(time_s: Array, outputs: Array, noise: Array, jitter: float) -> Array:
    """Return the standard deviation of every measurement from the sensor's noise and the jitter of the clock.

    Args:
        time_s: Sample times, s, shape (n,).
        outputs: Measurements, m or rad, shape (n, sensors), NaN where not measured.
        noise: Standard deviations of the sensors' noise at rest, m or rad, shape (sensors,).
        jitter: Standard deviation of the sampling time, s.

    Returns:
        sqrt(noise^2 + (jitter * speed)^2), m or rad, shape (n, sensors). The speed of a sensor is the slope of a
        parabola over 11 of its measurements.
    """
    by_row = np.tile(noise, (len(time_s), 1))
    for j, values in enumerate(outputs.T):
        measured = np.isfinite(values)
        if jitter > 0.0 and np.count_nonzero(measured) >= _SPEED_ROWS:
            by_row[measured, j] = np.hypot(
                noise[j], jitter * smooth_speed(time_s[measured], values[measured])
            )
    return by_row


def smooth_speed(time_s: Array, values: Array) -> Array:
    """Return the speed of a channel, m/s or rad/s, shape (n,): the slope of a parabola over 11 samples.

    Args:
        time_s: Sample times, s, shape (n,).
        values: Measurements, m or rad, shape (n,).
    """
    period = float(time_s[-1] - time_s[0]) / (len(time_s) - 1)
    return np.asarray(savgol_filter(values, _SPEED_ROWS, 2, deriv=1, delta=period))
