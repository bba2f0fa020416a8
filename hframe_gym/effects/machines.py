"""Preset machines with an effect of the library."""

import dataclasses

from ..machine import ARM, BUILTIN_MACHINES, Machine
from .unbalance import EFFECT as UNBALANCE


def pendulum() -> Machine:
    """Return the preset `motor` with 0.1 kg at the end of an arm of 0.1 m, which hangs down at the angle 0.

    Returns:
        The preset `pendulum`: coordinate arm (rad), one drive of 12 V, sensor arm_rad, and the weight as the
        effect `unbalance`, A = -m g r.
    """
    mass, gravity = 0.1, 9.81  # kg, m/s^2
    motor = BUILTIN_MACHINES["motor"]()
    (shaft,), (drive,), (encoder,) = motor.coordinates, motor.drives, motor.sensors
    arm = dataclasses.replace(shaft, name="arm", mass=round(shaft.mass + mass * ARM**2, 6), viscous=1e-4)
    machine = motor.replace(
        name="pendulum",
        description="A pendulum on a DC motor: 0.1 kg at 0.1 m, hanging at the angle 0.",
        coordinates=(arm,),
        drives=(dataclasses.replace(drive, coordinate="arm"),),
        sensors=(dataclasses.replace(encoder, channel="arm_rad", row={"arm": 1.0}),),
    )
    return machine.with_effects(UNBALANCE.at("arm", A=round(-mass * gravity * ARM, 4), p=0.0))
