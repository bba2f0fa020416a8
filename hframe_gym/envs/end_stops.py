"""End stops: rubber buffers at both ends of the ranges of x and y.

A buffer of stiffness k and damping c, compressed by d at the rate v, pushes back with k d (1 + c v) and never pulls: it
is stiff in compression and soft in release, so that an impact loses energy. It is an effect with an active region:
away from the ends it costs two comparisons per coordinate and step.

References:
    Hunt and Crossley, "Coefficient of restitution interpreted as damping in vibroimpact" (1975), with exponent 1.
"""

from __future__ import annotations

from ..dynamics.elementwise import copysign, maximum
from ..machine import Effect, EffectParameter, Machine

STIFFNESS = 2e5  # N/m: both motors at full voltage compress it by 1.2 mm; the light cart oscillates on it below 2 kHz
DAMPING = 1.5  # s/m: an impact at 0.5 m/s rebounds with less than half its speed


def _force(q, v, t, low, high, stiffness, damping):  # type: ignore[no-untyped-def]
    """Return f = -k d max(0, 1 + c v sign d), N, with the depth d beyond [low, high], m."""
    depth = maximum(q - high, 0.0) - maximum(low - q, 0.0)
    return -stiffness * depth * maximum(1.0 + damping * copysign(1.0, depth) * v, 0.0)


def _active_region(q, low, high):  # type: ignore[no-untyped-def]
    """Return whether the coordinate is beyond [low, high]."""
    return (q < low) | (q > high)


END_STOP = Effect(
    name="end_stop",
    family="force",
    site="coordinate",
    formula="f = -k d max(0, 1 + c v sign d), d the depth beyond [low, high]",
    source="Hunt and Crossley 1975",
    force=_force,
    active_region=_active_region,
    parameters=(
        EffectParameter("low", "position", -1e3, 1e3, scale=1e-3, grid=(0.0,)),
        EffectParameter("high", "position", -1e3, 1e3, scale=1e-3, grid=(0.0,)),
        EffectParameter("stiffness", "stiffness", 0.0, 1e9, scale=1e4, grid=(STIFFNESS,)),
        EffectParameter("damping", "s/m", 0.0, 1e3, scale=0.1, grid=(DAMPING,)),
    ),
)


def with_end_stops(machine: Machine) -> Machine:
    """Add rubber buffers at both ends of the ranges of x and y to a copy of a machine.

    Args:
        machine: Machine whose coordinates x and y have ranges.

    Returns:
        Copy with two more effects `end_stop`, one for x and one for y. Their parameters follow those of the machine.
    """
    stops = []
    for name in ("x", "y"):
        low, high = machine.coordinate(name).range  # type: ignore[misc]
        stops.append(END_STOP.at(name, low=low, high=high, stiffness=STIFFNESS, damping=DAMPING))
    return machine.with_effects(*stops)


def rated_belt_force(machine: Machine) -> float:
    """Add up the belt forces of all drives at rated voltage and standstill (no back-EMF).

    Args:
        machine: Machine with its drives.

    Returns:
        Sum of drive torque / pulley radius (of the drive force on a linear coordinate) over all drives, N.
    """
    return sum(d.gain * d.rated_voltage / machine.coordinate(d.coordinate).travel_per_unit for d in machine.drives)
