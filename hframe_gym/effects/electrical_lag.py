"""The winding's inductance: tau di/dt = (V - Ke N w)/R - i, tau = L/R; solved exactly over each part of a step."""

from ..dynamics.elementwise import exp, maximum
from ..machine.effect import Effect, EffectParameter


def next_state(z, i, dt, tau):  # type: ignore[no-untyped-def]
    return i + (z - i) * exp(-dt / maximum(tau, 1e-9))


def current(z):  # type: ignore[no-untyped-def]
    return z


EFFECT = Effect(
    name="electrical_lag",
    family="electrical_lag",
    site="drive",
    formula="tau di/dt = (V - Ke N w)/R - i",
    source="any text on DC motors",
    current=current,
    next_state=next_state,
    parameters=(EffectParameter("tau", "s", 0.0, 0.1, scale=5e-4, role="amplitude"),),
)
