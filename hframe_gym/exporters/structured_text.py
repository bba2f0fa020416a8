"""IEC 61131-3 Structured Text of the same formulas as the exporter `c`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

from typing_extensions import override

from ..errors import InputError
from ..machine import Machine
from .base import EXPORTERS, Files, MachineExporter, option
from .source.formula import Formula, Parameter, Signal
from .source.inverse_dynamics import BISECTIONS
from .source.language import Language, unbracketed, write_body
from .source.motion_formulas import MotionFormulas, check_prefix, motion_formulas

# Functions that the standard library lacks.
_HELPERS = {
    "sign": "SEL(x > 0.0, SEL(x < 0.0, 0.0, -1.0), 1.0)",
    "tanh": "1.0 - 2.0 / (EXP(2.0 * x) + 1.0)",
    "floor": "SEL(TRUNC(x) > x, TRUNC(x), TRUNC(x) - 1)",
    "copysign": "SEL(y < 0.0, ABS(x), -ABS(x))",
}


class StructuredText(Language):
    """Structured Text of IEC 61131-3 with LREAL."""

    functions: ClassVar[Mapping[str, str]] = {
        **{name: name.upper() for name in ("exp", "sin", "cos", "sqrt")},
        "log": "LN",
        "absolute": "ABS",
        "minimum": "MIN",
        "maximum": "MAX",
    }
    signs: ClassVar[Mapping[str, str]] = {"&": "AND", "|": "OR", "==": "=", "!=": "<>"}

    @override
    def number(self, text: str) -> str:
        """Write a number; a literal of Structured Text needs a decimal point, such as "1.0E-3"."""
        mantissa, sign, exponent = text.partition("e")
        return (mantissa if "." in mantissa else f"{mantissa}.0") + sign.upper() + exponent

    @override
    def choice(self, condition: str, yes: str, no: str) -> str:
        """Write a choice by SEL, whose first value is the one for a false condition."""
        return f"SEL({', '.join(map(unbracketed, (condition, no, yes)))})"

    @override
    def operation(self, name: str, operands: Sequence[str]) -> str:
        """Write an operation or function call as an expression without brackets around it.

        Raises:
            InputError: For `rint`, because Structured Text has no rounding to even.
        """
        if name == "rint":
            raise InputError(
                "Structured Text has no rounding to even, which a formula of this machine's effects uses"
            )
        return super().operation(name, operands)

    @override
    def assignment(self, target: str, value: str, *, kind: str) -> str:
        """Write "target := value;" for any `kind`: the names are declared before the body."""
        return f"{target} := {value};"


@EXPORTERS.register("st")
@dataclass(frozen=True, kw_only=True)
class StructuredTextExporter(MachineExporter):
    """Write Structured Text (IEC 61131-3) for a PLC: feedforward, friction compensation and a PID step.

    PREFIX.st has a function block for each function of `hframe export c`, from the same formulas in LREAL. An
    array counts from 0. The block of the PID keeps its integral; call it once per period.

    Example:  hframe export st --machine hframe --period 0.001 --out stage.st
    """

    period: float = option(0.01, "Control period of the PID in seconds, 1e-5 to 10.")
    prefix: str = option("stage", "Beginning of the names of functions and function blocks.")

    @override
    def files(self, machine: Machine) -> Files:
        """Write PREFIX.st."""
        prefix = check_prefix(self.prefix)
        motion = motion_formulas(machine, self.period)
        comment = (
            "(*\n" + "".join(f"  {line}\n" for line in self.header(machine, *motion.statements())) + "*)\n"
        )
        return {f"{prefix}.st": comment + "\n" + _source(motion, prefix)}


def _source(motion: MotionFormulas, prefix: str) -> str:
    """Return helper functions that occur, then functions and function blocks."""
    language = StructuredText(prefix)
    blocks = []
    for j, amplifier in motion.amplifiers.items():
        body = write_body(amplifier, language)
        name = f"{prefix}_amplifier_{j}"
        lines = [
            line if not line.startswith("result := ") else f"{name} := {line[10:]}" for line in body.lines
        ]
        declarations = [
            *_declared("VAR_INPUT", [("command", "LREAL", "V")]),
            *_declared("VAR", _temporaries(body.numbers, body.conditions)),
            *_constants(motion.parameters, body.used),
        ]
        blocks.append(_function(name, amplifier.comment, declarations, lines))
        blocks.append(_inverse(prefix, j, float(motion.dynamics.limits[j]), language))
    blocks += [_function_block(formula, motion, language) for formula in motion.formulas]
    helpers = [
        _function(
            f"{prefix}_{name}",
            f"{name} of x." if name != "copysign" else "Magnitude of x with the sign of y.",
            _declared("VAR_INPUT", [(v, "LREAL", "") for v in ("xy" if name == "copysign" else "x")]),
            [f"{prefix}_{name} := {formula};"],
        )
        for name, formula in _HELPERS.items()
        if name in language.helpers
    ]
    return "\n".join([*helpers, *blocks])


def _function_block(formula: Formula, motion: MotionFormulas, language: StructuredText) -> str:
    """Return a function block."""
    body = write_body(formula, language)
    states = set(formula.states)
    declarations = [
        *_declared("VAR_INPUT", [_declaration(s) for s in formula.inputs if s not in states]),
        *_declared("VAR_OUTPUT", [_declaration(s) for s in formula.outputs if s not in states]),
        *_declared("VAR", [_declaration(s) for s in formula.states]),
        *_declared("VAR_TEMP", _temporaries(body.numbers, body.conditions)),
        *_constants(motion.parameters, body.used),
    ]
    head = f"FUNCTION_BLOCK {language.prefix}_{formula.name}"
    return "\n".join([f"(* {formula.comment} *)", head, *declarations, *body.lines, "END_FUNCTION_BLOCK", ""])


def _function(name: str, comment: str, declarations: Sequence[str], lines: Sequence[str]) -> str:
    """Return a function with a number as its result."""
    return "\n".join(
        [f"(* {comment} *)", f"FUNCTION {name} : LREAL", *declarations, *lines, "END_FUNCTION", ""]
    )


def _inverse(prefix: str, j: int, limit: float, language: StructuredText) -> str:
    """Return the function that inverts an amplifier, `InverseDynamics.command` in Structured Text."""
    name, amplifier = f"{prefix}_command_{j}", f"{prefix}_amplifier_{j}"
    declarations = [
        *_declared("VAR_INPUT", [("voltage", "LREAL", "V")]),
        *_declared("VAR", [(v, "LREAL", "") for v in ("low", "high", "middle", "side")] + [("i", "INT", "")]),
    ]
    lines = [
        "low := 0.0;",
        f"high := {language.number(repr(limit))};",
        f"side := SEL(voltage > {amplifier}(0.0), -1.0, 1.0);",
        f"FOR i := 1 TO {BISECTIONS} DO",
        "    middle := 0.5 * (low + high);",
        f"    IF side * {amplifier}(side * middle) < side * voltage THEN",
        "        low := middle;",
        "    ELSE",
        "        high := middle;",
        "    END_IF;",
        "END_FOR;",
        f"{name} := SEL(voltage = {amplifier}(0.0), side * high, 0.0);",
    ]
    comment = (
        f"Smallest command in magnitude that gives a voltage at motor {j}, V; "
        "bisection within the drive's limit."
    )
    return _function(name, comment, declarations, lines)


def _declaration(signal: Signal) -> tuple[str, str, str]:
    """Return name, type and comment of a signal."""
    kind = f"ARRAY[0..{signal.size - 1}] OF LREAL" if signal.size else "LREAL"
    return signal.name, kind, signal.comment


def _temporaries(numbers: Iterable[str], conditions: Iterable[str]) -> list[tuple[str, str, str]]:
    """Return the declarations of intermediate results."""
    return [*((name, "LREAL", "") for name in numbers), *((name, "BOOL", "") for name in conditions)]


def _constants(parameters: Iterable[Parameter], used: frozenset[str]) -> list[str]:
    """Return the declarations of the parameters that occur."""
    language = StructuredText("")
    return _declared(
        "VAR CONSTANT",
        [
            (p.identifier, f"LREAL := {language.number(repr(p.value))}", p.comment)
            for p in parameters
            if p.identifier in used
        ],
    )


def _declared(kind: str, variables: Sequence[tuple[str, str, str]]) -> list[str]:
    """Return a block of declarations, empty without variables."""
    if not variables:
        return []
    lines = [
        f"    {name} : {of};" + (f" (* {comment} *)" if comment else "") for name, of, comment in variables
    ]
    return [kind, *lines, "END_VAR"]
