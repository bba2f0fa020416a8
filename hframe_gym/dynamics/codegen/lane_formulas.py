"""Elementary functions of SIMD registers, such as exp, as formulas of the vector instructions.

The functions have no branches, are accurate to a few units in the last place, and give the same bits on every
processor. The mathematical library of the system would need one call per number, and its results differ
between systems. A kernel calls them where a formula calls the function of the same name in `elementwise`. On
NumPy arrays, they compute the same with two roundings in place of each fused multiply-add.
"""

from __future__ import annotations

from math import factorial
from typing import Any

from ..symbolic.elementwise import absolute, copysign, floor, fma, polynomial, pow2, rint, where

_LOG2E = 1.4426950408889634
_SQRT2 = 1.4142135623730951
# ln 2 in two parts: the product of the first with an integer up to 2**20 is exact.
_LN2_HIGH, _LN2_LOW = 0.6931471803691238, 1.9082149292705877e-10
_TWO_OVER_PI = 0.6366197723675814
# pi/2 in three parts (Cody and Waite): the products of the first two with an integer up to 2**20 are exact.
# For larger integers, up to 1e12 and beyond, the single rounding of `fma` preserves the accuracy.
_PIO2 = (1.5707963267341256, 6.077100506303966e-11, 2.0222662487959506e-21)
# Taylor series: e**r to r**12, |r| <= 0.347, remainder 2e-16; artanh(s) / s to s**22, remainder 2e-19; sin r
# (without its first term, over r**3) to r**15 and cos r to r**16, |r| <= pi/4, remainders 5e-17 and 2e-18.
_EXPONENTIAL = tuple(1.0 / factorial(k) for k in range(12, -1, -1))
_ARTANH = tuple(1.0 / k for k in range(23, 0, -2))
_SINE = tuple((-1) ** (k // 2) / factorial(k) for k in range(15, 1, -2))
_COSINE = tuple((-1) ** (k // 2) / factorial(k) for k in range(16, -1, -2))


def exp(x: Any) -> Any:
    """Return e**x = 2**n e**r with an integer n and |r| <= ln(2)/2; 0 for x < -700, e**700 for x > 700."""
    bounded = where(x < -700.0, -700.0, where(x > 700.0, 700.0, x))
    n = rint(bounded * _LOG2E)
    r = fma(n, -_LN2_LOW, fma(n, -_LN2_HIGH, bounded))
    p = polynomial(r, _EXPONENTIAL)
    return where(x < -700.0, 0.0, p * pow2(n))


def _power(x: Any, step: float) -> Any:
    """Return step if x >= 2**step, -step if x < 2**(1 - step), otherwise 0."""
    return where(x >= pow2(step), step, where(x < pow2(1.0 - step), -step, 0.0))


def log(x: Any) -> Any:
    """Return n ln 2 + ln m with an integer n and 1/sqrt(2) < m <= sqrt(2); x is within 1e-300 to 1e300."""
    limited = where(x > 1e-300, where(x < 1e300, x, 1e300), 1e-300)
    n = _power(limited, 512.0)  # bisection of the exponent, to 1 <= limited / 2**n < 2
    n = n + _power(limited * pow2(-n), 256.0)
    n = n + _power(limited * pow2(-n), 128.0)
    n = n + _power(limited * pow2(-n), 64.0)
    n = n + _power(limited * pow2(-n), 32.0)
    n = n + _power(limited * pow2(-n), 16.0)
    n = n + _power(limited * pow2(-n), 8.0)
    n = n + _power(limited * pow2(-n), 4.0)
    n = n + _power(limited * pow2(-n), 2.0)
    n = n + _power(limited * pow2(-n), 1.0)
    n = where(limited * pow2(-n) > _SQRT2, n + 1.0, n)
    m = limited * pow2(-n)
    # ln m = 2 artanh s with s = (m - 1)/(m + 1), |s| <= 0.172.
    s = (m - 1.0) / (m + 1.0)
    q = s * s
    p = polynomial(q, _ARTANH)
    return fma(n, _LN2_HIGH, fma(n, _LN2_LOW, 2.0 * s * p))


def _sin_shifted(x: Any, quarter_turns: float) -> Any:
    """Return sin(x + quarter_turns pi/2), for quarter_turns 0 (sine) or 1 (cosine); x: angle, rad.

    With the nearest multiple n pi/2 of pi/2 and r = x - n pi/2, the value is sin r, cos r, -sin r or -cos r,
    according to the quadrant (n + quarter_turns) mod 4.
    """
    n = rint(x * _TWO_OVER_PI)
    r = fma(n, -_PIO2[2], fma(n, -_PIO2[1], fma(n, -_PIO2[0], x)))
    s = r * r
    odd = fma(s * r, polynomial(s, _SINE), r)
    even = polynomial(s, _COSINE)
    turn = n + quarter_turns
    quadrant = turn - 4.0 * floor(turn * 0.25)
    value = where((quadrant == 1.0) | (quadrant == 3.0), even, odd)
    return where(quadrant >= 2.0, -value, value)


def sin(x: Any) -> Any:
    """Return the sine of an angle, rad."""
    return _sin_shifted(x, 0.0)


def cos(x: Any) -> Any:
    """Return the cosine of an angle, rad."""
    return _sin_shifted(x, 1.0)


def tanh(x: Any) -> Any:
    """Return (1 - p) / (1 + p) with p = exp(-2 |x|) and the sign of x; below 0.4, a continued fraction."""
    # Lambert's continued fraction x / (1 + s / (3 + s / (5 + ...))) to the term 17: remainder 1e-17 for |x|
    # <= 0.4.
    s = x * x
    tail = 15.0 + s / 17.0
    tail = 13.0 + s / tail
    tail = 11.0 + s / tail
    tail = 9.0 + s / tail
    tail = 7.0 + s / tail
    tail = 5.0 + s / tail
    tail = 3.0 + s / tail
    e = exp(-2.0 * absolute(x))
    return where(absolute(x) < 0.4, x / (1.0 + s / tail), copysign((1.0 - e) / (1.0 + e), x))


def sign(x: Any) -> Any:
    """Return -1, 0 or 1."""
    return where(x > 0.0, 1.0, where(x < 0.0, -1.0, x))
