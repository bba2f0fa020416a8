"""An amplifier with another gain than declared: V' = (1 + g) V.

A refit that lets every drive's torque constant differ holds it already, but for a drive that is the only one: there
voltages tell no more than ratios to the gain.  So it is never found beside such a refit; it is here for declared
machines and for randomisation.
"""

from ..machine.effect import Effect, EffectParameter


def voltage(V, g):  # type: ignore[no-untyped-def]
    return V + g * V


EFFECT = Effect(
    name="gain_mismatch",
    family="gain_mismatch",
    site="drive",
    formula="V' = (1 + g) V",
    source="tolerance of amplifiers and motor constants",
    voltage=voltage,
    equivalent=("a torque constant that differs",),
    refitted=True,
    parameters=(EffectParameter("g", "1", -0.9, 9.0, scale=0.05, role="amplitude"),),
)
