"""End stops: rubber buffers at both ends of every axis of the tool, as an effect of the simulated machine.

References:
    Hunt and Crossley, "Coefficient of restitution interpreted as damping in vibroimpact" (1975).
"""

from __future__ import annotations

from ..dynamics.elementwise import copysign, maximum
from ..machine import Effect, EffectParameter, Machine
from .spaces import workspace_of

# Rubber buffers at the ends of x and y.
BUFFER_STIFFNESS = 2e5  # N/m: both motors at full voltage compress it by 1.2 mm; the cart oscillates on it below 2 kHz
BUFFER_DAMPING = 1.5  # s/m: an impact at 0.5 m/s rebounds with less than half its speed


def _buffer_force(q, v, t, low, high, stiffness, damping):  # type: ignore[no-untyped-def]
    """Return f = -k d max(0, 1 + c v sign d), N, with the depth d beyond [low, high], m."""
    depth = maximum(q - high, 0.0) - maximum(low - q, 0.0)
    return -stiffness * depth * maximum(1.0 + damping * copysign(1.0, depth) * v, 0.0)


def _compresses_buffer(q, low, high):  # type: ignore[no-untyped-def]
    """Return whether the coordinate is beyond [low, high]."""
    return (q < low) | (q > high)


END_STOP = Effect(
    name="end_stop",
    family="force",
    site="coordinate",
    formula="f = -k d max(0, 1 + c v sign d), d the depth beyond [low, high]",
    source="Hunt and Crossley 1975",
    force=_buffer_force,
    active_region=_compresses_buffer,
    parameters=(
        EffectParameter("low", "position", -1e3, 1e3, scale=1e-3, grid=(0.0,)),
        EffectParameter("high", "position", -1e3, 1e3, scale=1e-3, grid=(0.0,)),
        EffectParameter("stiffness", "stiffness", 0.0, 1e9, scale=1e4, grid=(BUFFER_STIFFNESS,)),
        EffectParameter("damping", "s/m", 0.0, 1e3, scale=0.1, grid=(BUFFER_DAMPING,)),
    ),
)


def with_end_stops(machine: Machine) -> Machine:
    """Add rubber buffers at both ends of the ranges of the tool's axes to a copy of a machine.

    A buffer of stiffness k and damping c, compressed by d at the rate v, pushes back with k d (1 + c v) and never
    pulls: it is stiff in compression and soft in release, so that an impact loses energy (Hunt and Crossley 1975 with
    exponent 1).

    Args:
        machine: Machine with a workspace.

    Returns:
        Copy with one more effect (modeled deviation) `end_stop` per axis. Their parameters follow those of the machine.

    Raises:
        InputError: If the machine has no workspace; see `workspace_of`.
    """
    stops = [
        END_STOP.at(name, low=low, high=high, stiffness=BUFFER_STIFFNESS, damping=BUFFER_DAMPING)
        for name, (low, high) in zip(machine.tool_axes, workspace_of(machine).tolist(), strict=True)
    ]
    return machine.with_effects(*stops)
