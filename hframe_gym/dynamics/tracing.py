"""Traced expressions: values that record what is computed with them.

A `Trace` records one function of a kernel. Its values are `Expression`s; arithmetic on them and the functions of
`elementwise` add nodes to a graph in which equal nodes exist only once. `expressions.function_source` writes the graph
as source text. Identifiers are made of fixed words and numbers only: no name of a machine file reaches generated text.
"""

from __future__ import annotations

import contextlib
import math
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from .expressions import Expression, Statement, simplified


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
        """Return the node of an operation, simplified where the result is exact.

        Args:
            operation: Operator, or name of a function of `elementwise`.
            *operands: Expressions and numbers.

        Returns:
            The node; equal operations give the same node.
        """
        values = tuple(map(self.expression, operands))
        simple = simplified(operation, values)
        if simple is not None:
            return simple
        return self._unique(operation, values, invariant=all(v.invariant for v in values))

    def _unique(self, operation: str, operands: tuple[Any, ...], *, invariant: bool) -> Expression:
        key = (operation, *(id(o) if isinstance(o, Expression) else o for o in operands))
        if key not in self._nodes:
            self._nodes[key] = Expression(self, operation, operands, invariant=invariant)
        return self._nodes[key]

    def expression(self, value: Any) -> Expression:
        """Convert a value to an expression.

        Args:
            value: Expression of this trace, or a finite number.

        Returns:
            The expression; a number becomes a node.
        """
        if isinstance(value, Expression):
            return value
        number = float(value)
        if not math.isfinite(number):
            raise ValueError(f"a formula contains the number {number}")
        # repr distinguishes 0.0 from -0.0, which are equal as keys.
        return self._unique("number", (repr(number),), invariant=True)

    def argument(self, name: str) -> Expression:
        """Return an argument of the function that it does not change.

        Args:
            name: Name of the argument.

        Returns:
            A variable that is the same in all steps of the loop.
        """
        return self._unique("variable", (name, 0), invariant=True)

    def load(self, array: str, row: int | str, name: str, *, invariant: bool = True) -> Expression:
        """Return a row of an array argument.

        Args:
            array: Name of the argument.
            row: Index of the row, as a number or as source text.
            name: Identifier of the value; empty if it is used once.
            invariant: Whether the row is the same in all steps of the loop.

        Returns:
            The row.
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
        """Return a new variable with a starting value; `assign` changes it.

        Args:
            role: What the value is: a fixed identifier.
            index: Index of the coordinate, belt, drive, sensor or effect; None for none.
            value: Starting value.

        Returns:
            The variable.
        """
        variable = self._unique("variable", (self._identifier(role, index), 0), invariant=False)
        self._block.append(Statement(f"{variable.operands[0]} = {{}}", (value,), (variable,)))
        return variable

    def call(self, function: str, *arguments: Any, results: Sequence[tuple[str, int | None]]) -> list[Expression]:
        """Call a function that returns several values.

        Args:
            function: Name of the function.
            *arguments: Expressions and numbers.
            results: Role and index of each returned value.

        Returns:
            One variable per returned value.
        """
        variables = [self._unique("variable", (self._identifier(*name), 0), invariant=False) for name in results]
        values = tuple(map(self.expression, arguments))
        text = f"{', '.join(v.operands[0] for v in variables)} = {function}({', '.join(['{}'] * len(values))})"
        self._block.append(Statement(text, values, tuple(variables)))
        return variables

    def assign(self, variable: Expression, value: Expression) -> Expression:
        """Change a variable.

        Args:
            variable: Latest version of the variable.
            value: New value.

        Returns:
            The new version, which later expressions must use.
        """
        name, version = variable.operands
        changed = self._unique("variable", (name, version + 1), invariant=False)
        self._block.append(Statement(f"{name} = {{}}", (value,), (changed,)))
        return changed

    def store(self, array: str, row: int, value: Any) -> None:
        """Write a value to a row of an array argument.

        Args:
            array: Name of the argument.
            row: Index of the row.
            value: Expression or number.
        """
        value = self.expression(value)
        self._block.append(Statement(f"store({array}, {row}, {{}})", (value,)))

    def line(self, text: str) -> None:
        """Add a line as it is.

        Args:
            text: Source text without indentation.
        """
        self._block.append(Statement(text))

    @contextlib.contextmanager
    def section(self, comment: str, prefix: str = "") -> Iterator[None]:
        """Begin a section with a comment.

        Args:
            comment: Text of the comment.
            prefix: Prefix of the names that are given inside.

        Returns:
            Nothing; use it in a `with` statement.
        """
        self._block.append(Statement(f"# {comment}"))
        self._prefix = prefix
        yield
        self._prefix = ""

    @contextlib.contextmanager
    def block(self, head: str, *values: Expression, loop: bool = False) -> Iterator[None]:
        """Add a block of lines.

        Args:
            head: First line of the block, with "{}" for each value.
            *values: Values in that line.
            loop: Whether the block repeats.

        Returns:
            Nothing; use it in a `with` statement.
        """
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
        """Update values inside an `if any_of(condition)` block; see `elementwise.update_if_any`.

        Args:
            condition: Condition per lane.
            values: Values to update.
            update: Function of the values; where the condition does not hold it changes nothing.

        Returns:
            The updated values.
        """
        variables = [self.variable("guarded", i, self.expression(value)) for i, value in enumerate(values)]
        with self.block("if any_of({}):", condition):
            return [self.assign(v, value) for v, value in zip(variables, update(variables), strict=True)]
