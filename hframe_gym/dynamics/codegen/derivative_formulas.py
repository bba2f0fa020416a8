"""Derivatives of the integrator's elementary functions, as formulas of SIMD registers.

`friction` defines the functions decay_integral, end_weight and ramp of the viscous damping of a step. The
derivative of the first follows from the functions themselves; the others cancel for weak damping and need a
series.
"""

from __future__ import annotations

from typing import Any

from ..physics.friction import decay_integral, end_weight, ramp
from ..symbolic.elementwise import absolute, any_of, fma, where
from .lane_formulas import exp

_SMALL = 0.5  # largest |z| of the series below: the remainder of the Taylor series to z**10 is below 1e-13


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
    # Derivative of the Bernoulli series of w, because the closed form cancels for small z.
    p = fma(q, 1.0 / 5322240.0, -1.0 / 172800.0)
    p = fma(q, p, 1.0 / 6048.0)
    p = fma(q, p, -1.0 / 240.0)
    p = fma(q, p, 1.0 / 12.0)
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
    # Taylor series: the sum of (-1)**k (k - 2) z**(k - 3) / k! from k = 3 on.
    p = fma(z, 11.0 / 6227020800.0, -10.0 / 479001600.0)
    p = fma(z, p, 9.0 / 39916800.0)
    p = fma(z, p, -8.0 / 3628800.0)
    p = fma(z, p, 7.0 / 362880.0)
    p = fma(z, p, -6.0 / 40320.0)
    p = fma(z, p, 5.0 / 5040.0)
    p = fma(z, p, -4.0 / 720.0)
    p = fma(z, p, 3.0 / 120.0)
    p = fma(z, p, -2.0 / 24.0)
    p = fma(z, p, 1.0 / 6.0)
    p = -p
    large = absolute(z) > _SMALL
    if any_of(large):
        safe = where(large, z, 1.0)
        e = exp(-safe)
        p = where(large, (2.0 - safe - (2.0 + safe) * e) / (safe * safe * safe), p)
    return p
