"""Traced expressions: symbolic values that record which operations are applied to them.

A `Trace` is the record of one function that is to be generated for a simulation kernel. The equations are
evaluated once with `Expression`s instead of numbers. Arithmetic and the functions of `elementwise` add
expressions to the record, where equal ones exist only once; `source_text.function_source` then writes the
function as source text. Names in this text are made of fixed words and numbers only: no name of a machine
file gets into generated code.
"""

from __future__ import annotations

import contextlib
import math
import re
import traceback
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

_PACKAGE = Path(__file__).parents[1]  # dynamics
# Parts of the messages of Python and NumPy about functions and operators that accept neither expressions nor
# arrays.
_NUMBERS_ONLY = (
    r"\bufunc",  # np.tanh(v)
    r"real number, not '?Expression",  # math.sin(v), float(v)
    r"(Expression|numpy\.ndarray) doesn't define __\w+__",  # round(v)
    r"only (0-dimensional|length-1|size-1) arrays",  # math.sin of an array
    r"'Expression' and '(Expression|float|int)'|'(float|int)' and 'Expression'",  # v % 0.1
)


def _operator(sign: str) -> Callable[[Expression, Any], Expression]:
    """Return the method of an expression that records an operation with another value."""
    return lambda self, other: self.trace.node(sign, self, other)


def _reflected(sign: str) -> Callable[[Expression, Any], Expression]:
    """Return the method that records an operation whose first operand is the other value."""
    return lambda self, other: self.trace.node(sign, other, self)


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

    __add__, __radd__ = _operator("+"), _reflected("+")
    __sub__, __rsub__ = _operator("-"), _reflected("-")
    __mul__, __rmul__ = _operator("*"), _reflected("*")
    __truediv__, __rtruediv__ = _operator("/"), _reflected("/")
    __lt__, __le__, __gt__, __ge__ = map(_operator, ("<", "<=", ">", ">="))
    __eq__, __ne__ = _operator("=="), _operator("!=")  # type: ignore[assignment]
    __and__, __or__ = _operator("&"), _operator("|")

    def __pow__(self, exponent: int) -> Expression:
        if not isinstance(exponent, int) or exponent < 1:
            raise TypeError(f"a formula may use ** with positive integers only, not {exponent!r}")
        return self if exponent == 1 else self * self ** (exponent - 1)


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


class Trace:
    """Record of one function that is to be generated: its expressions and statements.

    Args:
        signature: Name and arguments of the function, for example "prepare(parameters, derived, h)".

    Attributes:
        names: Name in the source text of each expression that has one.
    """

    def __init__(self, signature: str) -> None:
        self.signature = signature
        self._nodes: dict[tuple[Any, ...], Expression] = {}
        self.names: dict[Expression, str] = {}
        self._taken: Counter[str] = Counter()
        self._prefix = ""
        self.statements: list[Statement] = []
        self._block = self.statements

    # -- values ----------------------------------------------------------------------------------------------

    def node(self, operation: str, *operands: Any) -> Expression:
        """Return the expression of an operation, such as a + b or sin(a); equal ones give the same object.

        Operations such as x + 0 are simplified, which may change the sign of a zero.

        Raises:
            ValueError: If a number, or the result of an operation on two numbers, is not finite.
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
        """Convert a number to an expression of the generated function; return an expression unchanged.

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
        """Return the symbol of a scalar argument of the generated function, for example h."""
        return self._unique("variable", (name, 0), invariant=True)

    def load(self, array: str, row: int | str, name: str, *, invariant: bool = True) -> Expression:
        """Return the expression that loads one row of an array argument of the generated function.

        Args:
            array: Name of the argument in the function's signature; an array of shape (rows, LANES).
            row: Index of the row, as a number or as source text such as "step * 2 + 0".
            name: Name of the value in the source text. If it is empty, the text loads the row where it uses
                the value.
            invariant: Whether the row is the same in all steps of the integration loop.
        """
        value = self._unique("load", (f"load({array}, {row})",), invariant=invariant)
        if name:
            self.names[value] = name
        return value

    def let(self, role: str, index: int | None, value: Expression) -> Expression:
        """Give an expression the name role_index in the source text, compute it at this point, and return it.

        Inside a block `with trace.section(comment, prefix)`, the prefix is put before the name. Numbers,
        variables and expressions that have a name already are left unchanged.
        """
        if not value.is_leaf and value not in self.names:
            self.names[value] = self._identifier(role, index)
            self._block.append(Statement("", (value,)))
        return value

    def _identifier(self, role: str, index: int | None) -> str:
        name = f"{self._prefix}{role}" if index is None else f"{self._prefix}{role}_{index}"
        self._taken[name] += 1
        return name if self._taken[name] == 1 else f"{name}_again_{self._taken[name]}"

    # -- statements ------------------------------------------------------------------------------------------

    def variable(self, role: str, index: int | None, value: Expression) -> Expression:
        """Append a statement that creates a variable `role_index` with a value; `assign` changes it later."""
        variable = self._unique("variable", (self._identifier(role, index), 0), invariant=False)
        self._block.append(Statement(f"{variable.operands[0]} = {{}}", (value,), (variable,)))
        return variable

    def call(
        self, function: str, *arguments: Any, results: Sequence[tuple[str, int | None]]
    ) -> list[Expression]:
        """Append a statement to the generated function that calls a function with several return values.

        Args:
            function: Name of the function in the source text.
            *arguments: Its arguments: expressions and finite numbers.
            results: For each returned value, the name of its variable in two parts: role ("speed") and index,
                or None.

        Returns:
            One variable per returned value.
        """
        variables = [
            self._unique("variable", (self._identifier(*name), 0), invariant=False) for name in results
        ]
        values = tuple(map(self.expression, arguments))
        text = (
            f"{', '.join(v.operands[0] for v in variables)} = {function}({', '.join(['{}'] * len(values))})"
        )
        self._block.append(Statement(text, values, tuple(variables)))
        return variables

    def assign(self, variable: Expression, value: Expression) -> Expression:
        """Append an assignment to a variable and return its new expression.

        Do not use the old one afterwards.
        """
        name, version = variable.operands
        changed = self._unique("variable", (name, version + 1), invariant=False)
        self._block.append(Statement(f"{name} = {{}}", (value,), (changed,)))
        return changed

    def store(self, array: str, row: int | str, value: Any) -> None:
        """Append a statement that writes an expression or a finite number to a row of an array argument."""
        value = self.expression(value)
        self._block.append(Statement(f"store({array}, {row}, {{}})", (value,)))

    def line(self, text: str) -> None:
        """Append one line of source text, without indentation, in the innermost `with trace.block(...)`."""
        self._block.append(Statement(text))

    @contextlib.contextmanager
    def section(self, comment: str, prefix: str = "") -> Iterator[None]:
        """Append a comment to the generated function; names given inside the `with` block get a prefix.

        The prefix, for example "half_" for forces in the middle of a step, distinguishes quantities that are
        computed more than once.
        """
        self._block.append(Statement(f"# {comment}"))
        self._prefix = prefix
        yield
        self._prefix = ""

    @contextlib.contextmanager
    def block(self, head: str, *values: Expression, loop: bool = False) -> Iterator[None]:
        """Append `if`, `while` or `for` to the generated function; the `with` block appends its body.

        Args:
            head: First line, for example "if any_of({}):", with "{}" in place of each value.
            *values: Expressions in that line.
            loop: Whether this is the loop over the steps of the integrator; values in its body that are the
                same in all steps are then computed before it.
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
        """Append a block that updates values only if a condition is true for a machine in a register.

        Args:
            condition: Expression of a condition, one truth value per machine.
            values: Expressions and numbers to update.
            update: Function from the values to the new values. It must leave the values of a machine
                unchanged whose condition is false.

        Returns:
            Variables with the updated values, in the order of `values`.
        """
        variables = [self.variable("guarded", i, self.expression(value)) for i, value in enumerate(values)]
        with self.block("if any_of({}):", condition):
            return [self.assign(v, value) for v, value in zip(variables, update(variables), strict=True)]


def evaluate_formula(label: str, function: Callable[..., Any], *values: Any) -> Any:
    """Return the result of a formula of an effect or a sensor kind.

    Args:
        label: What the formula belongs to, and its name, for the message of an error.
        function: The formula.
        *values: Its arguments.

    Raises:
        TypeError: If the formula cannot be evaluated, for example because it uses a function of NumPy, or
            returns nothing.
    """
    try:
        result = function(*values)
    except TypeError as error:
        raise TypeError(f"{label}: {_describe_formula_error(error)}") from error
    if result is None:
        raise TypeError(f"{label}: the formula returns nothing; it must return the value")
    return result


def _describe_formula_error(error: TypeError) -> str:
    """Describe an error in a formula by its line, its message and, where one helps, advice.

    The text is, for example, "drag.py, line 7: must be real number, not Expression; use the functions of
    ..."; without a line if the error was not raised in Python code outside this package.
    """
    frames = [
        f for f in traceback.extract_tb(error.__traceback__) if _PACKAGE not in Path(f.filename).parents
    ]
    # without functions of NumPy that it calls
    in_formula = [f for f in frames if f.filename == frames[0].filename]
    place = f"{Path(in_formula[-1].filename).name}, line {in_formula[-1].lineno}: " if in_formula else ""
    advise = re.search("|".join(_NUMBERS_ONLY), str(error))
    return f"{place}{error}{'; use the functions of hframe_gym.dynamics.elementwise' if advise else ''}"
