"""Resistance of a winding that rises with the heat of its current: R (1 + a h) with tau dh/dt = i^2 - h.

The state h, A^2, is the mean square of the current over the thermal time constant tau; copper gains 0.39 % of
resistance per kelvin. A simulation begins with a cold winding (h = 0), a recording with what earlier motion
has left.
"""

from ..dynamics.elementwise import exp
from ..machine import Effect, EffectParameter, Machine

_WARM = 0.25  # of the current at standstill and rated voltage: about what motors bear continuously


def fits_site(machine: Machine, site: str) -> bool:
    """Return whether all drives of a site command voltages, so that the winding's resistance matters."""
    drives = machine.drives if site == "drives" else (machine.drive(site),)
    return all(drive.command == "voltage" for drive in drives)


def current(i, z, a):  # type: ignore[no-untyped-def]
    """Return the warm winding's current, A; i: current if cold, A, z: heat, A^2, a: relative rise, 1/A^2."""
    return i / (1.0 + a * z)


def next_state(z, i, dt, a, tau):  # type: ignore[no-untyped-def]
    """Return the heat, A^2, after the time dt, s, of the current i, A, of a cold winding; tau: s."""
    amps = current(i, z, a)
    return amps * amps + (z - amps * amps) * exp(-dt / tau)


def initial_spread(i):  # type: ignore[no-untyped-def]
    """Return the standard deviation of the heat when a recording begins, A^2.

    I: current at rated voltage, A.
    """
    return (_WARM * i) * (_WARM * i)


EFFECT = Effect(
    name="winding_heat",
    site="drive",
    shared=True,
    formula="i = (V - Ke N w)/(R (1 + a h)), tau dh/dt = i^2 - h",
    source="temperature coefficient of copper, IEC 60028; first-order thermal model of a winding",
    current=current,
    next_state=next_state,
    initial_spread=initial_spread,
    signal_order=-1,  # before the lag of the winding and a limit of its current
    fits_site=fits_site,
    equivalent=("a torque constant that falls with the heat of the motor",),
    parameters=(
        EffectParameter("a", "1/A^2", 0.0, 1e6, scale=0.1, role="amplitude"),
        EffectParameter("tau", "s", 1e-2, 1e5, scale=1.0, grid=(0.5, 2.0, 8.0, 30.0, 120.0), slope_of="a"),
    ),
)
