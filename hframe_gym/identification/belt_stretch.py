"""Typical stretch and vibration of the belts when a run begins.

At rest, friction holds the stretch; in motion, the drives cause it. Encoders on pulleys measure the stretch and the
vibration in addition to the motion of the carriages.
"""

from __future__ import annotations

import numpy as np

from ..dynamics import stiffness_matrix
from ..machine import Machine

# Torques that typically stretch the belts: at rest, the part of the motors' Coulomb friction that a decaying vibration
# leaves; in motion, the part of the torque at rated voltage that does not accelerate the motors or overcome back-EMF.
_HELD_FRICTION, _MOVING_TORQUE = 0.2, 0.25
_SMALLEST_ANGLE = 1e-6  # rad; a motor that is declared without friction still has some


def stretch_angles(machine: Machine, *, moving: bool) -> dict[str, float]:
    """Return the typical difference between the angle of each pulley and that of unstretched belts.

    Args:
        machine: Machine; without belts the result is empty.
        moving: True if the run begins in motion (the drives stretch the belts), False at rest (friction holds the
            stretch).

    Returns:
        Angle, rad, by name of each rotary coordinate with belts and a sensor, and without a spring.
    """
    torques = {c.name: _HELD_FRICTION * c.coulomb for c in machine.coordinates}
    for drive in machine.drives if moving else ():
        torques[drive.coordinate] += _MOVING_TORQUE * abs(drive.gain) * drive.rated_voltage
    return {
        name: max(torques[name] / stiffness, _SMALLEST_ANGLE) for name, stiffness in _pulley_stiffness(machine).items()
    }


def vibration_speeds(machine: Machine) -> dict[str, float]:
    """Return the speeds with which the pulleys typically vibrate against the belts while the machine moves.

    The amplitude of the vibration is the stretch of the belts that a quarter of the drives' rated torque causes.

    Args:
        machine: Machine; without belts the result is empty.

    Returns:
        Amplitude times natural frequency of the pulley on its belts, rad/s, by name of each pulley with a sensor.
    """
    angles = stretch_angles(machine, moving=True)
    return {
        name: angles[name] * float(np.sqrt(stiffness / machine.coordinate(name).mass))
        for name, stiffness in _pulley_stiffness(machine).items()
    }


def _pulley_stiffness(machine: Machine) -> dict[str, float]:
    """Return the torque per angle, Nm/rad, by name of each pulley with a sensor; carriages and other motors are held.

    Pulleys without a sensor (idlers) turn with the belt, so that its division into sections does not matter.
    """
    if not machine.belts:
        return {}
    matrix = stiffness_matrix(machine)
    measured = {s.coordinate for s in machine.sensors}
    rotary = [i for i, c in enumerate(machine.coordinates) if c.kind == "rotary" and matrix[i, i] > 0.0]
    idlers = [i for i in rotary if machine.coordinates[i].name not in measured]
    stiffness = {}
    for i in rotary:
        coordinate = machine.coordinates[i]
        if i not in idlers and coordinate.name not in machine.spring_loaded:
            turning = matrix[np.ix_([i, *idlers], [i, *idlers])]
            if np.linalg.matrix_rank(turning) < len(turning):  # the pulley could turn the idlers without any stretch
                turning = matrix[i : i + 1, i : i + 1]
            stiffness[coordinate.name] = 1.0 / float(np.linalg.inv(turning)[0, 0])
    return stiffness
