"""An eccentric pulley: belt travel r phi + e sin(phi + p), lever arm r + e cos(phi + p).

A run starts with belts that no eccentricity stretches. There the pulley is at the angle at which its belt travel equals
that of a round pulley: it lags by e sin(phi + p) / r.
"""

from ..dynamics.elementwise import cos, sin
from ..machine import Effect, EffectParameter, Machine


def next_state(z, dq):  # type: ignore[no-untyped-def]
    """Return the pulley's rotation since the start of the run, z + dq, rad; dq: rotation in the step, rad."""
    return z + dq


def rest_angle_offset(q, e, p, per_radius):  # type: ignore[no-untyped-def]
    """Return the lag e sin(phi + p) / r of the pulley at rest, rad; q: phi, rad, e: m, p: rad, per_radius: 1/r, 1/m."""
    return e * sin(q + p) * per_radius


def belt_travel(q, z, e, p, per_radius):  # type: ignore[no-untyped-def]
    """Return the added belt travel e (sin(phi + p - lag) - sin(phi_0 + p - lag)), m; phi = q, phi_0 = q - z."""
    start = q - z
    lag = rest_angle_offset(start, e, p, per_radius)
    return e * (sin(q + p - lag) - sin(start + p - lag))


def lever_arm(q, z, e, p, per_radius):  # type: ignore[no-untyped-def]
    """Return the added lever arm e cos(phi + p - lag), m/rad, with the lag at the start of the run."""
    return e * cos(q + p - rest_angle_offset(q - z, e, p, per_radius))


def fits(machine: Machine) -> bool:
    """Check whether a machine can have this effect: it needs belts.

    Args:
        machine: The machine.

    Returns:
        True if the machine has belts.
    """
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
