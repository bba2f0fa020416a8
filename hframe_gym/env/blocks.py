"""Between an environment's arrays, one row an environment, and the kernel's blocks of lanes.

Environment b lives in lane b % LANES of block b // LANES.  Lanes left over in the last block repeat the last
environment, so they cost nothing and cannot leave the numbers.  All functions work on blocks first..last-1, run without
the interpreter lock and keep to arithmetic that rounds the same everywhere: an environment gets the same bits in any
batch, lane or thread.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ..machine.lanes import LANES, any_of, load, store, where
from ..machine.vector_math import maximum, minimum
from .draws import compiled, normal_pair


@compiled
def first_not_finite(actions: Any) -> int:
    """Flat index of the first entry of actions (B, inputs) that is not finite, or -1."""
    for b in range(actions.shape[0]):
        for k in range(actions.shape[1]):
            if not math.isfinite(actions[b, k]):
                return b * actions.shape[1] + k
    return -1


@compiled
def command(
    actions: Any, rated: Any, quantum: Any, lowest: Any, highest: Any, first: int, last: int, volts: Any, clipped: Any
) -> None:
    """Volts (blocks, inputs, LANES) from actions (B, inputs), shares of the rated voltage (inputs,).

    Actions end at -1 and 1; clipped (B,) grows by the number of entries that were out of range.  quantum: of the D/A
    converter, V (0: none), which ends at lowest and highest, V; each (inputs,).
    """
    count = actions.shape[0]
    for block in range(first, last):
        for lane in range(LANES):
            b = block * LANES + lane
            own = b < count
            b = b if own else count - 1
            for k in range(actions.shape[1]):
                share: Any = np.float64(actions[b, k])
                if share > 1.0 or share < -1.0:
                    share = 1.0 if share > 1.0 else -1.0
                    clipped[b] += own
                value = share * rated[k]
                if quantum[k] > 0.0:
                    value = np.rint(value / quantum[k]) * quantum[k]
                value = lowest[k] if value < lowest[k] else value
                volts[block, k, lane] = highest[k] if value > highest[k] else value


@compiled
def limit_current(
    state: Any,
    parameters: Any,
    rows: Any,
    columns: Any,
    most: float,
    asked: Any,
    row: int,
    first: int,
    last: int,
    out: Any,
) -> None:
    """Volts out (blocks, inputs, LANES) nearest to those asked for with which |V - Ke N w| / R <= most, A.

    rows (inputs,): of the state, each drive's speed; columns (inputs, 4): of the parameters Ke, N, R and the radius
    (-1: a linear drive); asked (blocks, rows, LANES) V from row on.
    """
    for block in range(first, last):
        for k in range(rows.shape[0]):
            for lane in range(LANES):
                speed = state[block, rows[k], lane]
                if columns[k, 3] >= 0:
                    speed /= parameters[block, columns[k, 3], lane]
                back = parameters[block, columns[k, 0], lane] * parameters[block, columns[k, 1], lane] * speed
                room = most * parameters[block, columns[k, 2], lane]
                out[block, k, lane] = min(back + room, max(back - room, asked[block, row + k, lane]))


@compiled
def late(history: Any, delays: Any, period: float, h: float, first: int, last: int, inputs: Any) -> None:
    """Mean voltage that arrives in each step of one control period, where drives are late.

    history (blocks, periods, inputs, LANES): volts held in this period (0), the one before (1), ...; delays
    (blocks, inputs, LANES) s; inputs (blocks, steps * inputs, LANES) is written.  h is not longer than the period, so
    a step's window touches two held values at most.
    """
    width = history.shape[2]
    oldest = history.shape[1] - 1
    for block in range(first, last):
        for row in range(inputs.shape[1]):
            k = row % width
            for lane in range(LANES):
                begin = (row // width) * h - delays[block, k, lane]
                older = min(oldest, max(0, math.ceil(-begin / period)))
                newer = min(oldest, max(0, math.ceil(-(begin + h) / period)))
                value = history[block, older, k, lane]
                if newer != older:
                    share = min(1.0, max(0.0, (begin + h + newer * period) / h))
                    value = (1.0 - share) * value + share * history[block, newer, k, lane]
                inputs[block, row, lane] = value


@compiled
def observe(
    state: Any,
    parameters: Any,
    rows: Any,
    radius_rows: Any,
    low: Any,
    high: Any,
    first: int,
    last: int,
    out: Any,
    tool: Any,
) -> int:
    """Rows of the state as float32 observations out (B, n or more), clipped to [low, high] (n,).

    rows (n,): which rows of the state, those of x and y first: tool (B, 2) gets them too; radius_rows (n,): the row of
    the parameters that turns travel (m) into the coordinate's own unit (rad), or -1.  Returns an environment whose
    state is not finite, or -1.
    """
    count = rows.shape[0]
    values = np.empty((count, LANES))
    broken = -1
    for block in range(first, last):
        begin = block * LANES
        rest = load(state[block], 0) * 0.0  # stays zero until something is not finite
        for j in range(count):
            value = load(state[block], rows[j])
            if radius_rows[j] >= 0:
                value = value / load(parameters[block], radius_rows[j])
            rest = rest + (value - value)
            store(values, j, minimum(maximum(value, low[j]), high[j]))
        for lane in range(min(LANES, out.shape[0] - begin)):
            for j in range(count):
                out[begin + lane, j] = values[j, lane]
            for j in range(2):
                tool[begin + lane, j] = values[j, lane]
        if any_of(where(rest == 0.0, 0.0, 1.0) > 0.0):
            store(values, 0, rest)
            broken = begin + _first_not_finite(values[0])
    return broken


@compiled
def _first_not_finite(row: Any) -> int:
    for lane in range(LANES):
        if not math.isfinite(row[lane]):
            return lane
    return 0


@compiled
def read(
    state: Any,
    parameters: Any,
    rows: Any,
    radius_rows: Any,
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

    rows, radius_rows (n,): as for `observe`.  A reading is value + noise * normal, rounded to quanta (0: not), and
    sticks at least and most, each (n,).  keys (B,), elapsed (B,): what the noise is counted by.  fresh: an episode
    begins, there is no reading before.
    """
    for i in range(index.shape[0]):
        b = index[i]
        block, lane = b // LANES, b % LANES
        spare, has_spare = 0.0, False
        for j in range(rows.shape[0]):
            value = state[block, rows[j], lane]
            if radius_rows[j] >= 0:
                value /= parameters[block, radius_rows[j], lane]
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


@compiled
def beyond(before: Any, after: Any, rows: Any, low: Any, high: Any, bulge: Any, first: int, last: int) -> Any:
    """Lanes (block * LANES + lane) of blocks first..last-1 that may have been beyond an end, ascending.

    before, after: states (blocks, rows, LANES) at both ends of a period; rows (n,): of the coordinates with ends low,
    high (n,), that may have gone bulge (n,), m, further than both.
    """
    found = np.empty((last - first) * LANES, np.int64)
    count = 0
    out = np.empty((1, LANES))
    for block in range(first, last):
        total = load(before[block], 0) * 0.0
        for j in range(rows.shape[0]):
            q, p = load(before[block], rows[j]), load(after[block], rows[j])
            over = (minimum(q, p) < low[j] + bulge[j]) | (maximum(q, p) > high[j] - bulge[j])
            total = total + where(over, 1.0, 0.0)
        if any_of(total > 0.0):
            store(out, 0, total)
            for lane in range(LANES):
                if out[0, lane] > 0.0:
                    found[count] = block * LANES + lane
                    count += 1
    return found[:count]


@compiled
def put(index: Any, rows: Any, table: Any) -> None:
    """Write rows (k, n) into the lanes of environments index (k,) of table (blocks, n or more, LANES)."""
    for i in range(index.shape[0]):
        for j in range(rows.shape[1]):
            table[index[i] // LANES, j, index[i] % LANES] = rows[i, j]


@compiled
def gather(source: Any, lanes: Any, first: int, out: Any) -> None:
    """Copy lanes (k,) of source (blocks, rows, LANES) to the front of out's blocks from `first` on.

    What is left of the last block that is touched repeats the last lane.
    """
    for i in range(-(-lanes.shape[0] // LANES) * LANES):
        block, lane = divmod(lanes[min(i, lanes.shape[0] - 1)], LANES)
        to, at = first + i // LANES, i % LANES
        for row in range(source.shape[1]):
            out[to, row, at] = source[block, row, lane]


@compiled
def scatter(source: Any, first: int, lanes: Any, out: Any) -> None:
    """Copy k lanes of source's blocks from `first` on back to lanes (k,) of out, `gather` in reverse."""
    for i in range(lanes.shape[0]):
        block, lane = divmod(lanes[i], LANES)
        for row in range(out.shape[1]):
            out[block, row, lane] = source[first + i // LANES, row, i % LANES]
