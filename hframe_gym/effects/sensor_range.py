"""A sensor that saturates: outside its range [low, high], it measures the nearer end of the range.

The range of the laser of Sollmann et al. (2010) ends at 100 mm (section V).
"""

from ..dynamics.elementwise import maximum, minimum
from ..machine import Effect, EffectParameter


def measurement(r, low, high):  # type: ignore[no-untyped-def]
    """Return the measurement of a sensor, m or rad: r, limited to the range from low to high."""
    return minimum(maximum(r, low), high)


EFFECT = Effect(
    name="sensor_range",
    family="sensor_range",
    site="sensor",
    formula="measurement = clip(r, low, high)",
    source="Sollmann et al., section V",
    measurement=measurement,
    signal_order=1,  # after scale and skew
    parameters=(
        EffectParameter("low", "position", -1e6, 1e6, scale=0.01),
        EffectParameter("high", "position", -1e6, 1e6, scale=0.01, above="low"),
    ),
)
