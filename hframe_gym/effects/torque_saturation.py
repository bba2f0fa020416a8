"""Torque constant falling with the current because the motor's iron saturates: torque N Kt i / (1 + s i^2).

The current, also as a sensor measures it, stays as it is.
"""

from ..machine import Effect, EffectParameter


def torque(i, s):  # type: ignore[no-untyped-def]
    """Return the current, A, that would give the same torque without saturation: i / (1 + s i^2).

    i: actual current, A, s: 1/A^2.
    """
    return i / (1.0 + s * i * i)


EFFECT = Effect(
    name="torque_saturation",
    site="drive",
    shared=True,
    formula="torque = N Kt i / (1 + s i^2)",
    source="saturation of iron, the simplest odd function whose slope at small currents is Kt",
    torque=torque,
    parameters=(EffectParameter("s", "1/A^2", 0.0, 1e6, scale=0.1, role="amplitude"),),
)
