"""Between an environment's arrays, one row an environment, and the kernel's blocks of lanes.

Environment b lives in lane b % LANES of block b // LANES.  Lanes left over in the last block repeat the last
environment, so they cost nothing and cannot leave the numbers.  Compiled functions work on blocks first..last-1, run
without the interpreter lock and keep to arithmetic that rounds the same everywhere: an environment gets the same bits
in any batch, lane or thread.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..dynamics.simd import LANES, any_of, load, store, where
from ..dynamics.simd_math import maximum, minimum
from .counter_rng import compiled

Index = NDArray[np.intp]


def runs(index: Index) -> Iterator[tuple[int, int]]:
    """The blocks that hold environments index (k,), ascending, as ranges first, last."""
    if len(index) == (index[-1] - index[0] + 1):
        yield int(index[0]) // LANES, int(index[-1]) // LANES + 1
        return
    own = np.unique(index // LANES)
    for part in np.split(own, np.flatnonzero(np.diff(own) > 1) + 1):
        yield int(part[0]), int(part[-1]) + 1


@compiled
def all_finite(actions: Any) -> bool:
    """Whether all entries of actions (B, inputs) are finite."""
    bad = 0
    for b in range(actions.shape[0]):
        for k in range(actions.shape[1]):
            # No way out of the loop, so that it becomes vector code.
            bad |= not abs(actions[b, k]) < math.inf
    return bad == 0


@compiled
def put(index: Any, rows: Any, table: Any) -> None:
    """Write rows (k, n) into the lanes of environments index (k,) of table (blocks, n or more, LANES)."""
    for i in range(index.shape[0]):
        for j in range(rows.shape[1]):
            table[index[i] // LANES, j, index[i] % LANES] = rows[i, j]


@compiled
def observe(state: Any, units: Any, entries: Any, box: Any, first: int, last: int, out: Any, tool: Any) -> int:
    """Entries of the state as float32 observations out (B, n or more), clipped to box (2, n).

    units (blocks, coordinates, LANES): own unit per metre of travel.  entries (n, 4): row of the state, its coordinate,
    and two coordinates whose product is added, or -1; the first two are x and y, which tool (B, 2) gets too.  Returns
    an environment whose state is not finite, or -1.
    """
    count = entries.shape[0]
    values = np.empty((count + 1, LANES))
    broken = -1
    for block in range(first, last):
        begin = block * LANES
        own, unit = state[block], units[block]
        rest = load(own, 0) * 0.0  # stays zero until something is not finite
        for j in range(count):
            value = load(own, entries[j, 0]) * load(unit, entries[j, 1])
            a, b = entries[j, 2], entries[j, 3]
            if a >= 0:
                value = value + load(own, a) * load(unit, a) * (load(own, b) * load(unit, b))
            rest = rest + (value - value)
            store(values, j, minimum(maximum(value, box[0, j]), box[1, j]))
        for lane in range(min(LANES, out.shape[0] - begin)):
            for j in range(count):
                out[begin + lane, j] = values[j, lane]
            for j in range(2):
                tool[begin + lane, j] = values[j, lane]
        if any_of(where(rest == 0.0, 0.0, 1.0) > 0.0):
            store(values, count, rest)
            for lane in range(LANES):
                if broken < 0 and not math.isfinite(values[count, lane]):
                    broken = begin + lane
    return broken
