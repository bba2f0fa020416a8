"""Source text in C99 and IEC 61131-3 Structured Text of formulas that are traced from the equations of motion.

The equations are evaluated once with traced expressions (`dynamics.tracing`), as for the simulation kernel, and the
recorded operations are written in another language. So there is one source of the equations. Names in the text are made
of fixed words, sanitized names of parameters, and numbers.
"""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from typing_extensions import override

from ..dynamics.symbolic.expressions import Expression
from ..dynamics.symbolic.tracing import Trace
from ..errors import InputError
from ..machine import Machine
from .base import plain

COMPARISONS = ("<", "<=", ">", ">=", "==", "!=")
_CONDITIONS = (*COMPARISONS, "&", "|")
_INFIX = (*_CONDITIONS, "+", "-", "*", "/", "neg", "fma", "where")  # not written as calls, in C at least


class FormulaTrace(Trace):
    """Trace of a formula without statements; what a kernel would skip by a branch is always evaluated."""

    @override
    def update_if_any(
        self, condition: Any, values: Sequence[Any], update: Callable[[Sequence[Any]], Sequence[Any]]
    ) -> list[Any]:
        """Return the updated values; the update changes nothing where the condition is false."""
        return list(update(values))


@dataclass(frozen=True)
class Parameter:
    """A parameter of the machine in exported source text.

    Attributes:
        comment: Full name and unit.
    """

    identifier: str
    value: float
    comment: str


@dataclass(frozen=True)
class Signal:
    """An input or output of a formula.

    Attributes:
        size: Number of its entries; 0 for a number instead of an array.
        comment: Meaning and unit.
    """

    name: str
    size: int
    comment: str

    def elements(self) -> list[str]:
        """Write each entry in source text, such as "velocity[0]"; arrays count from 0 in both languages."""
        return [f"{self.name}[{i}]" for i in range(self.size)] if self.size else [self.name]


@dataclass
class Formula:
    """A function from signals to signals, traced.

    Attributes:
        name: Name, after the prefix of the export.
        comment: What it computes.
        outputs: Results; a state is an input and an output of the same name.
        results: One expression for each entry of the outputs, in order.
    """

    name: str
    comment: str
    inputs: tuple[Signal, ...]
    outputs: tuple[Signal, ...]
    results: list[Expression] = field(default_factory=list)

    @property
    def states(self) -> tuple[Signal, ...]:
        """Signals that are input and output."""
        return tuple(signal for signal in self.outputs if signal in self.inputs)


def trace_formula(
    name: str,
    comment: str,
    inputs: Sequence[Signal],
    outputs: Sequence[Signal],
    function: Callable[..., Sequence[Any]],
    parameters: Mapping[str, Parameter],
) -> Formula:
    """Trace a function of the equations of motion as a formula.

    Args:
        function: Function (values, *arguments) of the parameter values by full name and of one value (or list of
            values) per input, which returns all entries of the outputs.
    """
    trace = FormulaTrace(name)
    values = {full: trace.argument(p.identifier) for full, p in parameters.items()}
    arguments: list[Any] = []
    for signal in inputs:
        elements = [trace.argument(text) for text in signal.elements()]
        arguments.append(elements if signal.size else elements[0])
    results = [trace.expression(value) for value in function(values, *arguments)]
    return Formula(name, comment, tuple(inputs), tuple(outputs), results)


def parameters_of(machine: Machine) -> dict[str, Parameter]:
    """Name the parameters of a machine in source text, by full name; identifiers are unique."""
    found: dict[str, Parameter] = {}
    taken: set[str] = set()
    for full, value in machine.parameters.items():
        stem = identifier = "p_" + re.sub(r"\W+", "_", full, flags=re.ASCII).strip("_").lower()
        number = 1
        while identifier in taken:  # Structured Text does not distinguish upper from lower case
            number += 1
            identifier = f"{stem}_{number}"
        taken.add(identifier)
        found[full] = Parameter(identifier, float(value), plain(f"{full}, {machine.unit(full)}"))
    return found


class Language(ABC):
    """How expressions and assignments are written in a language.

    Args:
        prefix: Prefix of the names of all functions.

    Attributes:
        helpers: Names of the functions beyond the standard library that the text written so far uses.
    """

    def __init__(self, prefix: str) -> None:
        self.prefix = prefix
        self.helpers: set[str] = set()

    @abstractmethod
    def number(self, text: str) -> str:
        """Write a number, given as Python writes it."""

    @abstractmethod
    def operation(self, name: str, operands: Sequence[str]) -> str:
        """Write an operation or a call of a function of operands, which are atoms or in brackets, without brackets.

        Args:
            name: Operator such as "+" or name of a function in `dynamics.elementwise`.
        """

    @abstractmethod
    def assignment(self, target: str, value: str, *, kind: str) -> str:
        """Write a line that assigns a value to a target.

        Args:
            kind: "number" or "condition" for a new name, "output" for an existing one.
        """


class C99(Language):
    """C of 1999 with math.h."""

    _FUNCTIONS: Mapping[str, str] = {
        **{name: name for name in ("exp", "log", "sin", "cos", "tanh", "sqrt", "copysign", "floor", "rint")},
        "absolute": "fabs",
        "minimum": "fmin",
        "maximum": "fmax",
    }

    @override
    def number(self, text: str) -> str:
        return text

    @override
    def operation(self, name: str, operands: Sequence[str]) -> str:
        if name == "neg":
            return f"-{operands[0]}"
        if name == "fma":
            return f"{operands[0]} * {operands[1]} + {operands[2]}"
        if name == "where":
            return f"{operands[0]} ? {operands[1]} : {operands[2]}"
        if name in (*_CONDITIONS, "+", "-", "*", "/"):
            sign = {"&": "&&", "|": "||"}.get(name, name)
            return f"{operands[0]} {sign} {operands[1]}"
        if name in self._FUNCTIONS:
            return f"{self._FUNCTIONS[name]}({', '.join(map(_unbracketed, operands))})"
        self.helpers.add(name)
        return f"{self.prefix}_{name}({', '.join(map(_unbracketed, operands))})"

    @override
    def assignment(self, target: str, value: str, *, kind: str) -> str:
        declared = {"number": "const double ", "condition": "const int ", "output": ""}[kind]
        return f"{declared}{target} = {value};"


class StructuredText(Language):
    """Structured Text of IEC 61131-3 with LREAL."""

    _FUNCTIONS: Mapping[str, str] = {
        **{name: name.upper() for name in ("exp", "sin", "cos", "sqrt")},
        "log": "LN",
        "absolute": "ABS",
        "minimum": "MIN",
        "maximum": "MAX",
    }

    @override
    def number(self, text: str) -> str:
        """Return a number; a literal of Structured Text has a decimal point."""
        mantissa, sign, exponent = text.partition("e")
        return (mantissa if "." in mantissa else f"{mantissa}.0") + sign.upper() + exponent

    @override
    def operation(self, name: str, operands: Sequence[str]) -> str:
        if name == "neg":
            return f"-{operands[0]}"
        if name == "fma":
            return f"{operands[0]} * {operands[1]} + {operands[2]}"
        inside = [_unbracketed(operand) for operand in operands]
        if name == "where":  # SEL(condition, value if false, value if true)
            return f"SEL({inside[0]}, {inside[2]}, {inside[1]})"
        if name in (*_CONDITIONS, "+", "-", "*", "/"):
            sign = {"&": "AND", "|": "OR", "==": "=", "!=": "<>"}.get(name, name)
            return f"{operands[0]} {sign} {operands[1]}"
        if name in self._FUNCTIONS:
            return f"{self._FUNCTIONS[name]}({', '.join(inside)})"
        if name == "rint":
            raise InputError(
                "Structured Text has no rounding to even, which a formula of this machine's effects uses"
            )
        self.helpers.add(name)
        return f"{self.prefix}_{name}({', '.join(inside)})"

    @override
    def assignment(self, target: str, value: str, *, kind: str) -> str:
        """Return an assignment in Structured Text; names are declared before the body."""
        return f"{target} := {value};"


@dataclass(frozen=True)
class Body:
    """Source text of a formula.

    Attributes:
        numbers: Names of new numbers.
        conditions: Names of new truth values.
        used: Texts of the inputs and parameters that occur.
    """

    lines: tuple[str, ...]
    numbers: tuple[str, ...]
    conditions: tuple[str, ...]
    used: frozenset[str]


def write_body(formula: Formula, language: Language) -> Body:
    """Write the assignments of a formula: common parts first, each computed once, then the outputs."""
    return _Writer(formula, language).body


class _Writer:
    """Writes the assignments of one formula."""

    def __init__(self, formula: Formula, language: Language) -> None:
        self._language = language
        self._uses: Counter[Expression] = Counter()
        self._texts: dict[Expression, str] = {}
        self._names: dict[str, list[str]] = {"number": [], "condition": []}
        self._lines: list[str] = []
        self._used: set[str] = set()
        visited: set[Expression] = set()
        for result in formula.results:
            self._count(result, visited)
        targets = [text for signal in formula.outputs for text in signal.elements()]
        # All values before the first assignment to an output: a state is an input as well.
        values = [
            self._atom(result) if formula.states else self._unbracketed(result) for result in formula.results
        ]
        self._lines += [
            language.assignment(target, value, kind="output")
            for target, value in zip(targets, values, strict=True)
        ]
        numbers, conditions = (tuple(self._names[kind]) for kind in ("number", "condition"))
        self.body = Body(tuple(self._lines), numbers, conditions, frozenset(self._used))

    def _count(self, value: Expression, visited: set[Expression]) -> None:
        self._uses[value] += 1
        if value not in visited:
            visited.add(value)
            for operand in value.operands:
                if isinstance(operand, Expression):
                    self._count(operand, visited)

    def _unbracketed(self, value: Expression) -> str:
        return _unbracketed(self._text(value))

    def _text(self, value: Expression) -> str:
        """Return an atom, or the formula of a value in brackets; lines that it needs are appended first."""
        if value in self._texts:
            return self._texts[value]
        if value.is_leaf:
            text = str(value.operands[0])
            if value.operation == "variable":
                self._used.add(text)
            else:
                text = self._language.number(text)
                text = f"({text})" if text.startswith("-") else text
            return text
        if self._uses[value] > 1 or value in value.trace.names:
            return self._atom(value)
        text = self._operation(value)
        return f"({text})" if value.operation in _INFIX else text

    def _atom(self, value: Expression) -> str:
        """Return a name or number; a formula gets a name and a line."""
        if value in self._texts or value.is_leaf:
            return self._text(value)
        text = self._operation(value)
        kind = "condition" if value.operation in _CONDITIONS else "number"
        name = value.trace.names.get(value) or f"{kind[0]}{len(self._names[kind]) + 1}"
        self._names[kind].append(name)
        self._lines.append(self._language.assignment(name, text, kind=kind))
        self._texts[value] = name
        return name

    def _operation(self, value: Expression) -> str:
        return self._language.operation(value.operation, [self._text(operand) for operand in value.operands])


def _unbracketed(text: str) -> str:
    """Return a text without the brackets around all of it."""
    if not text.startswith("("):
        return text
    depth = 0
    for i, sign in enumerate(text):
        depth += {"(": 1, ")": -1}.get(sign, 0)
        if depth == 0:
            return text[1:-1] if i == len(text) - 1 else text
    return text
