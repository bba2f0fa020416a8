"""Bridge that lets the motor coast between pulses: i' = (V - min(|V| / U, 1) Ke N w) / R, full voltage U.

A bridge that shorts the motor between pulses applies the mean voltage, so that the back-EMF brakes all the
time. One that opens (sign and magnitude, as many boards with an L298 are driven) has no current then: the
back-EMF brakes during the fraction |V| / U of the pulses only, and the speed rises steeply with a small duty
cycle. It holds for currents that end within the period of the pulses.
"""

from ..dynamics.elementwise import absolute, minimum
from ..machine import Effect, EffectParameter
from .winding_heat import fits_site


def current(i, V, R, U):  # type: ignore[no-untyped-def]
    """Return the mean current, A, of a bridge that lets the motor coast between pulses.

    i: current with back-EMF all the time, A, V: mean voltage, V, R: resistance, ohm, U: full voltage, V.
    """
    return V / R - minimum(absolute(V) / U, 1.0) * (V / R - i)


EFFECT = Effect(
    name="coasting_bridge",
    site="drive",
    shared=True,
    formula="i' = (V - min(|V|/U, 1) Ke N w)/R",
    source="bridges that are switched off between the pulses",
    current=current,
    signal_order=-4,  # first: of the current by Ohm's law
    fits_site=fits_site,
    parameters=(EffectParameter("U", "voltage", 1e-3, 1e4, scale=0.1, grid=(0.5, 0.7, 1.0, 1.4, 2.0)),),
)
