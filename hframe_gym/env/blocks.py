"""Between an environment's arrays, one row an environment, and the kernel's blocks of lanes.

Environment b lives in lane b % LANES of block b // LANES.  Lanes left over in the last block repeat the last
environment, so they cost nothing and cannot leave the numbers.  All functions work on blocks first..last-1, run without
the interpreter lock and keep to arithmetic that rounds the same everywhere: an environment gets the same bits in any
batch, lane or thread.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np
from numba import njit

from ..machine.lanes import LANES

Function = TypeVar("Function", bound=Callable[..., Any])


def compiled(function: Function) -> Function:
    """The function compiled by Numba, without the interpreter lock, kept on disk."""
    result: Any = njit(nogil=True, cache=True, error_model="numpy")(function)
    return result


@compiled
def first_not_finite(actions: Any) -> int:
    """Flat index of the first entry of actions (B, inputs) that is not finite, or -1."""
    for b in range(actions.shape[0]):
        for k in range(actions.shape[1]):
            if not math.isfinite(actions[b, k]):
                return b * actions.shape[1] + k
    return -1


@compiled
def command(actions: Any, rated: Any, first: int, last: int, volts: Any, clipped: Any) -> None:
    """Volts (blocks, inputs, LANES) from actions (B, inputs), shares of the rated voltage (inputs,), clipped.

    Actions end at -1 and 1; clipped (B,) grows by the number of entries that were out of range.
    """
    count = actions.shape[0]
    for block in range(first, last):
        for lane in range(LANES):
            b = min(block * LANES + lane, count - 1)
            for k in range(actions.shape[1]):
                share = min(1.0, max(-1.0, actions[b, k]))
                if share != actions[b, k] and b == block * LANES + lane:
                    clipped[b] += 1
                volts[block, k, lane] = share * rated[k]


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
def _observe_one(
    state: Any, parameters: Any, rows: Any, radius_rows: Any, low: Any, high: Any, b: int, out: Any
) -> bool:
    finite = True
    block, lane = b // LANES, b % LANES
    for j in range(rows.shape[0]):
        value = state[block, rows[j], lane]
        if radius_rows[j] >= 0:
            value /= parameters[block, radius_rows[j], lane]
        finite = finite and math.isfinite(value)
        out[b, j] = np.float32(min(high[j], max(low[j], value)))
    return finite


@compiled
def observe(
    state: Any, parameters: Any, rows: Any, radius_rows: Any, low: Any, high: Any, first: int, last: int, out: Any
) -> int:
    """Rows of the state as float32 observations out (B, n), clipped to [low, high] (n,).

    rows (n,): which rows of the state; radius_rows (n,): the row of the parameters that turns travel (m) into the
    coordinate's own unit (rad), or -1.  Returns the first environment whose state is not finite, or -1.
    """
    for b in range(first * LANES, min(last * LANES, out.shape[0])):
        if not _observe_one(state, parameters, rows, radius_rows, low, high, b, out):
            return b
    return -1


@compiled
def observe_some(
    state: Any, parameters: Any, rows: Any, radius_rows: Any, low: Any, high: Any, index: Any, out: Any
) -> None:
    """`observe` for the environments of index (k,) only; the other rows of out (B, n) stay."""
    for i in range(index.shape[0]):
        _observe_one(state, parameters, rows, radius_rows, low, high, index[i], out)


@compiled
def near(state: Any, rows: Any, low: Any, high: Any, reach: float, period: float, first: int, last: int) -> Any:
    """Lanes (block * LANES + lane) of blocks first..last-1 that may touch an end within a period, ascending.

    rows (n,): the coordinates with ends low, high (n,); near is who has less left than reach (m) and one and a
    half times the way it goes at its present speed.
    """
    coordinates = (state.shape[1] - 1) // 2
    found = np.empty((last - first) * LANES, np.int64)
    count = 0
    for block in range(first, last):
        for lane in range(LANES):
            close = False
            for j in range(rows.shape[0]):
                way = reach + 1.5 * period * abs(state[block, coordinates + rows[j], lane])
                q = state[block, rows[j], lane]
                close = close or q - way < low[j] or q + way > high[j]
            if close:
                found[count] = block * LANES + lane
                count += 1
    return found[:count].copy()


@compiled
def gather(source: Any, lanes: Any, out: Any) -> None:
    """Copy lanes (k,) of source (blocks, rows, LANES) to the front of out; what is left of out repeats the last."""
    for i in range(out.shape[0] * LANES):
        lane = lanes[min(i, lanes.shape[0] - 1)]
        for row in range(source.shape[1]):
            out[i // LANES, row, i % LANES] = source[lane // LANES, row, lane % LANES]


@compiled
def scatter(source: Any, lanes: Any, out: Any) -> None:
    """Copy the first k lanes of source back to lanes (k,) of out, `gather` in reverse."""
    for i in range(lanes.shape[0]):
        for row in range(out.shape[1]):
            out[lanes[i] // LANES, row, lanes[i] % LANES] = source[i // LANES, row, i % LANES]
