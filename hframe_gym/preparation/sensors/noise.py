"""Estimate quantum (quantization step) and noise of the sensors from the recordings alone."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.signal import savgol_coeffs, savgol_filter

from ...arrays import Array, Measurements, Quanta, Times
from ...recordings import exact_quantum, quantum_of
from ...robust_statistics import std_by_median, white_noise

_CURVE_ROWS = 21  # Measurements of a curve; in slow motion, they extend over several quanta.
_ROUNDING_ACCURACY = 1.2  # Rounding alone is estimated up to 12 % too large.
_MIN_RESTING_ROWS = 30  # Fewer resting rows of all runs together do not give a standard deviation.
_NO_CHANGE = 1e-12  # Third differences below this fraction of the largest value are rounding errors.
_REST_S = 0.02  # s; a quantized measurement that stays the same for longer shows that the sensor is at rest


def sensor_quantum(channel: Sequence[Array], resolution: float) -> float:
    """Estimate the quantization step (quantum) of a sensor from all runs.

    Args:
        channel: Measurements of the sensor by run, in its unit, each of shape (n,), NaN where not measured.
        resolution: Declared resolution, in its unit, 0 if there is none.

    Returns:
        Median of the quanta of single runs, in the sensor's unit. A run without a recognizable quantum, such
        as one with hardly any motion, does not count. If no run has one, the declared resolution, or a
        coarser step of which the values of all rows are multiples: in fast motion, hardly any rows that
        follow each other differ by one step.
    """
    quanta = [quantum for quantum in map(quantum_of, channel) if quantum > 0.0]
    if not quanta and resolution:
        quanta = [quantum for values in channel if (quantum := exact_quantum(values)) > resolution]
    return float(np.median(quanta)) if quanta else resolution


def noise_at_rest(channel: Sequence[Array], resting_rows: Sequence[int]) -> float | None:
    """Estimate the standard deviation of a sensor's noise from the rows at rest of all runs.

    Args:
        channel: Measurements of the sensor by run, in its unit, each of shape (n,), NaN where not measured.
        resting_rows: Number of rows at rest at the beginning of each run.

    Returns:
        Standard deviation of the measurements around one parabola per run, in the sensor's unit. Runs with
        fewer than 10 measurements at rest do not count. None if the others have too few (about 30 in total).
    """
    squares, rows = 0.0, 0
    for values, count in zip(channel, resting_rows, strict=True):
        at_rest = values[:count][np.isfinite(values[:count])]
        if len(at_rest) >= 10:
            # A parabola is subtracted: a machine that still creeps to rest is not noise. Equal values have
            # none.
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

    The first of these sources that is available is used: about 30 measurements at rest, the declared value,
    third differences of the measurements (of straight lines, those at their kinks). For a sensor with a
    quantum, deviations from a smooth curve (Savitzky and Golay 1964) replace the third differences if they
    are smaller. The result is at least the rounding error, quantum / sqrt(12).

    Args:
        channel: Measurements of the sensor by run, in its unit, each of shape (n,), NaN where not measured.
        resting_rows: Number of rows at rest at the beginning of each run.
        quantum: Quantization step of the sensor, in its unit; 0 if there is none.
        declared: Declared standard deviation, in its unit; 0 where none is declared.

    Returns:
        Standard deviation, in the sensor's unit.
    """
    rounding, at_rest = quantum / np.sqrt(12), noise_at_rest(channel, resting_rows)
    # An estimate of zero (a channel without any noise) is replaced by the declared value or by the
    # differences.
    if at_rest is not None:
        return max(at_rest, rounding) or declared or difference_noise(channel)
    if declared or not quantum:
        return max(rounding, declared or difference_noise(channel), 0.0 if declared else _kink_noise(channel))
    # The steps of slow motion raise third differences, vibration the deviations from a curve; noise raises
    # both.
    estimate = min(difference_noise(channel), _curve_noise(channel))
    return estimate if estimate > _ROUNDING_ACCURACY * rounding else rounding


def difference_noise(channel: Sequence[Array]) -> float:
    """Estimate a sensor's noise from third differences, which motion hardly changes (von Neumann 1941).

    Args:
        channel: Measurements of the sensor by run, in its unit, each of shape (n,), NaN where not measured.

    Returns:
        Standard deviation, in the sensor's unit, at least 1e-12. If no run has four measurements, 1.
    """
    measured = [values[np.isfinite(values)] for values in channel]
    if all(len(values) <= 3 for values in measured):
        return 1.0
    return max(white_noise(measured, 3), 1e-12)


def scatter_noise(values: Array, quantum: float) -> float:
    """Estimate a sensor's noise from a few measurements of one run, with or without motion.

    A speed that is counted in steps alternates between two neighbors while it is constant, and the median of
    third differences is then twice as large as this error: deviations from a smooth curve replace them if
    they are smaller.

    Args:
        values: Measurements, in the sensor's unit, shape (n,), NaN where not measured.
        quantum: Quantization step of the sensor, in its unit; 0 if there is none.

    Returns:
        Standard deviation, in the sensor's unit.
    """
    by_differences = difference_noise([values])
    return min(by_differences, _curve_noise([values])) if quantum > 0.0 else by_differences


def _kink_noise(channel: Sequence[Array]) -> float:
    """Estimate the noise of a measurement that consists of straight lines, in its unit; 0 for any other.

    A logger that averages over some pulses or interpolates writes such lines. Most of their third differences
    vanish, and the median of all would say that there is no noise: the errors are in the kinks.
    """
    measured = [values[np.isfinite(values)] for values in channel]
    differences = np.abs(np.concatenate([np.diff(values, 3) for values in measured]))
    largest = max((np.abs(values).max() for values in measured if len(values)), default=0.0)
    kinks = differences[differences > _NO_CHANGE * largest]
    fraction = len(kinks) / max(len(differences), 1)
    if not 0.0 < fraction <= 0.5:
        return 0.0
    return float(std_by_median(kinks)) * math.sqrt(fraction / math.comb(6, 3))


def _curve_noise(channel: Sequence[Array]) -> float:
    """Estimate a sensor's noise from deviations from parabolas over 21 rows; infinite if there are fewer."""
    runs = [values[np.isfinite(values)] for values in channel]
    deviations = [v - savgol_filter(v, _CURVE_ROWS, 2) for v in runs if len(v) >= _CURVE_ROWS]
    if not deviations:
        return math.inf
    removed = savgol_coeffs(_CURVE_ROWS, 2)[_CURVE_ROWS // 2]  # fraction of the noise's variance
    return float(np.sqrt(np.mean(np.concatenate(deviations) ** 2) / (1.0 - removed)))


def independent_values(time_s: Times, outputs: Measurements, quanta: Quanta) -> Array:
    """Return the weight of each measurement in a sum of squared errors: 1 if its error is independent.

    While a quantized sensor is at rest, all its measurements are equal and have the same rounding error. They
    count as one measurement: N equal measurements have the weight 1 / N each. A sensor counts as at rest if
    its measurement stays the same for more than 20 ms.

    Returns:
        Weights, dimensionless, shape (n, sensors): 0 where not measured; 1 / N at rest; 1 in motion, and for
        sensors without quantization.
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
