"""An amplifier without output below a voltage: V' = 0 for |V| < Vd, else V reduced by a fraction of Vd.

drop = 0 is a switch (the enable threshold of a servo amplifier). drop = 1 is a continuous dead zone (base-emitter
voltage of an output stage, contact voltage of brushes).
"""

from ..dynamics.elementwise import absolute, copysign, where
from ..machine import Effect, EffectParameter


def voltage(V, Vd, drop):  # type: ignore[no-untyped-def]
    """Return the output voltage, V: 0 for |V| < Vd, else V - drop Vd sign V; V, Vd: V, drop: fraction in [0, 1]."""
    return where(absolute(V) < Vd, 0.0, V - copysign(drop * Vd, V))


EFFECT = Effect(
    name="dead_band",
    family="dead_band",
    site="drive",
    shared=True,
    formula="V' = 0 for |V| < Vd, else V - drop Vd sign V",
    source="output stages without bias; brush contact voltage",
    voltage=voltage,
    signal_order=1,
    parameters=(
        EffectParameter("Vd", "V", 0.0, 100.0, scale=0.2, grid=(0.01, 0.03, 0.06, 0.12, 0.25, 0.5, 1.0), role="switch"),
        EffectParameter("drop", "1", 0.0, 1.0, scale=0.3, grid=(0.0, 1.0)),
    ),
)
