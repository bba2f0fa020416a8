"""What templates say: their titles, and the comments that explain the fields of a new machine.json."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from ...machine import SENSOR_KINDS, summary


@dataclass(frozen=True)
class Template:
    """What a template adds to the built-in machine of the same name.

    Attributes:
        title: What the template is, for lists of templates.
        comment: How the coordinates are counted, for the file.
        coordinates: Comments by name of the coordinate; without one, it is the pulley of a motor.
        lengths: m of rest length of each belt section per m of travel along x and y: the frame grows with the
            travel, and with it the belts.
    """

    title: str
    comment: str
    coordinates: Mapping[str, str]
    lengths: Mapping[str, tuple[float, float]] = field(default_factory=dict)


_CARRIAGE = "The carriage. mass: everything that moves, plus gear_ratio^2 times the inertia of the rotor."
_SHAFT = (
    "What turns. mass: moment of inertia of everything that turns, "
    "plus gear_ratio^2 times that of the rotor. viscous: without the back-EMF, which follows from Ke. "
    "Optional: range, [lowest, highest] angle, rad."
)
_COREXY = {
    "x": "The carriage on the bridge. mass: everything that moves along x, i.e. carriage and tool.",
    "y": "The bridge. mass: everything that moves along y, i.e. bridge, carriage and tool.",
}
_COREXY_LENGTHS = {
    **dict.fromkeys(("belt1_short", "belt2_short"), (0.5, 0.5)),
    **dict.fromkeys(("belt1_long", "belt2_long"), (1.5, 1.5)),
}
#: Templates of `hframe machines new` by the name of their built-in machine.
TEMPLATES: dict[str, Template] = {
    "hframe": Template(
        "H-frame, one belt for both motors",
        "H-frame: one belt for both motors. With p = radius * phi: x = (p2 - p1) / 2 and y = -(p1 + p2) / 2.",
        {
            "x": "The bridge. mass: everything that moves along x, i.e. bridge, cart and tool.",
            "y": "The cart on the bridge. mass: everything that moves along y, i.e. cart and tool.",
        },
        {"left": (1.5, 0.5), "right": (1.5, 0.5), "bottom": (1.0, 1.0)},
    ),
    "corexy": Template(
        "CoreXY, a belt for each motor",
        "CoreXY: one belt per motor. With p = radius * phi: x = (p1 + p2) / 2 and y = (p1 - p2) / 2.",
        _COREXY,
        _COREXY_LENGTHS,
    ),
    "printer": Template(
        "CoreXY printer with stepper motors",
        "CoreXY printer: one belt per motor. With p = radius * phi: x = (p1 + p2) / 2 and y = (p1 - p2) / 2.",
        _COREXY,
        _COREXY_LENGTHS,
    ),
    "axis": Template(
        "One axis",
        "One axis: the motor moves the carriage directly, gear_ratio is "
        "the angle of its shaft per m of travel.",
        {"x": _CARRIAGE},
    ),
    "belt-axis": Template(
        "One axis with a belt",
        "Belt axis: a belt between the motor's pulley and an idler moves the carriage, x = radius * phi.",
        {"x": "The carriage. mass: everything that moves with it, without motor and pulley."},
        {"motor_side": (0.5, 0.0), "idler_side": (1.5, 0.0)},
    ),
    "xy-table": Template(
        "XY table, a motor for each direction",
        "XY table: each motor moves one axis directly, gear_ratio is the angle of its shaft per m of travel.",
        {
            "x": (
                "What moves along x, the y axis included. "
                "mass: plus gear_ratio^2 times the inertia of the rotor."
            ),
            "y": "What moves along y. mass: plus gear_ratio^2 times the inertia of the rotor.",
        },
    ),
    "motor": Template(
        "Motor",
        "A motor: angles count in the direction of a positive voltage. Without a range it may turn freely.",
        {"shaft": _SHAFT},
    ),
    "pendulum": Template(
        "Pendulum on a motor",
        "A pendulum: the effect `unbalance` is its weight, A sin(angle + p); it hangs at the angle 0.",
        {"arm": _SHAFT},
    ),
    "wheel": Template(
        "Wheel with a gear motor",
        "A wheel behind a gear motor: angles are those of the wheel, the recorded command is a duty cycle.",
        {"wheel": _SHAFT},
    ),
    "servo": Template(
        "Servo",
        "A servo: the recorded command is the angle that it shall take, and 0 is the middle of its range.",
        {"horn": _SHAFT},
    ),
}
PULLEY_COMMENT = (
    "The pulley of a motor, behind the gear. "
    "mass: moment of inertia of the pulley, plus gear_ratio^2 times that of the rotor. "
    "viscous: without the back-EMF, which follows from Ke. radius: pitch radius, teeth * pitch / (2 pi)."
)
BELT_COMMENT = (
    "A section of a belt. EA: force that would double its length. "
    "rest_length: its length with all coordinates at 0. extension: "
    "m of stretch per m of travel of each coordinate (1 or -1; a pulley's travel is radius * angle)."
)
DRIVE_COMMENTS = {  # by kind
    "voltage": (
        "A DC motor; channel is the column of its voltage in the recordings. Kt and Ke are equal in SI "
        "units. resistance: between the terminals, cables included. Optional: current_limit (A), delay "
        "(s), converter_bits, voltage_range (V)."
    ),
    "duty-cycle": (
        "A DC motor on a bridge; channel is the column of the duty cycle, -1 to 1, in the recordings. "
        "rated_voltage: the supply; supply: column of a measured one, V. Kt and Ke are equal in SI "
        "units. Optional: current_limit (A)."
    ),
    "current": (
        "A motor whose amplifier controls the current; channel is the column of the commanded current "
        "in the recordings, A. rated_current: largest command. Optional: bandwidth (Hz) of the "
        "amplifier, current_limit (A), delay (s)."
    ),
    "torque": (
        "A drive that controls the torque of the motor shaft; channel is the column of the commanded "
        "torque in the recordings, Nm. rated_torque: largest command. Optional: Kt (true per commanded "
        "torque), bandwidth (Hz)."
    ),
    "position": (
        "A drive that follows a commanded position; channel is its column in the recordings. Torque of "
        "the motor shaft: speed_gain * (speed wanted - speed), at most torque_limit; speed wanted: "
        "position_gain * (command - position), at most speed_limit. A stepper: position_gain * "
        "speed_gain = 50 * holding torque. Optional: integral_rate. rated_position: largest command of "
        "the environment. `hframe identify` estimates the gains."
    ),
    "stepper": (
        "A stepper motor; channel is the column of the angle to which its steps lead. Torque of the motor "
        "shaft: holding_torque * sin(periods * gear_ratio * (command - position)), with the holding torque "
        "at the current of the driver. Optional: periods, full steps per turn / 4 (50). Its damping belongs "
        "to viscous of its coordinate. rated_position: largest command of the environment, which needs a "
        "period of about 1 ms."
    ),
    "speed": (
        "A drive that follows a commanded speed; channel is its column in the recordings. Torque of the "
        "motor shaft: speed_gain * (command - speed + integral_rate * its integral), at most torque_limit. "
        "rated_speed: largest command of the environment. `hframe identify` estimates the gains."
    ),
}
_SENSOR_COMMENTS = {  # by kind
    "encoder": (
        "An incremental encoder. resolution: 2 pi / (4 * lines * gear_ratio) for one on the motor "
        "shaft; noise: 0 if it is below the resolution."
    ),
    "laser": (
        "A sensor with a fixed zero. noise: standard deviation at rest; resolution: 0 for an analog sensor."
    ),
}
_OTHER_SENSOR_COMMENT = (
    "noise: standard deviation at rest, 0 if it is unknown; resolution: 0 for an analog sensor."
)


def sensor_comment(kind: str) -> str:
    """Return the comment that explains a sensor of a registered kind in a new machine.json."""
    if kind in _SENSOR_COMMENTS:
        return _SENSOR_COMMENTS[kind]
    return f"{summary(SENSOR_KINDS.get(kind)).rstrip('.')}. {_OTHER_SENSOR_COMMENT}"
