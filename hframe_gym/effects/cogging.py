"""Torque that varies with the angle of the motor, A sin(n q + p): detent torque."""

from ..dynamics.elementwise import sin
from ..machine import Effect, EffectParameter


def force(q, A, n, p):  # type: ignore[no-untyped-def]
    """Return the torque A sin(n q + p), Nm (or N); q: position, rad or m, n: rad per unit, p: phase, rad."""
    return A * sin(n * q + p)


EFFECT = Effect(
    name="cogging",
    site="motor",
    formula="f = A sin(n q + p)",
    source="Hanselman, Brushless Permanent Magnet Motor Design, chapter 7",
    force=force,
    parameters=(
        EffectParameter("A", "force", -1e3, 1e3, scale=0.3, role="amplitude"),
        EffectParameter("n", "rad/position", 1e-3, 1e5, scale=0.1, role="rate", simpler={1.0: "unbalance"}),
        EffectParameter("p", "rad", -100.0, 100.0, scale=1.0, role="phase"),
    ),
)
