"""Stretch of the belts when a run begins: at rest by forces and friction, in motion by the drives.

Encoders on pulleys measure the stretch in addition to the motion of the carriages. Forces of effects, such as
cables, stretch the belts by an amount that a machine predicts. What static friction holds beyond that differs
from run to run, and only its typical size is known.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ...arrays import Array
from ...dynamics import effect_forces, stiffness_matrix
from ...machine import Machine, pulley_names, rest_state

# Torques that typically stretch the belts: at rest, the part of the motors' Coulomb friction that a decaying
# vibration leaves; in motion, the part of the torque at rated voltage that does not accelerate the motors or
# overcome back-EMF.
_HELD_FRICTION, _MOVING_TORQUE = 0.2, 0.25
_SMALLEST_ANGLE = 1e-6  # rad; a motor that is declared without friction still has some


def linear_coordinates(machine: Machine) -> NDArray[np.bool_]:
    """Mark the linear coordinates of a machine (carriages).

    Returns:
        True for linear, False for rotary coordinates, shape (coordinates,).
    """
    return np.array([c.kind == "linear" for c in machine.coordinates])


def static_equilibrium(machine: Machine, positions: Array) -> Array:
    """Compute the pulleys' angles at rest from carriage positions, with belts that forces may stretch.

    Effects such as cables and tilt exert forces at rest. Static friction carries such a force up to the
    Coulomb level. A larger force has displaced the carriage, which is assumed to rest at the far end of its
    first swing: there the belts carry twice the force in excess of the Coulomb level, but at most the entire
    force.

    Args:
        positions: Positions in one or several runs, m or rad, shape (..., coordinates); only linear
            coordinates (carriages) are used. Coordinates that structural effects added, the last ones, may be
            missing.

    Returns:
        Positions of all coordinates, m or rad, shape (..., coordinates): for the carriages, those in
        `positions`; for all others, also those that may be missing, the positions without stretch
        (`rest_state`), from which pulleys turn by the smallest angles at which the belts carry the forces.
    """
    names = machine.coordinate_names
    linear, pulleys = linear_coordinates(machine), np.isin(names, pulley_names(machine))
    carriages = positions[..., : len(names)][..., linear[: positions.shape[-1]]]
    flat = carriages.reshape(math.prod(carriages.shape[:-1]), carriages.shape[-1])  # (runs, carriages)
    at_rest = np.array([rest_state(machine, q, leading=len(q))[: len(names)] for q in flat])
    if any(e.definition.force for e in machine.effects):
        forces = _forces_at_rest(machine, at_rest)[:, linear]  # N, (runs, carriages)
        friction = np.array([c.coulomb for c in machine.coordinates])[linear]
        # The belts carry twice the force in excess of friction, but at most the entire force.
        carried = np.sign(forces) * np.clip(2.0 * (np.abs(forces) - friction), 0.0, np.abs(forces))
        stretched = np.any(carried != 0.0, axis=1)
        stiffness = stiffness_matrix(machine, at_rest[stretched])[:, linear][:, :, pulleys]  # N/rad
        # The pulleys turn by the smallest angles at which the belts carry these forces.
        for run, matrix in zip(np.flatnonzero(stretched), stiffness, strict=True):
            at_rest[run, pulleys] += np.linalg.lstsq(matrix, carried[run], rcond=None)[0]
    return at_rest.reshape(*carriages.shape[:-1], len(names))


def _forces_at_rest(machine: Machine, positions: Array) -> Array:
    """Return the effects' force on each coordinate at rest, N or Nm, shape (runs, coordinates)."""
    motion = np.repeat(positions[:, None], 2, axis=1)  # two equal samples of each run
    inputs = np.zeros((2, len(machine.drives)))
    forces = effect_forces(machine, np.array([0.0, 1e-3]), motion, np.zeros_like(motion), inputs)
    return np.broadcast_to(forces, motion.shape)[:, 0]


def max_held_angle(machine: Machine) -> Array:
    """Return how far from equilibrium static friction can hold each pulley of a machine with belts.

    This is a generous estimate: 2 F / (k r) with the Coulomb friction F of all coordinates together, as a
    force at the belt, the mean stiffness k of the belts and the radius r of the pulley.

    Returns:
        Largest deviation of the pulley's angle at each sensor, rad, shape (sensors,); 0 for sensors on linear
        coordinates.
    """
    friction = sum(c.coulomb / c.travel_per_unit for c in machine.coordinates)  # N, as a force at the belt
    stiffness = float(np.mean([b.EA / b.rest_length for b in machine.belts]))  # N/m
    coordinates = [machine.coordinate(machine.coordinate_of_sensor(s)) for s in machine.sensors]
    return np.array([2 * friction / stiffness / c.radius if c.kind == "rotary" else 0.0 for c in coordinates])


def stretch_angles(machine: Machine, *, moving: bool) -> dict[str, float]:
    """Return the typical angle by which belt stretch turns each pulley at the start of a run.

    It is the standard deviation of the unknown initial angle, relative to unstretched belts: a typical torque
    divided by the rotational stiffness of the belts at the pulley.

    Args:
        machine: Machine; without belts the result is empty.
        moving: False for a run that begins at rest: the torque is 20 % of the pulley's Coulomb friction. True
            for one that begins in motion: 25 % of the drive's torque at rated voltage is added.

    Returns:
        Angle, rad, at least 1e-6, by name of each pulley with a sensor; those in `Machine.spring_loaded` are
        left out.
    """
    torques = {c.name: _HELD_FRICTION * c.coulomb for c in machine.coordinates}
    for drive in machine.drives if moving else ():
        torques[drive.coordinate] += _MOVING_TORQUE * abs(drive.gain) * drive.rated_voltage
    return {
        name: max(torques[name] / stiffness, _SMALLEST_ANGLE)
        for name, stiffness in _pulley_stiffness(machine).items()
    }


def vibration_speeds(machine: Machine) -> dict[str, float]:
    """Return the typical speed amplitude with which each pulley vibrates on its belts in a moving machine.

    It is the standard deviation of the pulley's unknown velocity at the start of a run that begins in motion.

    Args:
        machine: Machine; without belts the result is empty.

    Returns:
        Speed, rad/s, by name of each pulley with a sensor: the angle `stretch_angles(machine, moving=True)`,
        rad, times the natural angular frequency of the pulley on its belts, 1/s. Those in
        `Machine.spring_loaded` are left out.
    """
    angles = stretch_angles(machine, moving=True)
    return {
        name: angles[name] * float(np.sqrt(stiffness / machine.coordinate(name).mass))
        for name, stiffness in _pulley_stiffness(machine).items()
    }


def _pulley_stiffness(machine: Machine) -> dict[str, float]:
    """Return the torque per angle, Nm/rad, by pulley with a sensor; carriages and other motors are held.

    Pulleys without a sensor (idlers) turn with the belt, so that its division into sections does not matter.
    """
    if not machine.belts:
        return {}
    matrix = stiffness_matrix(machine)
    measured = {s.coordinate for s in machine.sensors if s.of_position}
    pulleys = [machine.coordinate_names.index(name) for name in pulley_names(machine)]
    stretching = [i for i in pulleys if matrix[i, i] > 0.0]
    idlers = [i for i in stretching if machine.coordinates[i].name not in measured]
    stiffness = {}
    for i in stretching:
        if i in idlers:
            continue
        turning = matrix[np.ix_([i, *idlers], [i, *idlers])]
        # The pulley could turn the idlers without any stretch.
        if np.linalg.matrix_rank(turning) < len(turning):
            turning = matrix[i : i + 1, i : i + 1]
        stiffness[machine.coordinates[i].name] = 1.0 / float(np.linalg.inv(turning)[0, 0])
    return stiffness
