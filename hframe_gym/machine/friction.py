"""Motion of one coordinate under a held force, viscous and Coulomb friction, in closed form.

    m v' = f - b v - F sign(v)         (eq. 36-37, with friction at v = 0 a set: |friction| <= F)

Over a step with f, b and F held, v runs exponentially towards (f - F sign v)/b.  If it reaches zero it stays there
when |f| <= F and leaves on the other side otherwise.  Every case has a closed form, so nothing is regularised: a held
stage does not creep.  Viscous friction may differ by direction (b of the present one, b of the other).

All functions work on registers of lanes; SI units, travel of the coordinate in m.
"""

from __future__ import annotations

from numba import njit

from .lanes import absolute, any_of, copysign, fma, where
from .vector_math import exp

# Up to here the series are right to 1e-12; beyond (b h / m, a very damped machine) the exponential is worth its price.
_SMALL = 0.5

inlined = njit(forceinline=True, nogil=True, error_model="numpy")


@inlined
def decay_integral(z):  # type: ignore[no-untyped-def]
    """(1 - exp(-z)) / z for z >= 0: velocity gained per unit of force, over h/m."""
    p = fma(z, -1.0 / 39916800.0, 1.0 / 3628800.0)
    p = fma(z, -p, 1.0 / 362880.0)
    p = fma(z, -p, 1.0 / 40320.0)
    p = fma(z, -p, 1.0 / 5040.0)
    p = fma(z, -p, 1.0 / 720.0)
    p = fma(z, -p, 1.0 / 120.0)
    p = fma(z, -p, 1.0 / 24.0)
    p = fma(z, -p, 1.0 / 6.0)
    p = fma(z, -p, 0.5)
    p = fma(z, -p, 1.0)
    if any_of(z > _SMALL):
        large = where(z > _SMALL, z, 1.0)
        p = where(z > _SMALL, (1.0 - exp(-large)) / large, p)
    return p


@inlined
def end_weight(z):  # type: ignore[no-untyped-def]
    """Share w of the last velocity in the mean of an exponential decay: mean v = (1 - w) v0 + w v1.

    w = 1/(1 - exp(-z)) - 1/z, one half for small z (the trapezoid).
    """
    square = z * z
    p = fma(square, 1.0 / 47900160.0, -1.0 / 1209600.0)
    p = fma(square, p, 1.0 / 30240.0)
    p = fma(square, p, -1.0 / 720.0)
    p = fma(square, p, 1.0 / 12.0)
    p = fma(z, p, 0.5)
    if any_of(z > _SMALL):
        large = where(z > _SMALL, z, 1.0)
        p = where(z > _SMALL, 1.0 / (1.0 - exp(-large)) - 1.0 / large, p)
    return p


@inlined
def log1p_ratio(x):  # type: ignore[no-untyped-def]
    """log(1 + x) / x for 0 <= x < 1 or so (a stop within one step), by the series of atanh."""
    s = x / (2.0 + x)
    q = s * s
    p = fma(q, 1.0 / 17.0, 1.0 / 15.0)
    p = fma(q, p, 1.0 / 13.0)
    p = fma(q, p, 1.0 / 11.0)
    p = fma(q, p, 1.0 / 9.0)
    p = fma(q, p, 1.0 / 7.0)
    p = fma(q, p, 1.0 / 5.0)
    p = fma(q, p, 1.0 / 3.0)
    p = fma(q, p, 1.0)
    return 2.0 * p / (2.0 + x)


@inlined
def direction(v, f):  # type: ignore[no-untyped-def]
    """A number with the sign of the motion, or of the force where the coordinate is at rest."""
    return where(v == 0.0, f, v)


@inlined
def stays(v, f, coulomb):  # type: ignore[no-untyped-def]
    """Where a coordinate at rest is held by friction."""
    return (v == 0.0) & (absolute(f) <= coulomb)


@inlined
def kick(v, f, coulomb, toward, decay, gain):  # type: ignore[no-untyped-def]
    """Velocity after the step for every lane that does not stop inside it.

    Returns (velocity, stopped): where a moving lane reaches zero, `stopped` holds and `reverse` has the answer.
    """
    after = fma(decay, v, gain * (f - copysign(coulomb, toward)))
    # At rest without any force `toward` is zero, and zero is held.
    through = after * toward <= 0.0
    return where(through, 0.0, after), through & (v != 0.0)


@inlined
def reverse(v, f, coulomb, toward, viscous, viscous_back, mass, h):  # type: ignore[no-untyped-def]
    """Velocity and travel of a lane that stops inside the step: (velocity after, travel over the step).

    First leg: from v to rest in time `stop`.  Second: at rest if |f| <= F, else off the other way for h - stop.
    Meaningful only where `kick` says stopped.
    """
    net = f - copysign(coulomb, toward)
    x = -viscous * v / net
    stop = -(mass * v / net) * log1p_ratio(x)
    # Other lanes, whose numbers mean nothing, must stay within the step for the sake of the series above.
    stop = where((stop > 0.0) & (stop < h), stop, h)
    left = h - stop
    away = f + copysign(coulomb, toward)
    z = viscous_back * left / mass
    after = where(absolute(f) <= coulomb, 0.0, away * left / mass * decay_integral(z))
    travel = stop * (1.0 - end_weight(viscous * stop / mass)) * v + left * end_weight(z) * after
    return after, travel
