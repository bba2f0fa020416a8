"""Traced expressions against the same arithmetic on numbers."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from hframe_gym.dynamics import elementwise
from hframe_gym.dynamics.symbolic.source_text import function_source
from hframe_gym.dynamics.symbolic.tracing import Trace


def run(trace: Trace, **arguments: Any) -> list[float]:
    """Execute the source of a trace on plain numbers; return what it stored, by row."""
    names = ("absolute", "any_of", "copysign", "exp", "fma", "maximum", "minimum", "sin", "where")
    scope: dict[str, Any] = {name: getattr(elementwise, name) for name in names}
    stored: dict[int, float] = {}
    scope |= {
        "load": lambda array, row: array[row],
        "store": lambda array, row, value: stored.update({row: value}),
    }
    exec(function_source(trace), scope)
    scope[trace.signature.partition("(")[0]](**arguments)
    return [stored[row] for row in sorted(stored)]


def formula(a: Any, b: Any, c: Any) -> list[Any]:
    """Return values with every operator and precedence that formulas use."""
    return [
        a - (b - c),
        a / (b / c) * -c,
        -(a + b) * c - -a,
        elementwise.where((a < b) | ((b >= c) & (a != 0.5)), a * a**3, 2.0 - c),
        elementwise.fma(a, b, elementwise.maximum(c, 1.5) - 1.0 / a),
        elementwise.copysign(elementwise.exp(-a), b) + 0.0 * b + 1.0 * c,
    ]


@pytest.mark.parametrize("values", [(0.3, -1.2, 2.0), (2.0, 0.7, -0.4), (0.5, 0.6, 0.1)])
def test_traced_formula_equals_formula_of_numbers(values: tuple[float, float, float]) -> None:
    """Brackets and simplifications must not change a value."""
    trace = Trace("f(data, out)")
    for row, value in enumerate(formula(*(trace.load("data", i, f"d{i}") for i in range(3)))):
        trace.store("out", row, value)
    assert run(trace, data=values, out=None) == [float(v) for v in formula(*values)]


def test_loop_invariant_values_are_computed_before_the_loop() -> None:
    """Only what depends on a reassigned variable stays in the loop."""
    trace = Trace("f(data, out, steps)")
    a = trace.load("data", 0, "a")
    x = trace.variable("x", None, trace.load("data", 1, ""))
    with trace.block("for step in range(steps):", loop=True):
        x = trace.assign(x, x + elementwise.exp(a))
    trace.store("out", 0, x)
    before, _, inside = function_source(trace).partition("for step")
    assert "exp(" in before
    assert "exp(" not in inside
    assert run(trace, data=(0.5, 1.0), out=None, steps=3) == [pytest.approx(1.0 + 3 * np.exp(0.5))]


def test_named_value_keeps_its_value_when_a_variable_changes() -> None:
    """A value that was computed before an assignment is that of the old variable."""
    trace = Trace("f(data, out)")
    x = trace.variable("x", None, trace.load("data", 0, ""))
    before = trace.let("before", None, 2.0 * x)
    x = trace.assign(x, x + 1.0)
    trace.store("out", 0, before)
    trace.store("out", 1, 2.0 * x)
    assert run(trace, data=(3.0,), out=None) == [6.0, 8.0]


def test_stale_value_is_refused() -> None:
    """An expression of a variable that has changed since would read the new value."""
    trace = Trace("f(data, out)")
    x = trace.variable("x", None, trace.load("data", 0, ""))
    stale = 2.0 * x
    trace.assign(x, x + 1.0)
    trace.store("out", 0, stale)
    with pytest.raises(RuntimeError, match="x has changed"):
        function_source(trace)


def test_values_of_a_block_are_not_used_outside() -> None:
    """A value that is needed in an `if` block and after it is computed in both places."""
    trace = Trace("f(data, out)")
    a = trace.load("data", 0, "a")
    x = trace.variable("x", None, a)
    with trace.block("if any_of({}):", a > 1.0):
        x = trace.assign(x, elementwise.exp(a) * 2.0)
    trace.store("out", 0, x)
    trace.store("out", 1, elementwise.exp(a) * 3.0)
    for value in (0.5, 2.0):
        expected = [2.0 * np.exp(value) if value > 1.0 else value, 3.0 * np.exp(value)]
        assert run(trace, data=(value,), out=None) == pytest.approx(expected)


def test_branch_on_an_expression_is_refused() -> None:
    """A formula with `if` must fail with advice, not silently choose a branch."""
    a = Trace("f(data)").load("data", 0, "a")
    with pytest.raises(TypeError, match=r"elementwise\.where"):
        max(a, 1.0)
