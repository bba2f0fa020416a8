"""Scale error of a sensor: it measures (1 + g) times the true value r, with a constant relative error g.

The scale error of an encoder on a pulley has the same effect on the measurements as a wrong pulley radius.
"""

from ..machine import Effect, EffectParameter, Machine, rigid_motions


def measurement(r, g):  # type: ignore[no-untyped-def]
    """Return the measurement (1 + g) r, m or rad; r: true value, same unit; g: relative scale error, dimensionless."""
    return r + g * r


def fits(machine: Machine) -> bool:
    """Return whether a scale error can be identified on a machine, which needs more sensors than rigid-body motions.

    If a single sensor measures an axis, a scale error cannot be distinguished from masses and forces that are wrong by
    the same factor.
    """
    return len(machine.sensors) > max(1, len(rigid_motions(machine)))


EFFECT = Effect(
    name="sensor_scale",
    site="sensor",
    formula="measurement = (1 + g) r",
    source="sensor calibration error",
    measurement=measurement,
    equivalent=("a pulley's radius",),
    fits=fits,
    fits_site=Machine.measures_position,
    # From a tenth to ten times the declared scale; the search starts from errors of about 1 %.
    parameters=(EffectParameter("g", "1", -0.9, 9.0, scale=0.01, role="amplitude"),),
)
