"""Expressions and statements of a function whose source text is generated, and the generation of this text.

A `Trace` (module `tracing`) records them. In the source text, a value that is the same in all steps of a loop
is computed before the loop, and a value that is needed only inside an `if` block is computed there.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

# Binding strength of operators in Python: a stronger one needs no brackets inside a weaker one.
_COMPARISONS = dict.fromkeys(("<", "<=", ">", ">=", "==", "!="), 1)
_BINDING = {**_COMPARISONS, "|": 2, "&": 3, "+": 4, "-": 4, "*": 5, "/": 5, "neg": 6}
_ATOM = 7  # names, numbers and calls


class Recorder(Protocol):
    """The part of a `tracing.Trace`, the record of a function, that its expressions need."""

    signature: str
    names: dict[Expression, str]
    statements: list[Statement]

    def node(self, operation: str, *operands: Any) -> Expression:
        """Return the expression of an operation, see `tracing.Trace.node`."""

    def expression(self, value: Any) -> Expression:
        """Convert a finite number to an expression; return an expression unchanged."""

    def let(self, role: str, index: int, value: Any) -> Expression:
        """Give an expression the name role_index in the source text, see `tracing.Trace.let`; return it."""

    def update_if_any(
        self, condition: Expression, values: Sequence[Any], update: Callable[[Sequence[Any]], Sequence[Any]]
    ) -> list[Expression]:
        """Append a block that updates values where a condition is true, see `tracing.Trace.update_if_any`."""


class Expression:
    """A value in a generated function: a number, a variable, a row of an array, or an operation on values.

    Attributes:
        trace: Record of the function to which the expression belongs.
        operation: "number", "variable", "load" (row of an array), an operator such as "+", or the name of a
            function.
        operands: Operands of an operation. A number or load has its source text here; a variable has its name
            and a version number, which every assignment to the variable increases.
        invariant: Whether the value is the same in all steps of the loop.
        variables: Reassigned variables on which the value depends.
    """

    __slots__ = ("invariant", "operands", "operation", "trace", "variables")
    __array_ufunc__ = None  # NumPy scalars leave mixed operations to this class

    def __init__(
        self, trace: Recorder, operation: str, operands: tuple[Any, ...], *, invariant: bool
    ) -> None:
        self.trace = trace
        self.operation = operation
        self.operands = operands
        self.invariant = invariant
        self.variables: frozenset[Expression] = frozenset()
        if operation == "variable":
            self.variables = frozenset() if invariant else frozenset([self])
        else:
            self.variables = frozenset().union(*(o.variables for o in operands if isinstance(o, Expression)))

    @property
    def is_leaf(self) -> bool:
        """Whether the expression is a number or a variable, for which the generated code computes nothing."""
        return self.operation in ("number", "variable")

    def __bool__(self) -> bool:
        raise TypeError(
            "a formula cannot branch on its arguments "
            "(`hframe_gym.dynamics.elementwise.where` selects a value)"
        )

    __hash__ = object.__hash__

    def __neg__(self) -> Expression:
        return self.trace.node("neg", self)

    def __abs__(self) -> Expression:
        return self.trace.node("absolute", self)

    def __add__(self, other: Any) -> Expression:
        return self.trace.node("+", self, other)

    def __radd__(self, other: Any) -> Expression:
        return self.trace.node("+", other, self)

    def __sub__(self, other: Any) -> Expression:
        return self.trace.node("-", self, other)

    def __rsub__(self, other: Any) -> Expression:
        return self.trace.node("-", other, self)

    def __mul__(self, other: Any) -> Expression:
        return self.trace.node("*", self, other)

    def __rmul__(self, other: Any) -> Expression:
        return self.trace.node("*", other, self)

    def __truediv__(self, other: Any) -> Expression:
        return self.trace.node("/", self, other)

    def __rtruediv__(self, other: Any) -> Expression:
        return self.trace.node("/", other, self)

    def __pow__(self, exponent: int) -> Expression:
        if not isinstance(exponent, int) or exponent < 1:
            raise TypeError(f"a formula may use ** with positive integers only, not {exponent!r}")
        return self if exponent == 1 else self * self ** (exponent - 1)

    def __lt__(self, other: Any) -> Expression:
        return self.trace.node("<", self, other)

    def __le__(self, other: Any) -> Expression:
        return self.trace.node("<=", self, other)

    def __gt__(self, other: Any) -> Expression:
        return self.trace.node(">", self, other)

    def __ge__(self, other: Any) -> Expression:
        return self.trace.node(">=", self, other)

    def __eq__(self, other: Any) -> Expression:  # type: ignore[override]
        return self.trace.node("==", self, other)

    def __ne__(self, other: Any) -> Expression:  # type: ignore[override]
        return self.trace.node("!=", self, other)

    def __and__(self, other: Any) -> Expression:
        return self.trace.node("&", self, other)

    def __or__(self, other: Any) -> Expression:
        return self.trace.node("|", self, other)


@dataclass
class Statement:
    """A line of the function, or a block of lines.

    Attributes:
        text: Template of the line; "{}" marks the places of the values.
        sets: Variables to which the line assigns.
        body: Statements of the indented block below the line; empty for a simple statement.
        loop: Whether the block is the body of a loop.
    """

    text: str
    values: tuple[Expression, ...] = ()
    sets: tuple[Expression, ...] = ()
    body: list[Statement] = field(default_factory=list)
    loop: bool = False


def simplified(operation: str, values: tuple[Expression, ...]) -> Expression | None:
    """Simplify an operation, such as 2 + 3, x + 0 or x * 1, if possible; else return None.

    At most the sign of a zero may change.

    Raises:
        ValueError: If an operation on two numbers gives no finite number.
    """
    # The value of each operand that is a number, else None.
    numbers = [float(v.operands[0]) if v.operation == "number" else None for v in values]
    trace = values[0].trace
    if operation == "neg":
        if numbers[0] is not None:
            return trace.expression(-numbers[0])
        return values[0].operands[0] if values[0].operation == "neg" else None
    if operation not in ("+", "-", "*", "/"):
        return None
    (a, b), (first, second) = numbers, values
    if a is not None and b is not None:
        return trace.expression(
            {"+": a + b, "-": a - b, "*": a * b, "/": a / b if b else math.inf}[operation]
        )
    if operation in ("+", "-"):
        if b == 0.0:
            return first
        if a == 0.0:
            return second if operation == "+" else -second
        if second.operation == "neg":
            return trace.node("-" if operation == "+" else "+", first, second.operands[0])
    elif b == 1.0:
        return first
    elif operation == "*" and a == 1.0:
        return second
    return None


def function_source(trace: Recorder) -> str:
    """Write the source text of a traced function, which `lane_compiler` compiles.

    A RuntimeError refuses a function that uses the value of a variable from before an assignment.
    """
    return "\n".join([f"def {trace.signature}:", *_Writer(trace.statements, trace.names).lines]) + "\n"


class _Writer:
    """Writes the statements of a trace.

    A value gets a separate line if it has a name, is used more than once, or is computed before the loop.
    """

    def __init__(self, statements: list[Statement], names: dict[Expression, str]) -> None:
        self._names = names
        self._uses: Counter[Expression] = Counter()
        self._count(statements, set())
        self._temporaries = 0
        self._versions: dict[str, int] = {}
        self._before_loop: list[str] | None = None
        self._constants: dict[Expression, str] = {}
        self.lines = self._write(statements, {}, 1)

    def _count(self, statements: Sequence[Statement], visited: set[Expression]) -> None:
        """Count in how many places each value is used."""

        def visit(value: Expression) -> None:
            self._uses[value] += 1
            if value not in visited:
                visited.add(value)
                for operand in value.operands:
                    if isinstance(operand, Expression):
                        visit(operand)

        for statement in statements:
            if statement.text:  # a `let` is no use
                for value in statement.values:
                    visit(value)
            self._count(statement.body, visited)

    def _write(
        self, statements: Sequence[Statement], computed: dict[Expression, str], depth: int
    ) -> list[str]:
        """Return the lines of statements; computed: identifiers of values that exist already."""
        margin = "    " * depth
        lines: list[str] = []
        for statement in statements:
            if not statement.text:
                if self._uses[statement.values[0]]:  # values that nothing needs are left out
                    self._text(statement.values[0], computed, lines, margin)
                continue
            texts = [self._text(v, computed, lines, margin)[0] for v in statement.values]
            if statement.loop:
                self._before_loop, outside = lines, lines
                changing = {v.operands[0] for v in _set_in(statement.body)}
                steady = {
                    v: n for v, n in computed.items() if not changing & {x.operands[0] for x in v.variables}
                }
                inside = self._write(statement.body, steady, depth + 1)
                self._before_loop = None
                lines = [*outside, margin + statement.text, *inside]
                continue
            lines.append(margin + statement.text.format(*texts) if texts else margin + statement.text)
            if statement.body:
                lines += self._write(statement.body, dict(computed), depth + 1)
            self._versions |= dict(v.operands for v in statement.sets)
        return lines

    def _text(
        self, value: Expression, computed: dict[Expression, str], lines: list[str], margin: str
    ) -> tuple[str, int]:
        """Return a value's text and how tightly it binds; lines needed first are appended to `lines`."""
        if value.is_leaf:
            text = str(value.operands[0])
            if value.operation == "variable" and value.operands[1] != self._versions.get(text, 0):
                raise RuntimeError(
                    f"{text} has changed since an expression used it; name the expression before"
                )
            return text, _ATOM if not text.startswith("-") else _BINDING["neg"]
        if value in computed:
            return computed[value], _ATOM
        if value.invariant and self._before_loop is not None:
            if value not in self._constants:
                outside, self._before_loop = self._before_loop, None
                self._constants[value] = self._temporary(value, self._constants, outside, "    ")
                self._before_loop = outside
            return self._constants[value], _ATOM
        if value in self._names or self._uses[value] > 1:
            computed[value] = self._temporary(value, computed, lines, margin)
            return computed[value], _ATOM
        return self._formula(value, computed, lines, margin)

    def _temporary(
        self, value: Expression, computed: dict[Expression, str], lines: list[str], margin: str
    ) -> str:
        """Append a line that computes a value; return its identifier."""
        if value in computed:
            return computed[value]
        text, _ = self._formula(value, computed, lines, margin)
        name = self._names.get(value)
        if name is None:
            self._temporaries += 1
            name = f"t{self._temporaries}"
        lines.append(f"{margin}{name} = {text}")
        computed[value] = name
        return name

    def _formula(
        self, value: Expression, computed: dict[Expression, str], lines: list[str], margin: str
    ) -> tuple[str, int]:
        """Return the text that computes a value from its operands."""
        if value.operation == "load":
            return str(value.operands[0]), _ATOM
        texts = [self._text(o, computed, lines, margin) for o in value.operands]
        binding = _BINDING.get(value.operation)
        if binding is None:
            return f"{value.operation}({', '.join(text for text, _ in texts)})", _ATOM
        if value.operation == "neg":
            return f"-{_bracketed(*texts[0], binding)}", binding
        left, right = texts
        return f"{_bracketed(*left, binding)} {value.operation} {_bracketed(*right, binding + 1)}", binding


def _bracketed(text: str, binding: int, required: int) -> str:
    """Return text in brackets if it binds less tightly than required."""
    return text if binding >= required else f"({text})"


def _set_in(statements: Sequence[Statement]) -> set[Expression]:
    """Return the variables that statements set, at any depth."""
    return {v for s in statements for v in (*s.sets, *_set_in(s.body))}
