"""Belt teeth that meet those of a pulley: a force A |T| sin(n q + p) proportional to the belts' load T.

A pitch t on a pulley of radius r has n = 2 pi r / t. The load is the force or torque of the belts on the
pulley. The part that does not depend on the load is `cogging` with the same n.
"""

from ..dynamics.elementwise import absolute, sin
from ..machine import Effect, EffectParameter, Machine


def force(q, load, A, n, p):  # type: ignore[no-untyped-def]
    """Return the torque A |load| sin(n q + p), Nm; load: Nm, A and n: dimensionless, q, p: rad."""
    return A * absolute(load) * sin(n * q + p)


def fits_site(machine: Machine, site: str) -> bool:
    """Return whether a belt runs on the pulley of a motor."""
    return any(machine.drive(site).coordinate in belt.extension for belt in machine.belts)


EFFECT = Effect(
    name="belt_mesh",
    family="cogging",
    site="motor",
    formula="f = A |T| sin(n q + p), T: force of the belts",
    source="polygon effect of toothed belts, with a force that is proportional to that between the teeth",
    force=force,
    fits_site=fits_site,
    parameters=(
        EffectParameter("A", "1", -1.0, 1.0, scale=0.05, role="amplitude"),
        EffectParameter("n", "rad/position", 1e-3, 1e5, scale=0.1, role="rate"),
        EffectParameter("p", "rad", -100.0, 100.0, scale=1.0, role="phase"),
    ),
)
