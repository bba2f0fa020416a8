"""Typical motors without a stage, as templates for other machines: motor, wheel and servo."""

from __future__ import annotations

import math

from ..axis_unit import ARM
from ..components import Coordinate, Drive, Sensor
from ..machine import Machine


def motor() -> Machine:
    """Return a DC motor with an encoder, without a load.

    Returns:
        The preset `motor`: coordinate shaft (rad), one drive of 12 V, sensor shaft_rad.
    """
    return Machine(
        name="motor",
        description="A DC motor with an encoder of 500 lines, driven by a voltage.",
        coordinates=(Coordinate("shaft", mass=2e-5, viscous=1e-5, coulomb=3e-3, kind="rotary", radius=ARM),),
        belts=(),
        drives=(
            Drive(
                "motor", "v_V", "shaft", Kt=0.05, Ke=0.05, resistance=1.0, gear_ratio=1.0, rated_voltage=12.0
            ),
        ),
        sensors=(Sensor("shaft_rad", {"shaft": 1.0}, resolution=2 * math.pi / (4 * 500), kind="encoder"),),
    )


def wheel() -> Machine:
    """Return a wheel of a small mobile robot, on a gear motor whose H-bridge takes a duty cycle.

    The wheel has a radius of 35 mm and carries half of a robot of 1 kg, 6e-4 kg m^2 of the inertia; the
    rotor's inertia counts 900 times.

    Returns:
        The preset `wheel`: coordinate wheel (rad), one drive of the kind "duty-cycle" with a supply of 6 V
        and a gear of 30:1, sensor wheel_rad, an encoder of 3 lines on the motor.
    """
    gear = 30.0
    return Machine(
        name="wheel",
        description="A wheel of a mobile robot: gear motor, duty cycle, encoder on the motor.",
        coordinates=(Coordinate("wheel", mass=1e-3, viscous=5e-4, coulomb=0.03, kind="rotary", radius=ARM),),
        belts=(),
        drives=(
            Drive(
                "motor",
                "duty",
                "wheel",
                Kt=6e-3,
                Ke=6e-3,
                resistance=3.0,
                gear_ratio=gear,
                rated_voltage=6.0,
                kind="duty-cycle",
            ),
        ),
        sensors=(
            Sensor("wheel_rad", {"wheel": 1.0}, resolution=2 * math.pi / (4 * 3 * gear), kind="encoder"),
        ),
    )


def servo() -> Machine:
    """Return a hobby servo with an arm: it follows a commanded angle, and a sensor measures the angle.

    Returns:
        The preset `servo`: coordinate horn (rad), range +-90 degrees, one drive of the kind "position" with
        at most 0.2 Nm and 10 rad/s at the horn, sensor horn_rad with a known zero.
    """
    return Machine(
        name="servo",
        description="A hobby servo that follows a commanded angle.",
        coordinates=(
            Coordinate(
                "horn", mass=2e-4, viscous=1e-3, coulomb=0.01, kind="rotary", radius=ARM, range=(-1.57, 1.57)
            ),
        ),
        belts=(),
        drives=(
            Drive(
                "servo",
                "command_rad",
                "horn",
                Kt=1.0,
                Ke=0.0,
                resistance=1.0,
                gear_ratio=1.0,
                rated_voltage=1.57,
                kind="position",
                law_parameters={
                    "position_gain": 20.0,
                    "speed_limit": 10.0,
                    "speed_gain": 0.02,
                    "torque_limit": 0.2,
                },
            ),
        ),
        sensors=(Sensor("horn_rad", {"horn": 1.0}, noise=1e-3, resolution=1.5e-3, kind="laser"),),
    )
