"""Rearrange values between rows (one machine each) and blocks of `LANES` machines, simulated side by side.

In a block, each machine has a column ("lane").
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .compiled import compiled_only
from .machine_code import LANES


def in_blocks(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rearrange `values` of B machines, SI, shape (B, K), into blocks, shape (ceil(B / LANES), K, LANES).

    The processor simulates `LANES` machines side by side: 16 with AVX-512, otherwise 8. Copies of the last
    machine fill the last block.
    """
    count = -(-len(values) // LANES) * LANES
    padded = np.concatenate([values, np.repeat(values[-1:], count - len(values), axis=0)])
    return np.ascontiguousarray(padded.reshape(-1, LANES, values.shape[1]).transpose(0, 2, 1))


# Most blocks are complete. Their loops have a constant number of machines, which makes them several times as
# fast.


@partial(compiled_only, inlined=True)
def read_block(rows: Any, begin: int, block: Any) -> None:
    """Copy LANES rows of an array to the columns of a block; callable in compiled code only.

    Args:
        rows: Values of B machines, any unit, shape (B, K).
        begin: Row of the first machine of the block.
        block: Output, shape (K or more, LANES); its size is not checked. If fewer than LANES rows
            remain, further columns repeat the last row.
    """
    if begin + LANES <= rows.shape[0]:
        for k in range(rows.shape[1]):
            for lane in range(LANES):
                block[k, lane] = rows[begin + lane, k]
    else:
        for k in range(rows.shape[1]):
            for lane in range(LANES):
                block[k, lane] = rows[min(begin + lane, rows.shape[0] - 1), k]


@partial(compiled_only, inlined=True)
def write_block(block: Any, begin: int, count: int, rows: Any) -> None:
    """Copy the first values of a block's machines to the rows of an array; callable in compiled code only.

    Args:
        block: Values of LANES (8 or 16) machines, any unit, shape (count or more, LANES).
        begin: Row of the first machine of the block.
        count: Number of values per machine.
        rows: Output, shape (B, count or more). If fewer than LANES rows remain, further columns are ignored.
    """
    if begin + LANES <= rows.shape[0]:
        for k in range(count):
            for lane in range(LANES):
                rows[begin + lane, k] = block[k, lane]
    else:
        for k in range(count):
            for lane in range(rows.shape[0] - begin):
                rows[begin + lane, k] = block[k, lane]
