"""End stops: rubber buffers where a coordinate's range ends.

A buffer pushes back with k d (1 + c v), never pulls (Hunt and Crossley 1975, exponent 1): stiff in, soft out, so an
impact loses its energy.  It is an effect like any other, and a kernel with it costs a quarter more; as few stages are
ever at an end, a period is first run without buffers, and again with them for those that may have met one, each decided
by its own motion alone.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..machine import Effect, EffectParameter, Machine
from ..machine.kernel import Kernel, kernel_for
from ..machine.lanes import LANES, copysign
from ..machine.vector_math import maximum
from . import blocks

Array = NDArray[np.float64]
Tables: TypeAlias = tuple[Array, Array, Array, Array]
Run: TypeAlias = Callable[[Kernel, Tables, int, int], None]

STIFFNESS = 2e5  # N/m: both motors at full voltage press 1.2 mm into it; the light cart still swings slower than 2 kHz
DAMPING = 1.5  # s/m: an impact at 0.5 m/s comes back with less than half its speed
HASTE = 1.5  # times the acceleration that all stalled drives together give the nominal stage: more than any draw has


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
    """The kernel with end stops, for the stages of a batch that meet one.

    period: for which a stage is advanced at a time, s.  tables: of the batch, for their shapes.
    """

    def __init__(self, machine: Machine, period: float, tables: Tables) -> None:
        stopped = with_end_stops(machine)
        self._kernel = kernel_for(stopped)
        ranges = np.array([machine.coordinate(name).range for name in ("x", "y")])
        self._rows = np.array([machine.coordinate_names.index(name) for name in ("x", "y")])
        self._low, self._high = np.ascontiguousarray(ranges.T)
        # The largest way out and back within a period that an acceleration allows: a T^2 / 8.
        mass = np.array([machine.coordinate(name).mass for name in ("x", "y")])
        self._bulge = HASTE * stall_force(machine) / mass * period**2 / 8.0
        # Room for the stages that are run again, in the blocks of their own range; the stops' parameters stay.
        self._before = np.empty_like(tables[0])
        self._again = [np.empty_like(table) for table in tables]
        added = np.array(list(stopped.parameters.values())[len(machine.parameters) :])
        columns = np.broadcast_to(added[:, None], (len(tables[1]), len(added), LANES))
        self._again[1] = np.concatenate([tables[1], columns], axis=1)

    def remember(self, state: Array, first: int, last: int) -> None:
        """Keep the state of blocks first..last-1, before a period."""
        self._before[first:last] = state[first:last]

    def correct(self, run: Run, tables: Tables, first: int, last: int) -> None:
        """Advance those stages of blocks first..last-1 again that met an end in the period since `remember`.

        run: advances blocks by a kernel, run(kernel, tables, first, last).  tables: state, after the period without end
        stops, parameters, derived numbers and inputs of all, (blocks, rows, LANES).
        """
        lanes = blocks.beyond(self._before, tables[0], self._rows, self._low, self._high, self._bulge, first, last)
        if not len(lanes):
            return
        for table, copy in zip((self._before, *tables[1:]), self._again, strict=True):
            blocks.gather(table, lanes, first, copy)
        state, parameters, derived, inputs = self._again
        run(self._kernel, (state, parameters, derived, inputs), first, first - (-len(lanes) // LANES))
        blocks.scatter(state, first, lanes, tables[0])


def stall_force(machine: Machine) -> float:
    """Force of all drives together at rated voltage and standstill, N of belt."""
    total = 0.0
    for d in machine.drives:
        c = machine.coordinate(d.coordinate)
        total += d.gain * d.rated_voltage / (c.radius if c.kind == "rotary" else 1.0)
    return total
