"""Sizes of forces during recordings: of effects, of the drives, and of what a fitted model lacks.

What a model lacks is measured in two ways: `residue_force` by the corrections of an observer, and
`inverse_dynamics.force_error` by comparing the force of the drives with the one that the model needs.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from ...arrays import Array
from ...dynamics import net_forces
from ...machine import AppliedEffect, Machine
from ...preparation.dataset import Dataset, PreparedRecording
from ...robust_statistics import white_noise
from ..fit.estimation import Fit
from ..fit.model_error import BANDWIDTHS, search_step
from ..predict.prediction import (
    SEARCH_BANDWIDTH,
    map_runs,
    observer_gains,
    predict,
    prediction_error,
    residuals,
    whitened,
)
from ..predict.start_uncertainty import (
    effect_state_spreads,
    predict_with_displaced_starts,
    probable_amounts,
    uncertain_starts,
)


def effect_force(machine: Machine, effect: AppliedEffect, data: Dataset) -> float:
    """Return the root mean square force that an effect adds to a machine during the recordings.

    The motion is predicted without the effect.

    Args:
        machine: Machine with the effect or without it.
        effect: The effect with its parameters.
        data: Recordings, prepared.

    Returns:
        Force at the belt (torque / pulley radius), N, as `force_size`; infinite for an effect that adds
        coordinates or changes a measurement or the clock.
    """
    definition = effect.definition
    if definition.structure or definition.measurement or definition.measurement_delay or definition.clock:
        return np.inf
    without = machine.replace(effects=tuple(e for e in machine.effects if e.label != effect.label))
    return force_difference(without, without.with_effects(effect), data)


def force_difference(first: Machine, second: Machine, data: Dataset) -> float:
    """Return the root mean square difference between the forces of two machines along the same motion.

    If the second machine has one more effect and was refitted, this is the part of the effect's force that
    other values of the first machine's parameters cannot reproduce.

    Args:
        first: Machine whose predicted motion is used.
        second: Machine with the same coordinates.

    Returns:
        Force at the belt (torque / pulley radius), N, as `force_size`.
    """

    def of_run(run: PreparedRecording) -> Array:
        motion = predict(first, run, SEARCH_BANDWIDTH, period=data.period, states=True)
        record = (run.time_s, motion.positions[0], motion.velocities[0], run.inputs)
        change: Array = net_forces(second, *record) - net_forces(first, *record)
        return change.reshape(-1, len(first.coordinates)) / first.travel_per_unit

    return force_size(np.concatenate(list(map_runs(of_run, data))))


def drive_force(machine: Machine, data: Dataset) -> float:
    """Return the root mean square force that the recorded voltages cause in the drives, without back-EMF.

    It is the force at the belt (torque / pulley radius), N, as `force_size`.
    """
    gains = [drive.gain / machine.coordinate(drive.coordinate).travel_per_unit for drive in machine.drives]
    return force_size(np.concatenate([run.inputs for run in data.runs]) * gains)


def force_size(force: Array) -> float:
    """Return the root mean square magnitude of forces.

    Args:
        force: Forces at the belt, N, shape (n, coordinates); each row is one vector.

    Returns:
        Magnitude, N.
    """
    return float(np.sqrt(np.mean(np.sum(force**2, axis=1))))


def residue_force(fitted: Fit, data: Dataset, *, noise_of_motion: bool = False) -> float:
    """Return the root mean square force that a fitted model lacks during the recordings.

    An observer corrects the predicted velocities by the measurements. The lacking force is mass * correction
    / sampling period. The mean square that the sensors' noise causes is subtracted from its mean square.

    Args:
        fitted: Fitted machine with its observer bandwidth. For a fit in simulation (0), an observer of 3
            rad/s is used.
        noise_of_motion: Whether the noise of each sensor is at least that of its prediction errors, from
            their third differences, which a force hardly changes. Some hundred rows at rest tell the noise
            within a few percent only, and the force that it causes may be far larger than the lacking one.

    Returns:
        Force at the belt (torque / pulley radius), N, as `force_size`.
    """
    # The narrowest observer measures it where none is needed.
    bandwidth = max(fitted.bandwidth, BANDWIDTHS[-2])
    return _observed_force(
        fitted.machine, data, bandwidth, lambda run: run.noise, noise_of_motion=noise_of_motion
    )


def lacking_force(machine: Machine, data: Dataset) -> float | None:
    """Return the rms force that a machine lacks during recordings, relative to the force of the drives.

    It is the force of `residue_force` for the widest observer, which tolerates any error of the machine. Only
    the noise of the sensors at rest is subtracted: jitter of the clock is an estimate from the motion, and an
    error of the model or a sensor that repeats its measurements may be mistaken for it.

    Args:
        data: Runs, for example held-out ones.

    Returns:
        Ratio of root mean squares, dimensionless; infinite if no voltage is applied or the machine diverges;
        None if no sensor shows the direction of a motion, so that no observer can correct a prediction.
    """
    if not machine.shows_direction:
        return None
    force = _observed_force(
        machine, data, SEARCH_BANDWIDTH, lambda run: np.broadcast_to(data.noise, run.noise.shape)
    )
    drives = drive_force(machine, data)
    return force / drives if drives > 0.0 and math.isfinite(force) else math.inf


def _observed_force(
    machine: Machine,
    data: Dataset,
    bandwidth: float,
    noise_of: Callable[[PreparedRecording], Array],
    *,
    noise_of_motion: bool = False,
) -> float:
    """Return the rms force of an observer's corrections, N, beyond what noise (n, sensors) causes."""
    velocity_gains = observer_gains(machine, data.period, bandwidth)[len(machine.coordinates) :]
    mass = np.array([c.mass for c in machine.coordinates])
    # Velocity correction per sample -> acceleration -> force at the belt, per unit of each sensor's
    # innovation.
    force_gains = velocity_gains.T / data.period * mass / machine.travel_per_unit  # (sensors, coordinates)

    remembers = bool(np.any(effect_state_spreads(machine) > 0.0))

    def of_run(run: PreparedRecording) -> tuple[Array, Array]:
        errors = _errors_from_probable_start if remembers else _errors
        innovation = np.nan_to_num(errors(machine, run, data, bandwidth))
        return innovation, np.isfinite(run.outputs) * noise_of(run)  # (n, sensors) each

    runs = list(map_runs(of_run, data))
    factors = _noise_factors(runs) if noise_of_motion else 1.0
    innovation, noise = (np.concatenate(part) for part in zip(*runs, strict=True))
    noise_force = np.sqrt((factors * noise) ** 2 @ force_gains**2)
    square = force_size(innovation @ force_gains) ** 2 - force_size(noise_force) ** 2
    return math.sqrt(max(square, 0.0)) if math.isfinite(square) else math.inf


def _noise_factors(runs: Sequence[tuple[Array, Array]]) -> Array:
    """Return by what factor the noise of prediction errors exceeds the known one, at least 1, (sensors,).

    Args:
        runs: Errors and known noise of each run, 0 where not measured, in the sensors' units, shape
            (n, sensors) each.
    """
    factors = []
    for j in range(runs[0][0].shape[1]):
        known = [noise[:, j] > 0.0 for _, noise in runs]
        relative = [
            errors[rows, j] / noise[rows, j] for (errors, noise), rows in zip(runs, known, strict=True)
        ]
        factors.append(max(1.0, white_noise(relative, 3)))
    return np.array(factors)


def _errors(machine: Machine, run: PreparedRecording, data: Dataset, bandwidth: float) -> Array:
    """Return measured minus predicted values, in the sensors' units, shape (n, sensors)."""
    motion = predict(machine, run, bandwidth, period=data.period, longest_step=search_step(bandwidth, data))
    return np.asarray(prediction_error(run, data, motion.readings)[0])


def _errors_from_probable_start(
    machine: Machine, run: PreparedRecording, data: Dataset, bandwidth: float
) -> Array:
    """Return the same for a machine with effects that remember the time before, from a fit's start.

    Otherwise the heat of a winding at the start, say, would act throughout the run as a force that the model
    lacks.
    """
    start = uncertain_starts(machine, [run])[run.name]
    motion = predict_with_displaced_starts(
        machine, run, bandwidth, start, period=data.period, longest_step=search_step(bandwidth, data)
    )
    errors = prediction_error(run, data, motion.readings)
    residual = whitened(residuals(run, data, motion.readings), run, bandwidth)
    amounts = probable_amounts(residual[0], residual[1:], start.differences)
    return np.asarray(errors[0] + np.tensordot(amounts / start.differences, errors[1:] - errors[0], axes=1))
