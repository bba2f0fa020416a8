"""Closed forms of one variable from which formulas for an unexplained force or friction are built.

The shapes are those that machines produce: springs, stops, magnets, periodic rails, warm-up and friction
laws. Every shape is a function of the elementary functions of `dynamics.elementwise`, so the same text serves
the fit, the compiled simulation and the file that `hframe effects new` writes. Powers with a fitted exponent
are absent, because compiled simulations have no logarithm.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any, Literal

import numpy as np

from ...arrays import Array
from ...dynamics.elementwise import absolute, cos, exp, maximum, sin, sqrt

ShapeRole = Literal["center", "width", "period"]
_HARMONICS = 3


def bump(u, center, width):  # type: ignore[no-untyped-def]
    """Return the Gaussian bump exp(-z^2 / 2) with z = (u - center) / width, of height 1."""
    z = (u - center) / width
    return exp(-0.5 * z * z)


def catch(u, center, width):  # type: ignore[no-untyped-def]
    """Return a pull toward the center, -z exp((1 - z^2) / 2) with z = (u - center) / width; extremes +-1."""
    z = (u - center) / width
    return -z * exp(0.5 - 0.5 * z * z)


def resonance(u, center, width):  # type: ignore[no-untyped-def]
    """Return the Lorentz curve 1 / (1 + z^2) with z = (u - center) / width, a bump with wide flanks."""
    z = (u - center) / width
    return 1.0 / (1.0 + z * z)


def wide_catch(u, center, width):  # type: ignore[no-untyped-def]
    """Return a pull toward the center, -2 z / (1 + z^2) with z = (u - center) / width; extremes +-1."""
    z = (u - center) / width
    return -2.0 * z / (1.0 + z * z)


def step(u, center, width):  # type: ignore[no-untyped-def]
    """Return a smooth step from -1 to +1, tanh((u - center) / width)."""
    return 1.0 - 2.0 / (1.0 + exp(2.0 * (u - center) / width))


def slow_step(u, center, width):  # type: ignore[no-untyped-def]
    """Return a smooth step from -1 to +1 with slow ends, z / sqrt(1 + z^2) with z = (u - center) / width."""
    z = (u - center) / width
    return z / sqrt(1.0 + z * z)


def ramp_above(u, center):  # type: ignore[no-untyped-def]
    """Return max(u - center, 0): the compression of a contact that begins at the center, for larger u."""
    return maximum(u - center, 0.0)


def ramp_below(u, center):  # type: ignore[no-untyped-def]
    """Return max(center - u, 0): the compression of a contact that begins at the center, for smaller u."""
    return maximum(center - u, 0.0)


def parabola(u, center):  # type: ignore[no-untyped-def]
    """Return (u - center)^2."""
    return (u - center) * (u - center)


def decay(u, width):  # type: ignore[no-untyped-def]
    """Return the exponential decay exp(-|u| / width)."""
    return exp(-absolute(u) / width)


def hyperbola(u, width):  # type: ignore[no-untyped-def]
    """Return 1 / (1 + |u| / width), a slow decay from 1 at u = 0."""
    return 1.0 / (1.0 + absolute(u) / width)


def stribeck(u, width):  # type: ignore[no-untyped-def]
    """Return the Stribeck curve exp(-(u / width)^2)."""
    return exp(-(u / width) * (u / width))


@cache
def _function(expression: str, shapes: tuple[str, ...]) -> Callable[..., Any]:
    """Return the function (u, *shapes) of an expression of a term."""
    arguments = ("u", *shapes)
    text = f"lambda {', '.join(arguments)}: {expression.format(**{name: name for name in arguments})}"
    return eval(text, {"math": math, "sin": sin, "cos": cos, **globals()})  # type: ignore[no-any-return]


@dataclass(frozen=True)
class Term:
    """One summand of a formula: amplitudes times expressions of the variable u and shape parameters.

    Attributes:
        name: Name of the term in plain words, for example "magnetic catch".
        expressions: Value at amplitude 1 as Python source, one for each amplitude, with {u} and the names of
            the shapes in braces.
        shapes: Role of each shape parameter: "center" (a value of the variable), "width" (positive, in the
            unit of the variable) or "period" (positive, in that unit).
        powers: Power of the variable's unit in each expression; the amplitude has the unit of force /
            variable**power.
        helper: Function that the expressions call; its source is copied into a written effect. None: no
            function.
    """

    name: str
    expressions: tuple[str, ...]
    shapes: tuple[ShapeRole, ...] = ()
    powers: tuple[int | float, ...] = (0,)
    helper: Callable[..., Any] | None = None

    @property
    def complexity(self) -> int:
        """Number of parameters: amplitudes and shapes."""
        return len(self.expressions) + len(self.shapes)

    def values(self, u: Array, shapes: Array) -> Array:
        """Return the value of each function (column) at amplitude 1, shape (n, columns).

        Args:
            u: Values of the variable (position, velocity, path or time), SI, shape (n,).
            shapes: Shape parameters in the order of the attribute `shapes`, shape (parameters,), in the unit
                of the variable.
        """
        columns = (_function(expression, self.shapes)(u, *shapes) for expression in self.expressions)
        return np.stack([np.broadcast_to(column, u.shape) for column in columns], axis=1)

    def grid(self, low: float, high: float) -> list[tuple[float, ...]]:
        """Return start values for fitting the shape parameters: all combinations of centers, widths, periods.

        A term without shape parameters has a single empty combination.

        Args:
            low: Smallest value of the variable in the data, SI.
            high: Largest value of the variable in the data, SI.
        """
        span = high - low
        sets: list[tuple[float, ...]] = [()]
        for role in self.shapes:
            if role == "center":
                values = np.linspace(low - 0.5 * span, high + 0.5 * span, 49)
            elif role == "width":
                values = span * np.geomspace(0.02, 1.5, 10)
            else:
                values = span / np.arange(0.5, 10.01, 0.25)
            # Every set so far is extended by every value of this parameter.
            sets = [(*shape, float(value)) for shape in sets for value in values]
        return sets


def _shaped(name: str, function: Callable[..., Any], *shapes: ShapeRole, power: int = 0) -> Term:
    """Return a term of one column that calls a function of this module."""
    arguments = ", ".join("{" + role + "}" for role in shapes)
    return Term(name, (f"{function.__name__}({{u}}, {arguments})",), shapes, (power,), function)


def _periodic(harmonics: int) -> Term:
    """Return a periodic term: sine and cosine of the first harmonics."""
    orders = range(1, harmonics + 1)
    expressions = [
        f"{f}({2 * order} * math.pi * {{u}} / {{period}})" for order in orders for f in ("sin", "cos")
    ]
    name = "periodic" if harmonics == 1 else f"periodic with {harmonics} harmonics"
    return Term(name, tuple(expressions), ("period",), (0,) * (2 * harmonics))


_OFFSET = Term("constant", ("1.0",))
_POLYNOMIALS = (
    Term("line", ("{u}",), powers=(1,)),
    Term("square", ("{u} * {u}",), powers=(2,)),
    Term("cube", ("{u} * {u} * {u}",), powers=(3,)),
)
_SIGNED_SQUARE = Term("signed square", ("{u} * absolute({u})",), powers=(2,))
_SIZE = Term("size", ("absolute({u})",), powers=(1,))
_ROOT = Term("root", ("sqrt(absolute({u}))",), powers=(0.5,))
_STEPS = (_shaped("step", step, "center", "width"), _shaped("slow step", slow_step, "center", "width"))
_BUMPS = (_shaped("bump", bump, "center", "width"), _shaped("resonance", resonance, "center", "width"))
_CATCHES = (
    _shaped("magnetic catch", catch, "center", "width"),
    _shaped("wide magnetic catch", wide_catch, "center", "width"),
)
_RAMPS = (
    _shaped("contact above", ramp_above, "center", power=1),
    _shaped("contact below", ramp_below, "center", power=1),
)
_PARABOLA = _shaped("parabola", parabola, "center", power=2)
_WAVES = tuple(_periodic(h + 1) for h in range(_HARMONICS))
_DECAYS = (_shaped("decay", decay, "width"), _shaped("slow decay", hyperbola, "width"))
_STRIBECK = _shaped("Stribeck", stribeck, "width")

_OF_VARIABLE: dict[str, tuple[Term, ...]] = {
    "position": (*_POLYNOMIALS, _PARABOLA, _SIZE, *_WAVES, *_BUMPS, *_CATCHES, *_STEPS, *_RAMPS),
    "velocity": (*_POLYNOMIALS, _SIGNED_SQUARE, _SIZE, _ROOT, *_DECAYS, _STRIBECK, *_STEPS, *_RAMPS),
    "path": (*_POLYNOMIALS[:2], _ROOT, *_DECAYS, *_STEPS, _WAVES[0]),
    "time": (*_POLYNOMIALS[:2], _ROOT, *_DECAYS, *_STEPS, *_WAVES[:2], *_BUMPS[:1]),
}


def terms_of(variable: str, *, force: bool) -> tuple[Term, ...]:
    """Return the terms that a formula of a variable may contain.

    Args:
        variable: "position", "velocity", "path" (distance traveled since the start) or "time".
        force: True for a force, which may be constant; False for a friction level, whose constant is the
            declared Coulomb friction.

    Returns:
        Terms, simplest first; for a force the constant comes before all others.
    """
    terms = _OF_VARIABLE[variable]
    return (_OFFSET, *terms) if force else terms
