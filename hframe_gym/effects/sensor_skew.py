"""A sensor not perpendicular to the other axis: it measures r + a q with the position q of that axis."""

from ..machine import Effect, EffectParameter, Machine


def measurement(r, across, a):  # type: ignore[no-untyped-def]
    """Return the measurement r + a q, m; r: true value, m; across: q of the other axis, m; a: skew, m/m."""
    return r + a * across


def fits_site(machine: Machine, site: str) -> bool:
    """Return whether a sensor (channel) measures the position of one of two linear coordinates."""
    if not machine.measures_position(site):
        return False
    coordinate = machine.coordinate(machine.sensor(site).coordinate)
    return coordinate.kind == "linear" and machine.other_axis(coordinate.name) is not None


EFFECT = Effect(
    name="sensor_skew",
    site="sensor",
    formula="measurement = r + a across",
    source="target of a laser, or an axis, that is not square",
    measurement=measurement,
    fits_site=fits_site,
    parameters=(EffectParameter("a", "1", -1.0, 1.0, scale=0.01, role="amplitude"),),
)
