"""Belts that stiffen as they stretch, tension k s (1 + h s^2)."""

from ..machine.effect import Effect, EffectParameter


def tension(s, k, h):  # type: ignore[no-untyped-def]
    return k * s * (1.0 + h * s * s)


def energy_slope(s, h):  # type: ignore[no-untyped-def]
    return 0.5 * s * s * (1.0 + 0.5 * h * s * s)


EFFECT = Effect(
    name="belt_hardening",
    family="belt_hardening",
    site="belts",
    formula="T = k s (1 + h s^2)",
    source="Duffing's spring",
    tension=tension,
    energy_slope=energy_slope,
    parameters=(EffectParameter("h", "1/m^2", -1e12, 1e12, scale=0.1, role="amplitude"),),
)
