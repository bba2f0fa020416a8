"""New machines from templates: a built-in machine with other values, and comments on the fields of its file."""

from __future__ import annotations

import dataclasses
import difflib
import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ...arrays import Array
from ...errors import InputError, suggestion
from ...files import write_text
from ...machine import (
    BUILTIN_MACHINES,
    DRIVE_KINDS,
    RADIANS,
    SENSED_QUANTITIES,
    SENSOR_KINDS,
    Drive,
    Machine,
    Sensor,
    rest_positions_per_axis,
    summary,
)
from ...operating_system import quoted
from ...registry import load_plugins
from .machine_json import machine_to_dict
from .reader import MachineReader
from .schema import MachineFile

_QUADRATURE = 4  # edges per line of an encoder
_LINE = 100  # characters of a line of the file, comments excepted
# Beginning of the columns of commands, by the kinds of drives that a DC motor may have; they end in the unit.
_COMMANDS = {
    "voltage": "v",
    "duty-cycle": "duty",
    "current": "i",
    "torque": "torque",
    "position": "command",
    "speed": "command",
}
# Loop of a drive that follows a set point. Its speed follows with 100 1/s (16 Hz), below the belt modes of small
# stages; the other corner frequencies are a quarter and a fifth of it, as is usual (Ellis 2012, Control System
# Design Guide).
_SPEED_BANDWIDTH, _INTEGRAL_RATE, _POSITION_GAIN = 100.0, 25.0, 20.0  # 1/s
# What a DC motor has at rest at its rated voltage: A, Nm.
_AT_REST: dict[str, Callable[[Drive], float]] = {
    "current": lambda drive: drive.rated_voltage / drive.resistance,
    "torque": lambda drive: drive.Kt * drive.rated_voltage / drive.resistance,
}
_LONGEST = {
    "travel": 20.0,
    "pulley_radius": 1.0,
    "travel_per_turn": 1.0,
}  # m; larger values are refused, they are in millimeters


@dataclass(frozen=True)
class Template:
    """What a template adds to the built-in machine of the same name.

    Attributes:
        comment: How the coordinates are counted, for the file.
        coordinates: Comments by name of the coordinate; without one, it is the pulley of a motor.
        lengths: m of rest length of each belt section per m of travel along x and y: the frame grows with the travel,
            and with it the belts.
    """

    title: str
    comment: str
    coordinates: Mapping[str, str]
    lengths: Mapping[str, tuple[float, float]] = field(default_factory=dict)


_CARRIAGE = "The carriage. mass: everything that moves, plus gear_ratio^2 times the inertia of the rotor."
_SHAFT = (
    "What turns. mass: moment of inertia of everything that turns, plus gear_ratio^2 times that of the rotor. viscous: "
    "without the back-EMF, which follows from Ke. Optional: range, [lowest, highest] angle, rad."
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
        "One axis: the motor moves the carriage directly, gear_ratio is the angle of its shaft per m of travel.",
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
            "x": "What moves along x, the y axis included. mass: plus gear_ratio^2 times the inertia of the rotor.",
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
_MEASURED = "Does a sensor measure {} directly?"
_PULLEY_COMMENT = (
    "The pulley of a motor, behind the gear. mass: moment of inertia of the pulley, plus gear_ratio^2 times that of "
    "the rotor. viscous: without the back-EMF, which follows from Ke. radius: pitch radius, teeth * pitch / (2 pi)."
)
_BELT_COMMENT = (
    "A section of a belt. EA: force that would double its length. rest_length: its length with all coordinates at 0. "
    "extension: m of stretch per m of travel of each coordinate (1 or -1; a pulley's travel is radius * angle)."
)
_DRIVE_COMMENT = (
    "A DC motor; channel is the column of its voltage in the recordings. Kt and Ke are equal in SI units. resistance: "
    "between the terminals, cables included. Optional: current_limit (A), delay (s), converter_bits, voltage_range (V)."
)
_DUTY_COMMENT = (
    "A DC motor on a bridge; channel is the column of the duty cycle, -1 to 1, in the recordings. rated_voltage: the "
    "supply; supply: column of a measured one, V. Kt and Ke are equal in SI units. Optional: current_limit (A)."
)
_SET_POINT_COMMENT = (
    "A drive that follows a commanded position; channel is its column in the recordings. Torque of the motor shaft: "
    "speed_gain * (speed wanted - speed), at most torque_limit; speed wanted: position_gain * (command - position), at "
    "most speed_limit. A stepper: position_gain * speed_gain = 50 * holding torque. Optional: integral_rate. "
    "rated_position: largest command of the environment. `hframe identify` estimates the gains."
)
_SPEED_COMMENT = (
    "A drive that follows a commanded speed; channel is its column in the recordings. Torque of the motor shaft: "
    "speed_gain * (command - speed + integral_rate * its integral), at most torque_limit. rated_speed: "
    "largest command of the environment. `hframe identify` estimates the gains."
)
_CURRENT_COMMENT = (
    "A motor whose amplifier controls the current; channel is the column of the commanded current in the recordings, "
    "A. rated_current: largest command. Optional: bandwidth (Hz) of the amplifier, current_limit (A), delay (s)."
)
_TORQUE_COMMENT = (
    "A drive that controls the torque of the motor shaft; channel is the column of the commanded torque in the "
    "recordings, Nm. rated_torque: largest command. Optional: Kt (true per commanded torque), bandwidth (Hz)."
)
_ENCODER_COMMENT = (
    "An incremental encoder. resolution: 2 pi / (4 * lines * gear_ratio) for one on the motor shaft; noise: 0 if it is "
    "below the resolution."
)
_DRIVE_COMMENTS = {
    "voltage": _DRIVE_COMMENT,
    "duty-cycle": _DUTY_COMMENT,
    "current": _CURRENT_COMMENT,
    "torque": _TORQUE_COMMENT,
    "position": _SET_POINT_COMMENT,
    "speed": _SPEED_COMMENT,
}
_LASER_COMMENT = (
    "A sensor with a fixed zero. noise: standard deviation at rest; resolution: 0 for an analog sensor."
)
_OTHER_SENSOR_COMMENT = (
    "noise: standard deviation at rest, 0 if it is unknown; resolution: 0 for an analog sensor."
)


@dataclass(frozen=True)
class MachineOptions:
    """Values in which a new machine differs from its template; None keeps the template's value.

    Attributes:
        travel: Length of the workspace along x and y (an axis: along x only), m.
        mass: Moving masses along x and y (an axis: along x only), kg; of a rotary axis the moment of inertia, kg m^2.
        pulley_radius: Pitch radius of the motors' pulleys, m. With the template "axis", the gear ratio of the drive
            (rad of the motor per m) becomes gear_ratio / pulley_radius, where a `gear_ratio` of None counts as 1.
        travel_per_turn: In place of `pulley_radius` where the motor moves a carriage directly: travel per turn, m; the
            lead of a screw, 2 pi times the radius of a pulley.
        gear_ratio: Turns of the motor per turn of the pulley or screw. With the template "axis" and without either of
            both: angle of the motor per travel of the carriage, rad/m.
        rotor_inertia: Moment of inertia of a motor's rotor, kg m^2. gear_ratio^2 * rotor_inertia replaces the moment of
            inertia of the driven pulleys; it is added to the mass of a carriage or shaft that the motor moves directly.
        Kt: Torque constant of the motors, Nm/A; Ke becomes the same, in Vs/rad.
        resistance: Resistance of the motors, ohm.
        rated_voltage: Rated voltage of the motors, V.
        encoder_lines: Lines of the encoders on the motor shafts, read in quadrature; 0 for no encoders.
        linear_sensor: Whether sensors measure x and y (an axis: x).
        drive: What is commanded, for templates with DC motors: "voltage", "duty-cycle", "current", "torque", "position"
            or "speed". The largest current or torque is that of the motor at rest at its rated voltage, the largest
            speed the one without load; the gains of a loop are typical ones.
        sensor: Further sensors, "KIND@PART" each: a kind of sensor, and the coordinate that it measures; for a current
            the drive, for a belt force the belt. Their noise and resolution are 0 unless `values` has them.
        values: Further values by full name, SI, for example {"x.coulomb": 2.0, "x_m.noise": 1e-5}.
    """

    travel: tuple[float, ...] | None = None
    mass: tuple[float, ...] | None = None
    pulley_radius: float | None = None
    travel_per_turn: float | None = None
    gear_ratio: float | None = None
    rotor_inertia: float | None = None
    Kt: float | None = None
    resistance: float | None = None
    rated_voltage: float | None = None
    encoder_lines: int | None = None
    linear_sensor: bool = True
    drive: str | None = None
    sensor: Sequence[str] = ()
    values: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class TemplateQuestion:
    """An option of `hframe machines new` that a template has.

    Attributes:
        option: Its name in `MachineOptions`.
        default: Value of the template, SI; for `travel` and `mass` a text with one value per axis, separated by commas.
        choices: The answers that are accepted, and what each means; empty if the answer is a value.
        several: Whether the answer is any number of the choices, by default none, instead of one.
        alternative: Another option in `MachineOptions` that states the same quantity; empty if there is none.
    """

    option: str
    text: str
    default: str | float | int | bool
    choices: Mapping[str, str] = field(default_factory=dict)
    several: bool = False
    alternative: str = ""


def template_questions(like: str) -> tuple[TemplateQuestion, ...]:
    """Return the options of a template in the order in which they are asked for; they follow from its machine."""
    machine = BUILTIN_MACHINES[like]()
    drive, axes = machine.drives[0], [machine.coordinate(name) for name in machine.tool_axes]
    moved = machine.coordinate(drive.coordinate)
    planar, turning, follows = len(axes) == 2, machine.axis_unit is RADIANS, drive.law is not None
    is_pulley = moved.kind == "rotary" and not turning
    questions: list[TemplateQuestion] = []

    def ask(option: str, text: str, default: str | float | int | bool, alternative: str = "") -> None:
        rounded = float(f"{default:.4g}") if isinstance(default, float) else default
        questions.append(TemplateQuestion(option, text, rounded, alternative=alternative))

    if not turning:
        travel = [f"{c.range[1] - c.range[0]:g}" if c.range else "1" for c in axes]
        ask("travel", "Travel along x and y, m" if planar else "Travel, m", ",".join(travel))
    mass = (
        "Moment of inertia of what turns, without the motor, kg m^2"
        if turning
        else ("Moving mass along x and y, kg" if planar else "Moving mass without the motor, kg")
    )
    ask("mass", mass, ",".join(f"{c.mass:g}" for c in axes))
    if is_pulley:
        ask("pulley_radius", "Pitch radius of the motors' pulleys, m", moved.radius)
    elif not turning:
        per_turn = 2.0 * math.pi / drive.gear_ratio
        text = "Travel per turn, m: lead of the screw, or pitch times teeth of the pulley"
        ask("travel_per_turn", text, per_turn, "pulley_radius")
    if not follows:
        ratio = drive.gear_ratio if moved.kind == "rotary" else 1.0
        turned = "axis" if turning else "pulley" if is_pulley else "screw or pulley"
        ask("gear_ratio", f"Turns of the motor per turn of the {turned}", ratio)
    if not (turning and follows):
        inertia = moved.mass / drive.gear_ratio**2 if is_pulley else 0.0
        ask("rotor_inertia", "Moment of inertia of a motor's rotor, kg m^2", inertia)
    channels = ", ".join(machine.output_channels)
    further = TemplateQuestion(
        "sensor", f"Further sensors, beside {channels}", "", _further_sensors(machine), several=True
    )
    if follows:
        if not turning:
            ask("linear_sensor", _MEASURED.format(" and ".join(machine.tool_axes)), True)
        return (*questions, further)
    ask("Kt", "Torque constant of the motors, Nm/A", drive.Kt)
    ask("resistance", "Resistance of a motor, ohm", drive.resistance)
    ask("rated_voltage", "Rated voltage, V", drive.rated_voltage)
    commands = {kind: kind.replace("-", " ") for kind in _COMMANDS}
    questions += [TemplateQuestion("drive", "Command of the motors", drive.kind, commands), further]
    quanta = [s.resolution for s in machine.sensors if s.kind == "encoder"]
    lines = round(2 * math.pi / (_QUADRATURE * quanta[0] * drive.gear_ratio)) if quanta else 0
    ask("encoder_lines", "Lines of the encoders on the motors (0: none)", lines)
    if not turning:
        ask("linear_sensor", _MEASURED.format(" and ".join(machine.tool_axes)), True)
    return tuple(questions)


def new_machine(like: str, name: str, options: MachineOptions) -> Machine:
    """Create a machine from a template, with the user's values in place of some of the template's.

    The lengths of the belts are adapted to the travel, and the resolution of the encoders to their lines and the gear
    ratio.

    Args:
        like: Template, one of `TEMPLATES`.
        options: Values of the new machine, each None where the template's value is kept.

    Raises:
        InputError: If the template or a parameter in `options.values` is unknown, an option is not positive or does not
            fit the template, or the machine would have no sensor.
    """
    if like not in TEMPLATES:
        raise InputError(f"--like {like}: choose one of {', '.join(TEMPLATES)}{suggestion(like, TEMPLATES)}")
    machine = BUILTIN_MACHINES[like]().replace(
        name=name, description=f"A machine like {like}; see docs/machine.md."
    )
    _check(like, machine, options)
    machine = _with_travel(machine, TEMPLATES[like].lengths, options)
    machine = machine.replace(drives=tuple(_drive(machine, d, options) for d in machine.drives))
    machine = _with_masses(machine, options)
    gear_ratios = {d.coordinate: d.gear_ratio for d in BUILTIN_MACHINES[like]().drives}
    machine = machine.replace(sensors=_sensors(machine, gear_ratios, options))
    inertias = _shaft_inertias(machine)
    machine = machine.replace(
        drives=tuple(
            _commanded(machine, drive, options.drive, inertia)
            for drive, inertia in zip(machine.drives, inertias, strict=True)
        )
    )
    machine = machine.replace(drives=tuple(_reaching(machine, d) for d in machine.drives))
    for text in options.sensor:
        machine = machine.replace(sensors=(*machine.sensors, _further_sensor(machine, text)))
    if not machine.sensors:
        raise InputError(
            "no sensor is left: give the lines of encoders (--encoder-lines), or keep the linear sensor"
        )
    return _with_values(machine, options.values)


def write_machine_template(like: str, machine: Machine, path: Path) -> None:
    """Write a new machine to a machine.json with comments that explain its fields.

    Args:
        path: File to write; a missing folder is created, an existing file is replaced.

    Raises:
        InputError: If a value of the machine is not allowed, such as a negative mass; nothing is written then.
        OSError: If the file cannot be written.
    """
    content = machine_to_dict(machine)
    for entry in content["coordinates"]:
        if machine.axis_unit is RADIANS:  # no belt runs on it
            del entry["radius"]
    word = quoted(path.name)
    first = [
        "Machine description of hframe_gym. All values are in SI units; docs/machine.md describes every field.",
        TEMPLATES[like].comment,
        "Comments like this one are allowed in every object. They are ignored.",
        f"Next: hframe machines show {word}, then hframe check RUNS --machine {word}",
    ]
    comments = {
        "coordinates": lambda entry: TEMPLATES[like].coordinates.get(entry["name"], _PULLEY_COMMENT),
        "belts": lambda entry: _BELT_COMMENT,
        "drives": lambda entry: _DRIVE_COMMENTS[entry.get("kind", "voltage")],
        "sensors": lambda entry: _sensor_comment(entry["kind"]),
    }
    for key, comment in comments.items():
        content[key] = _commented(content[key], comment)
    schema = content.pop("schema")
    text = compact_json({"schema": schema, "comment": first, **content}) + "\n"
    MachineReader(path, MachineFile.model_validate_json(text)).machine()  # checks the values
    write_text(path, text)


def compact_json(value: Any, indent: int = 0) -> str:
    """Format JSON for people: an object or list is on one line if it fits there (100 characters)."""
    text = json.dumps(value, ensure_ascii=False)
    if len(text) + indent <= _LINE or not isinstance(value, dict | list):
        return text
    if isinstance(value, dict):
        lines = [f"{json.dumps(key)}: {compact_json(item, indent + 2)}" for key, item in value.items()]
    else:
        lines = [compact_json(item, indent + 2) for item in value]
    opening, closing = "{}" if isinstance(value, dict) else "[]"
    pad = " " * (indent + 2)
    return f"{opening}\n{pad}" + f",\n{pad}".join(lines) + f"\n{' ' * indent}{closing}"


def _sensor_comment(kind: str) -> str:
    """Return the comment on a sensor of a kind."""
    known = {"encoder": _ENCODER_COMMENT, "laser": _LASER_COMMENT}
    return known.get(kind) or f"{summary(SENSOR_KINDS.get(kind)).rstrip('.')}. {_OTHER_SENSOR_COMMENT}"


def _commented(
    entries: list[dict[str, Any]], comment: Callable[[dict[str, Any]], str]
) -> list[dict[str, Any]]:
    """Return entries with comments after their first fields; a comment that would be repeated is left out."""
    result, used = [], set()
    for entry in entries:
        text = comment(entry)
        (first, value), *_ = entry.items()
        result.append({first: value} | ({} if text in used else {"comment": text}) | entry)
        used.add(text)
    return result


def _check(like: str, machine: Machine, options: MachineOptions) -> None:
    """Check that options are positive and fit the template."""
    questions = template_questions(like)
    for question in questions:
        both = (question.option, question.alternative)
        if question.alternative and all(getattr(options, name) is not None for name in both):
            first, second = (f"--{name.replace('_', '-')}" for name in both)
            raise InputError(f"{first}: {second} states the same; give one of both")
    applies = {name for question in questions for name in (question.option, question.alternative)} | {
        "values"
    }
    for info in dataclasses.fields(options):
        if info.name not in applies and getattr(options, info.name) not in (info.default, None):
            raise InputError(
                f"--{info.name.replace('_', '-')}: {like} has none; see `hframe machines new --help`"
            )
    axes = len(machine.tool_axes)
    for name in ("travel", "mass"):
        values = getattr(options, name)
        if values is not None and len(values) != axes:
            example = "0.5" if axes == 1 else "0.3,0.2"
            raise InputError(
                f"--{name}: {like} needs {axes} value{'s'[: axes - 1]}, for example --{name} {example}"
            )
    driven_axes = {drive.coordinate for drive in machine.drives} & set(machine.tool_axes)
    for info in dataclasses.fields(options):
        value = getattr(options, info.name)
        values = value if isinstance(value, tuple) else (value,)
        numbers = [number for number in values if isinstance(number, int | float)]
        # A mass may include the rotor; the inertia of a pulley must be positive.
        included = info.name == "rotor_inertia" and driven_axes
        zero_allowed = included or info.name in ("encoder_lines", "linear_sensor")
        for number in numbers:
            if not math.isfinite(number) or number < 0 or (number == 0 and not zero_allowed):
                raise InputError(f"--{info.name.replace('_', '-')} {number:g}: must be positive")
            if number > _LONGEST.get(info.name, math.inf):
                raise InputError(
                    f"--{info.name.replace('_', '-')} {number:g}: is it in millimeters? Give it in m"
                )


def _with_travel(
    machine: Machine, lengths: Mapping[str, tuple[float, float]], options: MachineOptions
) -> Machine:
    """Return a machine with other ranges, and belts that are longer or shorter accordingly."""
    if options.travel is None:
        return machine
    travel = dict(zip(("x", "y"), options.travel, strict=False))
    change = dict.fromkeys(("x", "y"), 0.0)  # m
    coordinates = list(machine.coordinates)
    for index, c in enumerate(coordinates):
        if c.name in travel:
            change[c.name] = travel[c.name] - (c.range[1] - c.range[0] if c.range else 0.0)
            coordinates[index] = dataclasses.replace(c, range=(-travel[c.name] / 2, travel[c.name] / 2))
    belts = []
    for b in machine.belts:
        per_x, per_y = lengths[b.name]
        length = b.rest_length + per_x * change["x"] + per_y * change["y"]
        belts.append(dataclasses.replace(b, rest_length=round(length, 6)))
    return machine.replace(coordinates=tuple(coordinates), belts=tuple(belts))


def _drive(machine: Machine, drive: Drive, options: MachineOptions) -> Drive:
    """Return a drive with the values of the options."""
    new: dict[str, float] = {}
    if options.Kt is not None:
        new |= {"Kt": options.Kt, "Ke": options.Kt}
    given = {
        "resistance": options.resistance,
        "rated_voltage": options.rated_voltage,
        "gear_ratio": options.gear_ratio,
    }
    new |= {key: value for key, value in given.items() if value is not None}
    radius = options.pulley_radius
    if options.travel_per_turn is not None:
        radius = options.travel_per_turn / (2.0 * math.pi)
    if radius is not None and machine.coordinate(drive.coordinate).kind == "linear":
        new["gear_ratio"] = (options.gear_ratio or 1.0) / radius
    return dataclasses.replace(drive, **new)  # type: ignore[arg-type]


def _shaft_inertias(machine: Machine) -> Array:
    """Return the moment of inertia that each motor shaft moves while the other drives hold, kg m^2, shape (drives,)."""
    per_axis = rest_positions_per_axis(machine)  # (coordinates, axes)
    of_drives = per_axis[[machine.coordinate_names.index(d.coordinate) for d in machine.drives]]
    axes = np.linalg.inv(of_drives)  # travel of each axis per position of each drive
    masses = np.array([c.mass for c in machine.coordinates])
    along_drives = per_axis @ axes
    ratios = np.array([d.gear_ratio for d in machine.drives])
    return np.asarray(masses @ along_drives**2 / ratios**2)


def _commanded(machine: Machine, drive: Drive, kind: str | None, inertia: float) -> Drive:
    """Return a drive of another kind, whose column and largest command or torque are those of the same motor.

    `inertia` is what its shaft moves, kg m^2.
    """
    if kind is None or kind == drive.kind:
        return drive
    if kind not in _COMMANDS:
        raise InputError(
            f"--drive {kind}: choose one of {', '.join(_COMMANDS)}{suggestion(kind, _COMMANDS)}; docs/machine.md "
            "describes all kinds"
        )
    of_kind = DRIVE_KINDS.get(kind)
    unit = "" if of_kind.fraction else of_kind.unit(machine.coordinate(drive.coordinate).kind)
    channel = f"{_COMMANDS[kind]}{drive.name.removeprefix('motor')}{'_' * bool(unit)}{unit.replace('/', '_')}"
    if of_kind.law is not None:
        return _set_point_drive(drive, kind, channel, inertia)
    drive = dataclasses.replace(drive, kind=kind, channel=channel)
    if kind not in _AT_REST:
        return drive
    largest = float(f"{_AT_REST[kind](drive):.4g}")
    fixed: dict[str, Any] = {**of_kind.fixed, **({"Kt": 1.0} if kind == "torque" else {})}
    return dataclasses.replace(drive, rated_voltage=largest, voltage_range=None, **fixed)


def _set_point_drive(drive: Drive, kind: str, channel: str, inertia: float) -> Drive:
    """Return a drive whose loop makes the same motor follow positions or speeds; `inertia` at its shaft in kg m^2."""
    values = {
        "speed_gain": _SPEED_BANDWIDTH * inertia,
        "integral_rate": _INTEGRAL_RATE,
        "torque_limit": _AT_REST["torque"](drive),
    }
    without_load = float(f"{drive.rated_voltage / drive.emf_constant:.4g}")  # m/s or rad/s
    if kind == "position":
        values |= {"position_gain": _POSITION_GAIN, "speed_limit": without_load}
    fixed: dict[str, Any] = dict(DRIVE_KINDS.get(kind).fixed)
    return dataclasses.replace(
        drive,
        kind=kind,
        channel=channel,
        rated_voltage=without_load,
        voltage_range=None,
        law_parameters={name: float(f"{value:.4g}") for name, value in values.items()},
        **fixed,
    )


def _reaching(machine: Machine, drive: Drive) -> Drive:
    """Return a drive whose largest commanded position is that in the farthest corner of the workspace.

    That of a pulley is rounded up to whole rad. Other drives are returned as they are.
    """
    if drive.command != "position":
        return drive
    per_axis = rest_positions_per_axis(machine)[machine.coordinate_names.index(drive.coordinate)]
    corner = [max(map(abs, limits)) if limits else 0.0 for limits in machine.axis_ranges]
    largest = float(abs(per_axis) @ corner)
    if drive.coordinate not in machine.tool_axes:
        largest = math.ceil(largest)
    return dataclasses.replace(drive, rated_voltage=float(largest))


def _with_masses(machine: Machine, options: MachineOptions) -> Machine:
    """Return a machine with other masses, pulleys and rotors."""
    mass = dict(zip(machine.tool_axes, options.mass or (), strict=False))
    coordinates = []
    for c in machine.coordinates:
        new: dict[str, float] = {"mass": mass[c.name]} if c.name in mass else {}
        is_pulley = c.kind == "rotary" and c.name not in machine.tool_axes
        if is_pulley and options.pulley_radius is not None:
            new["radius"] = options.pulley_radius
        drives = [d for d in machine.drives if d.coordinate == c.name]
        if drives and options.rotor_inertia is not None:
            reflected = drives[0].gear_ratio ** 2 * options.rotor_inertia
            new["mass"] = reflected if is_pulley else mass.get(c.name, c.mass) + reflected
        coordinates.append(dataclasses.replace(c, **new))  # type: ignore[arg-type]
    return machine.replace(coordinates=tuple(coordinates))


def _sensors(
    machine: Machine, gear_ratios: Mapping[str, float], options: MachineOptions
) -> tuple[Sensor, ...]:
    """Return the sensors: encoders on the motor shafts, then those of the carriages."""
    carriages = [s for s in machine.sensors if s.kind != "encoder"] if options.linear_sensor else []
    if options.encoder_lines is None:
        ratio = {d.coordinate: gear_ratios[d.coordinate] / d.gear_ratio for d in machine.drives}
        encoders = [s for s in machine.sensors if s.kind == "encoder"]
        encoders = [dataclasses.replace(s, resolution=s.resolution * ratio[s.coordinate]) for s in encoders]
        return (*encoders, *carriages)
    encoders = []
    for drive in machine.drives if options.encoder_lines else ():
        kind = machine.coordinate(drive.coordinate).kind
        channel = (
            f"{drive.coordinate}_rad"
            if kind == "rotary"
            else f"{drive.coordinate}{'_encoder' * bool(carriages)}_m"
        )
        quantum = 2 * math.pi / (_QUADRATURE * options.encoder_lines * drive.gear_ratio)
        encoders.append(Sensor(channel, {drive.coordinate: 1.0}, resolution=quantum, kind="encoder"))
    return (*encoders, *carriages)


def _parts(machine: Machine, kind: str) -> tuple[str, tuple[str, ...]]:
    """Return at what sensors of a kind measure, such as "drive", and the names of these components of a machine."""
    component = SENSED_QUANTITIES[SENSOR_KINDS.get(kind).quantity()].component
    if component == "drive":
        return component, tuple(drive.name for drive in machine.drives)
    if component == "belt":
        return component, tuple(belt.name for belt in machine.belts)
    if SENSOR_KINDS.get(kind).turn is not None:  # an angle within one turn
        return "rotary coordinate", tuple(c.name for c in machine.coordinates if c.kind == "rotary")
    return component, machine.coordinate_names


def _further_sensors(machine: Machine) -> dict[str, str]:
    """Return the sensors of all kinds that a machine may have beside its own, KIND@PART, and what each measures."""
    load_plugins()  # may register kinds
    present = [(sensor.kind, sensor.row) for sensor in machine.sensors]
    choices = {}
    for kind in SENSOR_KINDS:
        for part in _parts(machine, kind)[1]:
            if (kind, {part: 1.0}) not in present:
                unit = machine.sensor_unit(Sensor("", {part: 1.0}, kind=kind))
                choices[f"{kind}@{part}"] = f"{kind.replace('-', ' ')} of {part}, {unit}"
    return choices


def _further_sensor(machine: Machine, text: str) -> Sensor:
    """Return the sensor that a text KIND@PART describes; its channel is named by the part and ends in its unit."""
    kind, separator, part = text.partition("@")
    if not separator:
        raise InputError(f"--sensor {text}: write KIND@PART, for example speed@{machine.tool_axes[0]}")
    try:
        component, parts = _parts(machine, kind)
    except InputError as error:
        raise InputError(f"--sensor {text}: {error}") from None
    if part not in parts:
        available = f"choose one of {', '.join(parts)}" if parts else "the machine has none"
        raise InputError(
            f"--sensor {text}: {kind} is measured at a {component}, and {part!r} is none; {available}"
            f"{suggestion(part, parts)}"
        )
    twin = next((s for s in machine.sensors if s.kind == kind and s.row == {part: 1.0}), None)
    if twin is not None:
        raise InputError(f"--sensor {text}: {twin.channel} is this sensor already; give each sensor once")
    ending = machine.sensor_unit(Sensor("", {part: 1.0}, kind=kind)).replace("^", "").replace("/", "_")
    channel = f"{part}_{ending}"
    if channel in machine.input_channels + machine.output_channels:
        channel = f"{part}_{kind.replace('-', '_')}_{ending}"
    return Sensor(channel, {part: 1.0}, kind=kind)


def _with_values(machine: Machine, values: Mapping[str, float]) -> Machine:
    """Return a machine with other parameter values."""
    names = machine.parameters | machine.device_parameters
    unknown = [name for name in values if name not in names]
    if unknown and unknown[0] in machine.ties:
        raise InputError(
            f"--set {unknown[0]}: it is tied to {machine.ties[unknown[0]][0]}; set that parameter"
        )
    if unknown:
        similar = difflib.get_close_matches(unknown[0], names, 3) or sorted(names)
        raise InputError(f"--set {unknown[0]}: there is no such parameter; there are {', '.join(similar)}")
    return machine.replace(values)
