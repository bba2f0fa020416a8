"""Values of a traced function: nodes of a graph of expressions, which record what is computed with them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .tracing import Trace


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
        """Return the node of a function of `elementwise`.

        Args:
            name: Name of the function.
            operands: Expressions and numbers.

        Returns:
            The node.
        """
        return self.trace.node(name, *operands)

    def name_as(self, role: str, index: int) -> Expression:
        """Give the value the name `role_index` in generated source, computed at this point of the trace.

        Args:
            role: What the value is: a fixed identifier.
            index: Index of the coordinate, belt, drive, sensor or effect.

        Returns:
            The same value.
        """
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


def simplified(operation: str, values: tuple[Expression, ...]) -> Expression | None:
    """Simplify an operation where the result is exact.

    Args:
        operation: Name of the operation.
        values: Operands.

    Returns:
        The result, or None if the operation needs an instruction.
    """
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
