"""End stops: rubber buffers where a coordinate's range ends.

A buffer pushes back with k d (1 + c v), never pulls (Hunt and Crossley 1975, exponent 1): stiff in, soft out, so an
impact loses its energy.  It is an effect like any other, with a guard: away from the ends a step pays two comparisons a
coordinate for it.
"""

from __future__ import annotations

from ..dynamics.simd import copysign
from ..dynamics.simd_math import maximum
from ..machine import Effect, EffectParameter, Machine

STIFFNESS = 2e5  # N/m: both motors at full voltage press 1.2 mm into it; the light cart still swings slower than 2 kHz
DAMPING = 1.5  # s/m: an impact at 0.5 m/s comes back with less than half its speed


def force(q, v, t, low, high, stiffness, damping):  # type: ignore[no-untyped-def]
    depth = maximum(q - high, 0.0) - maximum(low - q, 0.0)
    return -stiffness * depth * maximum(1.0 + damping * copysign(1.0, depth) * v, 0.0)


def guard(q, low, high):  # type: ignore[no-untyped-def]
    return (q < low) | (q > high)


END_STOP = Effect(
    name="end_stop",
    family="force",
    site="coordinate",
    formula="f = -k d max(0, 1 + c v sign d), d the depth beyond [low, high]",
    source="Hunt and Crossley 1975",
    force=force,
    guard=guard,
    parameters=(
        EffectParameter("low", "position", -1e3, 1e3, scale=1e-3, grid=(0.0,)),
        EffectParameter("high", "position", -1e3, 1e3, scale=1e-3, grid=(0.0,)),
        EffectParameter("stiffness", "stiffness", 0.0, 1e9, scale=1e4, grid=(STIFFNESS,)),
        EffectParameter("damping", "s/m", 0.0, 1e3, scale=0.1, grid=(DAMPING,)),
    ),
)


def with_end_stops(machine: Machine) -> Machine:
    """The machine with a buffer at both ends of x and y.  Its own parameters keep their order and come first."""
    stops = []
    for name in ("x", "y"):
        low, high = machine.coordinate(name).range  # type: ignore[misc]
        stops.append(END_STOP.at(name, low=low, high=high, stiffness=STIFFNESS, damping=DAMPING))
    return machine.with_effects(*stops)


def rated_belt_force(machine: Machine) -> float:
    """Force of all drives together at rated voltage and standstill, N of belt."""
    total = 0.0
    for d in machine.drives:
        c = machine.coordinate(d.coordinate)
        total += d.gain * d.rated_voltage / (c.radius if c.kind == "rotary" else 1.0)
    return total
