"""Analyze what a fitted machine leaves unexplained: errors per channel, missing forces, and what these depend on.

The missing force, also called force residual, is the force that would have to be added to the model for it to follow
the measurements. It is estimated from the corrections of an observer, which feeds the measurements back into a
prediction, see `prediction`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from ..machine import Machine
from ..machine.motion import pulley_names, rigid_motions
from .dataset import Dataset, PreparedRecording
from .prediction import (
    POLISH_STEP,
    SEARCH_BANDWIDTH,
    SIMULATION,
    map_runs,
    measurements_from,
    observer_gains,
    predict,
    prediction_error,
)
from .start_estimation import most_probable_initial_state, start_for_observer

Array = NDArray[np.float64]

# Low-pass cut-off frequencies, Hz.  In the force residual, noise is fast and a missing effect slow.
_RESIDUAL_CUTOFF = 30.0
MISSING_FORCE_CUTOFF = 40.0
_WHITENESS_BLOCK_S = 0.02
_WHITE = 0.6  # standard deviation of block means, in units of the noise


class ChannelError(NamedTuple):
    """Simulation error of one output channel; both values are None where the channel was never measured.

    Attributes:
        rmse: Root mean square error, in the channel's unit (m or rad).
        noise_ratio: The same divided by the standard deviation of the sensor's noise.
    """

    rmse: float | None
    noise_ratio: float | None


class Dependence(NamedTuple):
    """Dependence of the force residual on a variable.

    Attributes:
        variable: Name of the variable, e.g. "velocity of x".
        coordinate: Coordinate on which the force acts.
        explained: Fraction of the force residual's variance that a curve over the variable explains, in [0, 1].
    """

    variable: str
    coordinate: str
    explained: float


def simulation_error(machine: Machine, run: PreparedRecording, data: Dataset) -> Array:
    """Simulate a run; return measured minus simulated values, without the constant errors of uncertain sensor zeros.

    A zero is the measurement at position 0. Its error is estimated from the rows at rest and, within limits, from the
    complete run.

    Args:
        machine: Machine, simulated without feedback from its most probable initial state in this run.
        run: Measured run, n samples.
        data: Data set of the run, for the sampling period and the sensors' quantization steps.

    Returns:
        Errors, m or rad, NaN where not measured, shape (n, sensors).
    """
    start = most_probable_initial_state(machine, run, data)
    motion = predict(machine, run, SIMULATION, period=data.period, initial_state=start, longest_step=POLISH_STEP)
    error = prediction_error(run, data, motion.readings)[0]
    return np.where(np.isfinite(run.outputs), error, np.nan)


def channel_errors(machine: Machine, data: Dataset) -> dict[str, ChannelError]:
    """Simulate a machine over all runs and return the root mean square error of every output channel.

    Args:
        machine: Machine to simulate, without feedback of the measurements, from its most probable initial states.
        data: Measured runs (times, voltages, measurements, SI).

    Returns:
        By name of the output channel: root mean square error `rmse`, m or rad, and `noise_ratio`, dimensionless, the
        same divided by the standard deviation of the sensor's noise. Both are None for a channel without measurements.
    """
    return errors_by_channel(
        list(map_runs(lambda run: simulation_error(machine, run, data), data)), machine, data.noise
    )


def errors_by_channel(by_run: Sequence[Array], machine: Machine, noise: Array) -> dict[str, ChannelError]:
    """Return the root mean square of given simulation errors over all runs, for every output channel.

    Args:
        by_run: Errors by run, m or rad, NaN where not measured, shape (n, sensors) each.
        machine: Machine with the sensors.
        noise: Standard deviations of the sensors' noise, m or rad, shape (sensors,).

    Returns:
        By name of the output channel: root mean square error `rmse`, m or rad, and `noise_ratio`, dimensionless, the
        same divided by the standard deviation of the sensor's noise. Both are None for a channel without measurements.
    """
    error = np.concatenate(by_run)
    errors = {}
    for j, channel in enumerate(machine.output_channels):
        column = error[:, j][np.isfinite(error[:, j])]
        if len(column) == 0:
            errors[channel] = ChannelError(None, None)
            continue
        rmse = float(np.sqrt(np.mean(column**2)))
        errors[channel] = ChannelError(rmse, rmse / float(noise[j]))
    return errors


def force_residual(machine: Machine, run: PreparedRecording, data: Dataset) -> Array:
    """Estimate the force that would have to be added for the machine to follow the measurements.

    An observer corrects the predicted velocities at every sample by the measurements. This correction divided by the
    sampling period is an acceleration; times the mass or inertia it is the missing force. The estimate is valid below
    the observer's bandwidth (60 rad/s). A missing measurement causes no correction.

    The observer does not correct a carriage without a sensor. The force on such a carriage follows from the corrections
    of its pulleys, as if the belts were rigid.

    Args:
        machine: Machine that predicts.
        run: Measured run, n samples.
        data: Data set of the run, for the sampling period.

    Returns:
        Force on every coordinate, N or Nm, shape (n, coordinates).
    """
    velocity_gains = observer_gains(machine, data.period)[len(machine.coordinates) :]  # (coordinates, sensors)
    mass = np.array([c.mass for c in machine.coordinates])
    force = _innovations(machine, run, data, run.initial_state(machine))[0] @ velocity_gains.T / data.period * mass
    for i, motion in _motions_of_unmeasured(machine).items():
        force[:, i] = force @ motion  # virtual work along the motion of the carriage with its pulleys
    return force


def _innovations(
    machine: Machine, run: PreparedRecording, data: Dataset, start: Array, noise: Array | None = None
) -> Array:
    """Return measured minus predicted values, 0 where not measured, and their change by noise, (1 or 2, n, sensors)."""
    added = None if noise is None else np.stack([np.zeros_like(noise), -noise])
    motion = predict(machine, run, SEARCH_BANDWIDTH, period=data.period, initial_state=start, extra_measurement=added)
    innovation = measurements_from(start, machine, run) - motion.readings
    innovation[1:] -= innovation[:1]
    return np.nan_to_num(innovation)


def _motions_of_unmeasured(machine: Machine) -> dict[int, Array]:
    """Return the rigid motion that each coordinate without a sensor leads, shape (coordinates,), by its index.

    Coordinates whose motion moves no measured one are left out: nothing is known about the force on them.
    """
    measured = _measured(machine)
    motions = {machine.coordinate_names.index(name): motion for name, motion in rigid_motions(machine).items()}
    return {i: motion for i, motion in motions.items() if not measured[i] and np.any(motion[measured])}


def _measured(machine: Machine) -> NDArray[np.bool_]:
    """Mark the coordinates that the observer corrects by a sensor, shape (coordinates,)."""
    corrected = {sensor.coordinate for sensor in machine.sensors}
    return np.array([name in corrected for name in machine.coordinate_names])


def smooth_force_residual(machine: Machine, run: PreparedRecording, data: Dataset) -> Array:
    """Estimate the force that the model lacks in a run, on each coordinate alone, low-pass filtered at 30 Hz.

    The observer divides this force among a carriage and its pulleys in the ratio of its gains, wherever the force acts.
    Its corrections are therefore added along the motions that stretch no belt: the force on a carriage does the same
    virtual work as all corrections if only carriages have forces; that on a pulley, if only pulleys do. Corrections of
    positions count too: the predicted velocity, on which viscous friction and back-EMF act, lacks them.

    Args:
        machine: Machine that predicts.
        run: Measured run, n samples.
        data: Data set of the run, for the sampling period.

    Returns:
        Force on every coordinate, N or Nm, without phase lag, shape (n, coordinates).
    """
    start = start_for_observer(machine, run, data)
    force = _innovations(machine, run, data, start)[0] @ _rigid_force_gains(machine, data.period)
    return _low_pass(force, _RESIDUAL_CUTOFF, data.period)


def comparable_forces(machine: Machine, data: Dataset) -> tuple[Array, Array]:
    """Estimate the force that the model lacks along all runs and the part that the noise of the sensors causes.

    Forces on different coordinates are scaled: each counts as the root of the sum of squares of the forces at the belt,
    on its pulleys alone, that do the same work. One pulley is thus preferred to carriages, a carriage to two pulleys.

    Args:
        machine: Machine that predicts.
        data: Measured runs with n rows in total (times, voltages, measurements, SI).

    Returns:
        force: Force on every coordinate as in `smooth_force_residual`, scaled, N, shape (n, coordinates).
        noise: Change of this force by synthetic noise (fixed seed) in the measurements, N, shape (n, coordinates).
    """
    pulleys = [machine.coordinate_names.index(name) for name in pulley_names(machine)]
    travel, scales = machine.travel_per_unit, np.array(machine.travel_per_unit)
    for name, motion in rigid_motions(machine).items():
        scales[machine.coordinate_names.index(name)] *= np.linalg.norm((motion * travel)[pulleys]) or 1.0
    rng, gains, by_run = np.random.default_rng(0), _rigid_force_gains(machine, data.period) / scales, []
    for run in data.runs:
        start = start_for_observer(machine, run, data)
        innovations = _innovations(machine, run, data, start, _synthetic_noise(machine, run, data, rng))
        by_run.append([_low_pass(values @ gains, _RESIDUAL_CUTOFF, data.period) for values in innovations])
    force, noise = np.concatenate(by_run, axis=1)
    return force, noise


def _synthetic_noise(machine: Machine, run: PreparedRecording, data: Dataset, rng: np.random.Generator) -> Array:
    """Return noise of the measurements of a run, m or rad, shape (n, sensors); quantized sensors round the motion."""
    noise = rng.normal(size=run.outputs.shape) * np.sqrt(np.maximum(run.noise**2 - data.quantum**2 / 12, 0.0))
    exact = predict(machine, run, SEARCH_BANDWIDTH, period=data.period).readings[0]
    for j in np.flatnonzero(data.quantum > 0.0):
        offset, quantum = rng.random(), data.quantum[j]
        noise[:, j] = (np.round((exact[:, j] + noise[:, j]) / quantum + offset) - offset) * quantum - exact[:, j]
        noise[:, j] -= noise[: max(run.initial.resting_rows, 1), j].mean()  # as the zero of the sensor does
    return noise


def _rigid_force_gains(machine: Machine, period: float) -> Array:
    """Return the force on each coordinate per innovation, N or Nm per m or rad, shape (sensors, coordinates)."""
    names, motions = machine.coordinate_names, rigid_motions(machine)
    damping = np.array([c.viscous for c in machine.coordinates], float)
    for drive in machine.drives:
        damping[names.index(drive.coordinate)] += drive.gain * drive.emf_constant
    sums = np.eye(len(names))  # column i sums the forces on all coordinates to one on coordinate i
    for name, motion in motions.items():
        sums[:, names.index(name)] = motion
    if machine.belts and motions:
        modes, pulleys = np.array(list(motions.values())), [names.index(name) for name in pulley_names(machine)]
        sums[:, pulleys] = modes.T @ np.linalg.pinv(modes[:, pulleys].T)  # modes: (motions, coordinates)
    position_gains, velocity_gains = np.split(observer_gains(machine, period), 2)  # (coordinates, sensors) each
    mass = np.array([c.mass for c in machine.coordinates])
    return np.asarray((velocity_gains.T * mass + position_gains.T * damping) / period @ sums)


def missing_force(machine: Machine, data: Dataset) -> dict[str, Array]:
    """Estimate the force that the model lacks along all runs, together with the motion.

    An observer corrects the predicted velocities by the measurements. The corrections times the mass are the missing
    force after a low-pass filter with two equal poles at the observer's bandwidth. This function inverts the filter for
    frequencies up to 40 Hz, far above the observer's bandwidth (60 rad/s). The poles of a carriage that no sensor
    measures are slower: the corrections of its pulleys must move its mass too.

    Args:
        machine: Machine that predicts.
        data: Measured runs with n rows in total (times, voltages, measurements, SI).

    Returns:
        By coordinate name, an array of shape (n, 3) with the columns position, velocity and missing force: m, m/s, N
        for a linear and rad, rad/s, Nm for a rotary coordinate.
    """
    position_gains = observer_gains(machine, data.period)[: len(machine.coordinates)].sum(axis=1)
    # Time constant of each pole, s, about 1 / bandwidth, shape (coordinates,).
    time_constant = 2.0 * data.period / np.maximum(position_gains, 1e-12)
    inertia_ratio = np.ones(len(machine.coordinates))  # inertia of the rigid motion / inertia of its measured part
    measured, mass = _measured(machine), np.array([c.mass for c in machine.coordinates])
    for i, motion in _motions_of_unmeasured(machine).items():
        inertia = mass * motion**2
        inertia_ratio[i] = inertia.sum() / inertia[measured].sum()
        time_constant[i] = time_constant[measured & (motion != 0.0)].max()

    def of_run(run: PreparedRecording) -> Array:
        motion = predict(machine, run, SEARCH_BANDWIDTH, period=data.period, states=True)
        # f + 2 T f' + r T^2 f'' inverts the low-pass 1 / (1 + 2 T s + r T^2 s^2); for r = 1, it has equal poles.
        force = _low_pass(force_residual(machine, run, data), MISSING_FORCE_CUTOFF, data.period)
        first_derivative = np.gradient(force, run.time_s, axis=0)
        second_derivative = np.gradient(first_derivative, run.time_s, axis=0)
        unfiltered = force + 2 * time_constant * first_derivative + inertia_ratio * time_constant**2 * second_derivative
        return np.stack([motion.positions[0], motion.velocities[0], unfiltered], axis=2)  # (n, coordinates, 3)

    by_coordinate = np.concatenate(list(map_runs(of_run, data)))
    return {name: by_coordinate[:, i] for i, name in enumerate(machine.coordinate_names)}


def _low_pass(values: Array, cutoff: float, period: float) -> Array:
    """Return values (n, k) below a cut-off frequency, Hz, filtered without phase lag."""
    filtered: Array = signal.sosfiltfilt(signal.butter(2, min(0.9, 2 * cutoff * period), output="sos"), values, axis=0)
    return filtered


def dependence_variables(machine: Machine, run: PreparedRecording, data: Dataset) -> dict[str, Array]:
    """Return the variables of a run on which the force of a missing effect (deviation from the model) may depend.

    Args:
        machine: Machine that predicts positions and velocities, corrected by an observer at every sample.
        run: Measured run, n samples.
        data: Data set of the run, for the sampling period.

    Returns:
        By name, shape (n,) each: "position of C" (m or rad) and "velocity of C" (m/s or rad/s) for each coordinate C,
        the input channels (V) and "time" (s).
    """
    motion = predict(machine, run, SEARCH_BANDWIDTH, period=data.period, states=True)
    names = machine.coordinate_names
    variables = {f"position of {name}": motion.positions[0, :, i] for i, name in enumerate(names)}
    variables |= {f"velocity of {name}": motion.velocities[0, :, i] for i, name in enumerate(names)}
    variables |= {channel: run.inputs[:, j] for j, channel in enumerate(machine.input_channels)}
    return variables | {"time": run.time_s}


def white_sensors(machine: Machine, data: Dataset) -> NDArray[np.bool_]:
    """Test for each sensor whether its simulation error is white noise with the standard deviation of its noise.

    The test evaluates means over blocks of n measurements (20 ms if none is missing), minus the mean over the run. The
    standard deviation of such a mean is 1 / sqrt(n) of that of a sample if the error is white noise, but hardly smaller
    if it is correlated in time. The repeated rounding error of a sensor at rest counts once (`run.weights`).

    Args:
        machine: Machine to simulate.
        data: Measured runs (times, voltages, measurements, SI).

    Returns:
        True where the standard deviation of the block means is at most 0.6 times that of the noise, shape (sensors,);
        False where the simulation diverges.
    """
    rows = max(2, round(_WHITENESS_BLOCK_S / data.period))
    squares, count = np.zeros(len(machine.sensors)), np.zeros(len(machine.sensors))
    for run in data.runs:
        measured, error = np.isfinite(run.outputs), simulation_error(machine, run, data)
        for j in range(len(machine.sensors)):
            values, weights = error[measured[:, j], j], run.weights[measured[:, j], j]
            if not np.isfinite(values).all():
                squares[j] = np.inf
            elif len(values) >= rows:
                means, weights = (v[: len(v) // rows * rows].reshape(-1, rows).mean(axis=1) for v in (values, weights))
                squares[j] += np.sum(weights * (means - np.average(means, weights=weights)) ** 2)
                count[j] += weights.sum()
    return np.asarray(np.sqrt(squares / np.where(count > 0.0, count, 1.0)) <= _WHITE * data.noise)
