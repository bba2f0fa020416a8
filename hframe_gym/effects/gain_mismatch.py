"""An amplifier with another gain than declared: V' = (1 + g) V.

A refit that frees the torque constant of every drive already contains this effect, unless it acts before a
dead band that all drives share. With a single drive it cannot be identified at all, because voltages
determine only ratios to the gain. It also serves declared machines and randomization.
"""

from ..machine import Effect, EffectParameter


def voltage(V, g):  # type: ignore[no-untyped-def]
    """Return the output voltage (1 + g) V, V; V: commanded voltage, V, g: relative gain error."""
    return V + g * V


EFFECT = Effect(
    name="gain_mismatch",
    site="drive",
    formula="V' = (1 + g) V",
    source="tolerance of amplifiers and motor constants",
    voltage=voltage,
    equivalent=("a torque constant that differs",),
    refitted=True,
    parameters=(EffectParameter("g", "1", -0.9, 9.0, scale=0.05, role="amplitude"),),
)
