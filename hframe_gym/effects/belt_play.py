"""Play in the teeth and clamps of the belts: no tension for extensions within +-d."""

from ..dynamics.elementwise import maximum, minimum
from ..machine import Effect, EffectParameter


def beyond_play(s, d):  # type: ignore[no-untyped-def]
    """Return the part of a distance s, m or rad, that lies outside a play of half width d, same unit."""
    return s - minimum(maximum(s, -d), d)


def tension(s, k, d):  # type: ignore[no-untyped-def]
    """Return tension k (s - clip(s, -d, d)), N; s: extension, m, k: stiffness, N/m, d: half the play, m."""
    return k * beyond_play(s, d)


def energy_slope(s, d):  # type: ignore[no-untyped-def]
    """Return the derivative of the belt's energy E(s, k) by k, (s - clip(s, -d, d))^2 / 2, m^2; s, d: m."""
    stretch = beyond_play(s, d)
    return 0.5 * stretch * stretch


EFFECT = Effect(
    name="belt_play",
    site="belts",
    formula="T = k (s - clip(s, -d, d))",
    source="backlash of timing belts in the grooves of their pulleys",
    tension=tension,
    energy_slope=energy_slope,
    impacts=True,
    parameters=(
        EffectParameter("d", "m", 0.0, 1e-2, scale=0.05, role="amplitude", grid=(0.3, 1.0, 3.0, 10.0, 30.0)),
    ),
)
