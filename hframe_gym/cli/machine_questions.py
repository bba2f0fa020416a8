"""The command `hframe machines new`: its options, the questions that it asks on a terminal, and the file."""

from __future__ import annotations

import dataclasses
import math
import re
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import typer

from ..errors import InputError
from ..line_log import LineLog
from ..machine import Machine, motion_limits
from ..operating_system import quoted
from ..recordings import (
    TEMPLATES,
    MachineOptions,
    TemplateQuestion,
    new_machine,
    template_questions,
    write_machine_template,
)

_NONE = "none"  # answer to a question that permits several choices


@dataclass(frozen=True)
class MachineAnswers:
    """Values of the options of `hframe machines new`; options without a value are empty or missing.

    Attributes:
        like: Name of the template.
        out: File to write.
        name: Name of the machine; empty for that of the file.
        given: Values by name in `MachineOptions`: for `travel` and `mass` one number per axis, separated by
            commas, for `values` texts "PARAMETER=VALUE", SI, for `sensor` texts "KIND@PART".
    """

    like: str = ""
    out: Path | None = None
    name: str = ""
    given: Mapping[str, Any] = field(default_factory=dict)

    def with_answer(self, option: str, answer: object) -> MachineAnswers:
        """Return the answers with the value of one more option."""
        return dataclasses.replace(self, given={**self.given, option: answer})

    def options(self) -> MachineOptions:
        """Convert the answers to options of `new_machine`; an InputError names an invalid answer."""
        values = {}
        for text in self.given.get("values", ()):
            parameter, separator, value = text.partition("=")
            if not separator:
                raise InputError(f"--set {text}: write PARAMETER=VALUE, for example x.coulomb=2")
            values[parameter.strip()] = _number("set", value)
        lists = {name: _numbers(name, self.given[name]) for name in ("travel", "mass") if name in self.given}
        return MachineOptions(**{**self.given, **lists, "values": values})


def create_machine_file(answers: MachineAnswers, force: bool, log: LineLog) -> None:
    """Write a new machine.json from the options of `hframe machines new`, and print the limits of its motion.

    If the template and the file are given, other values default to those of the template. Otherwise, `ask`
    asks on the terminal for every missing value.

    Raises:
        InputError: If a value is wrong, the file exists and `force` is False, or template or file is missing
            and there is no terminal.
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
    """Return why a machine cannot be written to a file, or "" if it can.

    Args:
        path: The file; it must end in .json.
        force: Whether an existing file may be replaced.
    """
    if path.suffix != ".json":
        return "must end in .json"
    return "exists already; choose another name" if path.exists() and not force else ""


def motion_lines(machine: Machine) -> list[str]:
    """Describe moved mass, stall force and top speed along each rigid motion, to reveal wrong units.

    A drive that controls its current or torque has no back-EMF, so that its top speed is unknown.
    """
    lines = []
    has_speed = any(d.law or d.Ke for d in machine.drives)
    for name, limit in motion_limits(machine).items():
        c = machine.coordinate(name)
        speed = f", up to {limit.speed:.3g} {c.unit('speed')}" if has_speed else ""
        values = f"{limit.force:.3g} {c.unit('force')} at rest{speed}"
        lines.append(f"along {name}: {limit.inertia:.4g} {c.unit('mass')} with the rotors, {values}")
    return lines


def ask(answers: MachineAnswers, log: LineLog, force: bool = False) -> MachineAnswers:
    """Ask on the terminal for each missing option of `hframe machines new`, including the file.

    Args:
        answers: Options that are given; they are not asked for.
        log: Called with a line of text for each hint and each answer that is refused; the question is then
            repeated.
        force: Whether the name of an existing file is accepted.

    Returns:
        The answers with all options of the template.

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
    lines_given = "encoder_lines" in answers.given
    new_machine(like, "template", (answers if lines_given else _with_linear_sensor(answers)).options())
    while answers.out is None:
        path = Path(typer.prompt("File to write", default=f"my_{like}.json"))
        obstacle = file_obstacle(path, force)
        if obstacle:
            log(f"{path}: {obstacle}")
        else:
            answers = dataclasses.replace(answers, out=path)
    questions = {question.option: question for question in template_questions(like)}
    for option, question in questions.items():
        given = answers.given.keys() & {option, question.alternative}
        if not given and option != "linear_sensor":
            answers = _ask_value(answers, question, log)
    while "linear_sensor" in questions and "linear_sensor" not in answers.given:
        trial = answers.with_answer(
            "linear_sensor", typer.confirm(questions["linear_sensor"].text, default=True)
        )
        if _is_usable(trial, log):
            answers = trial
        elif not lines_given:
            others = {name: value for name, value in answers.given.items() if name != "encoder_lines"}
            answers = _ask_value(dataclasses.replace(answers, given=others), questions["encoder_lines"], log)
    return answers


def _ask_value(answers: MachineAnswers, question: TemplateQuestion, log: LineLog) -> MachineAnswers:
    """Ask for the value of an option until it can be used, and return the answers with it."""
    option, text = question.option, question.text
    default = _NONE if question.several else question.default
    if question.choices:
        listed = ", ".join(question.choices)
        text += f" ({listed}; several with commas)" if question.several else f" ({listed})"
    while True:
        answer = typer.prompt(text, default=default, type=type(default))
        if question.several and answer != default:
            answer = [part.strip() for part in answer.split(",") if part.strip()]
        # The template's value stays, to the last digit.
        answered = answers if answer == default else answers.with_answer(option, answer)
        # Whether a sensor is left shows with the last value, the encoders.
        if _is_usable(answered if option == "encoder_lines" else _with_linear_sensor(answered), log):
            return answered


def _with_linear_sensor(answers: MachineAnswers) -> MachineAnswers:
    """Return answers with sensors that measure x and y."""
    return answers.with_answer("linear_sensor", True)


def _is_usable(answers: MachineAnswers, log: LineLog) -> bool:
    """Return whether the answers make a machine; if not, print why, without naming options."""
    try:
        new_machine(answers.like, "template", answers.options())
    except InputError as error:
        log(re.sub(r" \(--[\w-]+\)|--[\w-]+:? ", "", str(error)))
        return False
    return True


def _numbers(option: str, text: str) -> tuple[float, ...]:
    """Return the numbers of a text separated by commas."""
    return tuple(_number(option, part) for part in text.split(","))


def _number(option: str, text: str) -> float:
    """Return the finite number of a text."""
    try:
        number = float(text)
    except ValueError:
        raise InputError(f"--{option}: {text!r} is not a number") from None
    if not math.isfinite(number):
        raise InputError(f"--{option}: {text!r} is not a finite number")
    return number
