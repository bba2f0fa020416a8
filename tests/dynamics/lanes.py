"""Call functions of SIMD registers from a test."""

from __future__ import annotations

import ctypes
from functools import cache

from numpy.typing import NDArray

from hframe_gym.dynamics.codegen.lane_program import LaneProgram


@cache
def _program(text: str) -> LaneProgram:
    return LaneProgram(text, ("f",))


def call(address: int, *arguments: NDArray | float) -> None:
    """Call a compiled function with contiguous arrays of rows, and numbers."""
    operands = [a if isinstance(a, float | int) else a.ctypes.data for a in arguments]
    kinds = [
        ctypes.c_double if isinstance(a, float) else ctypes.c_int64 if isinstance(a, int) else ctypes.c_void_p
        for a in arguments
    ]
    ctypes.CFUNCTYPE(None, *kinds)(address)(*operands)


def run(text: str, *arguments: NDArray | float) -> None:
    """Call the function `f` of a source text with contiguous arrays of rows, and numbers."""
    call(_program(text).addresses["f"], *arguments)
