"""An encoder whose disk or magnet is off center: it measures r + A sin(r + p) instead of the angle r.

An error of several periods per turn is `interpolation_error`.
"""

from ..dynamics.elementwise import sin
from ..machine import Effect, EffectParameter, Machine


def measurement(r, A, p):  # type: ignore[no-untyped-def]
    """Return the measurement r + A sin(r + p), rad; r: angle, rad, A: largest error, rad, p: phase, rad."""
    return r + A * sin(r + p)


def fits_site(machine: Machine, site: str) -> bool:
    """Return whether a sensor measures an angle."""
    return machine.sensor_unit(machine.sensors[machine.output_channels.index(site)]) == "rad"


EFFECT = Effect(
    name="eccentric_encoder",
    site="sensor",
    formula="measurement = r + A sin(r + p)",
    source="kinematics of an eccentric disk, first order in eccentricity / radius",
    measurement=measurement,
    fits_site=fits_site,
    parameters=(
        EffectParameter("A", "rad", -1.0, 1.0, scale=0.01, role="amplitude"),
        EffectParameter("p", "rad", -100.0, 100.0, scale=1.0, role="phase"),
    ),
)
