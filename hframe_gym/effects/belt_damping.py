"""Damping inside the belts: tension k (s + c ds/dt), the Kelvin-Voigt model."""

from ..machine import AppliedEffect, Effect, EffectParameter, Machine


def tension(s, rate, k, c):  # type: ignore[no-untyped-def]
    """Return tension k (s + c ds/dt), N; s: extension, m, rate: ds/dt, m/s, k: stiffness, N/m, c: time, s."""
    return k * (s + c * rate)


def fastest(machine: Machine, effect: AppliedEffect) -> float:
    """Return the rate at which the belts brake their fastest vibration w, c w^2, rad/s."""
    return effect.parameters["c"] * machine.highest_frequency**2


EFFECT = Effect(
    name="belt_damping",
    site="belts",
    formula="T = k s + c k ds/dt",
    source="Kelvin-Voigt model",
    tension=tension,
    fastest=fastest,
    parameters=(EffectParameter("c", "s", 0.0, 1e-2, scale=1e-4, role="amplitude"),),
)
