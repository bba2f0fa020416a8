"""Predict a run with a machine, for a batch of parameter values at once, and compare it with the measurements.

Two prediction modes:

- `one_step`: a Luenberger observer feeds the difference of measured and predicted values back into position and
  velocity at every sample.  The error of a wrong model remains local in time.
- `simulation`: the machine runs from its initial state without feedback.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from ..dynamics.simulation import Motion, simulate_batch, threads
from ..machine import Machine
from .dataset import Dataset, PreparedRecording
from .rest_measurement import sensor_zero_error

Array = NDArray[np.float64]
T = TypeVar("T")
# The last two are the former names of the modes; they go when no module uses them any more.
Mode = Literal["one_step", "simulation", "innovations", "free"]

SEARCH_STEP = 0.5e-3  # s; integration step of the search
POLISH_STEP = 0.125e-3  # s; an input that changes inside a step costs a micrometer at twice this step

# Observer bandwidth, rad/s.  Encoders are quiet; the noise of lasers must not shake the model.
_ENCODER_BANDWIDTH = 60.0
_LASER_BANDWIDTH = 25.0
_LONGEST_OBSERVER_PERIOD = 5e-3  # s; limits the observer gains of slowly sampled recordings
_BLOCK_S = 4e-3  # s; measurements respond more slowly than this to mechanical effects


def has_feedback(mode: Mode) -> bool:
    """Return whether a prediction mode feeds measurements back."""
    return mode in ("one_step", "innovations")


def map_runs(function: Callable[[PreparedRecording], T], data: Dataset) -> Iterator[T]:
    """Apply a function to every run, in parallel threads; results come in the order of the runs."""
    count = min(threads(), len(data.runs))
    if count == 1:
        yield from map(function, data.runs)
        return
    with ThreadPoolExecutor(count) as pool:
        yield from pool.map(function, data.runs)


def observer_gains(machine: Machine, period: float) -> Array:
    """Return the observer gains of one-step prediction: critically damped, one observer per sensor.

    Args:
        machine: Machine whose sensors feed back.
        period: Sampling period, s.

    Returns:
        Corrections of positions, then velocities, per unit of measurement error, shape (2 * coordinates, sensors).
    """
    count = len(machine.coordinates)
    gains = np.zeros((2 * count, len(machine.sensors)))
    has_encoders = any(sensor.incremental for sensor in machine.sensors)
    for j, sensor in enumerate(machine.sensors):
        name = sensor.coordinate
        i = machine.coordinate_names.index(name)
        # A laser beside encoders only corrects what these cannot see.
        bandwidth = _LASER_BANDWIDTH if has_encoders and not sensor.incremental else _ENCODER_BANDWIDTH
        rate = bandwidth * min(period, _LONGEST_OBSERVER_PERIOD)  # rad per sample
        gains[i, j] = 2 * rate / sensor.row[name]
        gains[count + i, j] = rate**2 / period / sensor.row[name]
    return gains


def predict(
    machine: Machine,
    run: PreparedRecording,
    mode: Mode,
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
        machine: Machine that predicts; it also determines where the run starts.
        run: Run to predict.
        mode: "one_step" or "simulation".
        period: Sampling period, s.
        parameters: Kernel parameters, shape (batch, parameters); default: those of the machine.
        extra_force: Force on every coordinate, N or Nm, held per sample, shape (batch, n, coordinates).
        extra_measurement: Value added to the sensors' output, channel units, shape (batch, n, sensors).
        initial_state: Positions and velocities, shape (batch, 2 * coordinates); default: the machine's in this run.
        longest_step: Maximum integration step, s.
        states: Whether to return positions and velocities too.

    Returns:
        Predicted measurements (batch, n, sensors), with positions and velocities (batch, n, coordinates) on request.
    """
    run_state = run.initial_state(machine)
    measured = gains = None
    if has_feedback(mode):
        start = run.initial.position
        encoders = [sensor.incremental for sensor in machine.sensors]
        # Encoders count from where the run starts, wherever the machine puts that.
        displacement = machine.sensor_matrix[:, : len(start)] @ (run_state[: len(start)] - start)
        measured = run.outputs + np.where(encoders, displacement, 0.0)
        if extra_measurement is not None:
            measured = measured - extra_measurement
        gains = observer_gains(machine, period)
    motion = simulate_batch(
        machine,
        run.time_s,
        run.inputs,
        parameters=parameters,
        start=run_state if initial_state is None else initial_state,
        extra_force=extra_force,
        measured=measured,
        gains=gains,
        longest_step=longest_step,
        states=states,
        parallel=False,
    )
    return motion if extra_measurement is None else motion._replace(readings=motion.readings + extra_measurement)


def mechanical_rows_per_block(data: Dataset) -> int:
    """Return how many rows may be averaged where only the response to mechanical effects matters."""
    return max(1, round(_BLOCK_S / data.period))


def prediction_error(run: PreparedRecording, data: Dataset, measurements: Array) -> Array:
    """Return measured minus predicted values, less what the sensors' zeros explain.

    Args:
        run: Measured run.
        data: Data set of the run, for the sensors' quanta.
        measurements: Predicted values, shape (batch, n, sensors).

    Returns:
        Errors in channel units, shape (batch, n, sensors); arbitrary where a value was not measured.
    """
    measured = np.isfinite(run.outputs)
    error: Array = run.outputs - measurements
    if not measured.all():
        error = np.where(measured, error, 0.0)
    max_mean = np.where(data.behind_belts, np.inf, data.quantum / 2)
    error -= sensor_zero_error(error, measured, run.initial.resting_rows, max_mean)
    return error


def residuals(run: PreparedRecording, data: Dataset, measurements: Array, rows_per_block: int = 1) -> Array:
    """Return measured minus predicted values in units of the noise.

    The error that the sensors' zeros explain is removed, see `prediction_error`.

    Args:
        run: Measured run.
        data: Data set of the run, for the sensors' noise.
        measurements: Predicted values, shape (batch, n, sensors).
        rows_per_block: How many consecutive rows are summed into one, scaled so that white noise keeps its size.
            Products of columns that change more slowly stay the same, with fewer rows to multiply.

    Returns:
        Residuals, zero where a value was not measured or does not count, shape (batch, n * sensors) or, with blocks,
        (batch, n // rows_per_block * sensors).
    """
    measured = np.isfinite(run.outputs)
    counted = measured if run.rows is None else measured & run.rows[:, None]
    with np.errstate(over="ignore", invalid="ignore"):  # parameters that make a machine diverge cost infinitely much
        error = prediction_error(run, data, measurements)
        error *= counted / data.noise
    batch, rows, sensors = error.shape
    if rows_per_block > 1:
        blocks = rows // rows_per_block
        error = error[:, : blocks * rows_per_block].reshape(batch, blocks, rows_per_block, sensors)
        error = error.sum(axis=2) / np.sqrt(rows_per_block)
    return error.reshape(batch, -1)


# Aliases until all packages use the new names.
over_runs = map_runs
