"""Elementary functions give the same values with CasADi as with NumPy."""

from __future__ import annotations

import numpy as np
import pytest

from hframe_gym.dynamics import elementwise
from hframe_gym.dynamics.physics.belts import reciprocals

UNARY = ("exp", "log", "sin", "cos", "tanh", "sqrt", "absolute", "sign", "floor")
BINARY = ("minimum", "maximum", "copysign")


@pytest.mark.parametrize("name", [*UNARY, *BINARY, "where", "fma"])
def test_casadi_agrees_with_numpy(name: str) -> None:
    """Evaluate each function symbolically at random points."""
    casadi = pytest.importorskip("casadi")
    function = getattr(elementwise, name)
    count = 1 if name in UNARY else 2 if name in BINARY else 3
    symbols = casadi.SX.sym("x", count)
    operands = casadi.vertsplit(symbols)
    if name == "where":
        operands = [operands[0] < 0.5, *operands[1:]]
    compiled = casadi.Function("f", [symbols], [function(*operands)])
    for point in np.random.default_rng(0).uniform(0.0, 1.0, (20, count)):
        values = [point[0] < 0.5, *point[1:]] if name == "where" else point
        assert float(compiled(point)) == pytest.approx(float(function(*values)), rel=1e-14)


def test_scalars_stay_scalars() -> None:
    """`where` of plain numbers gives a number, not an array without dimensions."""
    assert np.ndim(elementwise.where(True, 1.0, 2.0)) == 0
    assert not isinstance(elementwise.where(True, 1.0, 2.0), np.ndarray)


def test_reciprocals_of_numbers() -> None:
    """Without tracing every reciprocal is a separate division."""
    assert reciprocals([2.0, 4.0, 5.0, 8.0]) == [0.5, 0.25, 0.2, 0.125]


@pytest.mark.parametrize("name", ["rint", "pow2", "any_of"])
def test_functions_without_casadi_support(name: str) -> None:
    """The module docstring lists the functions that refuse CasADi operands."""
    casadi = pytest.importorskip("casadi")
    with pytest.raises(KeyError, match=name):
        getattr(elementwise, name)(casadi.SX.sym("x"))
