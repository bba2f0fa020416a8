"""A sensor that sticks at the ends of its range: what lies beyond low or high is shown as low or high.

The paper's laser does so at 100 mm (section V).
"""

from ..dynamics.elementwise import maximum, minimum
from ..machine.effect import Effect, EffectParameter


def measurement(r, low, high):  # type: ignore[no-untyped-def]
    return minimum(maximum(r, low), high)


EFFECT = Effect(
    name="sensor_range",
    family="sensor_range",
    site="sensor",
    formula="shown = clip(r, low, high)",
    source="Sollmann et al., section V",
    measurement=measurement,
    parameters=(
        EffectParameter("low", "position", -1e6, 1e6, scale=0.01),
        EffectParameter("high", "position", -1e6, 1e6, scale=0.01),
    ),
)
