"""An amplifier without output while the magnitude of the commanded voltage V is below a threshold Vd.

Above it, the output is V reduced in magnitude by drop * Vd. With drop = 0, it is V itself, so that it jumps
at the threshold (the enable threshold of a servo amplifier). With drop = 1, it rises continuously from 0
(base-emitter voltage of an output stage, contact voltage of brushes).
"""

from ..dynamics.elementwise import absolute, copysign, where
from ..machine import Effect, EffectParameter


def voltage(V, Vd, drop):  # type: ignore[no-untyped-def]
    """Return the output voltage of the amplifier, V: 0 for |V| < Vd, else V - drop * Vd * sign(V).

    Vd is the threshold, V, and drop the fraction of it by which the output is reduced above it, from 0 to 1.
    """
    return where(absolute(V) < Vd, 0.0, V - copysign(drop * Vd, V))


EFFECT = Effect(
    name="dead_band",
    site="drive",
    shared=True,
    formula="V' = 0 for |V| < Vd, else V - drop * Vd * sign(V)",
    source="output stages without bias; brush contact voltage",
    voltage=voltage,
    signal_order=1,  # after the gain
    parameters=(
        EffectParameter(
            "Vd", "V", 0.0, 100.0, scale=0.2, grid=(0.01, 0.03, 0.06, 0.12, 0.25, 0.5, 1.0), role="switch"
        ),
        EffectParameter("drop", "1", 0.0, 1.0, scale=0.3, grid=(0.0, 1.0)),
    ),
)
