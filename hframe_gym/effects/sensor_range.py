"""A sensor that saturates at the ends of its range [low, high].

The laser of Sollmann et al. (2010) does so at 100 mm (section V).
"""

from ..dynamics.elementwise import maximum, minimum
from ..machine import Effect, EffectParameter


def measurement(r, low, high):  # type: ignore[no-untyped-def]
    """Return the measurement clip(r, low, high), m or rad; r: ideal reading, low, high: range, same unit."""
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
