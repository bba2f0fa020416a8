"""A sensor with another gain than declared: it measures (1 + g) r.

For an encoder this is equivalent to another radius of the pulley.
"""

from ..machine import Effect, EffectParameter, Machine


def measurement(r, g):  # type: ignore[no-untyped-def]
    """Return the measurement (1 + g) r, m or rad; r: ideal reading, same unit, g: relative scale error."""
    return r + g * r


def fits(machine: Machine) -> bool:
    """Check whether a scale error can be identified: it needs more sensors than linear coordinates.

    A scale error of the only sensor of an axis is equivalent to other masses and forces of the machine.

    Args:
        machine: The machine.

    Returns:
        True if there are more sensors than linear coordinates.
    """
    return len(machine.sensors) > sum(c.kind == "linear" for c in machine.coordinates)


EFFECT = Effect(
    name="sensor_scale",
    family="sensor_scale",
    site="sensor",
    formula="measurement = (1 + g) r",
    source="calibration",
    measurement=measurement,
    equivalent=("a pulley's radius",),
    fits=fits,
    parameters=(EffectParameter("g", "1", -0.9, 9.0, scale=0.01, role="amplitude"),),
)
