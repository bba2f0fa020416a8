"""Compute how much of a missing force, or of a disagreement of sensors, a cause explains in other runs.

What refitted parameters can absorb (forces in proportion to accelerations, velocities, directions, voltages)
is removed from force and curves alike. The curve of a cause is fitted to all runs but one and then compared
with the force in that run; the sum over all runs is what the cause explains. Chance therefore explains
nothing on average, however many causes there are, and causes at different components compete for the same
force: that on a motor acts on both carriages in one ratio.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from ...arrays import Array
from ...machine import Machine
from ...preparation.dataset import Dataset
from ..forces.missing_force import MissingMotion, low_pass, motion_directions
from ..forces.motion_variables import variables_of_motion
from ..judge import cause as judge

_MOST_ROWS = 10_000  # that are compared; of longer recordings fewer per second
_PIECES = 6  # fewer runs are divided into at least that many pieces, each of which is left out once
# Of the mean square of a curve's pieces: pieces that the other runs do not excite get no force, and the more
# noise there is, the flatter is the best curve.
_RIDGES = (1e-4, 0.03, 0.3)
_RESTING = 0.01  # of the rms speed of each motion; a machine at rest shows no force
_RESTING_S = 0.025  # rows that are that close to motion count as motion, so that breakaways do

Columns = Array  # curve at the rows of all runs, one column per coefficient, shape (rows, k)


class Cause(NamedTuple):
    """Possible cause of a missing force or of a disagreement of sensors: curves over one variable.

    Attributes:
        component: Component on which the cause acts.
        variable: Name of its variable.
        coordinate: The component's coordinate.
        parts: Curves with common coefficients, each a force on a coordinate (index) or an error of a sensor
            (index). With the index None, the curve applies to all channels, each with separate coefficients.
    """

    component: str
    variable: str
    coordinate: str
    parts: tuple[tuple[int | None, Columns], ...]


class Signals:
    """The variables on which causes may depend, at those rows of all runs that are compared.

    Args:
        machine: Machine that predicts.
        motions: Missing forces and motion of each run.
        rate_hz: Rate of the rows that are compared, Hz.
        filtered: Whether forces below 30 Hz are compared.
    """

    def __init__(
        self, machine: Machine, data: Dataset, motions: list[MissingMotion], rate_hz: float, *, filtered: bool
    ):
        self.period, self._filtered = data.period, filtered
        by_run = [
            variables_of_motion(machine, run, data, motion.positions, motion.velocities)
            for run, motion in zip(data.runs, motions, strict=True)
        ]
        self._variables = {name: np.concatenate([of_run[name] for of_run in by_run]) for name in by_run[0]}
        ends = np.cumsum([len(run.time_s) for run in data.runs])
        self._slices = [slice(end - len(run.time_s), end) for end, run in zip(ends, data.runs, strict=True)]
        step = max(1, round(1.0 / (rate_hz * data.period)), ends[-1] // _MOST_ROWS)
        directions = motion_directions(machine, data)
        self._kept = [_moving_rows(motion.velocities @ directions.T, data.period, step) for motion in motions]

    @property
    def count(self) -> int:
        """Number of rows that are compared, of all runs together."""
        return sum(map(len, self._kept))

    def __getitem__(self, name: str) -> Array:
        """Return a variable at all rows of all runs, shape (rows,)."""
        return self._variables[name]

    def compared(self, columns: Columns, lag: tuple[Array, Array] | None = None) -> Columns:
        """Select, from columns at all rows, shape (rows of all runs, k), the n compared rows, shape (n, k).

        Args:
            columns: Values of any unit, the runs one after the other.
            lag: Numerator and denominator of a digital filter, in descending powers of z, that is applied to
                each run first, shape (order + 1,) each. Default: none.
        """
        by_run = [columns[of_run] for of_run in self._slices]
        if lag is not None:
            by_run = [signal.lfilter(*lag, values, axis=0) for values in by_run]
        return self.thinned(by_run)

    def thinned(self, by_run: list[Array]) -> Array:
        """Select the n compared rows of signals, shape (n, k): rows of motion at the rate of the comparison.

        If the compared forces are filtered, the signals are first filtered in the same way, below 30 Hz.

        Args:
            by_run: Signals at all rows of each run, in any unit, shape (rows of the run, k).
        """
        if self._filtered:
            by_run = [low_pass(values, self.period) for values in by_run]
        return np.concatenate([values[rows] for values, rows in zip(by_run, self._kept, strict=True)])

    def filtered(self, name: str, filter_of_run: Callable[[Array], Array]) -> Array:
        """Apply a filter to a variable, run by run, at all rows of all runs, shape (rows, k).

        Args:
            name: Name of the variable (`variables_of_motion`).
            filter_of_run: Function of the variable in one run, shape (rows of the run,), that returns k
                columns, shape (rows of the run, k).
        """
        return np.concatenate([filter_of_run(self._variables[name][rows]) for rows in self._slices])

    def pieces(self) -> NDArray[np.int64]:
        """Return the index of the first compared row of each piece, shape (pieces,).

        Each piece is left out once in a cross-validation. It is a run; of fewer than six runs, an equal part
        of one, so that there are at least six pieces.
        """
        each = max(1, -(-_PIECES // len(self._kept)))
        firsts, first = [], 0
        for rows in self._kept:
            firsts += [first + len(rows) * part // each for part in range(each)]
            first += len(rows)
        return np.array(firsts)

    def run_constants(self) -> Array:
        """Return indicator columns of the runs: 1 in the run's compared rows, else 0, shape (n, runs)."""
        lengths = [len(rows) for rows in self._kept]
        return np.repeat(np.eye(len(lengths)), lengths, axis=0)


class Unexplained(NamedTuple):
    """Unexplained forces or disagreements of sensors, and their response to causes.

    Attributes:
        values: Forces or disagreements at the compared rows, shape (n, channels).
        noise: Part of the values that noise causes, same shape.
        prompt: The same values without the lag of `filters`, to find periods and resonances, same shape.
        directions: Value of each channel per unit of a cause at each index, shape (channels, indices).
        filters: Numerator and denominator of the filter from causes to each channel; None if there is no lag.
    """

    values: Array
    noise: Array
    prompt: Array
    directions: Array
    filters: list[tuple[Array, Array]] | None = None


class CauseComparison:
    """Comparison of causes with unexplained forces or disagreements, beyond what a refit would absorb.

    Args:
        signals: Variables, and the rows that are compared.
        unexplained: Forces or disagreements at these rows.
        absorbed: Signals of which any linear combination is removed from each channel, at all rows,
            shape (rows, k).
        free_constants: Whether a constant of each run is removed as well, such as the zero of a sensor.
    """

    def __init__(
        self, signals: Signals, unexplained: Unexplained, absorbed: Array, *, free_constants: bool = False
    ):
        values, noise = unexplained.values, unexplained.noise
        # At the least a millionth of the values: data without noise have none.
        scale = np.maximum(noise.std(axis=0), 1e-6 * values.std(axis=0) + np.finfo(float).tiny)
        self.signals, self._filters = signals, unexplained.filters
        self._directions, self._pieces = unexplained.directions / scale[:, None], signals.pieces()
        constants = [signals.run_constants()] if free_constants else []
        self._bases = [
            _orthonormal(np.hstack([self._compared(channel, absorbed), *constants]))
            for channel in range(len(scale))
        ]
        self._values = self._without_absorbed(values / scale)
        self._prompt = self._without_absorbed(unexplained.prompt / scale)
        self._noise = self._without_absorbed(noise / scale)
        by_noise = float(np.sum(self._noise**2))
        self.total = float(np.sum(self._values**2))
        self.beyond_noise = judge.beyond_noise(self.total, by_noise)

    def _compared(self, channel: int, columns: Columns) -> Columns:
        """Return columns (rows, k) as a channel shows them, at the compared rows."""
        return self.signals.compared(columns, self._filters[channel] if self._filters else None)

    def _without_absorbed(self, values: Array) -> Array:
        """Return values (n, channels) without what the refitted parameters absorb."""
        columns = [values[:, c] - basis @ (basis.T @ values[:, c]) for c, basis in enumerate(self._bases)]
        return np.stack(columns, axis=1)

    def direction(self, index: int) -> Array:
        """Return what a unit cause changes in each channel, in units of its noise, shape (channels,).

        A channel is a motion along which forces are missing, or a combination of sensors that disagree.

        Args:
            index: Index of the coordinate on which a force of 1 N or 1 Nm acts, or, where disagreements of
                sensors are compared, of the sensor that has an error of one unit.
        """
        return self._directions[:, index]

    def target(self, index: int) -> Array:
        """Return the course of a cause at `index` that would explain most, up to a factor, shape (n,).

        It is the sum over the channels of `direction` times the unexplained values, both in units of the
        noise, at the compared rows. A curve of a cause is chosen by its correlation with it. The lag of an
        observer is removed.

        Args:
            index: Index as in `direction`.
        """
        return self._prompt @ self.direction(index)

    def _designs(self, cause: Cause) -> list[Array]:
        """Return what each channel shows of a cause's curve, without what is absorbed, shape (n, k) each."""
        channels = self._values.shape[1]
        designs: list[Array] = []
        for channel, basis in enumerate(self._bases):
            parts = []
            for index, columns in cause.parts:
                if index is None:
                    parts.append(np.kron(np.eye(channels)[channel], self._compared(channel, columns)))
                elif factor := self._directions[channel, index]:
                    parts.append(factor * self._compared(channel, columns))
                else:  # most forces show in one channel
                    parts.append(np.zeros((len(self._values), columns.shape[1])))
            design = np.sum(parts, axis=0)
            designs.append(design - basis @ (basis.T @ design))
        return designs

    def explained(self, cause: Cause) -> tuple[float, float, float]:
        """Compute how much of the unexplained values a cause explains.

        The curves of the cause are fitted to all pieces of the runs but one, and compared with the values in
        that piece, for each piece in turn. Sums of squares are those of values in units of their noise,
        dimensionless.

        Args:
            cause: Cause, of whose curves the best linear combination is fitted.

        Returns:
            reduction: Reduction of the sum of squares by these fits, summed over the pieces that they leave
            out; 0 if there is none.
            certain: The reduction minus its standard error, from the differences between the pieces.
            fraction: Explained part of the values beyond noise, with a fit to all pieces; what the cause
            explains of the noise is subtracted.
        """
        designs = self._designs(cause)
        squares, products = [], []
        for first, last in zip(self._pieces, [*self._pieces[1:], len(self._values)], strict=True):
            rows = slice(first, last)
            squares.append(np.sum([d[rows].T @ d[rows] for d in designs], axis=0))
            products.append(
                np.sum([d[rows].T @ self._values[rows, c] for c, d in enumerate(designs)], axis=0)
            )
        all_squares, all_products = np.sum(squares, axis=0), np.sum(products, axis=0)
        of_noise = np.sum([d.T @ self._noise[:, c] for c, d in enumerate(designs)], axis=0)
        best, certain, fraction = 0.0, 0.0, 0.0
        for relative in _RIDGES:
            ridge = relative * np.trace(all_squares) / len(all_squares) * np.eye(len(all_squares))
            if ridge[0, 0] <= 0.0:
                break
            reductions = []
            for square, product in zip(squares, products, strict=True):
                weights = np.linalg.solve(all_squares - square + ridge, all_products - product)
                reductions.append(float(2.0 * weights @ product - weights @ square @ weights))
            reduction, error = float(np.sum(reductions)), float(np.std(reductions) * np.sqrt(len(reductions)))
            if reduction > best:
                inverse = np.linalg.inv(all_squares + ridge)
                squared = float(all_products @ inverse @ all_products - of_noise @ inverse @ of_noise)
                best, certain, fraction = reduction, reduction - error, squared / self.beyond_noise
        return best, certain, min(max(fraction, 0.0), 1.0)


def _orthonormal(columns: Array) -> Array:
    """Return an orthonormal basis of columns, shape (n, rank)."""
    size = np.maximum(np.sqrt(np.mean(columns**2, axis=0)), np.finfo(float).tiny)
    basis, singular, _ = np.linalg.svd(columns / size, full_matrices=False)
    return np.asarray(basis[:, singular > 1e-6 * singular[0]])


def _moving_rows(velocities: Array, period: float, step: int) -> NDArray[np.int64]:
    """Return every step-th row with movement along a motion, (n, motions), or just before or after."""
    speeds = np.abs(velocities)
    moving = (speeds > _RESTING * np.sqrt(np.mean(speeds**2, axis=0))).any(axis=1)
    near = np.convolve(moving, np.ones(2 * round(_RESTING_S / period) + 1), mode="same") > 0.0
    rows = np.arange(0, len(near), step)
    return np.asarray(rows[near[rows]])
