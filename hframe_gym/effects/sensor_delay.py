"""A sensor that is late: it shows what was d seconds ago."""

from ..machine.effect import Effect, EffectParameter


def measurement_delay(d):  # type: ignore[no-untyped-def]
    return d


EFFECT = Effect(
    name="sensor_delay",
    family="sensor_delay",
    site="sensor",
    formula="shown(t) = r(t - d)",
    source="averaging and transmission in the sensor",
    measurement_delay=measurement_delay,
    parameters=(EffectParameter("d", "s", 0.0, 0.1, scale=1e-3, role="amplitude"),),
)
