"""Viscous friction that depends on the direction of motion: b (1 + a) forward, b (1 - a) backward.

Causes are seals, wipers and one-sided bearing preload. The declared coefficient b is the mean of both
directions.
"""

from ..machine import Effect, EffectParameter


def viscous(b, direction, a):  # type: ignore[no-untyped-def]
    """Return the viscous coefficient b (1 + a sign v), Ns/m or Nms; direction: sign v, a: from -1 to 1."""
    return b * (1.0 + direction * a)


EFFECT = Effect(
    name="asymmetric_viscous",
    site="coordinate",
    formula="b(v) = b (1 + a sign v)",
    source="seals and wipers with a lip; Bona and Indri 2005",
    viscous=viscous,
    parameters=(EffectParameter("a", "1", -0.99, 0.99, scale=0.1, role="amplitude"),),
)
