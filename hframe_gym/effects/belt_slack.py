"""Belts that go slack: the tension beyond the pretension T0 cannot fall below -T0."""

from ..dynamics.elementwise import maximum
from ..machine import Effect, EffectParameter


def tension(s, k, T0):  # type: ignore[no-untyped-def]
    """Return the belt tension beyond the pretension T0, N: max(k s, -T0); s: extension, m, k: N/m."""
    return maximum(k * s, -T0)


def energy_slope(s, k, T0):  # type: ignore[no-untyped-def]
    """Return the derivative of the belt's energy E(s, k) by k, max(s, -T0/k)^2 / 2, m^2.

    s: extension, m, k: stiffness, N/m, T0: pretension, N.
    """
    taut = maximum(s, -T0 / k)
    return 0.5 * taut * taut


EFFECT = Effect(
    name="belt_slack",
    site="belts",
    formula="T = max(k s, -T0)",
    source="a belt cannot transmit compression",
    tension=tension,
    energy_slope=energy_slope,
    parameters=(EffectParameter("T0", "N", 0.0, 1e5, scale=0.1, grid=(0.15, 0.3, 0.45, 0.6, 0.75, 0.9)),),
)
