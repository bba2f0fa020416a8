"""Viscous friction that depends on the direction of motion: b (1 + a) forward, b (1 - a) backward.

Causes are seals, wipers and one-sided bearing preload. The declared coefficient b is the mean of both directions.
"""

from ..machine import Effect, EffectParameter


def viscous(b, direction, a):  # type: ignore[no-untyped-def]
    """Compute the viscous coefficient b (1 + a sign v).

    Args:
        b: Viscous coefficient of the coordinate, Ns/m or Nms.
        direction: Sign of the speed v, +1 or -1.
        a: Relative difference between the directions, -1 to 1.

    Returns:
        Viscous coefficient in this direction, Ns/m or Nms.
    """
    return b * (1.0 + direction * a)


EFFECT = Effect(
    name="asymmetric_viscous",
    family="asymmetric_viscous",
    site="coordinate",
    formula="b(v) = b (1 + a sign v)",
    source="seals and wipers with a lip; Bona and Indri 2005",
    viscous=viscous,
    parameters=(EffectParameter("a", "1", -0.99, 0.99, scale=0.1, role="amplitude"),),
)
