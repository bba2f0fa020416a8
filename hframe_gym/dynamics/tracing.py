"""Traced expressions: values that record what is computed with them.

A `Trace` records one function of a simulation kernel (generated code). Its values are `Expression`s; arithmetic on them
and the functions of `elementwise` add nodes to a graph in which equal nodes exist only once.
`expressions.function_source` writes the graph as source text. Identifiers are made of fixed words and numbers only: no
name of a machine file reaches generated text.
"""

from __future__ import annotations

import contextlib
import math
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from .elementwise import where
from .expressions import Expression, Statement, simplified


class Trace:
    """Recorder of one function of the generated simulation code: its expressions and statements.

    Args:
        signature: Name and arguments of the function, for example "prepare(parameters, derived, h)".

    Attributes:
        statements: Statements of the function, in order.
        names: Identifier in the source text of each expression that has one.
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
        """Return the expression of an operation in the traced function, simplified where that is exact (x * 1 to x).

        Args:
            operation: Operator such as "+" or "neg", or name of a function such as "sin".
            *operands: Expressions of this trace, and finite numbers.

        Returns:
            The expression; equal operations on the same operands give the same object.

        Raises:
            ValueError: If a number is not finite.
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
            value: Expression of this trace, or a number.

        Returns:
            The expression itself, or an expression of the number.

        Raises:
            ValueError: If the number is not finite.
        """
        if isinstance(value, Expression):
            return value
        number = float(value)
        if not math.isfinite(number):
            raise ValueError(f"a formula contains the number {number}")
        # repr distinguishes 0.0 from -0.0, which are equal as keys.
        return self._unique("number", (repr(number),), invariant=True)

    def argument(self, name: str) -> Expression:
        """Return the expression of a scalar argument of the traced function, for example the step length h.

        Args:
            name: Name of the argument in the signature.

        Returns:
            Variable that the function does not change, so that it has the same value in all steps of the loop.
        """
        return self._unique("variable", (name, 0), invariant=True)

    def load(self, array: str, row: int | str, name: str, *, invariant: bool = True) -> Expression:
        """Return the expression of one row of an array argument of the traced function (one value per machine).

        Args:
            array: Name of the argument in the signature; array of shape (rows, LANES), one machine per column.
            row: Index of the row, as a number or as source text such as "step * 2 + 0".
            name: Identifier of the value in the source text; empty to write the load where the value is used.
            invariant: Whether the row is the same in all steps of the integration loop.

        Returns:
            Expression of the loaded row.
        """
        value = self._unique("load", (f"load({array}, {row})",), invariant=invariant)
        if name:
            self.names[value] = name
        return value

    def let(self, role: str, index: int | None, value: Expression) -> Expression:
        """Give an expression an identifier, and compute it at this place of the generated function.

        Args:
            role: First part of the identifier, for example "tension". The prefix of the section precedes it.
            index: Second part: index of the coordinate, belt, drive, sensor or effect; None for no second part.
            value: Expression to name. Numbers, variables and expressions that have an identifier remain as they are.

        Returns:
            The same expression.
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
        """Append the definition of a variable with an initial value to the generated function; `assign` changes it.

        Args:
            role: First part of the variable's name, for example "speed".
            index: Second part: index of the coordinate, belt, drive, sensor or effect; None for no second part.
            value: Initial value.

        Returns:
            Expression of the variable in its first version.
        """
        variable = self._unique("variable", (self._identifier(role, index), 0), invariant=False)
        self._block.append(Statement(f"{variable.operands[0]} = {{}}", (value,), (variable,)))
        return variable

    def call(self, function: str, *arguments: Any, results: Sequence[tuple[str, int | None]]) -> list[Expression]:
        """Append a call of a function that returns a tuple of several values to the generated function.

        Args:
            function: Name of the function in the generated module.
            *arguments: Arguments of the call: expressions of this trace, and finite numbers.
            results: Name of the variable for each returned value, as two parts: role ("speed") and index, or None.

        Returns:
            One variable per returned value.
        """
        variables = [self._unique("variable", (self._identifier(*name), 0), invariant=False) for name in results]
        values = tuple(map(self.expression, arguments))
        text = f"{', '.join(v.operands[0] for v in variables)} = {function}({', '.join(['{}'] * len(values))})"
        self._block.append(Statement(text, values, tuple(variables)))
        return variables

    def assign(self, variable: Expression, value: Expression) -> Expression:
        """Append an assignment of a new value to a variable of the generated function.

        Args:
            variable: Latest version of the variable.
            value: Expression of the new value.

        Returns:
            The new version, which later expressions must use.
        """
        name, version = variable.operands
        changed = self._unique("variable", (name, version + 1), invariant=False)
        self._block.append(Statement(f"{name} = {{}}", (value,), (changed,)))
        return changed

    def store(self, array: str, row: int, value: Any) -> None:
        """Append a statement that writes a value to a row of an array argument.

        Args:
            array: Name of an array argument of the generated function, shape (rows, LANES) with one machine per column;
                LANES is the number of machines that are computed together.
            row: Index of the row.
            value: Expression, or a finite number for all machines.

        Raises:
            ValueError: If the number is not finite.
        """
        value = self.expression(value)
        self._block.append(Statement(f"store({array}, {row}, {{}})", (value,)))

    def line(self, text: str) -> None:
        """Append one line of source code to the current block of the generated function, unchanged.

        Args:
            text: Source text without indentation and line break.
        """
        self._block.append(Statement(text))

    @contextlib.contextmanager
    def section(self, comment: str, prefix: str = "") -> Iterator[None]:
        """Append a comment, and give a prefix to all identifiers that are assigned in the `with` block.

        Args:
            comment: Text of the comment, without "#".
            prefix: Prefix of the identifiers, for example "half_".

        Yields:
            None.
        """
        self._block.append(Statement(f"# {comment}"))
        self._prefix = prefix
        yield
        self._prefix = ""

    @contextlib.contextmanager
    def block(self, head: str, *values: Expression, loop: bool = False) -> Iterator[None]:
        """Append a compound statement to the generated function; the `with` block appends its indented body.

        Args:
            head: First line such as "if any_of({}):", with "{}" for each value.
            *values: Expressions in that line.
            loop: Whether the compound statement is a loop.

        Yields:
            None.
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
        """Append a block `if any_of(condition):` that updates values; it is skipped where no machine needs the update.

        Args:
            condition: Expression of a condition, one truth value per machine (SIMD lane).
            values: Expressions and numbers to update.
            update: Function from the values to the new values; it must change nothing where the condition is false.

        Returns:
            Variables with the updated values, in the order of `values`.
        """
        variables = [self.variable("guarded", i, self.expression(value)) for i, value in enumerate(values)]
        with self.block("if any_of({}):", condition):
            return [self.assign(v, value) for v, value in zip(variables, update(variables), strict=True)]


def first_of(conditions: Sequence[Any], values: Sequence[Any], otherwise: Any) -> Any:
    """Select for every machine the value that belongs to the first of some conditions that holds.

    Args:
        conditions: Expressions of conditions, one truth value per machine (SIMD lane).
        values: Expression or number for each condition; further ones are ignored.
        otherwise: Expression or number for machines where no condition holds.

    Returns:
        Expression of the selected values; `otherwise` itself without conditions.
    """
    selected = otherwise
    for condition, value in reversed(list(zip(conditions, values, strict=False))):
        selected = where(condition, value, selected)
    return selected
