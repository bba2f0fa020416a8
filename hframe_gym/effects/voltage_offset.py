"""An amplifier with a zero offset: V' = V + V0.

At a motor that moves freely the effect is equivalent to a constant torque of the motor's gain times V0.
"""

from ..machine import Effect, EffectParameter


def voltage(V, V0):  # type: ignore[no-untyped-def]
    """Return the output voltage V + V0, V; V: commanded voltage, V, V0: offset, V."""
    return V + V0


EFFECT = Effect(
    name="voltage_offset",
    site="drive",
    formula="V' = V + V0",
    source="offset of an analog amplifier or D/A converter",
    voltage=voltage,
    signal_order=2,  # after gain and dead band
    parameters=(EffectParameter("V0", "V", -100.0, 100.0, scale=0.1, role="amplitude"),),
)
