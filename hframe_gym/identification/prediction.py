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
from .initial_state import settled
from .static_equilibrium import static_equilibrium

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
_INVERSION_ITERATIONS = 4  # each leaves a few hundredths of the error
_INVERSION_TOLERANCE = 1e-6  # m or rad
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
    has_motors = any(c.kind == "rotary" for c in machine.coordinates)
    for j, sensor in enumerate(machine.sensors):
        name = sensor.coordinate
        i = machine.coordinate_names.index(name)
        slow = has_motors and machine.coordinate(name).kind == "linear"
        bandwidth = _LASER_BANDWIDTH if slow else _ENCODER_BANDWIDTH
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
        initial_state: Positions and velocities, shape (batch, 2 * coordinates); default: the run's, see
            `initial_state_of_run`.
        longest_step: Maximum integration step, s.
        states: Whether to return positions and velocities too.

    Returns:
        Predicted measurements (batch, n, sensors), with positions and velocities (batch, n, coordinates) on request.
    """
    run_state = initial_state_of_run(machine, run)
    measured = gains = None
    if has_feedback(mode):
        count = len(run.start) // 2
        encoders = [machine.coordinate(sensor.coordinate).kind == "rotary" for sensor in machine.sensors]
        # Encoders count from where the run starts, wherever the machine puts that.
        displacement = machine.sensor_matrix[:, :count] @ (run_state[:count] - run.start[:count])
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


def initial_state_of_run(machine: Machine, run: PreparedRecording) -> Array:
    """Return the state at rest from which a machine predicts a run.

    Lasers determine the tool's position, the static equilibrium of the machine determines the motors' angles.  Encoders
    whose zero is known beyond the belts' stretch determine their motors' angles instead, with two exceptions while
    the encoder zeros have not been corrected with a fitted machine: eccentric pulleys, and all motors if an effect
    changes the tool position that the sensors imply.  In both cases the effect was mistaken for a stretch of the belts.

    Args:
        machine: Machine that predicts.
        run: Run whose initial rows are at rest.

    Returns:
        Positions and zero velocities, shape (2 * coordinates,).
    """
    if not machine.belts:
        return run.start
    tool_position = position_from_measurements(machine, run)
    position = static_equilibrium(machine, tool_position)
    if run.zeroed or np.array_equal(tool_position, run.start[: len(run.start) // 2]):
        excluded: list[str | None] = []
        if not run.zeroed:
            excluded = [machine.site_coordinate(e.site) for e in machine.effects if e.definition.behind]
        for i, angle in encoder_angles(machine, run).items():
            if machine.coordinate_names[i] not in excluded:
                position[i] = angle
    return np.concatenate([position, np.zeros_like(position)])


def encoder_angles(machine: Machine, run: PreparedRecording) -> dict[int, float]:
    """Return, by coordinate index, the angle that an encoder with a known zero gives for an ideal round pulley, rad."""
    angles: dict[int, float] = {}
    for j in np.flatnonzero(run.told):
        i = machine.coordinate_names.index(machine.sensors[j].coordinate)
        measured_angle = float(run.start[i])
        angles[i] = measured_angle
        for e in machine.effects:
            if e.definition.behind and machine.site_coordinate(e.site) == machine.coordinate_names[i]:
                angles[i] += float(e("behind", q=measured_angle, per_radius=1.0 / machine.radii[i]))
    return angles


def position_from_measurements(machine: Machine, run: PreparedRecording) -> Array:
    """Return a run's initial positions (coordinates,) with the sensor effects of the machine's lasers inverted.

    The inversion is a fixed-point iteration.  A measurement that no position explains, such as one beyond the end of a
    sensor's range, leaves the position as it is.
    """
    position = run.start[: len(run.start) // 2].copy()
    names = machine.coordinate_names
    for e in machine.effects:
        if not e.definition.reading or machine.coordinate(machine.site_coordinate(e.site) or "").kind != "linear":
            continue
        sensor = machine.sensors[machine.output_channels.index(e.site)]
        index, other = names.index(sensor.coordinate), machine.across(sensor.coordinate)
        measured = float(position[index])
        across = position[names.index(other)] if other else 0.0
        estimate = measured
        for _ in range(_INVERSION_ITERATIONS):
            estimate -= float(e("reading", r=estimate, across=across)) - measured
        if abs(float(e("reading", r=estimate, across=across)) - measured) < _INVERSION_TOLERANCE:
            position[index] = estimate
    return position


def mechanical_rows_per_block(data: Dataset) -> int:
    """Return how many rows may be averaged where only the response to mechanical effects matters."""
    return max(1, round(_BLOCK_S / data.period))


def residuals(run: PreparedRecording, data: Dataset, measurements: Array, rows_per_block: int = 1) -> Array:
    """Return measured minus predicted values in units of the noise.

    Each channel's zero is estimated, see `sensor_offsets`.

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
        error = run.outputs - measurements  # (batch, n, sensors)
        if not measured.all():
            error = np.where(measured, error, 0.0)
        error -= sensor_offsets(run, data, error, measured)
        error *= counted / data.noise
    batch, rows, sensors = error.shape
    if rows_per_block > 1:
        blocks = rows // rows_per_block
        error = error[:, : blocks * rows_per_block].reshape(batch, blocks, rows_per_block, sensors)
        error = error.sum(axis=2) / np.sqrt(rows_per_block)
    return error.reshape(batch, -1)


def sensor_offsets(run: PreparedRecording, data: Dataset, error: Array, measured: NDArray[np.bool_]) -> Array:
    """Return the part of prediction errors that the unknown zeros of the sensors explain.

    It is the mean over the settled rows at rest.  These rows determine the zero of a quantized channel only to within
    its quantum, so up to half a quantum of the mean error over the whole run is removed too, but not more: with
    feedback, a constant force shows as just such a mean.  For an encoder behind belts the entire mean is removed,
    because static friction holds an unknown stretch of the belts at rest.

    Args:
        run: Measured run.
        data: Data set of the run.
        error: Measured minus predicted values, zero where not measured, shape (batch, n, sensors).
        measured: Which values were measured, shape (n, sensors).

    Returns:
        Offsets in channel units, shape (batch, 1, sensors).
    """
    rest = settled(run.rest)
    counts = np.maximum(measured.sum(axis=0), 1)
    at_rest = error[:, rest].sum(axis=1) / np.maximum(measured[rest].sum(axis=0), 1)
    remaining_mean = error.sum(axis=1) / counts - at_rest * (measured.sum(axis=0) / counts)
    limit = np.where(data.behind_belts, np.inf, data.quantum / 2)
    offsets: Array = (at_rest + np.clip(remaining_mean, -limit, limit))[:, None, :]
    return offsets


# Aliases until all packages use the new names.
position_from_readings = position_from_measurements
over_runs = map_runs
