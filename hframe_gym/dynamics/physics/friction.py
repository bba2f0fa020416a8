"""Closed-form motion of one coordinate under a constant force with viscous and Coulomb friction.

    m dv/dt = f - b v - F sign(v)         (eq. 36-37; at v = 0 friction is a set: |friction| <= F)

With f, b and F constant over a step, v approaches (f - F sign v)/b exponentially. If it reaches zero it stays
there where |f| <= F, and reverses otherwise. Every case has a closed form, so nothing is regularized: a
machine that static friction holds does not creep. Viscous friction may depend on the direction of motion.

The functions are formulas of the kernel, where their operands are SIMD registers (one float per lane, one
lane per machine); they work on NumPy arrays as well. SI units; the position of a coordinate is its belt
travel, m (radius * angle of a rotary one), and forces act along it.
"""

from __future__ import annotations

from math import factorial
from typing import Any

from ..symbolic.elementwise import absolute, any_of, copysign, exp, fma, polynomial, where

# Argument b h / m up to which the series are accurate to 1e-12; strongly damped machines beyond it use the
# exponential.
_SMALL = 0.5
# Taylor series of (1 - exp(-z)) / z in -z, to z**10.
_DECAY = tuple(1.0 / factorial(k) for k in range(11, 0, -1))
# Bernoulli series 1/2 + z/12 - z**3/720 + ... of `end_weight`: factors of the odd powers.
_BERNOULLI = (1.0 / 47900160.0, -1.0 / 1209600.0, 1.0 / 30240.0, -1.0 / 720.0, 1.0 / 12.0)


def decay_integral(z: Any) -> Any:
    """Return (1 - exp(-z)) / z, the factor by which viscous friction reduces a step's change of speed.

    A constant force f changes the speed of a mass m with viscous coefficient b by f h / m * decay_integral(z)
    in a step of length h, with the damping z = b h / m, dimensionless. The factor is 1 for z = 0.
    """
    # The closed form cancels for small z.
    p = polynomial(-z, _DECAY)
    # a strongly damped machine; the branch is skipped if no machine of the register needs it
    if any_of(z > _SMALL):
        large = where(z > _SMALL, z, 1.0)
        p = where(z > _SMALL, (1.0 - exp(-large)) / large, p)
    return p


def end_weight(z: Any) -> Any:
    """Return the weight, in [1/2, 1), of a final speed in the mean speed of a step with damping z = b h / m.

    The mean is (1 - w) v0 + w v1 for initial speed v0, final speed v1 and the weight w = 1/(1 - exp(-z)) -
    1/z, if the force is constant. For small z this is the trapezoidal rule, w = 1/2.
    """
    square = z * z
    # The closed form cancels for small z.
    p = polynomial(square, _BERNOULLI)
    p = fma(z, p, 0.5)
    if any_of(z > _SMALL):
        large = where(z > _SMALL, z, 1.0)
        p = where(z > _SMALL, 1.0 / (1.0 - exp(-large)) - 1.0 / large, p)
    return p


def ramp(z: Any) -> Any:
    """Return (z - 1 + exp(-z)) / z**2, which gives the distance of a motion from rest with viscous friction.

    Under a constant force f, a mass m moves by f t**2 / m * ramp(b t / m) in the time t. Without damping it
    is 1/2; z is negative for motion reversed in time.
    """
    # Taylor series to z**8, relative remainder 2e-13 for |z| <= 1/4; in pairs, to shorten the chain of
    # dependent terms.
    q = z * z
    low = fma(q, fma(z, -1.0 / 120.0, 1.0 / 24.0), fma(z, -1.0 / 6.0, 0.5))
    high = fma(q, fma(z, -1.0 / 362880.0, 1.0 / 40320.0), fma(z, -1.0 / 5040.0, 1.0 / 720.0))
    r = q * q
    p = fma(r, fma(r, 1.0 / 3628800.0, high), low)
    large = absolute(z) > 0.25
    if any_of(large):  # overdamped within a step, which no machine is at its usual step length
        safe = where(large, z, 1.0)
        p = where(large, (safe - 1.0 + exp(-safe)) / (safe * safe), p)
    return p


def direction(v: Any, f: Any) -> Any:
    """Return a number with the sign of the motion: the speed v, m/s, or at rest the applied force f, N."""
    return where(v == 0.0, f, v)


def static_friction(f: Any, coulomb: Any) -> Any:
    """Return the dry friction force at rest, N, which balances the applied force f within F = `coulomb`."""
    below = where(f < coulomb, f, coulomb)  # min(f, F)
    return where(below > -coulomb, below, -coulomb)


def friction_force(v: Any, f: Any, coulomb: Any) -> Any:
    """Return the dry friction force, N: F sign(v), or at rest the applied force f limited to [-F, F].

    Args:
        v: Speed, m/s.
        f: Sum of all other forces on the coordinate, N.
        coulomb: Coulomb friction force F >= 0, N.
    """
    return where(v == 0.0, static_friction(f, coulomb), copysign(coulomb, v))


def update_speed(v: Any, f: Any, coulomb: Any, decay: Any, gain: Any) -> Any:
    """Return the speed after one step of length h, m/s, provided that it does not cross zero in the step.

    If the result and v have opposite signs, the speed does cross zero. The result is then invalid, and
    `stop_or_reverse` gives the speed.

    Args:
        v: Speed before the step, m/s.
        f: Sum of all forces on the coordinate except friction, N, constant over the step.
        coulomb: Coulomb friction force F >= 0, N.
        decay: Factor exp(-b h / m), dimensionless, by which viscous friction reduces the speed.
        gain: Speed gained per unit of force, h / m * decay_integral(b h / m), s/kg.
    """
    return fma(gain, f - friction_force(v, f, coulomb), decay * v)


def stop_or_reverse(
    v: Any, f: Any, coulomb: Any, viscous: Any, viscous_after: Any, mass: Any, per_mass: Any, h: Any
) -> Any:
    """Compute final speed, m/s, and distance, m, of a step of length h in which the coordinate comes to rest.

    The coordinate decelerates to rest. If static friction holds it (|f| <= F), it stays at rest; otherwise it
    reverses for the remaining time. The result is valid only where `update_speed` changes the sign of the
    speed.

    Args:
        v: Speed before the step, m/s.
        f: Sum of all forces on the coordinate except friction, N, constant over the step.
        coulomb: Coulomb friction force F >= 0, N.
        viscous: Viscous coefficient b in the direction of the motion before the stop, Ns/m.
        viscous_after: Viscous coefficient in the opposite direction, after a reversal, Ns/m.
        mass: Mass m, kg.
        per_mass: Reciprocal 1/m of the mass, 1/kg.
        h: Length of the step, s, float.
    """
    net = f - copysign(coulomb, v)
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
    # Lanes that do not stop must not take the slow path of `ramp`.
    stop = where(stop > 0.0, stop, 0.0)
    stop = where(stop > h, h, stop)
    remaining = h - stop
    # Deceleration to rest is acceleration from rest with time reversed.
    impulse = net * per_mass * stop
    to_rest = impulse * stop * ramp(-viscous * per_mass * stop)
    away = f - static_friction(f, coulomb)
    impulse = away * per_mass * remaining
    z = viscous_after * per_mass * remaining
    from_rest = ramp(z)
    return impulse * (1.0 - z * from_rest), impulse * remaining * from_rest - to_rest
