"""A sensor that saturates: outside its range [low, high], it measures the nearer end of the range.

The range of the laser of Sollmann et al. (2010) ends at 100 mm (section V).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..arrays import Array
from ..dynamics.elementwise import maximum, minimum
from ..machine import Effect, EffectParameter, Machine

UNLIMITED = 10.0  # An end that was never reached is set to this multiple of the largest measurement.
# Fraction of the measurements at one outermost value above which it may be the end of a range. Only runs that
# reach this value count: in the others, nothing tells whether the sensor could measure beyond it.
_END_FRACTION = 0.005
_TOP_PERCENTILE = 99.9  # the rows beyond it may be outliers


def measurement(r, low, high):  # type: ignore[no-untyped-def]
    """Return the measurement of a sensor, m or rad: r, limited to the range from low to high."""
    return minimum(maximum(r, low), high)


def starting_values(measured: Sequence[Array], noise: float) -> list[dict[str, float]]:
    """Estimate range limits of a sensor from its measurements: many equal extreme values mean saturation.

    Args:
        measured: Measurements of each run, m or rad, shapes (m,).
        noise: Standard deviation of their noise, m or rad.

    Returns:
        Sets of limits for a search, m or rad: the limit at which the sensor saturates; or, for two of them,
        each limit alone and both. Empty without saturation.
    """
    runs = [run for run in measured if len(run)]
    if not runs:
        return []
    low, high = (_end_of_range(runs, sign, 4.0 * max(noise, 1e-12)) for sign in (-1.0, 1.0))
    far = UNLIMITED * max(max(float(np.abs(run).max()) for run in runs), 1e-6)
    choices = [(low, None), (None, high), (low, high)]
    return [
        {"low": -far if a is None else a, "high": far if b is None else b}
        for a, b in dict.fromkeys(choices)
        if not (a is None and b is None)
    ]


def _end_of_range(runs: Sequence[Array], sign: float, width: float) -> float | None:
    """Return the outermost value in one direction, m or rad, if many measurements are equal to it, else None.

    Args:
        runs: Measurements of each run, m or rad, shapes (m,).
        sign: Direction, 1 or -1.
        width: Difference that counts as equal, m or rad.
    """
    tops = [float(np.percentile(sign * run, _TOP_PERCENTILE)) for run in runs]
    least = max(tops) - width
    reaching = np.concatenate([sign * run for run, top in zip(runs, tops, strict=True) if top > least])
    outermost = reaching[reaching > least]
    return sign * float(np.median(outermost)) if len(outermost) > _END_FRACTION * len(reaching) else None


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
