"""Convert the description of a rig to the parameters of the Euler simulator."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from tests.euler_simulator import parameter_table
from tests.euler_simulator.dynamics import FIELDS
from tests.reference_simulator import Array, Rig

# Fields of a rig that the Euler simulator has in another form. One that is neither here nor in `FIELDS` it
# lacks.
_CONVERTED = (
    "belt_damping_factor",
    "belt_energy_force",
    "belt_hardening",
    "belt_play_m",
    "belt_pretension_N",
    "emf_constant",
    "frame",
    "gear_ratio",
    "input_delay_s",
    "pulley_radius_m",
    "torque_constant",
    "yaw",
)
_YAW_DIVISORS = (
    "stribeck_velocity",
    "friction_wavelength",
    "hysteresis_travel",
    "dahl_travel",
    "catch_width",
)


def euler_parameters(rig: Rig) -> Array:
    """Return the parameters of the Euler simulator for a rig.

    Args:
        rig: The rig.

    Returns:
        Table of its parameters.

    Raises:
        ValueError: If the rig has an effect that the simulator lacks.
    """
    for name in {field.name for field in dataclasses.fields(rig)}.difference(FIELDS, _CONVERTED):
        if getattr(rig, name) != getattr(Rig(), name):
            raise ValueError(f"the Euler simulator has no {name}")
    if rig.frame and rig.frame.ground_friction:
        raise ValueError("the Euler simulator has no friction of the frame's ground")
    values: dict[str, Any] = {name: getattr(rig, name) for name in FIELDS if hasattr(rig, name)}
    for name in _YAW_DIVISORS:
        values[name] = (*values[name], 1.0)
    yaw, frame = rig.yaw, rig.frame
    values["mass"] = (*rig.mass, yaw.inertia if yaw else 1.0)
    values["viscous"] = (*rig.viscous, yaw.viscous if yaw else 0.0)
    values["spring_stiffness"] = (*rig.spring_stiffness, yaw.stiffness if yaw else 0.0)
    values["belt_damping_s"] = rig.belt_damping_s * np.array(rig.belt_damping_factor)
    values["torque_per_ampere"] = rig.gear_ratio * np.array(rig.torque_constant)
    values["emf_per_speed"] = rig.gear_ratio * np.array(rig.emf_constant)
    return parameter_table(
        **values,
        radius_m=rig.pulley_radius_m,
        half_width_m=yaw.half_width_m if yaw else 0.0,
        play_m=rig.belt_play_m,
        pretension_N=rig.belt_pretension_N,
        hardening=rig.belt_hardening,
        energy_force=float(rig.belt_energy_force),
        frame_rate=2.0 * np.pi * frame.hertz if frame else 0.0,
        frame_damping=frame.damping if frame else 0.0,
        frame_ratio=frame.mass_ratio if frame else 0.0,
    )
