"""Voltage that a bridge loses against the current while both switches of a leg are off: V - Vd sign(i).

Between opening one switch of a leg and closing the other, a bridge waits for its dead time. The current then
flows through a diode, and the voltage of the leg opposes it: each period of the pulses loses the product of
supply voltage and dead time, and the mean voltage Vd = U f t of supply U, frequency f and dead time t. A
current whose ripple passes zero flows in both directions, so that below a mean current i0 the loss is in
proportion to it.

In contrast to `dead_band`, which follows the sign of the voltage, the loss drives a motor that brakes.
"""

from ..dynamics.elementwise import maximum, minimum
from ..machine import Effect, EffectParameter
from .winding_heat import fits_site


def current(i, R, Vd, i0):  # type: ignore[no-untyped-def]
    """Return the current, A, that flows with the loss: the solution of R i' = R i - Vd clip(i' / i0, -1, 1).

    i: current without loss, A, R: resistance, ohm, Vd: voltage lost, V, i0: current from which on all of it
    is lost, A.
    """
    lost = Vd / R
    return i - minimum(maximum(i * (lost / (lost + i0)), -lost), lost)


EFFECT = Effect(
    name="inverter_dead_time",
    site="drive",
    shared=True,
    formula="i' = (V - Ke N w - Vd clip(i'/i0, -1, 1))/R",
    source="Jeong and Park, The Analysis and Compensation of Dead-Time Effects in PWM Inverters, 1991",
    current=current,
    signal_order=-2,  # before the heat of the winding, whose resistance the lost voltage meets as well
    fits_site=fits_site,
    equivalent=("the contact voltage of brushes, or the forward voltage of switches and diodes",),
    parameters=(
        EffectParameter("Vd", "V", 0.0, 100.0, scale=0.2, role="amplitude"),
        EffectParameter("i0", "A", 1e-4, 1e4, scale=0.1, grid=(0.02, 0.1), largest=0.3),
    ),
)
