"""Programming languages of controllers: how expressions, assignments and bodies of formulas are written."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

from ...dynamics.symbolic.source_text import count_uses
from ...dynamics.symbolic.tracing import Expression
from .formula import Formula

_CONDITIONS = ("<", "<=", ">", ">=", "==", "!=", "&", "|")
_BINARY = (*_CONDITIONS, "+", "-", "*", "/")
_INFIX = (*_BINARY, "neg", "fma", "where")  # not written as calls, in C at least


class Language(ABC):
    """Writer of expressions and assignments in one programming language.

    Args:
        prefix: Prefix of the names of all functions.

    Attributes:
        functions: Names of functions of the standard library by name in `dynamics.elementwise` (class
            attribute).
        signs: Signs of the operators that differ from Python's (class attribute).
        helpers: Names of the functions beyond the standard library that the text written so far uses.
    """

    functions: ClassVar[Mapping[str, str]]
    signs: ClassVar[Mapping[str, str]]

    def __init__(self, prefix: str) -> None:
        self.prefix = prefix
        self.helpers: set[str] = set()

    @abstractmethod
    def number(self, text: str) -> str:
        """Write a number of the language, such as "1.0E-3".

        Args:
            text: The number in Python's notation, "1e-3".
        """

    @abstractmethod
    def choice(self, condition: str, yes: str, no: str) -> str:
        """Write an expression that is `yes` where the condition holds, else `no`.

        All three are source texts of the language: a name, number or call, or an expression in brackets.
        """

    def operation(self, name: str, operands: Sequence[str]) -> str:
        """Write an operation or function call as an expression without brackets around it.

        Args:
            name: Operator such as "+" or name of a function in `dynamics.elementwise`.
            operands: Source texts: a name, number or call, or an expression in brackets.
        """
        if name == "neg":
            return f"-{operands[0]}"
        if name == "fma":
            return f"{operands[0]} * {operands[1]} + {operands[2]}"
        if name == "where":
            return self.choice(*operands)
        if name in _BINARY:
            return f"{operands[0]} {self.signs.get(name, name)} {operands[1]}"
        if name not in self.functions:
            self.helpers.add(name)
        function = self.functions.get(name, f"{self.prefix}_{name}")
        return f"{function}({', '.join(map(unbracketed, operands))})"

    @abstractmethod
    def assignment(self, target: str, value: str, *, kind: str) -> str:
        """Write a line that assigns a value to a target.

        Args:
            kind: "number" or "condition" for a new name, "output" for an existing one.
        """


@dataclass(frozen=True)
class Body:
    """Source text of a formula.

    Attributes:
        lines: Lines of the assignments, without indentation.
        numbers: Names of new numbers.
        conditions: Names of new truth values.
        used: Texts of the inputs and parameters that occur.
    """

    lines: tuple[str, ...]
    numbers: tuple[str, ...]
    conditions: tuple[str, ...]
    used: frozenset[str]


def write_body(formula: Formula, language: Language) -> Body:
    """Write the assignments of a formula: common parts first, each computed once, then the outputs.

    Args:
        language: Writer, to whose `helpers` the functions that the text uses are added.

    Returns:
        Lines without indentation, names of new numbers and of new truth values, and the texts of the inputs
        and parameters that occur.
    """
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
        for result in formula.results:
            count_uses(result, self._uses)
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

    def _unbracketed(self, value: Expression) -> str:
        return unbracketed(self._text(value))

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


def unbracketed(text: str) -> str:
    """Remove brackets that enclose the complete text."""
    if not text.startswith("("):
        return text
    depth = 0
    for i, sign in enumerate(text):
        depth += {"(": 1, ")": -1}.get(sign, 0)
        if depth == 0:
            return text[1:-1] if i == len(text) - 1 else text
    return text
