"""Estimate quantum (quantization step), noise and range of the sensors from the recordings alone."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence

import numpy as np
from scipy.signal import savgol_coeffs, savgol_filter

from ..arrays import Array
from ..effects import EFFECTS
from ..effects.sensor_range import UNLIMITED
from ..machine import AppliedEffect, Machine
from ..recordings import Recording, quantum_of
from .criteria import SaturationCriteria

Range = tuple[float, float]

_CURVE_ROWS = 21  # Measurements of a curve; in slow motion, they extend over several quanta.
_ROUNDING_ACCURACY = 1.2  # Rounding alone is estimated up to 12 % too large.
_MIN_RESTING_ROWS = 30  # Fewer resting rows of all runs together do not give a standard deviation.


def sensor_quantum(channel: Sequence[Array], resolution: float) -> float:
    """Estimate the quantization step (quantum) of a sensor from all runs.

    Args:
        channel: Measurements of the sensor by run, m or rad, each of shape (n,), NaN where not measured.
        resolution: Declared resolution, m or rad, 0 if there is none.

    Returns:
        Median of the quanta of single runs, m or rad. A run without a recognizable quantum, such as one with hardly any
        motion, does not count. If no run has one, the declared resolution.
    """
    quanta = [quantum for quantum in map(quantum_of, channel) if quantum > 0.0]
    return float(np.median(quanta)) if quanta else resolution


def noise_at_rest(channel: Sequence[Array], resting_rows: Sequence[int]) -> float | None:
    """Estimate the standard deviation of a sensor's noise from the rows at rest of all runs.

    Args:
        channel: Measurements of the sensor by run, m or rad, each of shape (n,), NaN where not measured.
        resting_rows: Number of rows at rest at the beginning of each run.

    Returns:
        Standard deviation around a parabola in each run, m or rad. Runs with fewer than 10 measurements at rest do not
        count. None if the others have too few (about 30 in total).
    """
    squares, rows = 0.0, 0
    for values, count in zip(channel, resting_rows, strict=True):
        at_rest = values[:count][np.isfinite(values[:count])]
        if len(at_rest) >= 10:
            # A parabola is subtracted: a machine that still creeps to rest is not noise. Equal values have none.
            grid = np.linspace(-1.0, 1.0, len(at_rest))
            parabola = (
                np.polynomial.polynomial.polyfit(grid, at_rest, 2) if np.ptp(at_rest) > 0.0 else at_rest[:1]
            )
            squares += float(np.sum((at_rest - np.polynomial.polynomial.polyval(grid, parabola)) ** 2))
            rows += len(at_rest) - 3
    return float(np.sqrt(squares / rows)) if rows >= _MIN_RESTING_ROWS else None


def sensor_noise(
    channel: Sequence[Array], resting_rows: Sequence[int], quantum: float, declared: float
) -> float:
    """Estimate the standard deviation of a sensor's noise.

    The first of these sources that is available is used: about 30 measurements at rest, the declared value, third
    differences of the measurements. For a sensor with a quantum, deviations from a smooth curve (Savitzky and Golay
    1964) replace the third differences if they are smaller. The result is at least the rounding error,
    quantum / sqrt(12).

    Args:
        channel: Measurements of the sensor by run, m or rad, each of shape (n,), NaN where not measured.
        resting_rows: Number of rows at rest at the beginning of each run.
        quantum: Quantization step of the sensor, m or rad; 0 if there is none.
        declared: Declared standard deviation, m or rad; 0 where none is declared.

    Returns:
        Standard deviation, m or rad.
    """
    rounding, at_rest = quantum / np.sqrt(12), noise_at_rest(channel, resting_rows)
    # An estimate of zero (a channel without any noise) is replaced by the declared value or by the differences.
    if at_rest is not None:
        return max(at_rest, rounding) or declared or difference_noise(channel)
    if declared or not quantum:
        return max(rounding, declared or difference_noise(channel))
    # The steps of slow motion raise third differences, vibration the deviations from a curve; noise raises both.
    estimate = min(difference_noise(channel), _curve_noise(channel))
    return estimate if estimate > _ROUNDING_ACCURACY * rounding else rounding


_REST_S = 0.02  # s; a quantized measurement that stays the same for longer shows that the sensor is at rest


def independent_values(time_s: Array, outputs: Array, quanta: Array) -> Array:
    """Return the weight of each measurement in a sum of squared errors: 1 if its error is independent.

    While a quantized sensor is at rest, all its measurements are equal and have the same rounding error. They count as
    one measurement: N equal measurements have the weight 1 / N each. A sensor counts as at rest if its measurement
    stays the same for more than 20 ms.

    Args:
        time_s: Sample times, s, shape (n,).
        outputs: Measurements, m or rad, shape (n, sensors), NaN where not measured.
        quanta: Quantization steps of the sensors, m or rad, 0 where there is none, shape (sensors,).

    Returns:
        Weights, dimensionless, shape (n, sensors): 0 where not measured; 1 / N at rest; 1 in motion, and for sensors
        without quantization.
    """
    counts = np.isfinite(outputs).astype(float)
    for values, count, quantum in zip(outputs.T, counts.T, quanta, strict=True):
        rows = np.flatnonzero(count)
        if quantum <= 0.0 or len(rows) == 0:
            continue
        changes = np.flatnonzero(np.abs(np.diff(values[rows])) > quantum / 2) + 1
        first = np.concatenate([[0], changes])  # row of each sequence of equal measurements
        lengths = np.diff(np.append(first, len(rows)))
        durations = time_s[rows[first + lengths - 1]] - time_s[rows[first]]
        count[rows] = np.repeat(np.where(durations > _REST_S, 1.0 / lengths, 1.0), lengths)
    return counts


_SPEED_ROWS, MIN_JITTER_ROWS = 11, 50  # samples that a speed is computed from; measured rows of a run
# Largest jitter, in sampling periods. Times that err uniformly over a whole period have a standard deviation of 0.29;
# much larger errors would exchange the order of the samples. What looks like more has another cause, such as a sensor
# that is slower than the log, and must not be taken for noise.
_LARGEST_JITTER = 0.5
# Variance of fifth differences of white noise with variance 1: the sum of the squared binomial coefficients.
_FIFTH_DIFFERENCE_VARIANCE = 252.0


def difference_noise(channel: Sequence[Array]) -> float:
    """Estimate a sensor's noise from third differences, which smooth motion hardly changes (von Neumann 1941).

    Args:
        channel: Measurements of the sensor by run, m or rad, each of shape (n,), NaN where not measured.

    Returns:
        Standard deviation, m or rad, at least 1e-12. If no run has four measurements, 1.
    """
    differences = np.concatenate([np.diff(values[np.isfinite(values)], n=3) for values in channel])
    if len(differences) == 0:
        return 1.0
    return max(1.4826 * float(np.median(np.abs(differences))) / np.sqrt(20.0), 1e-12)


def _curve_noise(channel: Sequence[Array]) -> float:
    """Estimate a sensor's noise, m or rad, from deviations from parabolas over 21 measurements; infinite if fewer."""
    runs = [values[np.isfinite(values)] for values in channel]
    deviations = [v - savgol_filter(v, _CURVE_ROWS, 2) for v in runs if len(v) >= _CURVE_ROWS]
    if not deviations:
        return math.inf
    removed = savgol_coeffs(_CURVE_ROWS, 2)[_CURVE_ROWS // 2]  # fraction of the noise's variance
    return float(np.sqrt(np.mean(np.concatenate(deviations) ** 2) / (1.0 - removed)))


def clock_jitter(times: Sequence[Array], channel: Sequence[Array], noise: float) -> float:
    """Estimate the jitter of the clock, the random error of the sampling times, from a channel during fast motion.

    A measurement that is late by dt has an error of dt * speed. During fast motion, the standard deviation s of the
    measurements is therefore given by s^2 = noise^2 + jitter^2 * speed^2. s is computed from fifth differences, which
    smooth motion hardly changes. Only the fastest quarter of the rows is used. Rows in which the sensor moves by less
    than sqrt(12) * noise per row are left out, because rounding errors of successive measurements then depend on each
    other.

    Args:
        times: Sample times by run, s, shape (n,) each.
        channel: Measurements of the sensor by run, m or rad, shape (n,) each, NaN where not measured.
        noise: Standard deviation of the sensor's noise at rest, m or rad.

    Returns:
        Standard deviation of the sampling time, s. 0 if there are no fast rows or no run of 50 measurements, if s^2 is
        at most 2 * noise^2, because vibrations may cause such a value, or if it would exceed half a sampling period.
    """
    squares, speeds, travels = [], [], []
    for time_s, values in zip(times, channel, strict=True):
        measured = np.isfinite(values)
        if np.count_nonzero(measured) < MIN_JITTER_ROWS:
            continue
        speed = smooth_speed(time_s[measured], values[measured])
        regular = np.linspace(time_s[measured][0], time_s[measured][-1], len(speed))
        at_regular_times = values[measured] + speed * (regular - time_s[measured])
        # at the middle of six samples
        squares.append(np.diff(at_regular_times, n=5) ** 2 / _FIFTH_DIFFERENCE_VARIANCE)
        speeds.append(np.abs(speed[2:-3]))
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


def saturation_ranges(
    recordings: Sequence[Recording], machine: Machine, noise: Array, criteria: SaturationCriteria
) -> dict[str, Range]:
    """Find the lasers that saturate: they stay at the end of their measuring range while the machine moves.

    A laser is a sensor with a fixed zero. It saturates at its largest (or smallest) measurement if two conditions hold,
    whose thresholds are those of the default `criteria`: at least 1 % of all rows are within 8 standard deviations of
    the noise from this measurement, and by the encoders, the laser's coordinate moves in these rows by at least 300
    standard deviations of the laser's noise. Without belts or encoders, nothing is found.

    Args:
        recordings: All runs of the rig.
        machine: Machine as declared.
        noise: Standard deviations of the sensors' noise, m or rad, shape (sensors,).

    Returns:
        Lower and upper end of the measuring range, m or rad, by channel of each saturating laser. For an end that the
        laser never reached, -10 or +10 times the largest magnitude of its measurements. Empty if none saturates.
    """
    ranges: dict[str, Range] = {}
    positions_by_run = [_positions_from_encoders(r, machine) for r in recordings]
    for j, sensor in enumerate(machine.sensors):
        if not sensor.fixed:
            continue
        i = machine.coordinate_names.index(sensor.coordinate)
        channel = [r.outputs[:, j] for r in recordings]
        motion = [positions[:, i] for positions in positions_by_run]
        ends = [_end(channel, motion, float(noise[j]), sign, 1.0, criteria) for sign in (-1.0, 1.0)]
        # A sensor that saturates at one end probably does so at the other as well; less evidence suffices there.
        if any(end is not None for end in ends):
            factor = criteria.second_end_factor
            ends = [_end(channel, motion, float(noise[j]), sign, factor, criteria) for sign in (-1.0, 1.0)]
            far = UNLIMITED * max(float(np.nanmax(np.abs(values), initial=0.0)) for values in channel)
            low, high = (
                sign * far if end is None else end for sign, end in zip((-1.0, 1.0), ends, strict=True)
            )
            ranges[sensor.channel] = (low, high)
    return ranges


def _positions_from_encoders(recording: Recording, machine: Machine) -> Array:
    """Return the displacements (n, coordinates) since the first row by the encoders, with unstretched belts."""
    encoders = [j for j, sensor in enumerate(machine.sensors) if sensor.incremental]
    count = len(machine.coordinates)
    if not encoders or not machine.belts:
        return np.full((len(recording.time_s), count), np.nan)
    extension = machine.belt_matrix
    rows = np.vstack([machine.sensor_matrix[encoders], extension])
    angles = recording.outputs[:, encoders] - recording.outputs[0, encoders]
    measured = np.hstack([angles, np.zeros((len(angles), len(extension)))])
    return np.asarray(np.linalg.lstsq(rows, measured.T, rcond=None)[0].T)


def _end(
    channel: Sequence[Array],
    motion: Sequence[Array],
    noise: float,
    sign: float,
    factor: float,
    criteria: SaturationCriteria,
) -> float | None:
    """Return where a sensor saturates at the upper (sign 1) or lower end (-1), or None; `factor` scales thresholds."""
    outward = sign * np.concatenate(channel)
    if not np.isfinite(outward).any():
        return None
    outermost = outward > float(np.nanmax(outward)) - criteria.saturation_band * noise
    if outermost.mean() < factor * criteria.min_saturated_fraction:
        return None
    distance, first = 0.0, 0
    for positions in motion:
        saturated = positions[outermost[first : first + len(positions)]]
        first += len(positions)
        if len(saturated) and np.isfinite(saturated).all():
            distance = max(distance, float(np.ptp(saturated)))
    if distance < factor * criteria.min_saturated_travel * noise:
        return None
    return sign * float(np.median(outward[outermost]))


def blank_saturated(
    recording: Recording,
    ranges: Mapping[str, Range],
    machine: Machine,
    noise: Array,
    criteria: SaturationCriteria,
) -> Recording:
    """Copy a recording, with NaN in place of saturated measurements.

    A measurement is saturated if it lies beyond an end of the sensor's range, or inside the range but closer to an end
    than 4 standard deviations of the noise (half of `criteria.saturation_band`). Beside a saturated row, 8 count
    instead of 4: of many saturated measurements, noise puts some further inside the range.

    Args:
        ranges: Lower and upper end of the measuring range by channel name, m or rad. Other channels are unchanged.
        noise: Standard deviations of the sensors' noise, m or rad, shape (sensors,).

    Returns:
        Copy with measurements of shape (n, sensors), m or rad; the recording itself is not changed.
    """
    outputs = recording.outputs.copy()
    for channel, (low, high) in ranges.items():
        j = machine.output_channels.index(channel)
        band = criteria.saturation_band * noise[j]
        # Distance from the nearer end, m; NaN: missing.
        inside = np.minimum(high - outputs[:, j], outputs[:, j] - low)
        saturated = inside < band / 2
        beside = np.append(saturated[1:], False) | np.insert(saturated[:-1], 0, False)
        outputs[saturated | (beside & (inside < band)), j] = np.nan
    return dataclasses.replace(recording, outputs=outputs)


def range_effects(
    ranges: Mapping[str, Range], selected: Sequence[AppliedEffect] = ()
) -> tuple[AppliedEffect, ...]:
    """Convert the ranges of saturated sensors to effects ``sensor_range``, which limit the measurements of a machine.

    Args:
        ranges: Lower and upper end of the measuring range by channel name, m or rad.
        selected: Effects that the search selected. If one of them is the ``sensor_range`` of the same sensor, the
            intersection of both ranges is used.

    Returns:
        One effect per channel in `ranges`, with the parameters `low` and `high`, m or rad.
    """
    effects = []
    for channel, (low, high) in ranges.items():
        for e in selected:
            if e.site == channel and (limits := e.measuring_range):
                low, high = max(low, limits[0]), min(high, limits[1])
        # Ranges may be disjoint.
        effects.append(EFFECTS["sensor_range"].at(channel, low=low, high=max(low, high)))
    return tuple(effects)
