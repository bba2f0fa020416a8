"""A pulley that runs out of true: belt travel r phi + e sin(phi + p), torque arm r + e cos(phi + p).

A run starts with belts that no eccentricity stretches, so there the pulley stands where its belt travel is that of a
round one: behind by e sin(phi + p) / r.
"""

from ..dynamics.elementwise import cos, sin
from ..machine.effect import Effect, EffectParameter


def next_state(z, dq):  # type: ignore[no-untyped-def]
    return z + dq


def rest_angle_offset(q, e, p, per_radius):  # type: ignore[no-untyped-def]
    return e * sin(q + p) * per_radius


def belt_travel(q, z, e, p, per_radius):  # type: ignore[no-untyped-def]
    start = q - z + p
    back = e * sin(start) * per_radius
    return e * (sin(q + p - back) - sin(start - back))


def lever_arm(q, z, e, p, per_radius):  # type: ignore[no-untyped-def]
    return e * cos(q + p - e * sin(q - z + p) * per_radius)


EFFECT = Effect(
    name="eccentric_pulley",
    family="eccentric_pulley",
    site="motor",
    formula="travel r phi + e sin(phi + p), arm r + e cos(phi + p)",
    source="kinematics of an eccentric circle, first order in e/r",
    belt_travel=belt_travel,
    lever_arm=lever_arm,
    rest_angle_offset=rest_angle_offset,
    next_state=next_state,
    fits=lambda machine: bool(machine.belts),
    parameters=(
        EffectParameter("e", "m", -1e-2, 1e-2, scale=0.1, role="amplitude"),
        EffectParameter("p", "rad", -100.0, 100.0, scale=1.0, role="phase"),
    ),
)
