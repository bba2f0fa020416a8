"""Elementary functions on lanes: branch-free, a few units in the last place, the same bits on every processor.

A call of the system's libm from a vector register costs one scalar call a lane and differs between systems; these
need neither.  On NumPy arrays (an effect's formula plotted, a test) they are NumPy's own.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numba.extending import overload

from .simd import SimdVector, floor, fma, pow2, rint, where

_LOG2E = 1.4426950408889634
_LN2_HIGH, _LN2_LOW = 0.6931471803691238, 1.9082149292705877e-10
_TWO_OVER_PI = 0.6366197723675814
# pi/2 in three parts (Cody and Waite): exact products for quotients up to 2**20.
_PIO2 = (1.5707963267341256, 6.077100506303966e-11, 2.0222662487959506e-21)


def exp(x: Any) -> Any:
    """e**x; in a kernel, arguments below -700 give zero and above 700 are clipped."""
    return np.exp(x)


def sin(x: Any) -> Any:
    """Sine of an angle in rad; in a kernel for sizes up to 1e6."""
    return np.sin(x)


def cos(x: Any) -> Any:
    """Cosine of an angle in rad; in a kernel for sizes up to 1e6."""
    return np.cos(x)


def minimum(a: Any, b: Any) -> Any:
    """The smaller of two."""
    return np.minimum(a, b)


def maximum(a: Any, b: Any) -> Any:
    """The larger of two."""
    return np.maximum(a, b)


def _lane_exp(x):  # type: ignore[no-untyped-def]
    bounded = where(x < -700.0, -700.0, where(x > 700.0, 700.0, x))
    n = rint(bounded * _LOG2E)
    r = fma(n, -_LN2_LOW, fma(n, -_LN2_HIGH, bounded))
    # Taylor to r**12: |r| <= 0.347, remainder 2e-16.
    p = fma(r, 1.0 / 479001600.0, 1.0 / 39916800.0)
    p = fma(r, p, 1.0 / 3628800.0)
    p = fma(r, p, 1.0 / 362880.0)
    p = fma(r, p, 1.0 / 40320.0)
    p = fma(r, p, 1.0 / 5040.0)
    p = fma(r, p, 1.0 / 720.0)
    p = fma(r, p, 1.0 / 120.0)
    p = fma(r, p, 1.0 / 24.0)
    p = fma(r, p, 1.0 / 6.0)
    p = fma(r, p, 0.5)
    p = fma(r, p, 1.0)
    p = fma(r, p, 1.0)
    return where(x < -700.0, 0.0, p * pow2(n))


def _lane_sin_shifted(x, quarter_turns):  # type: ignore[no-untyped-def]
    n = rint(x * _TWO_OVER_PI)
    r = fma(n, -_PIO2[2], fma(n, -_PIO2[1], fma(n, -_PIO2[0], x)))
    s = r * r
    # Taylor to r**15 and r**16: |r| <= pi/4, remainders 5e-17 and 2e-18.
    odd = fma(s, -1.0 / 1307674368000.0, 1.0 / 6227020800.0)
    odd = fma(s, odd, -1.0 / 39916800.0)
    odd = fma(s, odd, 1.0 / 362880.0)
    odd = fma(s, odd, -1.0 / 5040.0)
    odd = fma(s, odd, 1.0 / 120.0)
    odd = fma(s, odd, -1.0 / 6.0)
    odd = fma(s * r, odd, r)
    even = fma(s, 1.0 / 20922789888000.0, -1.0 / 87178291200.0)
    even = fma(s, even, 1.0 / 479001600.0)
    even = fma(s, even, -1.0 / 3628800.0)
    even = fma(s, even, 1.0 / 40320.0)
    even = fma(s, even, -1.0 / 720.0)
    even = fma(s, even, 1.0 / 24.0)
    even = fma(s, even, -0.5)
    even = fma(s, even, 1.0)
    turn = n + quarter_turns
    quadrant = turn - 4.0 * floor(turn * 0.25)
    value = where((quadrant == 1.0) | (quadrant == 3.0), even, odd)
    return where(quadrant >= 2.0, -value, value)


def _inlined(function: Any) -> Any:
    return njit(forceinline=True, nogil=True, error_model="numpy")(function)


_exp = _inlined(_lane_exp)
_sin_shifted = _inlined(_lane_sin_shifted)


@overload(exp, inline="never")
def _exp_on_lanes(x):  # type: ignore[no-untyped-def]
    if isinstance(x, SimdVector):
        return lambda x: _exp(x)
    return None


@overload(sin, inline="never")
def _sin_on_lanes(x):  # type: ignore[no-untyped-def]
    if isinstance(x, SimdVector):
        return lambda x: _sin_shifted(x, 0.0)
    return None


@overload(cos, inline="never")
def _cos_on_lanes(x):  # type: ignore[no-untyped-def]
    if isinstance(x, SimdVector):
        return lambda x: _sin_shifted(x, 1.0)
    return None


@overload(minimum, inline="never")
def _minimum_on_lanes(a, b):  # type: ignore[no-untyped-def]
    if isinstance(a, SimdVector) or isinstance(b, SimdVector):
        return lambda a, b: where(a < b, a, b)
    return None


@overload(maximum, inline="never")
def _maximum_on_lanes(a, b):  # type: ignore[no-untyped-def]
    if isinstance(a, SimdVector) or isinstance(b, SimdVector):
        return lambda a, b: where(a > b, a, b)
    return None
