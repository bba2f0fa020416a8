"""Motion of one coordinate under a held force, viscous and Coulomb friction, in closed form.

    m v' = f - b v - F sign(v)         (eq. 36-37, with friction at v = 0 a set: |friction| <= F)

Over a step with f, b and F held, v runs exponentially towards (f - F sign v)/b.  If it reaches zero it stays there
when |f| <= F and leaves on the other side otherwise.  Every case has a closed form, so nothing is regularised: a held
stage does not creep.  Viscous friction may differ by direction (b of the present one, b of the other).

All functions work on registers of lanes; SI units, travel of the coordinate in m.
"""

from __future__ import annotations

from numba import njit

from .simd import absolute, any_of, copysign, fma, where
from .simd_math import exp

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
def ramp(z):  # type: ignore[no-untyped-def]
    """(z - 1 + exp(-z)) / z**2, z = b t/m: travel from rest per unit of force, over t**2/m (1/2 without friction)."""
    # Taylor to z**8, remainder 2e-13 of the value for sizes up to 1/4; paired so that its terms do not wait in a row.
    q = z * z
    low = fma(q, fma(z, -1.0 / 120.0, 1.0 / 24.0), fma(z, -1.0 / 6.0, 0.5))
    high = fma(q, fma(z, -1.0 / 362880.0, 1.0 / 40320.0), fma(z, -1.0 / 5040.0, 1.0 / 720.0))
    r = q * q
    p = fma(r, fma(r, 1.0 / 3628800.0, high), low)
    large = absolute(z) > 0.25
    if any_of(large):  # overdamped within a step: no machine at its usual step
        safe = where(large, z, 1.0)
        p = where(large, (safe - 1.0 + exp(-safe)) / (safe * safe), p)
    return p


@inlined
def direction(v, f):  # type: ignore[no-untyped-def]
    """A number with the sign of the motion, or of the force where the coordinate is at rest."""
    return where(v == 0.0, f, v)


@inlined
def held(f, coulomb):  # type: ignore[no-untyped-def]
    """Friction's force at rest: whatever f is, up to the Coulomb level.  What it leaves of f is exactly zero below."""
    below = where(f < coulomb, f, coulomb)
    return where(below > -coulomb, below, -coulomb)


@inlined
def answer(v, f, coulomb):  # type: ignore[no-untyped-def]
    """Friction's force: the Coulomb level against the motion; at rest `held`."""
    return where(v == 0.0, held(f, coulomb), copysign(coulomb, v))


@inlined
def kick(v, f, coulomb, decay, gain):  # type: ignore[no-untyped-def]
    """Velocity after the step for every lane that does not stop inside it.

    Returns (velocity, stopped): where a moving lane reaches zero, `stopped` holds and `reverse` has the answer.
    """
    after = fma(gain, f - answer(v, f, coulomb), decay * v)
    return after, after * v < 0.0


@inlined
def reverse(v, f, coulomb, viscous, viscous_back, mass, per_mass, h):  # type: ignore[no-untyped-def]
    """Velocity and travel of a lane that stops inside the step: (velocity after, travel over the step).

    First leg: from v to rest in time `stop`.  Second: at rest if |f| <= F, else off the other way for h - stop.
    Meaningful only where `kick` says stopped.
    """
    dry = copysign(coulomb, v)
    net = f - dry
    # stop = m/b log(1 - b v/net), by the series of atanh in s = x/(2 + x), x = -b v/net.
    loss = viscous * v
    scale = 1.0 / (2.0 * net - loss)
    s = loss * scale
    q = s * s
    r = q * q
    low = fma(r, fma(q, 1.0 / 7.0, 1.0 / 5.0), fma(q, 1.0 / 3.0, 1.0))
    high = fma(r, fma(q, 1.0 / 15.0, 1.0 / 13.0), fma(q, 1.0 / 11.0, 1.0 / 9.0))
    w = r * r
    p = fma(w, fma(w, 1.0 / 17.0, high), low)
    stop = (-2.0 * mass * v * scale) * p
    # Lanes that do not stop must not make `ramp` take its long way.
    stop = where(stop > 0.0, stop, 0.0)
    stop = where(stop > h, h, stop)
    left = h - stop
    # A leg towards rest is one away from it with time reversed.
    push = net * per_mass * stop
    first = push * stop * ramp(-viscous * per_mass * stop)
    away = f - held(f, coulomb)
    push = away * per_mass * left
    z = viscous_back * per_mass * left
    share = ramp(z)
    return push * (1.0 - z * share), push * left * share - first
