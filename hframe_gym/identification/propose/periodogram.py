"""Find the spatial periods of the missing force, the force that a model lacks.

The periodogram is that of least squares, because positions are unequally spaced. `missing_force` estimates
the force up to a cut-off frequency, which a short period exceeds at high speed. Each period is therefore
fitted only to rows in which the motion is slow enough.
"""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray
from scipy.fft import next_fast_len, rfft

from ...arrays import Array
from ..forces.missing_force import HIGHEST_FREQUENCY

# Numbers of periods over the range of the positions. Less than one period of a force cannot be distinguished
# from a spring.
MIN_FRICTION_PERIODS, MIN_FORCE_PERIODS = 0.5, 1.0
_MAX_PERIODS = 1000.0
_ROWS_PER_PERIOD = 4.0  # Minimum number of rows per period. Rows of faster motion are not used.
# Lowest speed that is used, relative to the highest one that is used. Near standstill, the direction of dry
# friction is uncertain.
_SLOWEST = 0.02
# A period is tried only with this many slow rows: ten for each of the five fitted coefficients.
_MIN_ROWS = 50
_POINTS_PER_PERIOD = 4  # The grid of rates has this many points per additional period over the range.
# Least number of cells of the transform's position grid in the shortest period. A cubic spline then errs by 1
# / 7^4, at the double rate by 1 / 3^4.
_CELLS_PER_POINT = 8
_GROUP_RATIO = 2.0**0.5  # Ratio of the highest to the lowest rate of a group that is fitted to the same rows.
# Periods over the range. The strongest rate of each of these bands is returned, unless on the flank of a
# stronger one.
_BAND_EDGES = (3.0, 12.0, 40.0, 150.0)
_SLOW_PERIODS = np.concatenate([np.arange(0.5, 3.0, 0.25), np.arange(3.0, 6.1, 0.5)])
_MAX_RATES = 7


def periodogram_peaks(motion: Array, sampling_period: float, *, factor: Array | None = None) -> Array:
    """Find the spatial rates (2 pi / period) at which the missing force varies most with the position.

    The missing force is the force that the model lacks. At each spatial rate, a sine and a cosine of the
    position, times a factor, are fitted to it by least squares, together with a constant, viscous and dry
    friction: a least-squares periodogram. Rates from 1 (with a factor: 0.5) to 1000 periods over the range of
    the positions are tried. The fit at a rate uses only rows of slow motion, except near standstill: at their
    speed, one period takes at least four rows and at least 1 / `HIGHEST_FREQUENCY` (25 ms). The strength of a
    rate is the sum of squares of the force that sine and cosine explain in these rows.

    Args:
        motion: Columns position, velocity and missing force of one coordinate, m, m/s, N or rad, rad/s, Nm,
            shape (n, 3).
        sampling_period: Time from one row to the next, s.
        factor: By what the periodic quantity is multiplied in each row, shape (n,): the sign of the velocity
            for a friction level, the current for a torque constant. Default: 1, for a periodic force.

    Returns:
        At most seven spatial rates, rad per unit of position, shape (rates,). First, by decreasing strength,
        the strongest rate of each of five bands, with the limits 3, 12, 40 and 150 periods over the range of
        the positions; then the strongest of all other rates. A rate is skipped if it differs from an earlier
        one by at most 0.75 periods over the range. Empty if the position does not change or the motion is
        never slow enough.

    References:
        Lomb (1976), Least-squares frequency analysis of unequally spaced data.
    """
    span = float(np.ptp(motion[:, 0]))
    if span <= 0.0:
        return np.zeros(0)
    fewest = MIN_FORCE_PERIODS if factor is None else MIN_FRICTION_PERIODS
    points, power = _spectrum(
        motion, np.ones(len(motion)) if factor is None else factor, sampling_period, fewest
    )
    # First the best rate of each band, because the noise of the missing force grows with it; then the best of
    # all.
    band = np.searchsorted(_BAND_EDGES, points / _POINTS_PER_PERIOD)
    best_of_band = [np.flatnonzero(band == k)[np.argmax(power[band == k])] for k in np.unique(band)]
    peaks: list[int] = []
    for k in (*sorted(best_of_band, key=lambda k: -power[k]), *np.argsort(-power)):
        # not the flank of another peak
        if all(abs(points[k] - other) > 0.75 * _POINTS_PER_PERIOD for other in peaks):
            peaks.append(int(points[k]))
        if len(peaks) == _MAX_RATES:
            break
    return 2 * np.pi / (_POINTS_PER_PERIOD * span) * np.array(peaks, float)


def block_means(values: Array, rows: int) -> Array:
    """Average blocks of successive rows, such as the rows of `periodogram_peaks`.

    Args:
        values: Values of any unit, shape (n, ...).
        rows: Number of rows of a block; rows that do not fill the last one are left out.

    Returns:
        Means in the same unit, shape (n // rows, ...).
    """
    complete = len(values) // rows * rows
    return np.asarray(values[:complete].reshape(-1, rows, *values.shape[1:]).mean(axis=1))


def slow_rates(position: Array) -> Array:
    """Return start values for the spatial rate (2 pi / period) of friction that varies slowly by position.

    The values form a grid of 0.5 to 6 periods over the range of the positions. They are tried in addition to
    `periodogram_peaks`, which may overlook slow variations because the estimate of the missing force is
    noisy.

    Args:
        position: Positions of one coordinate over all rows of all runs, m or rad, shape (n,).

    Returns:
        Rates, rad per unit of position, shape (rates,); empty if the position does not change.
    """
    span = float(np.ptp(position))
    return np.asarray(2 * np.pi / span * _SLOW_PERIODS if span > 0.0 else np.zeros(0))


def _spectrum(
    motion: Array, factor: Array, sampling_period: float, fewest: float
) -> tuple[NDArray[np.int64], Array]:
    """Return the points of the grid of rates, and the square sum that each explains, shape (points,) each.

    A point k is the rate of k / `_POINTS_PER_PERIOD` periods over the range of the positions.
    """
    position, velocity, force = motion.T
    speed, span = np.abs(velocity), float(np.ptp(position))
    position = position - position.min()
    top = float(np.percentile(speed, 99))
    highest = min(HIGHEST_FREQUENCY, 1.0 / (_ROWS_PER_PERIOD * sampling_period))  # periods per second
    limits = [_POINTS_PER_PERIOD * fewest]
    while limits[-1] < _POINTS_PER_PERIOD * _MAX_PERIODS:
        limits.append(limits[-1] * _GROUP_RATIO)
    all_points, all_power = [np.zeros(0, np.int64)], [np.zeros(0)]
    for first, end in itertools.pairwise(np.ceil(limits).astype(np.int64)):
        points = np.arange(first, min(end, round(_POINTS_PER_PERIOD * _MAX_PERIODS) + 1))
        fastest = highest * _POINTS_PER_PERIOD * span / end
        rows = (speed > _SLOWEST * min(fastest, top)) & (speed < fastest)
        if np.count_nonzero(rows) < _MIN_ROWS:
            continue
        all_points.append(points)
        all_power.append(
            _explained_power(points, span, position[rows], velocity[rows], factor[rows], force[rows])
        )
    return np.concatenate(all_points), np.concatenate(all_power)


def _explained_power(
    points: NDArray[np.int64], span: float, position: Array, velocity: Array, factor: Array, force: Array
) -> Array:
    """Return the square sum that a sine and a cosine at each rate of the grid explain, shape (points,).

    Their products with the force and with constant, viscous and dry friction are Fourier transforms over the
    position. Each row is distributed over four neighboring cells of a grid of positions by a cubic B-spline,
    so that fast Fourier transforms can be used.
    """
    # Orthonormal basis of constant, viscous and dry friction, whose best fit is subtracted from the force.
    basis, _ = np.linalg.qr(np.stack([np.ones_like(position), velocity, np.sign(velocity)], axis=1))
    force = force - basis @ (basis.T @ force)
    # over _POINTS_PER_PERIOD times the range
    cells = next_fast_len(_CELLS_PER_POINT * int(points[-1] + 1), real=True)
    cell_position = position * (cells / (_POINTS_PER_PERIOD * span))
    first_cell = cell_position.astype(np.int64)
    of_rows = (first_cell + np.arange(4)[:, None]).ravel()
    parts = _spline_parts(cell_position - first_cell)
    columns = factor * np.vstack([force, basis.T, factor])
    sums = np.array([np.bincount(of_rows, (values * parts).ravel(), cells) for values in columns])
    spectra = rfft(sums)
    # The division undoes the smoothing by the spline.
    transforms = spectra[:-1, points].conj() / np.sinc(points / cells) ** 4
    double_rate = spectra[-1, 2 * points].conj() / np.sinc(2 * points / cells) ** 4
    projection, in_basis = transforms[0], transforms[1:]
    square = factor @ factor
    cc = 0.5 * (square + double_rate.real) - np.sum(in_basis.real**2, axis=0)
    ss = 0.5 * (square - double_rate.real) - np.sum(in_basis.imag**2, axis=0)
    cs = 0.5 * double_rate.imag - np.sum(in_basis.real * in_basis.imag, axis=0)
    determinant = np.maximum(cc * ss - cs**2, 1e-9 * cc * ss + 1e-300)
    explained = ss * projection.real**2 + cc * projection.imag**2 - 2 * cs * projection.real * projection.imag
    return np.asarray(explained / determinant)


def _spline_parts(offset: Array) -> Array:
    """Return the parts of rows that a cubic B-spline gives to four cells, shape (4, rows).

    The offset is a row's distance from the second of its cells towards the third, in cells.
    """
    rest = 1.0 - offset
    first, last = rest**3 / 6.0, offset**3 / 6.0
    return np.stack([first, 2.0 / 3.0 - offset**2 + 3.0 * last, 2.0 / 3.0 - rest**2 + 3.0 * first, last])
