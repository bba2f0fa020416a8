"""An eccentric pulley: belt travel r phi + e sin(phi + p), lever arm r + e cos(phi + p).

A run starts with belts that no eccentricity stretches. There the pulley is at the angle at which its belt travel equals
that of a round pulley: it lags by e sin(phi + p) / r.
"""

from ..dynamics.elementwise import cos, sin
from ..machine import Effect, EffectParameter, Machine


def next_state(z, dq):  # type: ignore[no-untyped-def]
    """Return the angle turned since the start of the run."""
    return z + dq


def rest_angle_offset(q, e, p, per_radius):  # type: ignore[no-untyped-def]
    """Return e sin(phi + p) / r."""
    return e * sin(q + p) * per_radius


def belt_travel(q, z, e, p, per_radius):  # type: ignore[no-untyped-def]
    """Return e (sin(phi + p - lag) - sin(phi_0 + p - lag)) with the lag at the start of the run."""
    start = q - z
    lag = rest_angle_offset(start, e, p, per_radius)
    return e * (sin(q + p - lag) - sin(start + p - lag))


def lever_arm(q, z, e, p, per_radius):  # type: ignore[no-untyped-def]
    """Return e cos(phi + p - lag)."""
    return e * cos(q + p - rest_angle_offset(q - z, e, p, per_radius))


def fits(machine: Machine) -> bool:
    """Return whether the machine has belts."""
    return bool(machine.belts)


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
    fits=fits,
    parameters=(
        EffectParameter("e", "m", -1e-2, 1e-2, scale=0.1, role="amplitude"),
        EffectParameter("p", "rad", -100.0, 100.0, scale=1.0, role="phase"),
    ),
)
