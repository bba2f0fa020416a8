"""Delayed voltage, V'(t) = V(t - d): dead time of the controller (all drives) or of an amplifier (one)."""

from ..machine import Effect, EffectParameter


def delay(d):  # type: ignore[no-untyped-def]
    """Return the delay d from commanded to effective voltage, s."""
    return d


EFFECT = Effect(
    name="input_delay",
    site="drives",
    formula="V'(t) = V(t - d)",
    source="dead time of sampled control",
    delay=delay,
    parameters=(EffectParameter("d", "s", 0.0, 0.1, scale=1e-3, role="amplitude"),),
)
