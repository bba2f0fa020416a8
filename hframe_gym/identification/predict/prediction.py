"""Predict a run with a machine, for a batch of parameter values at once, and compare it with measurements.

A Luenberger observer feeds the difference of measured and predicted values back into position and velocity at
every sample, so that the error of a wrong model remains local in time. Its bandwidth is an argument of every
prediction:

- `SEARCH_BANDWIDTH` (60 rad/s), the largest, suits a model that is still wrong (one-step prediction);
- `SIMULATION` (0) means no feedback: the machine runs from its initial state;
- between them, `model_error` chooses the bandwidth that the model's remaining error requires.

`start_uncertainty` removes from the residual the part that an uncertain initial state explains.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor, wait
from functools import lru_cache
from typing import TypeVar

import numpy as np

from ...arrays import Array
from ...dynamics import resolved_step, simulate_batch
from ...dynamics.simulation import Motion, threads
from ...machine import Machine, carried_through_contacts, rigid_basis
from ...parallel import single_threaded_linear_algebra
from ...preparation.dataset import Dataset, PreparedRecording
from ...preparation.start.sensor_zeros import max_zero_means, zeros_from_means
from .error_loops import mean_errors, scaled_errors

T = TypeVar("T")
SEARCH_BANDWIDTH = 60.0  # rad/s; confines the error of a wrong model to a few hundredths of a second
SIMULATION = 0.0  # rad/s; no feedback
# rad/s; with a narrower observer, the errors of interpolated voltages last for too many rows
NARROWEST_WITH_VOLTAGE_ERRORS = 15.0

SEARCH_STEP = 0.5e-3  # s; integration step of the search
POLISH_STEP = 0.125e-3  # s; an input that changes inside a step costs a micrometer at twice this step

# Bandwidth of lasers relative to that of encoders beside them, whose noise is smaller.
_LASER_BANDWIDTH_RATIO = 25.0 / 60.0
# A sensor of a speed corrects by 2 * bandwidth like one of a position, and has one pole there.
_SPEED_RATIO = 0.5
LONGEST_OBSERVER_PERIOD = 5e-3  # s; limits the observer gains of slowly sampled recordings
_BLOCK_S = 4e-3  # s; measurements respond more slowly than this to mechanical effects


def map_runs(function: Callable[[PreparedRecording], T], data: Dataset) -> Iterator[T]:
    """Apply a function to every run (one recording) of a data set, in parallel threads.

    Args:
        function: Function of one run; it is called from several threads.

    Yields:
        Result of the function for each run, in the order of the runs.
    """
    count = threads()
    # The runs occupy all cores; threads of the linear algebra library beside them would only wait for each
    # other.
    with single_threaded_linear_algebra():
        if min(count, len(data.runs)) == 1 or _of_pool.here:
            yield from map(function, data.runs)
            return
        results = [_pool(os.getpid(), count).submit(function, run) for run in data.runs]
        try:
            for result in results:
                yield result.result()
        finally:  # after an error as well, nothing goes on
            for result in results:
                result.cancel()
            wait(results)


class _OfPool(threading.local):
    """Whether the present thread is one of the pool: it must not wait for others of the pool."""

    here = False


_of_pool = _OfPool()


@lru_cache(maxsize=4)
def _pool(process: int, count: int) -> ThreadPoolExecutor:
    """Return threads that are kept between calls; a forked process makes new ones instead."""

    def mark() -> None:
        _of_pool.here = True

    return ThreadPoolExecutor(count, thread_name_prefix="hframe-runs", initializer=mark)


def sensor_bandwidths(machine: Machine, bandwidth: float) -> Array:
    """Return the observer bandwidth of every sensor: how fast its measurements correct a prediction.

    If the machine has encoders, the bandwidth of its other sensors of positions (lasers) is 5/12 of theirs,
    because lasers are noisier and only need to correct what encoders cannot measure. A sensor of a speed
    corrects, with half the bandwidth, the velocity of a coordinate whose position is not measured. All other
    sensors correct nothing, their errors only count: their bandwidth is 0.

    Args:
        bandwidth: Observer bandwidth of the encoders, or of all sensors if there are no encoders, rad/s.

    Returns:
        Bandwidths, rad/s, shape (sensors,).
    """
    located = {sensor.coordinate for sensor in machine.sensors if sensor.of_position}
    laser = _LASER_BANDWIDTH_RATIO if any(sensor.incremental for sensor in machine.sensors) else 1.0
    ratios = []
    for sensor in machine.sensors:
        if sensor.of_position:
            ratios.append(1.0 if sensor.incremental else laser)
        else:
            ratios.append(
                _SPEED_RATIO if sensor.kind == "speed" and sensor.coordinate not in located else 0.0
            )
    return np.asarray(bandwidth * np.array(ratios))


def innovation_variance(machine: Machine, data: Dataset, bandwidth: float) -> tuple[float, float]:
    """Return the expected variance of an exact machine's innovations (errors before each correction).

    Args:
        bandwidth: Bandwidth of the observer, rad/s; 0 for a simulation, whose errors are the noise.

    Returns:
        Means of the ratio (variance / noise variance) and of its logarithm over all measured values,
        dimensionless. If errors of interpolated voltages are filtered out of the residuals (`whitened`), the
        first is 1, and the second is that before the filter.
    """
    if data.has_voltage_errors and bandwidth >= NARROWEST_WITH_VOLTAGE_ERRORS:
        return 1.0, _log_variance_with_voltage_errors(data, bandwidth)
    variance = sensor_innovation_variance(machine, data.period, bandwidth)
    counts = np.sum([run.weights.sum(axis=0) for run in data.runs], axis=0)  # (sensors,)
    weights = counts / counts.sum()
    return float(weights @ variance), float(weights @ np.log(variance))


def sensor_innovation_variance(machine: Machine, period: float, bandwidth: float) -> Array:
    """Return the expected innovation variance / noise variance of each sensor for an exact machine.

    It is 1 / (1 - K) with the position gain K of the observer, at most 0.9.

    Args:
        period: Sampling period, s.
        bandwidth: Bandwidth of the observer, rad/s.

    Returns:
        Ratios, dimensionless, shape (sensors,).
    """
    # Position gain K of a critically damped observer: twice the bandwidth times the sampling period.
    gains = 2.0 * _observer_rates(machine, period, bandwidth)
    return np.asarray(1.0 / (1.0 - np.minimum(gains, 0.9)))


def _observer_rates(machine: Machine, period: float, bandwidth: float) -> Array:
    """Return the bandwidth of each sensor's observer times the period, up to `LONGEST_OBSERVER_PERIOD`."""
    return sensor_bandwidths(machine, bandwidth) * min(period, LONGEST_OBSERVER_PERIOD)


def _log_variance_with_voltage_errors(data: Dataset, bandwidth: float) -> float:
    """Return the mean logarithm of the variance of innovations before they are whitened."""
    total = 0.0
    for run in data.runs:
        if run.voltage_errors is not None:
            total += float(np.sum(run.weights * run.voltage_errors.log_variance(run.bandwidth(bandwidth))))
    return total / data.count


def whitened(residual: Array, run: PreparedRecording, bandwidth: float) -> Array:
    """Filter a residual so that errors of interpolated voltages leave no correlation in it.

    Args:
        residual: Residuals of a batch of predictions, in units of the noise, shape (batch, n * sensors).
        run: The run that was predicted.
        bandwidth: Bandwidth of the observer, rad/s.

    Returns:
        Residuals of the same shape; the given ones if the voltages are held, or below 15 rad/s
        (`NARROWEST_WITH_VOLTAGE_ERRORS`), where these errors add up.
    """
    bandwidth = run.bandwidth(bandwidth)
    if run.voltage_errors is None or bandwidth < NARROWEST_WITH_VOLTAGE_ERRORS:
        return residual
    return run.voltage_errors.whiten(residual, bandwidth)


def observer_gains(machine: Machine, period: float, bandwidth: float = SEARCH_BANDWIDTH) -> Array:
    """Return the gains of the Luenberger observer that feeds measurements back into a prediction.

    Each sensor of a position corrects its coordinate by an observer of second order with two equal poles at
    its bandwidth (`sensor_bandwidths`); a sensor of a speed corrects the velocity of a coordinate whose
    position is not measured, with one pole. A coordinate behind a contact, such as the teeth of a gear, gets
    the corrections of the one before it. Those that nothing corrects follow so that no belt is stretched.

    Args:
        machine: Machine whose sensors are fed back.
        period: Sampling period, s.
        bandwidth: Observer bandwidth of the encoders, rad/s; from it follow those of the other sensors.

    Returns:
        Corrections at each sample per unit of a sensor's measured minus predicted value: of the positions
        (first half of the rows), m or rad, and of the velocities (second half), m/s or rad/s,
        shape (2 * coordinates, sensors); 0 for a sensor that corrects nothing.
    """
    count = len(machine.coordinates)
    gains = np.zeros((2 * count, len(machine.sensors)))
    rates = _observer_rates(machine, period, bandwidth)  # rad per sample
    for j, (sensor, rate) in enumerate(zip(machine.sensors, rates, strict=True)):
        if rate == 0.0:
            continue
        name = sensor.coordinate
        i = machine.coordinate_names.index(name)
        # Poles (s + bandwidth)^2, discretized; sensor.row: change of the measurement per unit of the
        # coordinate.
        if sensor.of_position:
            gains[i, j] = 2 * rate / sensor.row[name]
            gains[count + i, j] = rate**2 / period / sensor.row[name]
        else:
            gains[count + i, j] = 2 * rate / sensor.row[name]
    carried = [carried_through_contacts(machine, half.T).T for half in (gains[:count], gains[count:])]
    return np.vstack(_followed(machine, carried))


def _followed(machine: Machine, gains: list[Array]) -> list[Array]:
    """Return gains with which uncorrected coordinates follow the others along motions that stretch no belt.

    If a motor without encoder stayed where it is, each correction of the carriage would stretch the belt. The
    forces would push the carriage back, and a fit would find a soft belt.
    """
    still = ~np.any([half.any(axis=1) for half in gains], axis=0)  # (coordinates,)
    if still.all() or not still.any() or not machine.belts:
        return gains
    rigid = rigid_basis(machine) * machine.travel_per_unit[:, None]
    follow = rigid[still] @ np.linalg.pinv(rigid[~still])  # travel per travel of the corrected coordinates
    follow *= machine.travel_per_unit[~still] / machine.travel_per_unit[still][:, None]
    followed = [half.copy() for half in gains]
    for half in followed:
        half[still] = follow @ half[~still]
    return followed


def predict(
    machine: Machine,
    run: PreparedRecording,
    bandwidth: float,
    *,
    period: float,
    parameters: Array | None = None,
    inputs: Array | None = None,
    extra_force: Array | None = None,
    extra_measurement: Array | None = None,
    initial_state: Array | None = None,
    longest_step: float = SEARCH_STEP,
    states: bool = False,
) -> Motion:
    """Predict a run's measurements, for several sets of parameters, perturbations or initial states at once.

    Voltages are held from row to row, or interpolated if the run has more than one update a row. Of those
    that change inside an integration step, the mean acts.

    Args:
        machine: Machine that predicts; its effects also determine the initial state.
        run: Run to predict, n samples.
        bandwidth: Bandwidth of the observer, rad/s; 0 for none. A run may have another one
            (`PreparedRecording.observer_bandwidth`).
        period: Sampling period, s.
        parameters: All parameters, SI, as in `Machine.parameters`, shape (batch, parameters). Default: the
            machine's.
        inputs: Voltages or other commands, in the drives' units, shape (batch, n, drives). Default: those of
            the run.
        extra_force: Additional force on every coordinate, N or Nm, constant from each sample to the next,
            shape (batch, n, coordinates). Default: none.
        extra_measurement: Value added to the sensors' output, in the sensors' units,
            shape (batch, n, sensors), or (batch, sensors) for a constant. Default: none.
        initial_state: Positions (m, rad), velocities (m/s, rad/s), effect states (SI; may be left out: zero),
            shape (2 * coordinates + effect states,) or with a leading batch axis. Default:
            `run.initial_state(machine)`. The observer shifts the measurements of encoders so that they agree
            with the first of these states.
        longest_step: Maximum integration step, s; stiff belts may need shorter ones (`resolved_step`).
        states: Whether to return positions and velocities too.

    Returns:
        `readings`: predicted measurements, in the sensors' units, shape (batch, n, sensors), not finite if
        the prediction diverges. With `states` also `positions`, m or rad, and `velocities`, m/s or rad/s,
        shape (batch, n, coordinates) each.
    """
    starts = np.atleast_2d(run.initial_state(machine) if initial_state is None else initial_state)
    constant = extra_measurement is not None and extra_measurement.ndim == 2
    varying = None if constant else extra_measurement
    measured = gains = None
    bandwidth = run.bandwidth(bandwidth)
    if bandwidth > 0.0:
        measured = measurements_from(starts[0], machine, run)
        measured = measured if varying is None else measured - varying
        gains = observer_gains(machine, period, bandwidth)
    step = resolved_step(machine, longest_step)
    voltages = run.held(step, inputs)
    motion = simulate_batch(
        machine,
        voltages.time_s,
        voltages.inputs,
        parameters=parameters,
        start=starts,
        extra_force=extra_force,
        measured=measured,
        gains=gains,
        offsets=extra_measurement if constant else None,
        longest_step=step,
        every=voltages.per_row,
        states=states,
        parallel=False,
    )
    return motion if varying is None else motion._replace(readings=motion.readings + varying)


def measurements_from(start: Array, machine: Machine, run: PreparedRecording) -> Array:
    """Return the measurements of a run, adapted to another initial state than the measured one.

    Encoders count from the initial position. If effects change what sensors measure, the position at the
    start differs from the measured one, and the encoders' measurements are shifted by this difference in all
    rows.

    Args:
        start: Initial state: positions, m or rad, first, shape (coordinates or more,).
        run: Run, n samples.

    Returns:
        Measurements minus the sensors' zeros, as in `run.outputs`, in the sensors' units, shape (n, sensors);
        NaN where they are missing.
    """
    measured_start = run.initial.position
    displacement = machine.sensor_matrix[:, : len(measured_start)] @ (
        start[: len(measured_start)] - measured_start
    )
    return run.outputs + np.where([sensor.incremental for sensor in machine.sensors], displacement, 0.0)


def mechanical_rows_per_block(data: Dataset) -> int:
    """Return how many rows of a residual may be combined into one, to save time in the search.

    Mechanical effects hardly change the residual within 4 ms. Combined rows are summed and divided by the
    root of their number.

    Args:
        data: Data set, for its sampling period.

    Returns:
        Number of rows in 4 ms, at least one; one if residuals are whitened, which makes them change fast.
    """
    return 1 if data.has_voltage_errors else max(1, round(_BLOCK_S / data.period))


def block_size(seconds: float, machine: Machine, data: Dataset) -> int:
    """Return the number of residual values in a block of consecutive rows with a given duration.

    Statistics that allow for correlation in time treat such blocks, not single values, as independent.

    Args:
        seconds: Duration of the block, s.
        data: Data set, for the sampling period.

    Returns:
        Number of values (rows times sensors), at least one row of them.
    """
    return max(1, round(seconds / data.period)) * len(machine.sensors)


def prediction_error(run: PreparedRecording, data: Dataset, measurements: Array) -> Array:
    """Return measured minus predicted values, without the constant error that uncertain sensor zeros cause.

    For encoders behind belts, the constant error is the mean error over the complete run. For all other
    sensors, it is the mean error over the rows at rest, changed by at most half a quantization step towards
    the mean over the complete run.

    Args:
        run: Measured run, n samples.
        data: Data set of the run, for the sensors' quantization steps.
        measurements: Predicted measurements of a batch of predictions, in the sensors' units, shape
            (batch, n, sensors).

    Returns:
        Errors, in the sensors' units, shape (batch, n, sensors); 0 where nothing was measured.
    """
    unscaled = np.isfinite(run.outputs).astype(np.float64)  # and 0 where nothing was measured
    zeros = _zeros(run, data, measurements, fitted=False)
    return scaled_errors(run.known_outputs, measurements, zeros, unscaled, 1)


def _zeros(run: PreparedRecording, data: Dataset, measurements: Array, fitted: bool) -> Array:
    """Return the errors of the sensors' zeros that are subtracted, shape (batch, sensors)."""
    weights = run.weights if fitted else np.isfinite(run.outputs)
    weights = np.array(weights if data.has_zero is None else weights * data.has_zero, np.float64, order="C")

    def mean(rows: slice) -> Array:
        return mean_errors(run.known_outputs, measurements, weights, rows.start, rows.stop)

    max_mean = data.fitted_zero_limits(run) if fitted else max_zero_means(data.behind_belts, data.quantum)
    return zeros_from_means(mean, len(run.time_s), run.initial.resting_rows, max_mean, data.quantum)


def residuals(
    run: PreparedRecording,
    data: Dataset,
    measurements: Array,
    rows_per_block: int = 1,
    *,
    fitted: bool = True,
) -> Array:
    """Return measured minus predicted values, divided by the standard deviations of the measurements' noise.

    The constant error that uncertain sensor zeros cause is estimated and subtracted first.

    Args:
        run: Measured run, n samples, with the standard deviation of each value's noise.
        data: Data set of the run, for the sensors' quantization steps.
        measurements: Predicted measurements of a batch of predictions, in the sensors' units, shape
            (batch, n, sensors).
        rows_per_block: Number of consecutive rows that are combined into one: their sum divided by the root
            of this number. White noise keeps its standard deviation, slow residuals keep their sum of
            squares.
        fitted: True for the residual of a fit: measurements with the same rounding error count as one, and
            the zeros of sensors that measured at rest without quantization are corrected without limit.
            False: evaluation.

    Returns:
        Residuals, dimensionless, shape (batch, n // rows_per_block * sensors), all sensors of one row before
        the next; zero where a value was not measured.
    """
    scales = run.fit_scales if fitted else (run.weights > 0.0) / run.noise
    # Parameters that make a machine diverge cost infinitely much.
    with np.errstate(over="ignore", invalid="ignore"):
        zeros = _zeros(run, data, measurements, fitted)
        scales = scales / np.sqrt(rows_per_block) if rows_per_block > 1 else scales
        error = scaled_errors(run.known_outputs, measurements, zeros, scales, rows_per_block)
    return error.reshape(len(error), -1)
