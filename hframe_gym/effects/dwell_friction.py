"""Dry friction that rises with the age of the contact, F = Fc + dF ln(1 + a/tau), as after a dwell.

The age a grows with time, and motion renews the contact over a distance D: da/dt = 1 - |v| a/D. At constant
speed it is D/|v|, so that friction falls with speed: F = Fc + dF ln(1 + D/(|v| tau)). How long the machine
rested before a recording is unknown. The state is therefore z = ln(1 + a/tau), on which the friction depends
linearly.
"""

from ..dynamics.elementwise import absolute, exp, log, maximum
from ..machine import Effect, EffectParameter

_LEAST_PATH = 1e-6  # of D; below, the mean of exp(-path) over a step is 1 within half of this
_REST = 10.0  # s; typical rest before a recording


def next_state(z, dq, dt, tau, D):  # type: ignore[no-untyped-def]
    """Return the state z = ln(1 + a/tau) after a motion dq in the time dt, s: solved for constant speed.

    D is the distance over which motion renews the contact, m or rad, as dq; tau: s.
    """
    path = absolute(dq) / D
    long_enough = maximum(path, _LEAST_PATH)
    left = exp(-path)
    return log(1.0 + (exp(z) - 1.0) * left + dt / tau * (1.0 - exp(-long_enough)) / long_enough)


def coulomb(z, dF):  # type: ignore[no-untyped-def]
    """Return the change dF z of the Coulomb friction force, N or Nm; dF: force per e-fold of the age."""
    return dF * z


def initial_spread(tau):  # type: ignore[no-untyped-def]
    """Return the standard deviation of the state when a recording begins, after a rest of typical length.

    Tau: s.
    """
    return log(1.0 + _REST / tau)


EFFECT = Effect(
    name="dwell_friction",
    family="stribeck_friction",
    site="coordinate",
    formula="F = Fc + dF ln(1 + a/tau), da/dt = 1 - |v| a/D",
    source="Dieterich 1979, J. Geophys. Res. 84(B5); Ruina 1983, J. Geophys. Res. 88(B12)",
    coulomb=coulomb,
    next_state=next_state,
    initial_spread=initial_spread,
    parameters=(
        EffectParameter("dF", "force", 0.0, 1e3, scale=0.1, role="amplitude"),
        EffectParameter("tau", "s", 1e-4, 1e3, scale=1.0, grid=(0.02, 0.2)),
        EffectParameter("D", "position", 1e-6, 1e3, scale=0.01, grid=(1e-4, 2e-3), largest=0.25),
    ),
)
