"""End stops: rubber buffers where a coordinate's range ends.

A buffer pushes back with k d (1 + c v), never pulls (Hunt and Crossley 1975, exponent 1): stiff in, soft out, so an
impact loses its energy.  It is an effect like any other, and a kernel with it costs a quarter more; as few stages are
ever near an end, only those are advanced by that kernel, each decided by its own state alone.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..machine import Effect, EffectParameter, Machine
from ..machine.kernel import kernel_for
from ..machine.lanes import LANES, copysign
from ..machine.vector_math import maximum
from . import blocks

Array = NDArray[np.float64]
Tables = tuple[Array, Array, Array, Array]

STIFFNESS = 2e5  # N/m: both motors at full voltage press 1.2 mm into it; the light cart still swings slower than 2 kHz
DAMPING = 1.5  # s/m: an impact at 0.5 m/s comes back with less than half its speed
REACH = 0.01  # m: no nearer, a stage at rest needs 200 m/s^2 to touch a stop within 10 ms; full voltage gives 150


def force(q, v, t, low, high, stiffness, damping):  # type: ignore[no-untyped-def]
    depth = maximum(q - high, 0.0) - maximum(low - q, 0.0)
    return -stiffness * depth * maximum(1.0 + damping * copysign(1.0, depth) * v, 0.0)


END_STOP = Effect(
    name="end_stop",
    family="force",
    site="coordinate",
    formula="f = -k d max(0, 1 + c v sign d), d the depth beyond [low, high]",
    source="Hunt and Crossley 1975",
    force=force,
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


class EndStops:
    """The kernel with end stops, for the stages of a batch that are near one."""

    def __init__(self, machine: Machine) -> None:
        stopped = with_end_stops(machine)
        self._kernel = kernel_for(stopped)
        ranges = np.array([machine.coordinate(name).range for name in ("x", "y")])
        self._rows = np.array([machine.coordinate_names.index(name) for name in ("x", "y")])
        self._low, self._high = np.ascontiguousarray(ranges.T)
        self._added = np.array(list(stopped.parameters.values())[len(machine.parameters) :])

    def find(self, state: Array, period: float, first: int, last: int) -> NDArray[np.int64]:
        """Lanes of blocks first..last-1 with a stage near an end."""
        found: NDArray[np.int64] = blocks.near(state, self._rows, self._low, self._high, REACH, period, first, last)
        return found

    def advance(self, tables: Tables, lanes: NDArray[np.int64], h: float, steps: int) -> Array:
        """Where the stages in lanes (k,) are after `steps` steps of h with end stops, in blocks; nothing is changed.

        tables: state, parameters, derived numbers and inputs of all, (blocks, rows, LANES).
        """
        count = -(-len(lanes) // LANES)
        copies = [np.empty((count, table.shape[1], LANES)) for table in tables]
        for table, copy in zip(tables, copies, strict=True):
            blocks.gather(table, lanes, copy)
        state, parameters, derived, inputs = copies
        added = np.broadcast_to(self._added[:, None], (count, len(self._added), LANES))
        parameters = np.concatenate([parameters, added], axis=1)
        self._kernel.advance_blocks(state, parameters, derived, inputs, h, steps, 0, count)
        return state
