"""Stribeck friction: the Coulomb friction force changes at low speed, F(v) = Fc + dF exp(-(v/vs)^2).

dF < 0 describes friction that rises with speed.
"""

from ..dynamics.elementwise import exp
from ..machine import Effect, EffectParameter


def coulomb(v, dF, vs):  # type: ignore[no-untyped-def]
    """Return the change dF exp(-(v/vs)^2) of Coulomb friction, N or Nm; v, vs: speeds, m/s or rad/s."""
    ratio = v / vs
    return dF * exp(-ratio * ratio)


EFFECT = Effect(
    name="stribeck_friction",
    site="coordinate",
    formula="F(v) = Fc + dF exp(-(v/vs)^2)",
    source="Armstrong-Helouvry, Dupont and Canudas de Wit 1994, Automatica 30(7), eq. 8 with exponent 2",
    coulomb=coulomb,
    parameters=(
        EffectParameter("dF", "force", -1e3, 1e3, scale=0.3, role="amplitude"),
        EffectParameter("vs", "speed", 1e-5, 1e3, scale=0.3, grid=(0.005, 0.015, 0.04, 0.1, 0.25)),
    ),
)
