"""The command `hframe machines new`: its options, the questions that it asks on a terminal, and the file."""

from __future__ import annotations

import dataclasses
import math
import re
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import typer

from ..errors import InputError
from ..machine import Machine, motion_limits
from ..operating_system import quoted
from ..recordings import (
    TEMPLATE_QUESTIONS,
    TEMPLATES,
    WITH_CARRIAGES,
    MachineOptions,
    new_machine,
    template_value,
    write_machine_template,
)


@dataclass(frozen=True)
class MachineAnswers:
    """Values of the options of `hframe machines new`; what is not given is empty or None.

    Attributes:
        like: Name of the template.
        out: File to write.
        name: Name of the machine.
        travel: Travel along the axes, m, separated by commas.
        mass: Moving masses along the axes, kg, separated by commas.
        pulley_radius: Pitch radius of the motors' pulleys, m.
        gear_ratio: Turns of the motor per turn of the pulley.
        rotor_inertia: Moment of inertia of a rotor, kg m^2.
        Kt: Torque constant, Nm/A.
        resistance: Resistance of a motor, ohm.
        rated_voltage: Rated voltage, V.
        encoder_lines: Lines of the encoders; 0 for none.
        linear_sensor: Whether sensors measure x and y.
        values: Further values as texts "PARAMETER=VALUE", SI.
    """

    like: str = ""
    out: Path | None = None
    name: str = ""
    travel: str = ""
    mass: str = ""
    pulley_radius: float | None = None
    gear_ratio: float | None = None
    rotor_inertia: float | None = None
    Kt: float | None = None
    resistance: float | None = None
    rated_voltage: float | None = None
    encoder_lines: int | None = None
    linear_sensor: bool | None = None
    values: tuple[str, ...] = ()

    def options(self) -> MachineOptions:
        """Convert the answers, which are partly texts, to the options of `new_machine`.

        Raises:
            InputError: If a text is not a number, or does not have the form PARAMETER=VALUE.
        """
        plain = (
            "pulley_radius",
            "gear_ratio",
            "rotor_inertia",
            "Kt",
            "resistance",
            "rated_voltage",
            "encoder_lines",
        )
        values = {}
        for text in self.values:
            parameter, separator, value = text.partition("=")
            if not separator:
                raise InputError(f"--set {text}: write PARAMETER=VALUE, for example x.coulomb=2")
            values[parameter.strip()] = _number("set", value)
        return MachineOptions(
            travel=_numbers("travel", self.travel),
            mass=_numbers("mass", self.mass),
            linear_sensor=self.linear_sensor is not False,
            values=values,
            **{name: getattr(self, name) for name in plain},
        )


def create_machine_file(answers: MachineAnswers, force: bool, log: Callable[[str], None]) -> None:
    """Write a new machine.json from the options of `hframe machines new`, and print the limits of its motion.

    If template and file are given, values that are not given are those of the template. Otherwise, `ask` asks on the
    terminal for everything that is not given.

    Args:
        answers: Values of the command's options, empty or None where not given.
        force: Whether an existing file is replaced.
        log: Called with a line of text for the user.

    Raises:
        InputError: If a value is wrong, the file exists and `force` is False, or template or file is missing and there
            is no terminal.
    """
    if answers.out and (obstacle := file_obstacle(answers.out, force)):
        replacing = ", or replace it with --force" if obstacle.startswith("exists") else ""
        raise InputError(f"--out {answers.out}: {obstacle}{replacing}")
    missing = " and ".join(f"--{name}" for name in ("like", "out") if not getattr(answers, name))
    if missing and not sys.stdin.isatty():
        raise InputError(f"{missing}: missing, for example hframe machines new --like corexy --out my.json")
    if missing:
        answers = ask(answers, log, force)
    path = answers.out or Path(f"my_{answers.like}.json")
    machine = new_machine(answers.like, answers.name or path.stem, answers.options())
    write_machine_template(answers.like, machine, path)
    log(f"wrote {path}: {answers.like} with {', '.join(machine.input_channels + machine.output_channels)}")
    for line in motion_lines(machine):
        log(line)
    log("if one of these values is implausible, check the units of the values you entered")
    word = quoted(str(path))
    log(f"next: edit its values, then `hframe machines show {word}` and `hframe check RUNS --machine {word}`")


def file_obstacle(path: Path, force: bool) -> str:
    """Return why a new machine cannot be written to a file, and what to do; empty if it can."""
    if path.suffix != ".json":
        return "must end in .json"
    return "exists already; choose another name" if path.exists() and not force else ""


def motion_lines(machine: Machine) -> list[str]:
    """Describe moved mass, stall force and top speed at rated voltage of each rigid motion, to reveal wrong units."""
    lines = []
    for name, limit in motion_limits(machine).items():
        c = machine.coordinate(name)
        values = f"{limit.force:.3g} {c.unit('force')} at rest, up to {limit.speed:.3g} {c.unit('speed')}"
        lines.append(f"along {name}: {limit.inertia:.4g} {c.unit('mass')} with the rotors, {values}")
    return lines


def ask(answers: MachineAnswers, log: Callable[[str], None], force: bool = False) -> MachineAnswers:
    """Ask on the terminal for each option of `hframe machines new` that is not given, including the file to write.

    Enter accepts the value of the template. After an invalid answer, the question is repeated.

    Args:
        answers: Values of the command's options, empty or None where not given.
        log: Called with a line of text for the user.
        force: Whether the name of an existing file is accepted.

    Raises:
        InputError: If a given value cannot be used, for example an unknown template.
    """
    log("Enter accepts the value in brackets. All values are in SI units.")
    like = answers.like
    while not like:
        like = typer.prompt(f"Template ({', '.join(TEMPLATES)})", default="corexy")
        if like not in TEMPLATES:
            log(f"{like}: there is no such template")
            like = ""
    answers = dataclasses.replace(answers, like=like)
    # Refuses wrong options before the first question. Encoders that no option gives can still be answered.
    lines_given = answers.encoder_lines is not None
    new_machine(like, "template", (answers if lines_given else _with_linear_sensor(answers)).options())
    while answers.out is None:
        path = Path(typer.prompt("File to write", default=f"my_{like}.json"))
        obstacle = file_obstacle(path, force)
        if obstacle:
            log(f"{path}: {obstacle}")
        else:
            answers = dataclasses.replace(answers, out=path)
    for option, question, templates in TEMPLATE_QUESTIONS:
        if like in templates and getattr(answers, option) in ("", None):
            answers = _ask_value(answers, option, question, log)
    while answers.linear_sensor is None and like in WITH_CARRIAGES:
        axes = "x and y" if like in ("hframe", "corexy") else "x"
        measured = typer.confirm(f"Does a sensor measure {axes} directly?", default=True)
        trial = dataclasses.replace(answers, linear_sensor=measured)
        if _is_usable(trial, log):
            answers = trial
        elif not lines_given:
            option, question, _ = TEMPLATE_QUESTIONS[-1]
            answers = _ask_value(dataclasses.replace(answers, encoder_lines=None), option, question, log)
    return answers


def _ask_value(
    answers: MachineAnswers, option: str, question: str, log: Callable[[str], None]
) -> MachineAnswers:
    """Ask for the value of an option until it can be used, and return the answers with it."""
    default = template_value(new_machine(answers.like, "template", MachineOptions()), option)
    while True:
        answer = typer.prompt(question, default=default, type=type(default))
        # The template's value stays, to the last digit.
        answered = answers if answer == default else dataclasses.replace(answers, **{option: answer})
        # Whether a sensor is left shows with the last value, the encoders.
        if _is_usable(answered if option == "encoder_lines" else _with_linear_sensor(answered), log):
            return answered


def _with_linear_sensor(answers: MachineAnswers) -> MachineAnswers:
    """Return answers with sensors that measure x and y."""
    return dataclasses.replace(answers, linear_sensor=True)


def _is_usable(answers: MachineAnswers, log: Callable[[str], None]) -> bool:
    """Return whether a machine can be made with the answers; otherwise say why not, without the names of options."""
    try:
        new_machine(answers.like, "template", answers.options())
    except InputError as error:
        log(re.sub(r" \(--[\w-]+\)|--[\w-]+:? ", "", str(error)))
        return False
    return True


def _numbers(option: str, text: str) -> tuple[float, ...] | None:
    """Return the numbers of a text separated by commas, or None for an empty text."""
    return tuple(_number(option, part) for part in text.split(",")) if text else None


def _number(option: str, text: str) -> float:
    """Return the finite number of a text."""
    try:
        number = float(text)
    except ValueError:
        raise InputError(f"--{option}: {text!r} is not a number") from None
    if not math.isfinite(number):
        raise InputError(f"--{option}: {text!r} is not a finite number")
    return number
