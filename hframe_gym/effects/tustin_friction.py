"""Friction that falls exponentially with speed, as in lubricated guides: F(v) = Fc + dF exp(-|v|/vs).

It is Stribeck friction with the exponent 1 (Tustin) in place of 2: it falls at once, and more slowly at the
end.
"""

from ..dynamics.elementwise import absolute, exp
from ..machine import Effect
from .stribeck_friction import EFFECT as STRIBECK


def coulomb(v, dF, vs):  # type: ignore[no-untyped-def]
    """Return the change dF exp(-|v|/vs) of Coulomb friction, N or Nm; v, vs: speeds, m/s or rad/s."""
    return dF * exp(-absolute(v) / vs)


EFFECT = Effect(
    name="tustin_friction",
    family="stribeck_friction",
    site="coordinate",
    formula="F(v) = Fc + dF exp(-|v|/vs)",
    source="Armstrong-Helouvry, Dupont and Canudas de Wit 1994, Automatica 30(7), eq. 8 with exponent 1",
    coulomb=coulomb,
    parameters=STRIBECK.parameters,
)
