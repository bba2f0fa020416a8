"""A sensor that is not square to the other axis: it shows r + a q, q the position across."""

from ..machine.effect import Effect, EffectParameter


def measurement(r, across, a):  # type: ignore[no-untyped-def]
    return r + a * across


EFFECT = Effect(
    name="sensor_skew",
    family="sensor_skew",
    site="sensor",
    formula="shown = r + a across",
    source="a laser's target or an axis out of square",
    measurement=measurement,
    fits=lambda machine: any(machine.across(s.coordinate) for s in machine.sensors),
    parameters=(EffectParameter("a", "1", -1.0, 1.0, scale=0.01, role="amplitude"),),
)
