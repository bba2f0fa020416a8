"""Typical stretch and vibration of the belts when a run begins.

At rest, friction holds the stretch; in motion, the drives cause it. Encoders on pulleys measure both beside the motion
of the carriages.
"""

from __future__ import annotations

import numpy as np

from ..machine import Machine

# Fraction of the motors' Coulomb friction that typically remains as belt tension when the stage has come to rest, and
# fraction of the torque at rated voltage that typically stretches the belts in motion.
_HELD_FRICTION, _MOVING_TORQUE = 0.1, 0.5
_SMALLEST_ANGLE = 1e-6  # rad; keeps the column of a motor without friction away from zero


def stretch_angles(machine: Machine, *, moving: bool) -> dict[str, float]:
    """Return the angles by which the stretch of the belts typically turns the pulleys at the beginning of a run.

    Args:
        machine: Machine with or without belts.
        moving: Whether the run begins in motion, in which the drives stretch the belts; otherwise friction does, at
            rest.

    Returns:
        Angle, rad, by name of each rotary coordinate with a sensor and without a spring; empty without belts.
    """
    if not machine.belts:
        return {}
    measured = {s.coordinate for s in machine.sensors}
    driven = {d.coordinate: _MOVING_TORQUE * abs(d.gain) * d.rated_voltage for d in machine.drives if moving}
    torques = {c.name: _HELD_FRICTION * c.coulomb + driven.get(c.name, 0.0) for c in machine.coordinates}
    return {
        c.name: max(torques[c.name] / c.radius**2 / _stiffness(machine), _SMALLEST_ANGLE)
        for c in machine.coordinates
        if c.kind == "rotary" and c.name in measured and c.name not in machine.spring_loaded
    }


def vibration_speeds(machine: Machine) -> dict[str, float]:
    """Return the speeds with which the pulleys typically vibrate against the belts while the machine moves.

    Args:
        machine: Machine with or without belts.

    Returns:
        Natural frequency times the angle by which the drives stretch the belts, rad/s, by name of each pulley with a
        sensor.
    """
    speeds = {}
    for name, angle in stretch_angles(machine, moving=True).items():
        pulley = machine.coordinate(name)
        speeds[name] = angle * float(np.sqrt(_stiffness(machine) * pulley.radius**2 / pulley.mass))
    return speeds


def _stiffness(machine: Machine) -> float:
    """Return the mean stiffness of the belt sections, N/m."""
    return float(np.mean([b.EA / b.rest_length for b in machine.belts]))
