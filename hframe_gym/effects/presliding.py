"""Friction with a bristle state: before it slides a contact gives like a spring (Dahl 1968; LuGre without Stribeck).

dz/dt = v - s0 |v| z/F, friction s0 z + s1 dz/dt, with F the Coulomb level, Stribeck's part and all.  With v held the
state's flow over a way dq is closed: z runs exponentially towards +-F/s0.
"""

from ..dynamics.elementwise import absolute, copysign, exp, maximum
from ..machine.effect import Effect, EffectParameter


def next_state(z, dq, level, s0):  # type: ignore[no-untyped-def]
    end = maximum(level, 1e-12) / s0
    towards = copysign(end, dq)
    return towards + (z - towards) * exp(-absolute(dq) / end)


def friction(z, v, level, s0, s1):  # type: ignore[no-untyped-def]
    return s0 * z + s1 * (v - s0 * absolute(v) * z / maximum(level, 1e-12))


EFFECT = Effect(
    name="presliding",
    family="presliding",
    site="coordinate",
    formula="dz/dt = v - s0 |v| z/F, friction s0 z + s1 dz/dt",
    source="Dahl 1968; Canudas de Wit et al. 1995",
    friction=friction,
    next_state=next_state,
    parameters=(
        EffectParameter("s0", "stiffness", 1e-3, 1e9, scale=1.0, grid=(3e2, 1e3, 3e3, 1e4, 3e4)),
        EffectParameter("s1", "viscous", 0.0, 1e6, scale=1.0),
    ),
)
