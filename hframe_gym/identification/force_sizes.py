"""Sizes of forces during recordings: of effects, of the drives, and of what a fitted model lacks."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ..dynamics import net_forces
from ..machine import AppliedEffect, Machine
from .dataset import Dataset, PreparedRecording
from .estimation import Fit
from .model_error import BANDWIDTHS, search_step
from .prediction import SEARCH_BANDWIDTH, map_runs, observer_gains, predict, prediction_error

Array = NDArray[np.float64]


def effect_force(machine: Machine, effect: AppliedEffect, data: Dataset) -> float:
    """Return the root mean square force that an effect adds to a machine during the recordings.

    Args:
        machine: Machine with or without the effect; the motion is predicted without it.
        effect: Effect (deviation from the nominal model) whose force is evaluated.
        data: Runs (times, voltages, measurements) over which the machine is predicted.

    Returns:
        Root mean square over all rows of the root sum of squares over the coordinates, as a force at the belt (torque /
        pulley radius), N; infinite for an effect that adds coordinates or changes a measurement: no force describes it.
    """
    if effect.definition.structure or effect.definition.measurement or effect.definition.measurement_delay:
        return np.inf
    without = machine.replace(effects=tuple(e for e in machine.effects if e.label != effect.label))
    return force_difference(without, without.with_effects(effect), data)


def force_difference(first: Machine, second: Machine, data: Dataset) -> float:
    """Return the root mean square difference between the forces of two machines along the same motion.

    If the second machine has one more effect (deviation from the nominal model) and was refitted, this is the part of
    the effect's force that other values of the first machine's parameters cannot reproduce.

    Args:
        first: Machine whose predicted motion is used.
        second: Machine with the same coordinates.
        data: Runs over which the motion is predicted (times, voltages, measurements, SI).

    Returns:
        Root mean square over all rows of the root sum of squares over the coordinates, as a force at the belt (torque /
        pulley radius), N.
    """

    def of_run(run: PreparedRecording) -> Array:
        motion = predict(first, run, SEARCH_BANDWIDTH, period=data.period, states=True)
        record = (run.time_s, motion.positions[0], motion.velocities[0], run.inputs)
        change: Array = net_forces(second, *record) - net_forces(first, *record)
        return change.reshape(-1, len(first.coordinates)) / first.travel_per_unit

    return force_size(np.concatenate(list(map_runs(of_run, data))))


def drive_force(machine: Machine, data: Dataset) -> float:
    """Return the root mean square force that the voltages of the recordings cause in the drives, without back-EMF.

    Args:
        machine: Machine with its drives.
        data: Runs with the voltages.

    Returns:
        Root mean square over all rows of the root sum of squares over the drives, as a force at the belt (torque /
        pulley radius), N.
    """
    gains = [drive.gain / machine.coordinate(drive.coordinate).travel_per_unit for drive in machine.drives]
    return force_size(np.concatenate([run.inputs for run in data.runs]) * gains)


def force_size(force: Array) -> float:
    """Return the root mean square over time of a force with several components.

    Args:
        force: Forces at n samples, N, shape (n, coordinates).

    Returns:
        Root mean square over the samples of the root sum of squares over the coordinates, N.
    """
    return float(np.sqrt(np.mean(np.sum(force**2, axis=1))))


def residue_force(fitted: Fit, data: Dataset) -> float:
    """Return the root mean square force that a fitted model lacks during the recordings.

    An observer corrects the predicted velocities by the measurements. These corrections, divided by the sampling period
    and times the mass, are forces. The part of them that the sensors' noise causes is subtracted.

    Args:
        fitted: Fitted machine with its observer bandwidth; a fit in simulation is observed with 3 rad/s.
        data: Runs that were fitted (times, voltages, measurements, SI).

    Returns:
        Root mean square over all rows of the root sum of squares over the coordinates, as a force at the belt (torque /
        pulley radius), N.
    """
    machine = fitted.machine
    bandwidth = max(fitted.bandwidth, BANDWIDTHS[-2])  # the narrowest observer measures it where none is needed
    velocity_gains = observer_gains(machine, data.period, bandwidth)[len(machine.coordinates) :]
    mass = np.array([c.mass for c in machine.coordinates])
    # Velocity correction per sample -> acceleration -> force at the belt, per unit of each sensor's innovation.
    force_gains = velocity_gains.T / data.period * mass / machine.travel_per_unit  # (sensors, coordinates)

    def of_run(run: PreparedRecording) -> tuple[Array, Array]:
        motion = predict(machine, run, bandwidth, period=data.period, longest_step=search_step(bandwidth))
        innovation = np.nan_to_num(prediction_error(run, data, motion.readings)[0])  # (n, sensors)
        return innovation @ force_gains, np.sqrt((np.isfinite(run.outputs) * run.noise**2) @ force_gains**2)

    correction, noise = (np.concatenate(part) for part in zip(*map_runs(of_run, data), strict=True))
    return math.sqrt(max(force_size(correction) ** 2 - force_size(noise) ** 2, 0.0))
