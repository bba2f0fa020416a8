"""An eccentric pulley: belt travel r phi + e sin(phi + p), lever arm r + e cos(phi + p).

At the start of a run, the eccentricity stretches no belt: the pulley has the angle at which its belt travel
equals that of a round pulley. This angle is smaller than that of the round pulley by lag = e sin(phi + p) /
r.
"""

from ..dynamics.elementwise import cos, sin
from ..machine import Effect, EffectParameter, Machine


def next_state(z, dq):  # type: ignore[no-untyped-def]
    """Advance the state of the effect, the pulley's rotation since the start of the run, rad: z + dq."""
    return z + dq


def rest_angle_offset(q, e, p, per_radius):  # type: ignore[no-untyped-def]
    """Return the angle e sin(phi + p) / r, rad, by which the pulley lags behind a round one at a run's start.

    q is the angle phi of a round pulley with the same belt travel, rad; e the eccentricity, m; p its angle at
    phi = 0, rad; per_radius is 1/r, 1/m.
    """
    return e * sin(q + p) * per_radius


def belt_travel(q, z, e, p, per_radius):  # type: ignore[no-untyped-def]
    """Return the belt travel that the eccentricity adds, m: e (sin(phi + p - lag) - sin(phi_0 + p - lag)).

    phi_0 = q - z is the angle at the start of the run, and lag = e sin(phi_0 + p) / r; see
    `rest_angle_offset`.
    """
    start = q - z
    lag = rest_angle_offset(start, e, p, per_radius)
    return e * (sin(q + p - lag) - sin(start + p - lag))


def lever_arm(q, z, e, p, per_radius):  # type: ignore[no-untyped-def]
    """Return the lever arm by eccentricity, m/rad: e cos(phi + p - lag); lag: as in `belt_travel`."""
    return e * cos(q + p - rest_angle_offset(q - z, e, p, per_radius))


def fits(machine: Machine) -> bool:
    """Return whether a machine can have this effect: it needs belts."""
    return bool(machine.belts)


EFFECT = Effect(
    name="eccentric_pulley",
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
