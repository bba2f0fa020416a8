"""Traced expressions: values that record what is computed with them.

A `Trace` records one function of a kernel. Its values are `Expression`s; arithmetic on them and the functions of
`elementwise` add nodes to a graph in which equal nodes exist only once. `trace_source` writes the graph as source text.
Identifiers are made of fixed words and numbers only: no name from a machine file reaches generated text.
"""

from __future__ import annotations

import contextlib
import math
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

_BINDING = {
    "<": 1,
    "<=": 1,
    ">": 1,
    ">=": 1,
    "==": 1,
    "!=": 1,
    "|": 2,
    "&": 3,
    "+": 4,
    "-": 4,
    "*": 5,
    "/": 5,
    "neg": 6,
}
_ATOM = 7


class Expression:
    """A node of a trace: a number, a variable, an element of an array, or an operation on other nodes.

    Attributes:
        trace: Trace to which the node belongs.
        operation: "number", "variable", "load", an operator, or the name of a function.
        operands: Operands; of a number its text, of a load its text, of a variable its name and its version. Every
            assignment to a variable makes a new version.
        invariant: Whether the value is the same in all steps of the loop.
        variables: Reassigned variables on which the value depends.
    """

    __slots__ = ("invariant", "operands", "operation", "trace", "variables")
    __array_ufunc__ = None  # NumPy scalars leave mixed operations to this class

    def __init__(self, trace: Trace, operation: str, operands: tuple[Any, ...], *, invariant: bool) -> None:
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
        """Whether the node is a number or a variable."""
        return self.operation in ("number", "variable")

    def traced_function(self, name: str, operands: Sequence[Any]) -> Expression:
        """Return the node of a function of `elementwise`."""
        return self.trace.node(name, *operands)

    def name_as(self, role: str, index: int) -> Expression:
        """Give the value the name `role_index` in generated source, computed at this point of the trace."""
        return self.trace.let(role, index, self)

    def __bool__(self) -> bool:
        raise TypeError("a formula cannot branch on its arguments; use hframe_gym.dynamics.elementwise.where")

    __hash__ = object.__hash__

    def __neg__(self) -> Expression:
        return self.trace.node("neg", self)

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
        values: Values in the line.
        sets: Variables that the line sets.
        body: Lines of a block.
        loop: Whether the block repeats.
    """

    text: str
    values: tuple[Expression, ...] = ()
    sets: tuple[Expression, ...] = ()
    body: list[Statement] = field(default_factory=list)
    loop: bool = False


class Trace:
    """One function of a kernel.

    Args:
        signature: Name and arguments of the function, for example "prepare(parameters, derived, h)".

    Attributes:
        statements: Lines of the function.
        names: Identifiers of the values that have one.
    """

    def __init__(self, signature: str) -> None:
        self.signature = signature
        self._nodes: dict[tuple[Any, ...], Expression] = {}
        self.names: dict[Expression, str] = {}
        self._taken: Counter[str] = Counter()
        self._prefix = ""
        self.statements: list[Statement] = []
        self._block = self.statements

    # -- values ----------------------------------------------------------------------------------------------------

    def node(self, operation: str, *operands: Any) -> Expression:
        """Return the node of an operation, simplified where the result is exact."""
        values = tuple(map(self.expression, operands))
        simple = _simplified(operation, values)
        if simple is not None:
            return simple
        return self._unique(operation, values, invariant=all(v.invariant for v in values))

    def _unique(self, operation: str, operands: tuple[Any, ...], *, invariant: bool) -> Expression:
        key = (operation, *(id(o) if isinstance(o, Expression) else o for o in operands))
        if key not in self._nodes:
            self._nodes[key] = Expression(self, operation, operands, invariant=invariant)
        return self._nodes[key]

    def expression(self, value: Any) -> Expression:
        """Return a value as expression: numbers become nodes, expressions stay."""
        if isinstance(value, Expression):
            return value
        number = float(value)
        if not math.isfinite(number):
            raise ValueError(f"a formula contains the number {number}")
        # repr distinguishes 0.0 from -0.0, which are equal as keys.
        return self._unique("number", (repr(number),), invariant=True)

    def argument(self, name: str) -> Expression:
        """Return an argument of the function that it does not change."""
        return self._unique("variable", (name, 0), invariant=True)

    def load(self, array: str, row: int | str, name: str, *, invariant: bool = True) -> Expression:
        """Return a row of an array argument.

        Args:
            array: Name of the argument.
            row: Index of the row, as a number or as source text.
            name: Identifier of the value; empty if it is used once.
            invariant: Whether the row is the same in all steps of the loop.
        """
        value = self._unique("load", (f"load({array}, {row})",), invariant=invariant)
        if name:
            self.names[value] = name
        return value

    def let(self, role: str, index: int | None, value: Expression) -> Expression:
        """Name a value and compute it at this point.

        Args:
            role: What the value is: a fixed identifier.
            index: Index of the coordinate, belt, drive, sensor or effect; None for none.
            value: The value.

        Returns:
            The value.
        """
        if not value.is_leaf and value not in self.names:
            self.names[value] = self._identifier(role, index)
            self._block.append(Statement("", (value,)))
        return value

    def _identifier(self, role: str, index: int | None) -> str:
        name = f"{self._prefix}{role}" if index is None else f"{self._prefix}{role}_{index}"
        self._taken[name] += 1
        return name if self._taken[name] == 1 else f"{name}_again_{self._taken[name]}"

    # -- statements ------------------------------------------------------------------------------------------------

    def variable(self, role: str, index: int | None, value: Expression) -> Expression:
        """Return a new variable with a starting value; `assign` changes it."""
        variable = self._unique("variable", (self._identifier(role, index), 0), invariant=False)
        self._block.append(Statement(f"{variable.operands[0]} = {{}}", (value,), (variable,)))
        return variable

    def call(self, function: str, *arguments: Any, results: Sequence[tuple[str, int | None]]) -> list[Expression]:
        """Call a function that returns several values; results: role and index of each. Return them as variables."""
        variables = [self._unique("variable", (self._identifier(*name), 0), invariant=False) for name in results]
        values = tuple(map(self.expression, arguments))
        text = f"{', '.join(v.operands[0] for v in variables)} = {function}({', '.join(['{}'] * len(values))})"
        self._block.append(Statement(text, values, tuple(variables)))
        return variables

    def assign(self, variable: Expression, value: Expression) -> Expression:
        """Change a variable; return its new version, which later expressions must use."""
        name, version = variable.operands
        changed = self._unique("variable", (name, version + 1), invariant=False)
        self._block.append(Statement(f"{name} = {{}}", (value,), (changed,)))
        return changed

    def store(self, array: str, row: int, value: Any) -> None:
        """Write a value to a row of an array argument."""
        value = self.expression(value)
        self._block.append(Statement(f"store({array}, {row}, {{}})", (value,)))

    def line(self, text: str) -> None:
        """Add a line as it is."""
        self._block.append(Statement(text))

    @contextlib.contextmanager
    def section(self, comment: str, prefix: str = "") -> Iterator[None]:
        """Add a comment; names that are given inside begin with `prefix`."""
        self._block.append(Statement(f"# {comment}"))
        self._prefix = prefix
        yield
        self._prefix = ""

    @contextlib.contextmanager
    def block(self, head: str, *values: Expression, loop: bool = False) -> Iterator[None]:
        """Add a block, `head` being its first line; loop: whether it repeats."""
        statement = Statement(head, values)
        self._block.append(statement)
        outer, self._block = self._block, statement.body
        if loop:
            statement.loop = True
        yield
        self._block = outer

    def update_if_any(
        self, condition: Expression, values: Sequence[Any], update: Callable[[Sequence[Any]], Sequence[Any]]
    ) -> list[Expression]:
        """Update values inside an `if any_of(condition)` block; see `elementwise.update_if_any`."""
        variables = [self.variable("guarded", i, self.expression(value)) for i, value in enumerate(values)]
        with self.block("if any_of({}):", condition):
            return [self.assign(v, value) for v, value in zip(variables, update(variables), strict=True)]


def _simplified(operation: str, values: tuple[Expression, ...]) -> Expression | None:
    """Return the result of operations that need no instruction, or None."""
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
        return trace.expression({"+": a + b, "-": a - b, "*": a * b, "/": a / b if b else math.inf}[operation])
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
