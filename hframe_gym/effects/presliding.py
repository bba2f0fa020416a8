"""Friction with a bristle state: before it slides, a contact deflects like a spring (Dahl 1968; LuGre).

dz/dt = v - s0 |v| z/F, friction s0 z + s1 dz/dt, where F is the Coulomb friction force including the Stribeck
effect. For a constant speed the state has a closed solution over a distance dq: z approaches +-F/s0
exponentially.
"""

from ..dynamics.elementwise import absolute, copysign, exp, maximum
from ..machine import Effect, EffectParameter

_LOWEST_LEVEL = 1e-12  # N or Nm; avoids a division by zero without Coulomb friction


def next_state(z, dq, level, s0):  # type: ignore[no-untyped-def]
    """Return the deflection after constant speed, e + (z - e) exp(-|dq| s0/F) with e = sign(dq) F/s0.

    z: deflection of the bristle, m or rad, as the distance dq; level: friction force F with the Stribeck
    effect, N or Nm; s0: stiffness of the bristle, N/m or Nm/rad.
    """
    limit = maximum(level, _LOWEST_LEVEL) / s0
    final = copysign(limit, dq)
    return final + (z - final) * exp(-absolute(dq) / limit)


def friction(z, v, level, s0, s1):  # type: ignore[no-untyped-def]
    """Return the friction, N or Nm: s0 z + s1 dz/dt with dz/dt = v - s0 |v| z/F; s1: damping, Ns/m or Nms."""
    return s0 * z + s1 * (v - s0 * absolute(v) * z / maximum(level, _LOWEST_LEVEL))


def initial_spread(level, s0):  # type: ignore[no-untyped-def]
    """Return the standard deviation of z after unrecorded motion, a quarter of its limit F/s0, m or rad."""
    return 0.25 * level / s0


EFFECT = Effect(
    name="presliding",
    site="coordinate",
    formula="dz/dt = v - s0 |v| z/F, friction s0 z + s1 dz/dt",
    source="Dahl 1968; Canudas de Wit et al. 1995",
    friction=friction,
    next_state=next_state,
    initial_spread=initial_spread,
    parameters=(
        EffectParameter("s0", "stiffness", 1e-3, 1e9, scale=1.0, grid=(3e2, 1e3, 3e3, 1e4, 3e4)),
        EffectParameter("s1", "viscous", 0.0, 1e6, scale=1.0),
    ),
)
