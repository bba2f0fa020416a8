"""Predict a run with a machine, for a batch of parameter values at once, and compare it with the measurements.

A Luenberger observer feeds the difference of measured and predicted values back into position and velocity at every
sample, so that the error of a wrong model remains local in time. Its bandwidth is an argument of every prediction:

- `SEARCH_BANDWIDTH` (60 rad/s), the widest, suits a model that is still wrong;
- `SIMULATION` (0) means no feedback: the machine runs from its initial state;
- between them, `model_error` chooses the bandwidth that the model's remaining error requires.

At the start, static friction holds the belts at an unknown stretch; its effect is projected out of the residual.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import lru_cache
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import ThreadpoolController

from ..dynamics import simulate_batch
from ..dynamics.simulation import Motion, threads
from ..machine import Machine
from .dataset import Dataset, PreparedRecording
from .rest_measurement import rigid_basis, sensor_zero_error

Array = NDArray[np.float64]
T = TypeVar("T")
SEARCH_BANDWIDTH = 60.0  # rad/s; confines the error of a wrong model to a few hundredths of a second
SIMULATION = 0.0  # rad/s; no feedback

SEARCH_STEP = 0.5e-3  # s; integration step of the search
POLISH_STEP = 0.125e-3  # s; an input that changes inside a step costs a micrometer at twice this step

# Bandwidth of lasers relative to that of encoders beside them, whose noise is smaller.
_LASER_BANDWIDTH_RATIO = 25.0 / 60.0
_LONGEST_OBSERVER_PERIOD = 5e-3  # s; limits the observer gains of slowly sampled recordings
# Fraction of the motors' Coulomb friction that typically remains as belt tension when the stage has come to rest.
_HELD_FRICTION = 0.1
_SMALLEST_HELD_ANGLE = 1e-6  # rad; keeps the column of a motor without friction away from zero
_UNMEASURED_POSITION = 2e-4  # m; error of a position that follows from later measurements
_BLOCK_S = 4e-3  # s; measurements respond more slowly than this to mechanical effects


def map_runs(function: Callable[[PreparedRecording], T], data: Dataset) -> Iterator[T]:
    """Apply a function to every run (one recording) of a data set, in parallel threads.

    Args:
        function: Function of one run; it is called from several threads.
        data: Data set with the runs (times, voltages, measurements, SI).

    Yields:
        Result of the function for each run, in the order of the runs.
    """
    count = min(threads(), len(data.runs))
    # The runs occupy all cores; threads of the linear algebra library beside them would only wait for each other.
    with _linear_algebra().limit(limits=1, user_api="blas"):
        if count == 1:
            yield from map(function, data.runs)
            return
        with ThreadPoolExecutor(count) as pool:
            yield from pool.map(function, data.runs)


@lru_cache(maxsize=1)
def _linear_algebra() -> ThreadpoolController:
    """Return the control of the linear algebra library's threads; finding the library takes milliseconds."""
    return ThreadpoolController()


def sensor_bandwidths(machine: Machine, bandwidth: float) -> Array:
    """Return the bandwidth with which the measurements of every sensor correct a prediction (observer bandwidth).

    Lasers beside encoders only correct what these cannot measure; their larger noise must not disturb the prediction.

    Args:
        machine: Machine with its sensors.
        bandwidth: Observer bandwidth of encoders, rad/s; that of lasers beside encoders is 5/12 of it.

    Returns:
        Bandwidths, rad/s, shape (sensors,).
    """
    incremental = np.array([sensor.incremental for sensor in machine.sensors])
    ratio = _LASER_BANDWIDTH_RATIO if incremental.any() else 1.0
    return np.asarray(bandwidth * np.where(incremental, 1.0, ratio))


def observer_gains(machine: Machine, period: float, bandwidth: float = SEARCH_BANDWIDTH) -> Array:
    """Return the gains of the Luenberger observer that feeds measurements back into a prediction.

    Each sensor corrects its coordinate by an observer of second order with two equal poles at the bandwidth.

    Args:
        machine: Machine whose sensors are fed back.
        period: Sampling period, s.
        bandwidth: Observer bandwidth of encoders, rad/s, see `sensor_bandwidths`.

    Returns:
        Corrections per sample of positions (first half of the rows) and velocities (second half), in the coordinates'
        units, per unit of measurement error, shape (2 * coordinates, sensors).
    """
    count = len(machine.coordinates)
    gains = np.zeros((2 * count, len(machine.sensors)))
    rates = sensor_bandwidths(machine, bandwidth) * min(period, _LONGEST_OBSERVER_PERIOD)  # rad per sample
    for j, (sensor, rate) in enumerate(zip(machine.sensors, rates, strict=True)):
        name = sensor.coordinate
        i = machine.coordinate_names.index(name)
        # Poles (s + bandwidth)^2, discretized; sensor.row: change of the measurement per unit of the coordinate.
        gains[i, j] = 2 * rate / sensor.row[name]
        gains[count + i, j] = rate**2 / period / sensor.row[name]
    return gains


def predict(
    machine: Machine,
    run: PreparedRecording,
    bandwidth: float,
    *,
    period: float,
    parameters: Array | None = None,
    extra_force: Array | None = None,
    extra_measurement: Array | None = None,
    initial_state: Array | None = None,
    longest_step: float = SEARCH_STEP,
    states: bool = False,
) -> Motion:
    """Predict the measurements of a run for a batch of parameters or perturbations.

    Args:
        machine: Machine that predicts; its effects (deviations from the model) also determine the initial state.
        run: Run to predict, n samples.
        bandwidth: Bandwidth of the observer that corrects the prediction by the measurements, rad/s; 0 for none.
        period: Sampling period, s.
        parameters: All machine parameters, SI, in the order of `Machine.parameters`, shape (batch, parameters).
            Default: those of the machine.
        extra_force: Additional force on every coordinate, N or Nm, constant from each sample to the next, shape
            (batch, n, coordinates). Default: none.
        extra_measurement: Value added to the sensors' output, in their units, shape (batch, n, sensors). Default: none.
        initial_state: Positions, then velocities, in the coordinates' units, shape (batch, 2 * coordinates) or
            (2 * coordinates,); encoders count from the first. Default: `run.initial_state(machine)`.
        longest_step: Maximum integration step, s.
        states: Whether to return positions and velocities too.

    Returns:
        Motion with the predicted measurements `readings`, in the sensors' units, shape (batch, n, sensors), and if
        `states`, `positions` and `velocities`, in the coordinates' units, shape (batch, n, coordinates).
    """
    states_given = run.initial_state(machine) if initial_state is None else initial_state
    run_state = np.atleast_2d(states_given)[0]
    measured = gains = None
    if bandwidth > 0.0:
        start = run.initial.position
        encoders = [sensor.incremental for sensor in machine.sensors]
        # Encoders count from where the run starts, wherever the machine puts that.
        displacement = machine.sensor_matrix[:, : len(start)] @ (run_state[: len(start)] - start)
        measured = run.outputs + np.where(encoders, displacement, 0.0)
        if extra_measurement is not None:
            measured = measured - extra_measurement
        gains = observer_gains(machine, period, bandwidth)
    motion = simulate_batch(
        machine,
        run.time_s,
        run.inputs,
        parameters=parameters,
        start=states_given,
        extra_force=extra_force,
        measured=measured,
        gains=gains,
        longest_step=longest_step,
        states=states,
        parallel=False,
    )
    return motion if extra_measurement is None else motion._replace(readings=motion.readings + extra_measurement)


def mechanical_rows_per_block(data: Dataset) -> int:
    """Return how many rows of a recording may be averaged, as mechanical effects act more slowly than 4 ms.

    Args:
        data: Data set, for its sampling period.

    Returns:
        Number of rows in 4 ms, at least one.
    """
    return max(1, round(_BLOCK_S / data.period))


def prediction_error(run: PreparedRecording, data: Dataset, measurements: Array) -> Array:
    """Return measured minus predicted values, corrected for the uncertain zeros of the sensors.

    Subtracted is the constant part that an error of the zeros (measurements at position 0) explains, see
    `rest_measurement.sensor_zero_error`.

    Args:
        run: Measured run, n samples.
        data: Data set of the run, for the sensors' quantization steps.
        measurements: Predicted measurements of a batch of predictions, m or rad, shape (batch, n, sensors).

    Returns:
        Errors in the sensors' units, shape (batch, n, sensors); arbitrary where a value was not measured.
    """
    measured = np.isfinite(run.outputs)
    error: Array = run.outputs - measurements
    if not measured.all():
        error = np.where(measured, error, 0.0)
    max_mean = np.where(data.behind_belts, np.inf, data.quantum / 2)
    error -= sensor_zero_error(error, measured, run.initial.resting_rows, max_mean)
    return error


def residuals(run: PreparedRecording, data: Dataset, measurements: Array, rows_per_block: int = 1) -> Array:
    """Return measured minus predicted values, divided by the standard deviations of the sensors' noise.

    The constant part that an error of the sensors' zeros explains is subtracted, see `prediction_error`.

    Args:
        run: Measured run, n samples, with the standard deviation of each value's noise.
        data: Data set of the run, for the sensors' quantization steps.
        measurements: Predicted measurements of a batch of predictions, m or rad, shape (batch, n, sensors).
        rows_per_block: How many consecutive rows are summed into one and divided by the root of that number. White
            noise keeps its size, and so do inner products of residuals that change more slowly, with fewer rows.

    Returns:
        Residuals, dimensionless, shape (batch, n // rows_per_block * sensors); zero where a value was not measured or
        `run.rows` excludes it.
    """
    measured = np.isfinite(run.outputs)
    counted = measured if run.rows is None else measured & run.rows[:, None]
    with np.errstate(over="ignore", invalid="ignore"):  # parameters that make a machine diverge cost infinitely much
        error = prediction_error(run, data, measurements)
        error *= counted / run.noise
    batch, rows, sensors = error.shape
    if rows_per_block > 1:
        blocks = rows // rows_per_block
        error = error[:, : blocks * rows_per_block].reshape(batch, blocks, rows_per_block, sensors)
        error = error.sum(axis=2) / np.sqrt(rows_per_block)
    return error.reshape(batch, -1)


@dataclass(frozen=True)
class InitialStateProjection:
    """Projection that removes the unknown initial stretch of the belts from residuals.

    Attributes:
        directions: Orthonormal responses of the residual to s independent initial belt stretches, shape (rows, s).
        weights: Fraction of the residual along each that is removed, 0 (stretch known by the prior) to 1, shape (s,).
    """

    directions: Array
    weights: Array

    def __call__(self, residual: Array) -> Array:
        """Remove the part of residuals that an optimal initial stretch explains, weighted by its prior.

        Args:
            residual: Residuals of a batch of predictions, in units of the noise, shape (batch, rows).

        Returns:
            Projected residuals, same shape; their sum of squares is the cost at the optimal initial stretch.
        """
        return residual - (residual @ self.directions) * self.weights @ self.directions.T


def held_belt_angles(machine: Machine) -> dict[str, float]:
    """Return by which motor angles static friction typically keeps the belts stretched at rest.

    Args:
        machine: Machine with or without belts.

    Returns:
        Angle, rad, by name of each rotary coordinate with a sensor and without a spring; empty without belts.
    """
    if not machine.belts:
        return {}
    stiffness = float(np.mean([b.EA / b.rest_length for b in machine.belts]))
    measured = {s.coordinate for s in machine.sensors}
    return {
        c.name: max(_HELD_FRICTION * c.coulomb / c.radius**2 / stiffness, _SMALLEST_HELD_ANGLE)
        for c in machine.coordinates
        if c.kind == "rotary" and c.name in measured and c.name not in machine.spring_loaded
    }


def initial_state_projection(
    machine: Machine,
    run: PreparedRecording,
    data: Dataset,
    bandwidth: float,
    *,
    initial_state: Array | None = None,
    longest_step: float = SEARCH_STEP,
    rows_per_block: int = 1,
) -> InitialStateProjection | None:
    """Return the projection that removes from residuals what the unknown initial belt stretch of a run explains.

    Static friction maintains an unknown stretch of the belts when a run begins, which encoders behind belts do not
    resolve. The response of the residual to it, one vector per motor, is removed from residual and Jacobian alike
    (variable projection), with a Gaussian prior of the size that friction can maintain. A run whose position no laser
    measures at rest has further such vectors, one per motion that stretches no belt.

    Args:
        machine: Machine that predicts.
        run: Run to predict.
        data: Data set of the run.
        bandwidth: Bandwidth of the observer that corrects the prediction by the measurements, rad/s; 0 for none.
        initial_state: Positions, then velocities, in the coordinates' units, shape (2 * coordinates,). Default:
            `run.initial_state(machine)`.
        longest_step: Maximum integration step, s.
        rows_per_block: Number of consecutive rows summed into one, as in `residuals`.

    Returns:
        Projection of residuals, shape (batch, rows). None without belts or if the simulation diverges.

    References:
        Golub and Pereyra (1973), variable projection.
    """
    held_angles = held_belt_angles(machine)
    if not held_angles:
        return None
    state = run.initial_state(machine) if initial_state is None else initial_state
    displacements = np.zeros((len(held_angles), len(machine.coordinates)))  # of the initial positions, one per row
    for k, (name, angle) in enumerate(held_angles.items()):
        displacements[k, machine.coordinate_names.index(name)] = angle
    if not run.initial.lasers_measured:
        displacements = np.vstack([displacements, _rigid_displacements(machine, run, held_angles)])
    initial_states = np.tile(state, (len(displacements) + 1, 1))
    initial_states[1:, : displacements.shape[1]] += displacements
    motion = predict(
        machine, run, bandwidth, period=data.period, initial_state=initial_states, longest_step=longest_step
    )
    residual = residuals(run, data, motion.readings, rows_per_block)
    columns = (residual[1:] - residual[0]).T  # (rows, displacements), in units of the prior's standard deviation
    if not np.all(np.isfinite(columns)):
        return None
    # The minimum of |residual - columns w|^2 + |w|^2 over w is the squared norm of the residual projected like this.
    directions, sizes, _ = np.linalg.svd(columns, full_matrices=False)
    return InitialStateProjection(directions, 1.0 - 1.0 / np.sqrt(1.0 + sizes**2))


def _rigid_displacements(machine: Machine, run: PreparedRecording, held_angles: dict[str, float]) -> Array:
    """Return rigid motions of the size by which a position that no laser measures may be wrong, (k, coordinates)."""
    travel = [angle * machine.coordinate(name).travel_per_unit for name, angle in held_angles.items()]
    size = max(travel) if run.initial.position_measured else _UNMEASURED_POSITION
    rigid = rigid_basis(machine)
    linear = [c.kind == "linear" for c in machine.coordinates]
    return np.asarray(size * (rigid / np.linalg.norm(rigid[linear], axis=0)).T)
