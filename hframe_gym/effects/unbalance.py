"""The weight of a mass off the axis: a pendulum, an arm in the vertical plane, an unbalanced pulley."""

from ..dynamics.elementwise import sin
from ..machine import Effect, EffectParameter, Machine


def fits_site(machine: Machine, site: str) -> bool:
    """Return whether the effect can act at a coordinate, given by its name, which must be rotary."""
    return machine.coordinate(site).kind == "rotary"


def force(q, A, p):  # type: ignore[no-untyped-def]
    """Return the torque A sin(q + p), Nm; q: angle, rad, A: weight times distance, Nm, p: phase, rad."""
    return A * sin(q + p)


EFFECT = Effect(
    name="unbalance",
    site="coordinate",
    formula="f = A sin(q + p)",
    source="moment of the weight, A = m g r",
    force=force,
    fits_site=fits_site,
    equivalent=("cogging with one period per revolution",),
    parameters=(
        EffectParameter("A", "force", -1e3, 1e3, scale=0.3, role="amplitude"),
        EffectParameter("p", "rad", -100.0, 100.0, scale=1.0, role="phase"),
    ),
)
