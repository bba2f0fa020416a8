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
from ..machine.motion import rigid_motions
from .dataset import Dataset, PreparedRecording
from .free_parameters import typical_force
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
from .start_estimation import most_probable_initial_state

Array = NDArray[np.float64]

# Low-pass cut-off frequencies, Hz.  In the force residual, noise is fast and a missing effect slow.
_RESIDUAL_CUTOFF = 30.0
MISSING_FORCE_CUTOFF = 40.0
_DEPENDENCE_BINS = 16
_MINIMUM_DEPENDENCE = 0.05  # fraction of the variance
_ROUNDING_FORCE = 1e-9  # of the typical force; a smaller missing force is a rounding error, as on an axis at rest
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
    start = run.initial_state(machine)
    predicted = predict(machine, run, SEARCH_BANDWIDTH, period=data.period, initial_state=start).readings[0]
    innovation = np.nan_to_num(measurements_from(start, machine, run) - predicted)  # (n, sensors)
    velocity_gains = observer_gains(machine, data.period)[len(machine.coordinates) :]  # (coordinates, sensors)
    mass = np.array([c.mass for c in machine.coordinates])
    force = innovation @ velocity_gains.T / data.period * mass
    for i, motion in _motions_of_unmeasured(machine).items():
        force[:, i] = force @ motion  # virtual work along the motion of the carriage with its pulleys
    return force


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
    """Estimate the force that the model lacks in a run (`force_residual`), low-pass filtered at 30 Hz without lag.

    Args:
        machine: Machine that predicts.
        run: Measured run, n samples.
        data: Data set of the run, for the sampling period.

    Returns:
        Force on every coordinate, N or Nm, shape (n, coordinates).
    """
    return _low_pass(force_residual(machine, run, data), _RESIDUAL_CUTOFF, data.period)


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


def rank_dependences(machine: Machine, data: Dataset) -> list[Dependence]:
    """Rank the variables on which the force that the model lacks depends, as a hint to its cause.

    For each coordinate and each variable (position, velocity, voltage, time), the mean of the force over bins of the
    variable is computed.

    Args:
        machine: Machine that predicts.
        data: Measured runs (times, voltages, measurements, SI).

    Returns:
        Pairs of coordinate and variable whose bin means explain more than 5 % of the variance of the force, with this
        fraction, sorted by the explained variance of the force (torque / pulley radius), largest first. A coordinate on
        which the machine lacks no force, because it never moves or the machine is exact, has none.
    """
    force = np.concatenate([smooth_force_residual(machine, run, data) for run in data.runs])
    by_run = [dependence_variables(machine, run, data) for run in data.runs]
    variables = {name: np.concatenate([variables[name] for variables in by_run]) for name in by_run[0]}
    # Fraction of the variance that a curve over the variable explains, for each coordinate and variable.
    dependences = [
        Dependence(name, coordinate, _correlation_ratio(force[:, i], values))
        for i, coordinate in enumerate(machine.coordinate_names)
        for name, values in variables.items()
    ]
    variance = dict(zip(machine.coordinate_names, np.var(force / machine.travel_per_unit, axis=0), strict=True))  # N^2
    least = (_ROUNDING_FORCE * typical_force(machine)) ** 2
    noticeable = (d for d in dependences if d.explained > _MINIMUM_DEPENDENCE and variance[d.coordinate] > least)
    return sorted(noticeable, key=lambda d: -d.explained * variance[d.coordinate])


def _correlation_ratio(values: Array, variable: Array) -> float:
    """Return the fraction of the variance of values (n,) that bins of a variable explain (Fisher 1925).

    The bins have about the same number of samples; equal values of the variable are in one bin.
    """
    total = float(np.var(values))
    if total == 0.0 or np.ptp(variable) == 0.0:
        return 0.0
    ranks = np.searchsorted(np.sort(variable), variable)
    bins = ranks * _DEPENDENCE_BINS // len(variable)
    counts = np.maximum(np.bincount(bins, minlength=_DEPENDENCE_BINS), 1)
    means = np.bincount(bins, values, _DEPENDENCE_BINS) / counts
    return float(np.var(means[bins]) / total)


def is_white(machine: Machine, data: Dataset) -> bool:
    """Test whether the simulation error is white noise with the standard deviation of the sensors' noise.

    The test evaluates means over blocks of 20 ms, minus the mean over the run. For n samples per block, the standard
    deviation of such a mean is 1 / sqrt(n) of that of a sample if the error is white noise, but hardly smaller if it is
    correlated in time.

    Args:
        machine: Machine to simulate.
        data: Measured runs (times, voltages, measurements, SI).

    Returns:
        True if the standard deviation of the block means of every channel is at most 0.6 times that of its noise.
        Blocks with missing measurements do not count.
    """
    rows = max(2, round(_WHITENESS_BLOCK_S / data.period))
    errors = [simulation_error(machine, run, data) for run in data.runs]
    for j in range(len(machine.sensors)):
        means = []
        for error in errors:
            blocks = error[: len(error) // rows * rows, j].reshape(-1, rows)
            blocks = blocks[np.isfinite(blocks).all(axis=1)]
            means.append(blocks.mean(axis=1) - blocks.mean() if len(blocks) else np.zeros(0))
        spread = float(np.sqrt(np.mean(np.concatenate(means) ** 2))) if any(map(len, means)) else 0.0
        if spread > _WHITE * data.noise[j]:
            return False
    return True
