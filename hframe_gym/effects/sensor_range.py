"""A sensor that saturates: outside its range [low, high], it measures the nearer end of the range.

The range of the laser of Sollmann et al. (2010) ends at 100 mm (section V).
"""

from __future__ import annotations

import numpy as np

from ..arrays import Array
from ..dynamics.elementwise import maximum, minimum
from ..machine import Effect, EffectParameter, Machine

UNLIMITED = 10.0  # An end that was never reached is set to this multiple of the largest measurement.
# Fraction of the measurements at one outermost value above which it may be the end of a range.
_END_FRACTION = 0.005


def measurement(r, low, high):  # type: ignore[no-untyped-def]
    """Return the measurement of a sensor, m or rad: r, limited to the range from low to high."""
    return minimum(maximum(r, low), high)


def starting_values(measured: Array, noise: float) -> list[dict[str, float]]:
    """Estimate range limits of a sensor from its measurements: many equal extreme values mean saturation.

    Args:
        measured: Measurements, m or rad, shape (m,).
        noise: Standard deviation of their noise, m or rad.

    Returns:
        Sets of limits for a search, m or rad: the limit at which the sensor saturates; or, for two of them,
        each limit alone and both. Empty without saturation.
    """
    if len(measured) == 0:
        return []
    ends = []
    for sign in (-1.0, 1.0):
        outward = sign * measured
        top = float(np.percentile(outward, 99.9))
        outermost = outward > top - 4 * max(noise, 1e-12)
        saturated = float(np.mean(outermost)) > _END_FRACTION
        ends.append(sign * float(np.median(outward[outermost])) if saturated else None)
    far = UNLIMITED * max(float(np.abs(measured).max()), 1e-6)
    low, high = ends
    choices = [(low, None), (None, high), (low, high)]
    return [
        {"low": -far if a is None else a, "high": far if b is None else b}
        for a, b in dict.fromkeys(choices)
        if not (a is None and b is None)
    ]


EFFECT = Effect(
    name="sensor_range",
    site="sensor",
    formula="measurement = clip(r, low, high)",
    source="Sollmann et al., section V",
    measurement=measurement,
    fits_site=Machine.measures_position,
    range_ends=("low", "high"),
    starting_values=starting_values,
    signal_order=1,  # after scale and skew
    parameters=(
        EffectParameter("low", "position", -1e6, 1e6, scale=0.01),
        EffectParameter("high", "position", -1e6, 1e6, scale=0.01, above="low"),
    ),
)
