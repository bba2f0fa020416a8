"""Belts that stiffen with extension: tension k s (1 + h s^2)."""

from ..machine import Effect, EffectParameter


def tension(s, k, h):  # type: ignore[no-untyped-def]
    """Return the tension k s (1 + h s^2), N; s: extension, m, k: stiffness, N/m, h: hardening, 1/m^2."""
    return k * s * (1.0 + h * s * s)


def energy_slope(s, h):  # type: ignore[no-untyped-def]
    """Return the derivative of the belt's energy E(s, k) by k, s^2/2 (1 + h s^2/2), m^2; s: m, h: 1/m^2."""
    return 0.5 * s * s * (1.0 + 0.5 * h * s * s)


EFFECT = Effect(
    name="belt_hardening",
    site="belts",
    formula="T = k s (1 + h s^2)",
    source="Duffing oscillator",
    tension=tension,
    energy_slope=energy_slope,
    parameters=(EffectParameter("h", "1/m^2", -1e12, 1e12, scale=0.1, role="amplitude"),),
)
