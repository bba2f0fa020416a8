"""Dry friction that grows with the torque of the drive, F = Fc + mu |torque|, as in gears and lead screws."""

from ..dynamics.elementwise import absolute
from ..machine import Effect, EffectParameter


def coulomb(drive, mu):  # type: ignore[no-untyped-def]
    """Return the additional friction mu |drive|, N or Nm; drive: its force or torque, mu: dimensionless."""
    return mu * absolute(drive)


EFFECT = Effect(
    name="load_friction",
    site="motor",
    formula="F = Fc + mu |torque of the drive|",
    source="Duclusaud et al. 2025, Extended friction models for the physics simulation of servo actuators",
    coulomb=coulomb,
    parameters=(EffectParameter("mu", "1", 0.0, 0.95, scale=0.1, role="amplitude"),),
)
