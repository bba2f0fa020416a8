"""Errors of the voltages that are interpolated between the rows of a log that is slower than its controller.

Between two rows, a controller answers rounding errors of its sensors that the log does not contain. The mean
voltage from one row to the next therefore differs from the interpolated one, by an error that is independent
of those before and after it. Each error pushes the machine, and changes the residual until the observer has
corrected it: the residual of an exact machine is correlated in time and between the sensors, and larger than
noise where the voltages jump.

To first order, the residual is r = n + G w, with innovations n of the observer, the errors w of the voltages,
and the response G of the predictions to them. Its covariance is S = D + G Q G', with the variances D of the
innovations and Q of the errors. Each block of rows, given the rows shortly before it, is made white with unit
variance by the inverse of a Cholesky factor of its covariance: chi-squared of an exact machine is 1, and rows
that a jump affects count as little as they say. A Kalman filter does the same for a linear machine; these
responses are also those of a machine that friction holds, where voltages change nothing.

References:
    Gelb (1974), "Applied Optimal Estimation".
    Vecchia (1988), "Estimation and model identification for continuous spatial processes", on the likelihood
    of values given those shortly before them.
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy import sparse
from scipy.ndimage import uniform_filter1d
from typing_extensions import override

from ...arrays import Array
from ...machine import Machine
from ...preparation.dataset import Dataset, PreparedRecording, VoltageErrors
from .prediction import (
    POLISH_STEP,
    SEARCH_STEP,
    SIMULATION,
    map_runs,
    predict,
    prediction_error,
    sensor_innovation_variance,
)
from .voltage_responses import voltage_responses

# If the part of a voltage that interpolation misses is independent from one change to the next, with the
# variance s^2, third differences of the rows have the variance 20 s^2 (1 + 9 + 9 + 1), and the mean voltage
# from one row to the next errs by 0.41 s^2 (two changes a row) to 0.43 s^2 (five and more): half of it is
# what the log lacks, the other half what the interpolation takes from the rows beside.
_SHARE = 0.42 / 20.0
_ROWS = 9  # over which the squares of third differences are averaged; the motion changes more slowly
# Product of the observer's bandwidth and the time after which a response is negligible; twice as long changes
# nothing.
_SETTLED = 9.0
_LARGEST_RESPONSE = 1e9  # noise per volt
# Rows of a residual that are made white together, and rows before them that are taken as known. Values that
# are farther apart remain slightly correlated, which costs 0.001 of the logarithm of the likelihood per value
# at 250 Hz (0.02 where friction holds the machine); a factor of the whole covariance has 29 MB per 1500 rows
# at 15 rad/s. The memory for each observer, 4 bytes * (8 + 16) * sensors^2 a row, permits long sessions: 0.5
# GB for 300,000 rows of four sensors.
_BLOCK, _BEFORE = 8, 16  # two blocks
_BLOCKS_TOGETHER = 128  # blocks that are factorized, or whitened in one product; limits the memory
_DRAWS = 8  # of voltage errors, for their effect on simulations: their rms is 15 % accurate in a run


def interpolation_variance(inputs: Array) -> Array:
    """Estimate the error variance of the mean voltage from each row to the next, if rows are interpolated.

    It is 0.021 times the mean square of the third differences of the rows, over the nine rows around. Of
    voltages that move smoothly, these differences are 0.

    Args:
        inputs: Voltages in the rows, V, shape (n, drives).

    Returns:
        Variances, V^2, shape (n - 1, drives).
    """
    squares = np.zeros((len(inputs) - 1, inputs.shape[1]))
    squares[1:-1] = np.diff(inputs, 3, axis=0) ** 2
    averages = uniform_filter1d(squares, _ROWS, axis=0, mode="nearest")
    return np.asarray(_SHARE * np.maximum(averages, 0.0))  # running sums leave rounding errors


def mean_voltage_variance(run: PreparedRecording) -> Array:
    """Estimate the error variance of the mean voltage from each row of a run to the next.

    It is that of the interpolation, plus a part for jitter: a controller also answers the jitter of its clock
    in the steps between the rows. Of n changes per row, n - 1 contain such an answer, each for an n-th of the
    row, which neither the rows nor the third differences of the voltages show.

    Args:
        run: Run whose voltages change between the rows.

    Returns:
        Variances, V^2, shape (n - 1, drives).
    """
    variance = interpolation_variance(run.without_clock_answers())
    if run.clock_voltages is None:
        return variance
    squares = uniform_filter1d(run.clock_voltages.answers**2, _ROWS, axis=0, mode="nearest")[:-1]
    return np.asarray(variance + (run.updates - 1) / run.updates**2 * np.maximum(squares, 0.0))


def with_voltage_errors(machine: Machine, data: Dataset) -> Dataset:
    """Copy a data set so that its residuals take the errors of interpolated voltages into account.

    Args:
        machine: Machine, refitted to these runs, that shows how predictions respond to voltages.
        data: Runs whose voltages change between the rows.

    Returns:
        Copy; the measurements, shape (n, sensors) each, are the same.
    """

    def with_errors(run: PreparedRecording) -> PreparedRecording:
        return dataclasses.replace(run, voltage_errors=InterpolationErrors(machine, run, data))

    return dataclasses.replace(data, runs=tuple(map(with_errors, data.runs)))


def expected_excess(machine: Machine, data: Dataset, bandwidth: float) -> float:
    """Return the chi-squared per sample that errors of interpolated voltages add for an exact machine.

    It is dimensionless, 1 if these errors are as large as the noise.

    Args:
        machine: Machine, refitted to these runs, whose predictions respond to the errors.
        data: Runs whose voltages change between the rows.
        bandwidth: Bandwidth of the observer, rad/s.
    """

    def of_run(run: PreparedRecording) -> float:
        return float(np.sum(InterpolationErrors(machine, run, data).responses(bandwidth).data ** 2))

    return sum(map_runs(of_run, data)) / data.count


def simulation_error(machine: Machine, data: Dataset) -> Array:
    """Return the error that interpolated voltages cause in simulations, root mean square over the runs.

    Each run is simulated with eight random draws of these errors and compared with the simulation without
    them.

    Args:
        machine: Machine that is simulated.
        data: Runs whose voltages change between the rows (times, voltages, measurements, SI).

    Returns:
        Errors in the sensors' units, shape (sensors,); zeros if the voltages are held.
    """
    if not data.has_voltage_errors:
        return np.zeros(len(machine.sensors))
    rng = np.random.default_rng(0)

    def draws(run: PreparedRecording) -> Array:
        # Interpolated between the rows, independent errors of the rows add up like those of the mean
        # voltages.
        deviations = np.sqrt(np.vstack([mean_voltage_variance(run), np.zeros(len(machine.drives))]))
        return (
            np.concatenate([np.zeros((1, *deviations.shape)), rng.normal(size=(_DRAWS, *deviations.shape))])
            * deviations
        )

    errors = dict(zip((run.name for run in data.runs), map(draws, data.runs), strict=True))

    def of_run(run: PreparedRecording) -> Array:
        motion = predict(
            machine,
            run,
            SIMULATION,
            period=data.period,
            inputs=run.inputs + errors[run.name],
            longest_step=POLISH_STEP,
        )
        change = prediction_error(run, data, motion.readings)
        change = np.where(np.isfinite(run.outputs), change[1:] - change[0], np.nan)
        return change.reshape(-1, len(machine.sensors))

    changes = np.concatenate(list(map_runs(of_run, data)))
    return np.asarray(np.sqrt(np.nanmean(changes**2, axis=0)))


class Whitening(NamedTuple):
    """Filter that makes the residual of a run white, block by block, given the rows before each block.

    Attributes:
        factors: Inverse Cholesky factor of each block, in single precision to save memory, dimensionless,
            shape (blocks, _BLOCK * sensors, (_BEFORE + _BLOCK) * sensors); 0 for rows outside the run.
        log_variance: Logarithm of the variance of each value, given those before it, shape (n, sensors).
    """

    factors: NDArray[np.float32]
    log_variance: Array

    @classmethod
    def of(cls, responses: sparse.csr_array, variance: Array) -> Whitening:
        """Compute the whitening filter for a residual of n rows, shape (n * sensors,), of an exact machine.

        Its covariance is that of the observer's innovations, plus `responses` times its transpose.

        Args:
            responses: Change of the residual by errors of one standard deviation, dimensionless, shape (n *
                sensors, errors).
            variance: Variance of the innovations of each sensor, dimensionless, shape (sensors,).
        """
        sensors = len(variance)
        values, count = responses.shape[0], _BLOCK * sensors
        factors = np.zeros((-(-values // count), count, (_BEFORE + _BLOCK) * sensors), np.float32)
        log_variance = np.zeros((len(factors), count))
        for first in range(0, len(factors), _BLOCKS_TOGETHER):
            part = slice(first, first + _BLOCKS_TOGETHER)
            covariances = _covariances(responses, variance, first, len(factors[part]))
            before, with_before = covariances[:, :-count, :-count], covariances[:, :-count, -count:]
            # What the rows before a block say about it; only what they leave open needs a factor.
            expected = np.linalg.solve(before, with_before).swapaxes(1, 2)
            root = np.linalg.cholesky(covariances[:, -count:, -count:] - expected @ with_before)
            factors[part, :, -count:] = inverse = np.linalg.inv(root)
            factors[part, :, :-count] = -inverse @ expected
            log_variance[part] = 2.0 * np.log(np.diagonal(root, axis1=1, axis2=2))
        return cls(factors, log_variance.reshape(-1, sensors)[: values // sensors])

    def __call__(self, residual: Array) -> Array:
        """Return white residuals of predictions, shape (batch, n * sensors), like the given ones."""
        blocks, of_block, window = self.factors.shape
        before = window - of_block
        padded = np.zeros((blocks * of_block + before, len(residual)))
        padded[before : before + residual.shape[1]] = residual.T
        windows = sliding_window_view(padded, window, axis=0)[::of_block]  # (blocks, batch, window)
        white = np.empty_like(residual)
        for first in range(0, blocks, _BLOCKS_TOGETHER):
            part = slice(first, first + _BLOCKS_TOGETHER)
            values = np.concatenate(self.factors[part].astype(float) @ windows[part].swapaxes(1, 2))
            begin = first * of_block
            end = min(begin + len(values), residual.shape[1])
            white[:, begin:end] = values[: end - begin].T
        return white


def _covariances(responses: sparse.csr_array, variance: Array, first: int, blocks: int) -> Array:
    """Return the covariances of some blocks of a residual and the rows before each, (blocks, values, values).

    Rows outside the run are independent of all others.
    """
    count, before = _BLOCK * len(variance), _BEFORE // _BLOCK
    begin = first - before
    known = responses[max(begin, 0) * count : (first + blocks) * count].tocoo()
    block, value = np.divmod(known.row + (max(begin, 0) - begin) * count, count)
    # Errors are counted from the first one of each block; those before it are few.
    step = _BLOCK * (responses.shape[1] // max(responses.shape[0] // len(variance) - 1, 1))
    error = known.col - (block + begin) * step
    earliest = error.min(initial=0)
    dense = np.zeros((before + blocks, count, error.max(initial=0) + 1 - earliest))
    dense[block, value, error - earliest] = known.data
    covariances = np.zeros((blocks, before + 1, count, before + 1, count))
    for apart in range(before + 1):
        common = max(dense.shape[2] - apart * step, 0)
        later, earlier = dense[apart:, :, :common], dense[: len(dense) - apart, :, apart * step :]
        products = later @ earlier.swapaxes(1, 2)
        for k in range(before + 1 - apart):
            covariances[:, k + apart, :, k] = products[k : k + blocks]
            covariances[:, k, :, k + apart] = products[k : k + blocks].swapaxes(1, 2)
    size = (before + 1) * count
    complete = covariances.reshape(blocks, size, size)
    complete[:, range(size), range(size)] += np.tile(variance, (before + 1) * _BLOCK)
    return complete


class InterpolationErrors(VoltageErrors):
    """Errors of the interpolated voltages of a run, and their influence on the residual.

    The errors are those of the mean voltage of each drive from a row to the next, with the standard
    deviations of `mean_voltage_variance`.
    """

    def __init__(self, machine: Machine, run: PreparedRecording, data: Dataset) -> None:
        # Pulses last from row to row: the response is that of held voltages.
        held = dataclasses.replace(run, updates=1, voltage_errors=None)
        self._variance = mean_voltage_variance(run)
        self._machine, self._run = machine, held
        self._data = dataclasses.replace(data, runs=(held,))
        self._by_bandwidth: dict[float, tuple[Whitening, Array]] = {}

    @override
    def whiten(self, residual: Array, bandwidth: float) -> Array:
        """Filter a residual so that its values are independent with unit variance despite the voltage errors.

        What unknown zeros of the sensors explain is removed as well.

        Args:
            residual: Residuals of a batch of predictions, in units of the noise, shape (batch, n * sensors).
            bandwidth: Bandwidth of the observer, rad/s.

        Returns:
            White residuals, dimensionless, same shape; NaN for a prediction that diverges.
        """
        finite = np.isfinite(residual).all(axis=1)
        if finite.all():
            return self._without_zeros(residual, bandwidth)  # without copies
        white = np.full_like(residual, np.nan)
        white[finite] = self._without_zeros(residual[finite], bandwidth)
        return white

    def _without_zeros(self, residual: Array, bandwidth: float) -> Array:
        """Return finite residuals white, without what unknown zeros of the sensors explain."""
        whitening, zeros = self._prepared(bandwidth)
        white = whitening(residual)
        return white - (white @ zeros.T) @ zeros

    @override
    def log_variance(self, bandwidth: float) -> Array:
        """Return the logarithm of each residual's variance, given those before it, before it is whitened.

        Args:
            bandwidth: Bandwidth of the observer, rad/s.

        Returns:
            Natural logarithm of variance / noise variance, dimensionless, shape (n, sensors).
        """
        return self.whitening(bandwidth).log_variance

    def whitening(self, bandwidth: float) -> Whitening:
        """Return the filter that makes the residual, shape (n * sensors,), of an exact machine white.

        It is computed once for each bandwidth.

        Args:
            bandwidth: Bandwidth of the observer, rad/s.
        """
        return self._prepared(bandwidth)[0]

    def _prepared(self, bandwidth: float) -> tuple[Whitening, Array]:
        """Return whitening and an orthonormal basis of the white responses to zeros, (zeros, n * sensors)."""
        if bandwidth not in self._by_bandwidth:
            variance = sensor_innovation_variance(self._machine, self._data.period, bandwidth)
            whitening = Whitening.of(self.responses(bandwidth), variance)
            white = whitening(self._zero_responses())
            self._by_bandwidth[bandwidth] = whitening, np.ascontiguousarray(np.linalg.qr(white.T)[0].T)
        return self._by_bandwidth[bandwidth]

    def _zero_responses(self) -> Array:
        """Return the residual's change by an error of each unknown zero, shape (zeros, n * sensors).

        The mean error, which a fit removes otherwise, is mostly that of the voltages. With an observer,
        constant errors of the zeros have constant innovations, of all sensors; those that were not measured
        are 0.
        """
        run, data = self._run, self._data
        scales = np.sqrt(run.weights) / run.noise
        free = np.flatnonzero(np.isinf(data.fitted_zero_limits(run)) & (run.weights.sum(axis=0) > 0.0))
        responses = np.zeros((len(free), *scales.shape))
        responses[np.arange(len(free)), :, free] = (scales[:, free] / scales[:, free].max(axis=0)).T
        return responses.reshape(len(free), scales.size)

    def responses(self, bandwidth: float) -> sparse.csr_array:
        """Return the change of the residual by each error of a mean voltage of one standard deviation.

        Args:
            bandwidth: Bandwidth of the observer, rad/s.

        Returns:
            Sparse matrix, dimensionless, shape (n * sensors, (n - 1) * drives): all sensors of a row before
            the next row, all drives of an interval between rows before the next interval.
        """
        intervals = np.arange(len(self._run.time_s) - 1)
        per_volt, _ = voltage_responses(
            self._machine,
            self._run,
            self._data,
            intervals,
            bandwidth,
            per_block=1,
            settled=_SETTLED,
            longest_step=SEARCH_STEP,  # errors of voltages are known within a factor of four
        )
        # Where the machine diverges, its residual is infinite anyway; responses must not make the covariance
        # so.
        per_volt.data[~(np.abs(per_volt.data) < _LARGEST_RESPONSE)] = 0.0
        deviations = np.sqrt(self._variance).ravel()
        per_volt.data *= deviations[per_volt.indices]
        return per_volt
