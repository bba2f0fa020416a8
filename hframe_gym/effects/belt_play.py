"""Play in the belts' teeth and clamps: within +-d of extension a belt carries nothing."""

from ..dynamics.elementwise import maximum, minimum
from ..machine.effect import Effect, EffectParameter


def tension(s, k, d):  # type: ignore[no-untyped-def]
    return k * (s - minimum(maximum(s, -d), d))


def energy_slope(s, d):  # type: ignore[no-untyped-def]
    z = s - minimum(maximum(s, -d), d)
    return 0.5 * z * z


EFFECT = Effect(
    name="belt_play",
    family="belt_play",
    site="belts",
    formula="T = k (s - clip(s, -d, d))",
    source="backlash of timing belts in their pulleys' grooves",
    tension=tension,
    energy_slope=energy_slope,
    parameters=(EffectParameter("d", "m", 0.0, 1e-2, scale=0.05, role="amplitude"),),
)
