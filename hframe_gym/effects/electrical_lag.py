"""Inductance of the winding: tau di/dt = (V - Ke N w)/R - i, tau = L/R, exact over each part of a step."""

from ..dynamics.elementwise import exp, maximum
from ..machine import Effect, EffectParameter

_SHORTEST_LAG = 1e-9  # s; avoids a division by zero for tau = 0


def next_state(z, i, dt, tau):  # type: ignore[no-untyped-def]
    """Return the motor current, A, after the time dt, s: i + (z - i) exp(-dt/tau).

    i is the current without inductance, (V - Ke N w)/R, A, and tau = L/R the time constant of the winding, s.
    """
    return i + (z - i) * exp(-dt / maximum(tau, _SHORTEST_LAG))


def current(z):  # type: ignore[no-untyped-def]
    """Return the motor current, A: the state z of the effect."""
    return z


EFFECT = Effect(
    name="electrical_lag",
    site="drive",
    shared=True,
    formula="tau di/dt = (V - Ke N w)/R - i",
    source="equation of the armature circuit of a DC motor",
    current=current,
    next_state=next_state,
    parameters=(EffectParameter("tau", "s", 0.0, 0.1, scale=5e-4, role="amplitude"),),
)
