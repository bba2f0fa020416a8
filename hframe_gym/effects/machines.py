"""Preset machines with an effect of the library."""

import math

from ..machine import ARM, Coordinate, Drive, Machine, Sensor
from .unbalance import EFFECT as UNBALANCE


def pendulum() -> Machine:
    """Return a pendulum on a motor: 0.1 kg at the end of an arm of 0.1 m, which hangs down at the angle 0.

    Returns:
        The preset `pendulum`: coordinate arm (rad), one drive of 12 V, sensor arm_rad, and the weight as the effect
        `unbalance`, A = -m g r.
    """
    mass, gravity = 0.1, 9.81  # kg, m/s^2
    machine = Machine(
        name="pendulum",
        description="A pendulum on a DC motor: 0.1 kg at 0.1 m, hanging at the angle 0.",
        coordinates=(Coordinate("arm", mass=1.02e-3, viscous=1e-4, coulomb=3e-3, kind="rotary", radius=ARM),),
        belts=(),
        drives=(
            Drive(
                "motor", "v_V", "arm", Kt=0.05, Ke=0.05, resistance=1.0, gear_ratio=1.0, rated_voltage=12.0
            ),
        ),
        sensors=(Sensor("arm_rad", {"arm": 1.0}, resolution=2 * math.pi / (4 * 500), kind="encoder"),),
    )
    return machine.with_effects(UNBALANCE.at("arm", A=round(-mass * gravity * ARM, 4), p=0.0))
