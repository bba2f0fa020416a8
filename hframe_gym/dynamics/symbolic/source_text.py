"""Source text of a traced function.

A value that is the same in all steps of a loop is computed before the loop, and a value that is needed only
inside an `if` block is computed there.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from .tracing import Expression, Statement, Trace

# Binding strength of operators in Python: a stronger one needs no brackets inside a weaker one.
_COMPARISONS = dict.fromkeys(("<", "<=", ">", ">=", "==", "!="), 1)
_BINDING = {**_COMPARISONS, "|": 2, "&": 3, "+": 4, "-": 4, "*": 5, "/": 5, "neg": 6}
_ATOM = 7  # names, numbers and calls


def function_source(trace: Trace) -> str:
    """Write the source text of a traced function, which `lane_compiler` compiles.

    A RuntimeError refuses a function that uses the value of a variable from before an assignment.
    """
    return "\n".join([f"def {trace.signature}:", *_Writer(trace.statements, trace.names).lines]) + "\n"


def count_uses(value: Expression, uses: Counter[Expression]) -> None:
    """Count one more use of a value and, if it is its first one, one more use of each of its operands.

    Args:
        value: Expression that a statement uses.
        uses: Number of uses by expression; increased here.
    """
    uses[value] += 1
    if uses[value] == 1:
        for operand in value.operands:
            if isinstance(operand, Expression):
                count_uses(operand, uses)


class _Writer:
    """Writes the statements of a trace.

    A value gets a separate line if it has a name, is used more than once, or is computed before the loop.
    """

    def __init__(self, statements: list[Statement], names: dict[Expression, str]) -> None:
        self._names = names
        self._uses: Counter[Expression] = Counter()
        self._count(statements)
        self._temporaries = 0
        self._versions: dict[str, int] = {}
        self._before_loop: list[str] | None = None
        self._constants: dict[Expression, str] = {}
        self.lines = self._write(statements, {}, 1)

    def _count(self, statements: Sequence[Statement]) -> None:
        """Count in how many places each value is used."""
        for statement in statements:
            if statement.text:  # a `let` is no use
                for value in statement.values:
                    count_uses(value, self._uses)
            self._count(statement.body)

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
