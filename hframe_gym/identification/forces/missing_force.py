"""The force that a model lacks, on each coordinate or along each motion.

The missing force, also called force residual, is the force that would have to be added to the model for it to
follow the measurements. It is estimated from the corrections of an observer, which feeds the measurements
back into a prediction, see `prediction`.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import NamedTuple

import numpy as np
from scipy import signal
from scipy.linalg import null_space

from ...arrays import Array
from ...machine import Machine
from ...machine.motion import pulley_names, rigid_motions
from ...preparation.dataset import Dataset, PreparedRecording
from ..fit.start_estimation import start_for_observer
from ..predict.prediction import SEARCH_BANDWIDTH, map_runs, measurements_from, observer_gains, predict

# Low-pass cut-off frequency, Hz. In the force residual, noise is fast and a missing effect slow.
_RESIDUAL_CUTOFF = 30.0
HIGHEST_FREQUENCY = 40.0  # Hz, up to which the missing force is estimated


def _innovations(
    machine: Machine, run: PreparedRecording, data: Dataset, start: Array, noise: Array | None = None
) -> Array:
    """Return measured minus predicted, 0 if not measured, and its change by noise, (1 or 2, n, sensors)."""
    added = None if noise is None else np.stack([np.zeros_like(noise), -noise])
    motion = predict(
        machine, run, SEARCH_BANDWIDTH, period=data.period, initial_state=start, extra_measurement=added
    )
    innovation = _innovation(motion.readings, machine, run, start)
    innovation[1:] -= innovation[:1]
    return innovation


def _innovation(readings: Array, machine: Machine, run: PreparedRecording, start: Array) -> Array:
    """Return measured minus predicted values, 0 where not measured, from a given start, same shape."""
    return np.nan_to_num(measurements_from(start, machine, run) - readings)


def smooth_force_residual(machine: Machine, run: PreparedRecording, data: Dataset) -> Array:
    """Estimate the force that the model lacks in a run, on each coordinate alone, low-pass filtered at 30 Hz.

    The observer divides this force among a carriage and its pulleys in the ratio of its gains, wherever the
    force acts. Its corrections are therefore added along the motions that stretch no belt: the force on a
    carriage does the same virtual work as all corrections if only carriages have forces; that on a pulley, if
    only pulleys do. Corrections of positions count too: the predicted velocity, on which viscous friction and
    back-EMF act, lacks them.

    Args:
        run: Measured run, n samples.
        data: Data set of the run, for the sampling period.

    Returns:
        Force on every coordinate, N or Nm, without phase lag, shape (n, coordinates).
    """
    start = start_for_observer(machine, run, data)
    force = _innovations(machine, run, data, start)[0] @ _observed_forces(machine, data.period).gains
    return _low_pass(force, _RESIDUAL_CUTOFF, data.period)


class MissingMotion(NamedTuple):
    """Missing force and disagreement of the sensors in a run of n samples, on a machine with m rigid motions.

    Attributes:
        force: Force that the model lacks along each rigid motion (`rigid_motions`; coordinates without one
            move alone), N or Nm, below 30 Hz, shape (n, m).
        correction: Force along each motion by which the observer corrects the prediction. It follows the
            missing force with a lag (`correction_filters`), but has white noise; shape (n, m).
        correction_noise: Part of `correction` that synthetic noise (fixed seed) in the measurements causes,
            same shape.
        disagreement: Combinations of the sensors' errors that no rigid motion causes, in standard deviations
            of the sensors' noise, shape (n, sensors - m).
        disagreement_noise: Part of `disagreement` that the same noise causes, same shape.
        positions: Predicted positions, m or rad, shape (n, coordinates).
        velocities: Predicted velocities, m/s or rad/s, shape (n, coordinates).
    """

    force: Array
    correction: Array
    correction_noise: Array
    disagreement: Array
    disagreement_noise: Array
    positions: Array
    velocities: Array


def missing_motions(machine: Machine, data: Dataset) -> list[MissingMotion]:
    """Estimate, for each run, the force that the model lacks and the disagreement of the sensors.

    Both are given along the rigid motions of the machine and in combinations of the sensors that no rigid
    motion changes, together with the part that noise causes.

    Returns:
        Forces, N or Nm, disagreements and motion, arrays of shape (n, ...), one entry per run of n samples.
    """
    observed, combinations = _observed_forces(machine, data.period), sensor_combinations(machine, data)
    rng, motions = np.random.default_rng(0), []
    for run in data.runs:
        start = start_for_observer(machine, run, data)
        innovations = _innovations(machine, run, data, start, _synthetic_noise(machine, run, data, rng))
        correction, correction_noise = innovations @ observed.motion_gains
        force = _inverted(correction, observed, run, data, _RESIDUAL_CUTOFF)
        state = predict(machine, run, SEARCH_BANDWIDTH, period=data.period, initial_state=start, states=True)
        disagreement, disagreement_noise = innovations @ combinations
        positions, velocities = state.positions[0], state.velocities[0]
        corrections = correction, correction_noise, disagreement, disagreement_noise
        motions.append(MissingMotion(force, *corrections, positions, velocities))
    return motions


def motion_directions(machine: Machine, data: Dataset) -> Array:
    """Return the matrix from forces on the coordinates to forces along the rigid motions.

    A rigid motion stretches no belt; a coordinate that takes part in none is a motion of its own.

    Args:
        data: Data set, for the sampling period.

    Returns:
        Displacement of each coordinate per unit of the motion, m or rad, shape (motions, coordinates). The
        product with forces on the coordinates, N or Nm, gives the force along each motion.
    """
    return _observed_forces(machine, data.period).modes


def correction_filters(machine: Machine, data: Dataset) -> list[tuple[Array, Array]]:
    """Return the low-pass filters that lead from the missing force to the observer's corrections (60 rad/s).

    Both are forces along a rigid motion of the machine, N or Nm. For a constant force they are equal.

    Args:
        data: Data set, for the sampling period.

    Returns:
        Numerator and denominator of a digital filter at the sampling period, in descending powers of z, shape
        (order + 1,) each, by motion; 1 and 1 for a motion that no sensor measures.
    """
    observed = _observed_forces(machine, data.period)
    filters = []
    for first, second in zip(observed.first, observed.second, strict=True):
        if second > 0.0:
            filters.append(signal.bilinear([1.0], [second, first, 1.0], 1.0 / data.period))
        else:
            filters.append((np.ones(1), np.ones(1)))
    return filters


def sensor_combinations(machine: Machine, data: Dataset) -> Array:
    """Return the combinations of the position sensors' errors that no rigid motion causes.

    Args:
        data: Data set with the standard deviations of their noise.

    Returns:
        Combinations as columns, 1/m or 1/rad, whose noise has the standard deviation 1,
        shape (sensors, position sensors - motions).
    """
    noise, positions = np.asarray(data.noise, float), machine.position_sensors
    scaled = (machine.sensor_matrix @ _observed_forces(machine, data.period).modes.T) / noise[:, None]
    of_positions = np.asarray(null_space(scaled[positions].T)) / noise[positions, None]
    combinations = np.zeros((len(noise), of_positions.shape[1]))
    combinations[positions] = of_positions
    return combinations


def _synthetic_noise(
    machine: Machine, run: PreparedRecording, data: Dataset, rng: np.random.Generator
) -> Array:
    """Return noise of a run, in the sensors' units, (n, sensors); quantized sensors round the motion."""
    noise = rng.normal(size=run.outputs.shape) * np.sqrt(np.maximum(run.noise**2 - data.quantum**2 / 12, 0.0))
    exact = predict(machine, run, SEARCH_BANDWIDTH, period=data.period).readings[0]
    for j in np.flatnonzero(data.quantum > 0.0):
        offset, quantum = rng.random(), data.quantum[j]
        noise[:, j] = (np.round((exact[:, j] + noise[:, j]) / quantum + offset) - offset) * quantum - exact[
            :, j
        ]
        noise[:, j] -= noise[: max(run.initial.resting_rows, 1), j].mean()  # as the zero of the sensor does
    return noise


class _ObservedForces(NamedTuple):
    """What the corrections of an observer say about the force on each coordinate.

    A rigid motion stretches no belt: a carriage moves with its pulleys. Other coordinates move alone. The
    error e of a rigid motion obeys M e'' + (D + M l1) e' + (D l1 + M l2) e = missing force, with mass M,
    damping D, and the gains of position and velocity l1, 1/s, and l2, 1/s^2. The last term on the left is the
    force that corrects the motion.

    Attributes:
        gains: Correcting force on each coordinate per innovation, N or Nm per m or rad,
            shape (sensors, coordinates).
        motion_gains: Correcting force along each motion, N or Nm per m or rad, shape (sensors, motions).
        first: (D + M l1) / (D l1 + M l2), s, shape (motions,).
        second: M / (D l1 + M l2), s^2, shape (motions,).
        modes: Displacement of the coordinates along each motion, shape (motions, coordinates).
        distribution: Force on a coordinate, if only carriages or only pulleys have forces, per force along a
            motion, shape (motions, coordinates).
    """

    gains: Array
    motion_gains: Array
    first: Array
    second: Array
    modes: Array
    distribution: Array


def _observed_forces(machine: Machine, period: float) -> _ObservedForces:
    """Return what corrections say about forces, for an observer of `SEARCH_BANDWIDTH` at a period, s."""
    names, motions = machine.coordinate_names, rigid_motions(machine)
    pulleys = [names.index(name) for name in pulley_names(machine)] if machine.belts and motions else []
    leading = [names.index(name) for name in motions]
    leading += [i for i in range(len(names)) if i not in leading and i not in pulleys]
    # (motions, coordinates)
    modes = np.vstack([*motions.values(), *np.eye(len(names))[leading[len(motions) :]]])
    distribution = np.eye(len(names))[leading]
    if pulleys:
        distribution[:, pulleys] = np.linalg.pinv(modes[:, pulleys].T)
    mass, damping = np.array([(c.mass, c.viscous) for c in machine.coordinates], float).T
    for drive in machine.drives:
        damping[names.index(drive.coordinate)] += drive.gain * drive.emf_constant
    # (coordinates, sensors)
    position_gains, velocity_gains = np.split(observer_gains(machine, period) / period, 2)
    measured = machine.sensor_matrix @ modes.T  # (sensors, motions)
    motion_gains = ((modes * mass) @ velocity_gains + (modes * damping) @ position_gains).T
    stiffness = np.sum(motion_gains * measured, axis=0)  # D l1 + M l2
    resistance = np.sum(((modes * mass) @ position_gains).T * measured, axis=0) + modes**2 @ damping
    first, second = (
        # It is 0 where nothing is measured.
        np.divide(values, stiffness, out=np.zeros_like(stiffness), where=stiffness > 0.0)
        for values in (resistance, modes**2 @ mass)
    )
    return _ObservedForces(motion_gains @ distribution, motion_gains, first, second, modes, distribution)


class FollowedRun(NamedTuple):
    """Motion of a machine along a run of n samples, corrected by the observer of 60 rad/s.

    Attributes:
        positions: Predicted positions, m or rad, shape (n, coordinates).
        velocities: Predicted velocities, m/s or rad/s, shape (n, coordinates).
        innovation: Measured minus predicted values, in the sensors' units, 0 where not measured,
            shape (n, sensors).
    """

    positions: Array
    velocities: Array
    innovation: Array


def follow_runs(machine: Machine, data: Dataset) -> list[FollowedRun]:
    """Predict all runs with the observer of 60 rad/s, from the starts that need the smallest corrections.

    Returns:
        Motion and innovations of each run, arrays of shape (n, ...) for a run of n samples, SI.
    """

    def of_run(run: PreparedRecording) -> FollowedRun:
        start = start_for_observer(machine, run, data)
        motion = predict(machine, run, SEARCH_BANDWIDTH, period=data.period, initial_state=start, states=True)
        innovation = _innovation(motion.readings, machine, run, start)[0]
        return FollowedRun(motion.positions[0], motion.velocities[0], innovation)

    return list(map_runs(of_run, data))


def missing_force(
    machine: Machine,
    data: Dataset,
    cutoff: float = _RESIDUAL_CUTOFF,
    *,
    followed: Sequence[FollowedRun] | None = None,
) -> dict[str, Array]:
    """Estimate the force that the model lacks along all runs, together with the motion.

    An observer corrects the prediction by the measurements. Above its bandwidth (60 rad/s), its correcting
    force lags behind the missing one and falls. Both are inverted; but as the inversion amplifies the noise
    of the sensors with the square of the frequency, the result is attenuated above a cut-off frequency,
    without phase lag.

    Args:
        data: Measured runs with n rows in total.
        cutoff: Cut-off frequency, Hz. Default: 30, for small periodic forces; narrow forces need more.
        followed: Predicted runs, if known. Default: result of `follow_runs`.

    Returns:
        By coordinate name, an array of shape (n, 3) with the columns position, velocity and missing force: m,
        m/s, N for a linear and rad, rad/s, Nm for a rotary coordinate. The force on a carriage is the one
        that does the same work as all corrections if only carriages have forces; that on a pulley, if only
        pulleys do.
    """
    observed = _observed_forces(machine, data.period)

    def of_run(run: PreparedRecording, motion: FollowedRun) -> Array:
        force = _inverted(motion.innovation @ observed.motion_gains, observed, run, data, cutoff)
        return np.stack([motion.positions, motion.velocities, force @ observed.distribution], axis=2)

    followed = follow_runs(machine, data) if followed is None else followed
    by_coordinate = np.concatenate(list(map(of_run, data.runs, followed)))  # (n, coordinates, 3)
    return {name: by_coordinate[:, i] for i, name in enumerate(machine.coordinate_names)}


def sensor_errors(machine: Machine, followed: Sequence[FollowedRun]) -> dict[str, Array]:
    """Return the position sensors' prediction errors beside the motion, after an observer's corrections.

    Errors that change faster than the bandwidth of the observer (60 rad/s; 25 rad/s of lasers beside
    encoders) are complete; the observer corrects slower errors.

    Args:
        followed: Runs predicted with the observer, n rows in total.

    Returns:
        By channel, an array of shape (n, 3) with the columns position and velocity of the coordinate that the
        sensor mainly measures, m, m/s or rad, rad/s, and measured minus predicted value, in the sensor's
        unit.
    """
    channels = {s.channel: j for j, s in enumerate(machine.sensors) if s.of_position}
    coordinates = [machine.coordinate_names.index(machine.sensors[j].coordinate) for j in channels.values()]
    by_channel = np.concatenate(  # (n, channels, 3)
        [
            np.stack(
                [
                    run.positions[:, coordinates],
                    run.velocities[:, coordinates],
                    run.innovation[:, list(channels.values())],
                ],
                axis=2,
            )
            for run in followed
        ]
    )
    return {channel: by_channel[:, k] for k, channel in enumerate(channels)}


def _inverted(
    correcting: Array, observed: _ObservedForces, run: PreparedRecording, data: Dataset, cutoff: float
) -> Array:
    """Return the missing force along each motion, N or Nm, from the correcting one, both (n, motions)."""
    correcting = _low_pass(correcting, cutoff, data.period)
    slope = np.gradient(correcting, run.time_s, axis=0)
    return correcting + observed.first * slope + observed.second * np.gradient(slope, run.time_s, axis=0)


def low_pass(values: Array, period: float) -> Array:
    """Filter a signal as the missing force is filtered: keep its part below 30 Hz, without phase lag.

    The result has the shape (n, k) and the unit of the signal.

    Args:
        values: Signal of any unit, one per column, shape (n, k).
        period: Sampling period, s.
    """
    return _low_pass(values, _RESIDUAL_CUTOFF, period)


def _low_pass(values: Array, cutoff: float, period: float) -> Array:
    """Return values (n, k) below a cut-off frequency, Hz, filtered without phase lag."""
    filtered: Array = signal.sosfiltfilt(_butterworth(min(0.9, 2 * cutoff * period)), values, axis=0)
    return filtered


@cache
def _butterworth(relative_cutoff: float) -> Array:
    """Return a second-order low-pass filter, with a cut-off frequency relative to half the sampling rate."""
    return np.asarray(signal.butter(2, relative_cutoff, output="sos"))
