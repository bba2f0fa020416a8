"""Elementary functions of SIMD registers, such as exp, and the exchange of rows between arrays and blocks of machines.

A SIMD register (`simd.SimdVector`) holds `LANES` (8 or 16) float64 numbers, one per simulated machine. The functions
have no branches, are accurate to a few units in the last place, and give the same bits on every processor. The
mathematical library of the system would need one call per number, and its results differ between systems.

Importing this module registers these functions of `elementwise` with Numba. `floor`, `minimum`, `maximum` and `where`
are registered for plain numbers (float64) too, so that compiled formulas can use them for registers and for numbers.

A block holds the values of LANES machines, one column per machine; other arrays have one row per machine.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import types
from numba.extending import overload

from .elementwise import absolute, copysign, cos, exp, floor, fma, maximum, minimum, pow2, rint, sign, sin, tanh, where
from .simd import LANES, SimdVector, inlined

__all__ = ["cos", "exp", "floor", "maximum", "minimum", "read_block", "sign", "sin", "tanh", "where", "write_block"]

_LOG2E = 1.4426950408889634
# ln 2 in two parts: the product of the first with an integer up to 2**20 is exact.
_LN2_HIGH, _LN2_LOW = 0.6931471803691238, 1.9082149292705877e-10
_TWO_OVER_PI = 0.6366197723675814
# pi/2 in three parts (Cody and Waite): the products of the first two with an integer up to 2**20 are exact. For larger
# integers, up to 1e12 and beyond, the single rounding of `fma` preserves the accuracy.
_PIO2 = (1.5707963267341256, 6.077100506303966e-11, 2.0222662487959506e-21)


def _vector_exp(x):  # type: ignore[no-untyped-def]
    """Return e**x = 2**n e**r with an integer n and |r| <= ln(2)/2; 0 for x < -700, e**700 for x > 700."""
    bounded = where(x < -700.0, -700.0, where(x > 700.0, 700.0, x))
    n = rint(bounded * _LOG2E)
    r = fma(n, -_LN2_LOW, fma(n, -_LN2_HIGH, bounded))
    # Taylor series to r**12: |r| <= 0.347, remainder 2e-16.
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


def _vector_sin_shifted(x, quarter_turns):  # type: ignore[no-untyped-def]
    """Return sin(x + quarter_turns pi/2), for quarter_turns 0 (sine) or 1 (cosine); x: angle, rad.

    With the nearest multiple n pi/2 of pi/2 and r = x - n pi/2, the value is sin r, cos r, -sin r or -cos r, according
    to the quadrant (n + quarter_turns) mod 4.
    """
    n = rint(x * _TWO_OVER_PI)
    r = fma(n, -_PIO2[2], fma(n, -_PIO2[1], fma(n, -_PIO2[0], x)))
    s = r * r
    # Taylor series of sin r (odd) to r**15 and of cos r (even) to r**16: |r| <= pi/4, remainders 5e-17 and 2e-18.
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


def _vector_tanh(x):  # type: ignore[no-untyped-def]
    """Return (1 - e) / (1 + e) with e = e**(-2 |x|), with the sign of x; below 0.4, a continued fraction."""
    # Lambert's continued fraction x / (1 + s / (3 + s / (5 + ...))) to the term 17: remainder 1e-17 for |x| <= 0.4.
    s = x * x
    tail = 15.0 + s / 17.0
    tail = 13.0 + s / tail
    tail = 11.0 + s / tail
    tail = 9.0 + s / tail
    tail = 7.0 + s / tail
    tail = 5.0 + s / tail
    tail = 3.0 + s / tail
    e = _exp(-2.0 * absolute(x))
    return where(absolute(x) < 0.4, x / (1.0 + s / tail), copysign((1.0 - e) / (1.0 + e), x))


def _vector_sign(x):  # type: ignore[no-untyped-def]
    """Return -1, 0 or 1."""
    return where(x > 0.0, 1.0, where(x < 0.0, -1.0, x))


_exp = inlined(_vector_exp)
_tanh = inlined(_vector_tanh)
_sign = inlined(_vector_sign)
_sin_shifted = inlined(_vector_sin_shifted)


def _register(function: Any, implementation: Any) -> None:
    """Let compiled code call an implementation where a function of `elementwise` gets a SIMD register."""

    @overload(function, inline="never")
    def of_vector(x):  # type: ignore[no-untyped-def]
        return (lambda x: implementation(x)) if isinstance(x, SimdVector) else None


_register(exp, _exp)
_register(sin, inlined(lambda x: _sin_shifted(x, 0.0)))
_register(cos, inlined(lambda x: _sin_shifted(x, 1.0)))
_register(tanh, _tanh)
_register(sign, _sign)


@overload(floor)
def _floor_of_number(x):  # type: ignore[no-untyped-def]
    if isinstance(x, types.Float):
        return lambda x: np.floor(x)
    return None


@overload(minimum)
def _minimum_of_numbers(a, b):  # type: ignore[no-untyped-def]
    if isinstance(a, types.Float) and isinstance(b, types.Float):
        return lambda a, b: a if a < b else b  # as for registers, also with NaN and -0.0
    return None


@overload(maximum)
def _maximum_of_numbers(a, b):  # type: ignore[no-untyped-def]
    if isinstance(a, types.Float) and isinstance(b, types.Float):
        return lambda a, b: a if a > b else b
    return None


@overload(where)
def _where_of_numbers(condition, yes, no):  # type: ignore[no-untyped-def]
    if isinstance(condition, types.Boolean):
        return lambda condition, yes, no: yes if condition else no
    return None


# Most blocks are complete. Their loops have a constant number of machines, which makes them several times as fast.


@inlined
def read_block(rows: Any, begin: int, block: Any) -> None:
    """Copy LANES rows of an array to the columns of a block; callable in compiled code only.

    Args:
        rows: Values of n machines, any unit, shape (n, k).
        begin: Row of the first machine of the block.
        block: Output, shape (k or more, LANES); its size is not checked. If fewer than LANES rows
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


@inlined
def write_block(block: Any, begin: int, count: int, rows: Any) -> None:
    """Copy the first values of the machines of a block to the rows of an array; callable in compiled code only.

    Args:
        block: Values of LANES (8 or 16) machines, any unit, shape (count or more, LANES).
        begin: Row of the first machine of the block.
        count: Number of values per machine.
        rows: Output, shape (n, count or more). If fewer than LANES rows remain, further columns are ignored.
    """
    if begin + LANES <= rows.shape[0]:
        for k in range(count):
            for lane in range(LANES):
                rows[begin + lane, k] = block[k, lane]
    else:
        for k in range(count):
            for lane in range(rows.shape[0] - begin):
                rows[begin + lane, k] = block[k, lane]
