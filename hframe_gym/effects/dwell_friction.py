"""Dry friction that rises with the age of the contact, F = Fc + dF ln(1 + z/tau), as after a dwell.

The age z grows with time, and motion renews the contact over a distance D: dz/dt = 1 - |v| z/D. At constant speed it
is D/|v|, so that friction falls with speed: F = Fc + dF ln(1 + D/(|v| tau)).
"""

from ..dynamics.elementwise import absolute, exp, log, maximum
from ..machine import Effect, EffectParameter

_LEAST_PATH = 1e-6  # of D; below, the mean of exp(-path) over a step is 1 within half of this


def next_state(z, dq, dt, D):  # type: ignore[no-untyped-def]
    """Return the age of the contact, s, after a motion dq in the time dt, s: the solution for constant speed.

    D is the distance over which motion renews the contact, m or rad, as dq.
    """
    path = absolute(dq) / D
    long_enough = maximum(path, _LEAST_PATH)
    return z * exp(-path) + dt * (1.0 - exp(-long_enough)) / long_enough


def coulomb(z, dF, tau):  # type: ignore[no-untyped-def]
    """Return the change dF ln(1 + z/tau) of the Coulomb friction force, N or Nm; z, tau: s, dF: force per e-fold."""
    return dF * log(1.0 + z / tau)


EFFECT = Effect(
    name="dwell_friction",
    family="stribeck_friction",
    site="coordinate",
    formula="F = Fc + dF ln(1 + z/tau), dz/dt = 1 - |v| z/D",
    source="Dieterich 1979, J. Geophys. Res. 84(B5); Ruina 1983, J. Geophys. Res. 88(B12)",
    coulomb=coulomb,
    next_state=next_state,
    parameters=(
        EffectParameter("dF", "force", 0.0, 1e3, scale=0.1, role="amplitude"),
        EffectParameter("tau", "s", 1e-4, 1e3, scale=1.0, grid=(0.02, 0.2)),
        EffectParameter("D", "position", 1e-6, 1e3, scale=0.01, grid=(1e-4, 2e-3), largest=0.25),
    ),
)
