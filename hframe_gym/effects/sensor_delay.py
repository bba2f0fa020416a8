"""A sensor with a delay: the measurement is the reading d seconds earlier."""

from ..machine import Effect, EffectParameter, Machine


def measurement_delay(d):  # type: ignore[no-untyped-def]
    """Return the delay d from reading to measurement, s."""
    return d


EFFECT = Effect(
    name="sensor_delay",
    site="sensor",
    formula="measurement(t) = r(t - d)",
    source="averaging and transmission in the sensor",
    measurement_delay=measurement_delay,
    fits_site=Machine.measures_position,
    parameters=(EffectParameter("d", "s", 0.0, 0.1, scale=1e-3, role="amplitude"),),
)
