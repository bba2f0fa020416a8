"""What a rig's sensors say: readings with noise and resolution, and the observation that is made of them.  Compiled."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..dynamics.simd import LANES
from .counter_rng import compiled, normal_pair


@compiled
def read(
    state: Any,
    units: Any,
    entries: Any,
    quanta: Any,
    noise: Any,
    least: Any,
    most: Any,
    keys: Any,
    elapsed: Any,
    index: Any,
    fresh: bool,
    readings: Any,
) -> None:
    """Take the sensors' readings (B, 2, n), the last and the one before, of environments index (k,).

    units, entries (n, 4): as for `blocks.observe`.  A reading is value + noise * normal, rounded to quanta (0: not),
    and sticks at least and most, each (n,).  keys (B,), elapsed (B,): what the noise is counted by.  fresh: an episode
    begins, there is no reading before.
    """
    for i in range(index.shape[0]):
        b = index[i]
        block, lane = b // LANES, b % LANES
        spare, has_spare = 0.0, False
        for j in range(entries.shape[0]):
            value = state[block, entries[j, 0], lane] * units[block, entries[j, 1], lane]
            p, q = entries[j, 2], entries[j, 3]
            if p >= 0:
                across = state[block, q, lane] * units[block, q, lane]
                value += state[block, p, lane] * units[block, p, lane] * across
            if noise[j] > 0.0:
                if has_spare:
                    drawn = spare
                else:
                    drawn, spare = normal_pair(keys[b], elapsed[b], j)
                has_spare = not has_spare
                value += noise[j] * drawn
            if quanta[j] > 0.0:
                value = np.rint(value / quanta[j]) * quanta[j]
            value = min(most[j], max(least[j], value))
            readings[b, 1, j] = value if fresh else readings[b, 0, j]
            readings[b, 0, j] = value


@compiled
def report(
    readings: Any,
    period: float,
    least: Any,
    most: Any,
    tool: Any,
    lasers: Any,
    low: Any,
    high: Any,
    edges: Any,
    index: Any,
    out: Any,
    achieved: Any,
) -> None:
    """Observations out (B, 2 n) of environments index (k,) from readings (B, 2, n): they, and their differences per s.

    achieved (B, 2): the laser's reading inside its range, else the tool by the encoders, tool (2, n) @ readings; edges
    (2, 2): x and y, low and high, of the goals' box.
    """
    n = readings.shape[2]
    for i in range(index.shape[0]):
        b = index[i]
        for j in range(n):
            now = readings[b, 0, j]
            out[b, j] = np.float32(min(high[j], max(low[j], now)))
            change = (now - readings[b, 1, j]) / period
            out[b, n + j] = np.float32(min(high[n + j], max(low[n + j], change)))
        for axis in range(2):
            place = 0.0
            blind = True
            for j in range(n):
                place += tool[axis, j] * readings[b, 0, j]
                blind = blind and tool[axis, j] == 0.0
            j = lasers[axis]
            if j >= 0 and (blind or least[j] < readings[b, 0, j] < most[j]):
                place = readings[b, 0, j]
            achieved[b, axis] = np.float32(min(edges[axis, 1], max(edges[axis, 0], place)))
