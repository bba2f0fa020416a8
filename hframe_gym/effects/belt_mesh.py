"""Teeth of a belt that meet those of a pulley, A (1 + |T| / T0) sin(n q + p): the force grows with the load T.

A pitch t on a pulley of radius r has n = 2 pi r / t. The load is the force or torque of the belts on the pulley.
"""

from ..dynamics.elementwise import absolute, sin
from ..machine import Effect, EffectParameter, Machine


def force(q, load, A, n, p, T0):  # type: ignore[no-untyped-def]
    """Return the torque A (1 + |load| / T0) sin(n q + p), Nm; load, T0: Nm, q: rad, n: rad per rad, p: phase, rad."""
    return A * (1.0 + absolute(load) / T0) * sin(n * q + p)


def fits_site(machine: Machine, site: str) -> bool:
    """Return whether a belt runs on the pulley of a motor."""
    return any(machine.drive(site).coordinate in belt.extension for belt in machine.belts)


EFFECT = Effect(
    name="belt_mesh",
    family="cogging",
    site="motor",
    formula="f = A (1 + |T| / T0) sin(n q + p), T: force of the belts",
    source="polygon effect of toothed belts, with a force that grows with that between the teeth",
    force=force,
    fits_site=fits_site,
    parameters=(
        EffectParameter("A", "force", -1e3, 1e3, scale=0.3, role="amplitude"),
        EffectParameter("n", "rad/position", 1e-3, 1e5, scale=0.1, role="rate"),
        EffectParameter("p", "rad", -100.0, 100.0, scale=1.0, role="phase"),
        EffectParameter("T0", "force", 1e-3, 1e6, scale=1.0, grid=(1.0,)),
    ),
)
