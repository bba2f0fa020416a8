"""Dry friction that grows along the way, F(q) = Fc + s q: rails out of parallel, a belt on its flange."""

from ..machine.effect import Effect, EffectParameter


def coulomb(q, s):  # type: ignore[no-untyped-def]
    return s * q


EFFECT = Effect(
    name="friction_slope",
    family="position_friction",
    site="coordinate",
    formula="F(q) = Fc + s q",
    source="rails out of parallel",
    coulomb=coulomb,
    parameters=(EffectParameter("s", "stiffness", -1e6, 1e6, scale=0.3, role="amplitude"),),
)
