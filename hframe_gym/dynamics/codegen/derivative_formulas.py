"""Derivatives of the integrator's elementary functions, as formulas of SIMD registers.

`friction` defines the functions decay_integral, end_weight and ramp of the viscous damping of a step. The
derivative of the first follows from the functions themselves; the others cancel for weak damping and need a
series.
"""

from __future__ import annotations

from math import factorial
from typing import Any

from ..physics.friction import decay_integral, end_weight, ramp
from ..symbolic.elementwise import absolute, any_of, polynomial, where
from .lane_formulas import exp

_SMALL = 0.5  # largest |z| of the series below: the remainder of the Taylor series to z**10 is below 1e-13
# Derivative of the Bernoulli series of `end_weight`: factors of the even powers.
_BERNOULLI_SLOPE = (1.0 / 5322240.0, -1.0 / 172800.0, 1.0 / 6048.0, -1.0 / 240.0, 1.0 / 12.0)
# The sum of (-1)**k (k - 2) z**(k - 3) / k! from k = 3 on, with the opposite sign.
_RAMP_SLOPE = tuple((-1) ** (k + 1) * (k - 2) / factorial(k) for k in range(13, 2, -1))


def decay_integral_slope(z: Any) -> Any:
    """Return the derivative of the function D(z) = (1 - exp(-z)) / z, see `friction.decay_integral`.

    It is (ramp(z) - D(z)) with `ramp` of `friction`, and -1/2 at z = 0. The argument is z = b h / m >= 0,
    dimensionless, of a step of length h with viscous friction b.
    """
    return ramp(z) - decay_integral(z)


def end_weight_slope(z: Any) -> Any:
    """Return the derivative of w(z) = 1 / (1 - exp(-z)) - 1 / z (`friction.end_weight`), 1/12 at z = 0.

    The argument is dimensionless, as in `decay_integral_slope`.
    """
    q = z * z
    # The closed form cancels for small z.
    p = polynomial(q, _BERNOULLI_SLOPE)
    if any_of(z > _SMALL):
        large = where(z > _SMALL, z, 1.0)
        w = end_weight(large)
        p = where(z > _SMALL, w - w * w + (1.0 - 2.0 * w) / large, p)
    return p


def ramp_slope(z: Any) -> Any:
    """Return the derivative of ramp(z) = (z - 1 + exp(-z)) / z**2 (`friction.ramp`), -1/6 at z = 0.

    The argument is z = b t / m, dimensionless, of a motion of the duration t; it is negative for motion
    reversed in time.
    """
    p = -polynomial(z, _RAMP_SLOPE)
    large = absolute(z) > _SMALL
    if any_of(large):
        safe = where(large, z, 1.0)
        e = exp(-safe)
        p = where(large, (2.0 - safe - (2.0 + safe) * e) / (safe * safe * safe), p)
    return p
