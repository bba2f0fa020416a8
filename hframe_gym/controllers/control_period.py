"""Control periods: those that controllers accept, and those at which they can damp a machine's vibrations."""

from __future__ import annotations

import numpy as np

from ..dynamics import belt_modes
from ..errors import InputError
from ..machine import Machine

# s. The preview and the horizon of the controllers last a fixed time, so that a shorter period costs time and
# memory.
SHORTEST_PERIOD, LONGEST_PERIOD = 1e-5, 10.0
# Control periods per period of the slowest belt mode, at least, where one is suggested.
SAMPLES_PER_MODE = 4.0


def check_period(period: float) -> float:
    """Return the control `period`, s; raise an InputError if it is not between 1e-5 s and 10 s."""
    if not SHORTEST_PERIOD <= period <= LONGEST_PERIOD:
        limits = f"{SHORTEST_PERIOD:g} to {LONGEST_PERIOD:g} s"
        raise InputError(f"period is {period!r}, it must be a positive number of seconds from {limits}")
    return float(period)


def shorter_period(machine: Machine, period: float) -> float | None:
    """Suggest a shorter control period, s, if a machine's belt modes are all above half the control rate.

    A sampled controller cannot observe or damp a vibration above half its rate (Nyquist frequency). The
    suggestion is the longest period of 1, 2 or 5 times a power of ten that is at most a quarter of the period
    of the slowest belt mode. None if the `period`, s, suffices or no belt vibrates.
    """
    modes = belt_modes(machine)
    if not modes or modes[0] <= 0.5 / period:
        return None
    longest = 1.0 / (SAMPLES_PER_MODE * modes[0])
    decade = 10.0 ** np.floor(np.log10(longest))
    return float(max(step * decade for step in (1.0, 2.0, 5.0) if step * decade <= longest))


def period_concern(machine: Machine, period: float) -> str | None:
    """Return a warning that proposes a shorter control period than `period`, s, or None if it suffices."""
    shorter = shorter_period(machine, period)
    if shorter is None:
        return None
    slowest = belt_modes(machine)[0]
    return (
        f"machine {machine.name!r}: its slowest belt mode, {slowest:.0f} Hz, "
        f"is above half the control rate of {1.0 / period:.0f} Hz, so no controller can damp it; "
        f"try a control period of {shorter:g} s (--period {shorter:g})"
    )
