"""Damping inside the belts: tension k (s + c ds/dt), the Kelvin-Voigt model."""

from ..machine import Effect, EffectParameter


def tension(s, rate, k, c):  # type: ignore[no-untyped-def]
    """Return tension k (s + c ds/dt), N; s: extension, m, rate: ds/dt, m/s, k: stiffness, N/m, c: time, s."""
    return k * (s + c * rate)


EFFECT = Effect(
    name="belt_damping",
    site="belts",
    formula="T = k s + c k ds/dt",
    source="Kelvin-Voigt model",
    tension=tension,
    parameters=(EffectParameter("c", "s", 0.0, 1e-2, scale=1e-4, role="amplitude"),),
)
