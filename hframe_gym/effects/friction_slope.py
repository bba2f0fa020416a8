"""Dry friction that grows along the way, F(q) = Fc + s q: rails not parallel, a belt against its flange."""

from ..machine import Effect, EffectParameter


def coulomb(q, s):  # type: ignore[no-untyped-def]
    """Return the change s q of the Coulomb friction, N or Nm; q: position, m or rad, s: N/m or Nm/rad."""
    return s * q


EFFECT = Effect(
    name="friction_slope",
    family="position_friction",
    site="coordinate",
    formula="F(q) = Fc + s q",
    source="rails that are not parallel",
    coulomb=coulomb,
    parameters=(EffectParameter("s", "stiffness", -1e6, 1e6, scale=0.3, role="amplitude"),),
)
