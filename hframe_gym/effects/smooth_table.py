"""What no formula of the library explains: a table of a force, or of a Coulomb level, against one variable.

Straight lines between KNOTS values; knots lie where the variable was and closer where the curve bends.  A table is
named as what it is: `smooth_force[position of y]` at x is an unnamed force on x that follows y.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

from ..dynamics.elementwise import absolute, where
from ..machine.effect import Effect, EffectParameter

KNOTS = 24
KINDS = {"smooth_force": "force", "smooth_friction": "coulomb"}


def _evolve(z, dq):  # type: ignore[no-untyped-def]
    return z + absolute(dq)


def _table(contribution: str) -> Callable[..., Any]:
    """f(u) through (k_i, f_i), constant beyond the ends, as a function with its source."""
    knots, values = ([f"{letter}{i:02d}" for i in range(KNOTS)] for letter in "kf")
    # Piece by piece the way of u beyond each knot, times the slope there: nothing here needs a branch.
    terms = [
        f"    total = total + ({values[i + 1]} - {values[i]}) / ({knots[i + 1]} - {knots[i]}) "
        f"* where(u < {knots[i]}, 0.0, where(u > {knots[i + 1]}, {knots[i + 1]}, u) - {knots[i]})"
        for i in range(KNOTS - 1)
    ]
    lines = [f"def {contribution}(u, {', '.join(knots + values)}):", f"    total = {values[0]}", *terms]
    text = "\n".join([*lines, "    return total"]) + "\n"
    scope: dict[str, Any] = {"where": where}
    exec(text, scope)  # a function of 49 arguments that nobody should have to read
    function = scope[contribution]
    function.text = text  # what the kernel inlines
    return function  # type: ignore[no-any-return]


@lru_cache(maxsize=256)
def definition(name: str) -> Effect:
    """The effect `smooth_force[VARIABLE]` or `smooth_friction[VARIABLE]`.

    VARIABLE: "position of C", "velocity of C", "path of C" (the way gone since the run began) or "time".
    Raises KeyError for another name.
    """
    kind, _, against = name.rstrip("]").partition("[")
    contribution = KINDS[kind]
    what, _, coordinate = against.partition(" of ")
    if what not in ("position", "velocity", "path", "time") or bool(coordinate) == (what == "time"):
        raise KeyError(name)
    numbers = [EffectParameter(f"k{i:02d}", "", -1e9, 1e9, scale=1.0, role="fixed") for i in range(KNOTS)]
    numbers += [EffectParameter(f"f{i:02d}", "force", -1e6, 1e6, scale=0.3, role="amplitude") for i in range(KNOTS)]
    return Effect(
        name=name,
        family="smooth_table",
        site="coordinate",
        formula=f"{'f' if contribution == 'force' else 'F - Fc'} = table of {against}",
        source="this recording",
        against=against,
        next_state=_evolve if what == "path" else None,
        parameters=tuple(numbers),
        **{contribution: _table(contribution)},  # type: ignore[arg-type]
    )
