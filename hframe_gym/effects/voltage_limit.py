"""An amplifier that cannot reach the commanded voltage, as when its supply is lower: |V'| <= U."""

from ..dynamics.elementwise import maximum, minimum
from ..machine import Effect, EffectParameter


def voltage(V, U):  # type: ignore[no-untyped-def]
    """Return the limited voltage clip(V, -U, U), V; V: commanded voltage, V, U: limit, V."""
    return minimum(maximum(V, -U), U)


EFFECT = Effect(
    name="voltage_limit",
    site="drive",
    shared=True,
    formula="|V'| <= U",
    source="supply voltage and maximum duty cycle of amplifiers",
    voltage=voltage,
    signal_order=3,  # last of the effects on a voltage: no output exceeds the supply
    parameters=(
        EffectParameter(
            "U", "voltage", 1e-3, 1e4, scale=0.1, grid=(0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.88, 0.95)
        ),
    ),
)
