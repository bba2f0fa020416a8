"""An amplifier whose zero is off: V' = V + V0.

On a motor that moves freely it cannot be told from a constant torque of the size gain times V0.
"""

from ..machine.effect import Effect, EffectParameter


def voltage(V, V0):  # type: ignore[no-untyped-def]
    return V + V0


EFFECT = Effect(
    name="voltage_offset",
    family="voltage_offset",
    site="drive",
    formula="V' = V + V0",
    source="offset of an analogue amplifier or D/A converter",
    voltage=voltage,
    parameters=(EffectParameter("V0", "V", -100.0, 100.0, scale=0.1, role="amplitude"),),
)
