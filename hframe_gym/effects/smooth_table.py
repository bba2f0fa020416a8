"""Tables for residuals without a formula: a force or Coulomb friction as a function of one variable.

The curve is linear between KNOTS values. Knots lie where the variable has been, and closer where the curve
bends. The name of a table states force and variable: `smooth_force[position of y]` at x is an unnamed force
on x that depends on y.
"""

from __future__ import annotations

import inspect
from functools import lru_cache
from typing import Any

from ..dynamics.elementwise import absolute, where
from ..machine import AppliedEffect, Effect, EffectParameter

KNOTS = 24
TABLE_FAMILY = "smooth_table"
HOOK_OF_KIND = {"smooth_force": "force", "smooth_friction": "coulomb"}
_KNOT_NAMES = tuple(f"k{i:02d}" for i in range(KNOTS))
_VALUE_NAMES = tuple(f"f{i:02d}" for i in range(KNOTS))


def _path_length(z, dq):  # type: ignore[no-untyped-def]
    """Return the distance traveled since the start of the run."""
    return z + absolute(dq)


class _Table:
    """The hook of a table: the curve through (k_i, f_i), constant beyond the ends.

    A class, because its arguments are made of the knots, and because machines with tables must be picklable.
    """

    __signature__ = inspect.Signature(
        [
            inspect.Parameter(name, inspect.Parameter.POSITIONAL_OR_KEYWORD)
            for name in ("u", *_KNOT_NAMES, *_VALUE_NAMES)
        ]
    )

    def __call__(self, u: Any, *knots_and_values: Any) -> Any:
        """Interpolate the table linearly at u; constant beyond the first and the last knot.

        Each piece adds its slope times the distance of u from its left knot, so that no branch is necessary.
        """
        knots, values = knots_and_values[:KNOTS], knots_and_values[KNOTS:]
        total = values[0]
        for i in range(KNOTS - 1):
            slope = (values[i + 1] - values[i]) / (knots[i + 1] - knots[i])
            within = where(u > knots[i + 1], knots[i + 1], u) - knots[i]
            total = total + slope * where(u < knots[i], 0.0, within)
        return total

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Table)

    def __hash__(self) -> int:
        return hash(_Table)


@lru_cache(maxsize=256)
def definition(name: str) -> Effect:
    """Create the definition of a tabulated effect from its name.

    Args:
        name: "smooth_force[VARIABLE]" (a force) or "smooth_friction[VARIABLE]" (a change of the Coulomb
            friction). VARIABLE is "position of C", "velocity of C", "path of C" (distance traveled since the
            start of the run) or "time", where C is the name of a coordinate.

    Returns:
        Effect with the parameters k00..k23 (knots, unit of the variable) and f00..f23 (values, N or Nm).

    Raises:
        KeyError: If the name does not have this form.
    """
    kind, _, against = name.rstrip("]").partition("[")
    variable, _, coordinate = against.partition(" of ")
    is_complete = name == f"{kind}[{against}]" and bool(coordinate) == (variable != "time")
    if (
        not is_complete
        or kind not in HOOK_OF_KIND
        or variable not in ("position", "velocity", "path", "time")
    ):
        raise KeyError(name)
    hook = HOOK_OF_KIND[kind]
    parameters = [EffectParameter(k, "", -1e9, 1e9, scale=1.0, role="fixed") for k in _KNOT_NAMES]
    parameters += [EffectParameter(f, "force", -1e6, 1e6, scale=0.3, role="amplitude") for f in _VALUE_NAMES]
    return Effect(
        name=name,
        family=TABLE_FAMILY,
        site="coordinate",
        formula=f"{'f' if hook == 'force' else 'F - Fc'} = table of {against}",
        source="this recording",
        against=against,
        next_state=_path_length if variable == "path" else None,
        parameters=tuple(parameters),
        **{hook: _Table()},  # type: ignore[arg-type]
    )


def tabulated_range(effect: AppliedEffect) -> tuple[float, float]:
    """Return the first and the last knot of a table, in its variable's unit; it is constant beyond them."""
    return effect.parameters[_KNOT_NAMES[0]], effect.parameters[_KNOT_NAMES[-1]]
