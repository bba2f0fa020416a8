"""Supply voltage that falls with the power that the drives draw: V' = V (1 - s), with the relative sag s.

Bridges of voltages V draw the current V i / U from a supply of voltage U, so that an inner resistance R_s
takes the fraction g V i with g = R_s / U^2. The capacitor behind it makes this the steady state of a lag tau.
The effect at "drives" is that of one supply for all drives, at a drive that of its own. Braking drives raise
the voltage.
"""

from ..dynamics.elementwise import exp
from ..machine import Effect, EffectParameter
from .winding_heat import fits_site


def current(i, V, R, z):  # type: ignore[no-untyped-def]
    """Return the current with the relative sag z, A.

    I: current, A, and V: voltage, V, without sag, R: ohm.
    """
    return i - z * V / R


def next_state(z, dt, power, stall_power, g, tau):  # type: ignore[no-untyped-def]
    """Return the relative sag after the time dt, s: solution of tau ds/dt = g (power - stall_power s) - s.

    power: what the drives draw without sag, W; stall_power: what they draw at standstill, W, by which the
    power falls with the sag; g: relative sag per power, 1/W, tau: time constant, s.
    """
    load = 1.0 + g * stall_power
    steady = g * power / load
    return steady + (z - steady) * exp(-load * dt / tau)


EFFECT = Effect(
    name="supply_sag",
    site="drives",
    formula="V' = V (1 - s), tau ds/dt = g sum V i - s",
    source="source with inner resistance and a capacitor behind it",
    current=current,
    next_state=next_state,
    signal_order=-3,  # before the other effects on a current, which it changes through the voltage
    fits_site=fits_site,
    parameters=(
        EffectParameter("g", "1/W", 0.0, 1e3, scale=0.1, role="amplitude"),
        EffectParameter("tau", "s", 1e-5, 10.0, scale=1.0, grid=(2e-3, 8e-3, 32e-3)),
    ),
)
