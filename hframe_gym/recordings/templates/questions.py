"""Questions about a new machine: the options that each template has, and whether the answers fit it."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from ...errors import InputError
from ...machine import BUILTIN_MACHINES, RADIANS, Machine
from .drives import COMMANDS, FOLLOWING
from .options import MachineOptions
from .sensors import QUADRATURE, further_sensors
from .texts import TEMPLATES

_MEASURED = "Does a sensor measure {} directly?"
# m; larger values are refused, they are in millimeters.
_LONGEST = {"travel": 20.0, "pulley_radius": 1.0, "travel_per_turn": 1.0}


@dataclass(frozen=True)
class TemplateQuestion:
    """An option of `hframe machines new` that a template has.

    Attributes:
        option: Its name in `MachineOptions`.
        text: The question, with its unit, without a question mark.
        default: Value of the template, SI; for `travel` and `mass` a text with one value per axis, separated
            by commas.
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
    """Return the questions to ask about a template, one for each of its options, in order.

    Args:
        like: Name of the template, a key of `TEMPLATES`.

    Returns:
        For each question its option, text, default (the template's value, SI) and possible answers.
    """
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
        "sensor", f"Further sensors, beside {channels}", "", further_sensors(machine), several=True
    )
    if follows:
        if not turning:
            kinds = {kind: kind for kind in FOLLOWING}
            questions.append(TemplateQuestion("drive", "Command of the motors", drive.kind, kinds))
            ask("linear_sensor", _MEASURED.format(" and ".join(machine.tool_axes)), True)
        return (*questions, further)
    ask("Kt", "Torque constant of the motors, Nm/A", drive.Kt)
    ask("resistance", "Resistance of a motor, ohm", drive.resistance)
    ask("rated_voltage", "Rated voltage, V", drive.rated_voltage)
    commands = {kind: kind.replace("-", " ") for kind in COMMANDS}
    questions += [TemplateQuestion("drive", "Command of the motors", drive.kind, commands), further]
    quanta = [s.resolution for s in machine.sensors if s.kind == "encoder"]
    lines = round(2 * math.pi / (QUADRATURE * quanta[0] * drive.gear_ratio)) if quanta else 0
    ask("encoder_lines", "Lines of the encoders on the motors (0: none)", lines)
    if not turning:
        ask("linear_sensor", _MEASURED.format(" and ".join(machine.tool_axes)), True)
    return tuple(questions)


def check_options(like: str, machine: Machine, options: MachineOptions) -> None:
    """Check that options are positive and fit the template.

    Args:
        like: Name of the template.
        machine: The built-in machine of this name.

    Raises:
        InputError: If an option does not apply to the template, has a wrong number of values, or has a value
            that is negative, zero where this is meaningless, not finite, or probably in mm.
    """
    _check_that_options_apply(like, options)
    axes = len(machine.tool_axes)
    for name in ("travel", "mass"):
        values = getattr(options, name)
        if values is not None and len(values) != axes:
            example = "0.5" if axes == 1 else "0.3,0.2"
            raise InputError(
                f"--{name}: {like} needs {axes} value{'s'[: axes - 1]}, for example --{name} {example}"
            )
    zero_allowed = {"encoder_lines", "linear_sensor"}
    if {drive.coordinate for drive in machine.drives} & set(machine.tool_axes):
        zero_allowed.add("rotor_inertia")  # a mass may include it; the inertia of a pulley must be positive
    for info in dataclasses.fields(options):
        value = getattr(options, info.name)
        for number in value if isinstance(value, tuple) else (value,):
            if not isinstance(number, int | float):
                continue
            if not math.isfinite(number) or number < 0 or (number == 0 and info.name not in zero_allowed):
                raise InputError(f"{_flag(info.name)} {number:g}: must be positive")
            if number > _LONGEST.get(info.name, math.inf):
                raise InputError(f"{_flag(info.name)} {number:g}: is it in millimeters? Give it in m")


def _check_that_options_apply(like: str, options: MachineOptions) -> None:
    """Check that a template has the options, and that no two of them state the same."""
    applies = {"values"}
    for question in template_questions(like):
        both = (question.option, question.alternative)
        if question.alternative and all(getattr(options, name) is not None for name in both):
            first, second = map(_flag, both)
            raise InputError(f"{first}: {second} states the same; give one of both")
        applies.update(both)
    for info in dataclasses.fields(options):
        if info.name not in applies and getattr(options, info.name) not in (info.default, None):
            others = ", ".join(name for name in TEMPLATES if name != like and _has_option(name, info.name))
            remedy = f"leave it out, or begin from one that has it: --like {others}"
            raise InputError(f"{_flag(info.name)}: {like} has none; {remedy}")


def _has_option(like: str, option: str) -> bool:
    """Return whether a template asks about an option, or about its alternative."""
    return any(option in (q.option, q.alternative) for q in template_questions(like))


def _flag(option: str) -> str:
    """Return the command's spelling of an option in `MachineOptions`."""
    return f"--{option.replace('_', '-')}"
