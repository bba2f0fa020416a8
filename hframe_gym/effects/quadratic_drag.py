"""Drag that grows with the square of the speed, -c v |v|: air, churned grease, a fan on the spindle."""

from ..dynamics.elementwise import absolute
from ..machine import Effect, EffectParameter


def force(v, c):  # type: ignore[no-untyped-def]
    """Return the drag force -c v |v|, N or Nm; v: speed, m/s or rad/s, c: Ns^2/m^2 or Nms^2."""
    return -c * v * absolute(v)


EFFECT = Effect(
    name="quadratic_drag",
    site="coordinate",
    formula="f = -c v |v|",
    source="drag at high Reynolds number",
    force=force,
    parameters=(EffectParameter("c", "drag", -1e6, 1e6, scale=0.3, role="amplitude"),),
)
