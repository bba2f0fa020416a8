"""Torque constant that varies with the motor's angle, torque = N Kt i (1 + a sin(n q + p)), by commutation.

In contrast to `cogging`, the torque is in proportion to the current and vanishes without it.
"""

from ..dynamics.elementwise import sin
from ..machine import Effect, EffectParameter


def torque(i, q, a, n, p):  # type: ignore[no-untyped-def]
    """Return the current, A, that would give the same torque without the ripple: i (1 + a sin(n q + p)).

    i: actual current, A, q: position, rad or m, n: rad per unit of q, p: phase, rad.
    """
    return i * (1.0 + a * sin(n * q + p))


EFFECT = Effect(
    name="commutation_ripple",
    site="motor",
    formula="torque = N Kt i (1 + a sin(n q + p))",
    source="Hanselman, Brushless Permanent Magnet Motor Design, chapter 8",
    torque=torque,
    parameters=(
        EffectParameter("a", "1", -0.99, 0.99, scale=0.1, role="amplitude"),
        EffectParameter("n", "rad/position", 1e-3, 1e5, scale=0.1, role="rate"),
        EffectParameter("p", "rad", -100.0, 100.0, scale=1.0, role="phase"),
    ),
)
