"""One step of the integrator in plain Python: the specification of the compiled, generated kernel.

The step of length h advances belt travel p, speed v and the states z of the effects with constant voltages.
It is a symmetric splitting around the exact flow of each coordinate with friction:

    1. half-way point      p1 = p + h/2 v,  z1 = z after h/2
       forces there        f1, F1 (Coulomb friction force)
       acceleration        a = (f1 - b v - friction(v, f1, F1)) / m
    2. corrected point     p2 = p1 + h^2/12 a,  v2 = v + h/2 a,  z2 = z after h/2 with v2
       forces there        f2, F2; belts without nonlinear effects: f2 = f1 - G' k G h^2/12 a
    3. exact flow          m dv/dt = f2 - b v - F2 sign v over h, through a stop, gives v and p
    4. effect states       z after h

A damper of a contact (`Effect.damping`) takes the mean rate that it leaves over the step (`BeltEquations`).
Step 2 cancels the frequency error (omega h)^2/24 of the position Verlet scheme (Takahashi and Imada 1984;
Chin 1997). The exact flow replaces the scheme's half steps, so that strong damping costs no accuracy.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from .equations import Equations, ForceBalance
from .parameterized_machine import MotionPoint


def reference_step(
    equations: Equations, state: MotionPoint, voltages: Sequence[float], h: float
) -> MotionPoint:
    """Advance a machine by one step of the integrator, in plain Python, as a reference for the compiled code.

    With belt travel p and speed v before the step, the forces are evaluated at p + h/2 v, which gives the
    acceleration a, and again at p + h/2 v + h^2/12 a (the last term raises the accuracy, Takahashi and Imada
    1984; Chin 1997) and v + h/2 a. The motion from p and v under the second forces and under friction is
    computed in closed form.

    Args:
        state: Motion before the step, of floats; its effect states are those of its time (`elapsed` is None).
        voltages: Commanded voltage of each drive, V, constant over the step.
        h: Length of the step, s.
    """
    h = h * equations.step_factor(state.effect_states)
    p, v = state.travel, state.speed
    coordinates = range(len(p))
    motor_voltages = equations.motor_voltages(voltages)

    # 1. Forces at the half-way point, and the acceleration.
    half_way = [p[i] + 0.5 * h * v[i] for i in coordinates]
    point = MotionPoint(half_way, v, state.time + 0.5 * h, state.effect_states, 0.5 * h)
    belts = equations.belt_states(point)
    forces = equations.add_drive_forces(equations.belt_forces(point, belts), motor_voltages)
    balance = equations.force_balance(point, motor_voltages, forces)
    a = [_acceleration(equations, i, v[i], balance) for i in coordinates]

    # 2. Forces at the corrected point.
    shift = [h * h / 12.0 * a[i] for i in coordinates]
    corrected = [half_way[i] + shift[i] for i in coordinates]
    mean_speed = [v[i] + 0.5 * h * a[i] for i in coordinates]
    gained = [h * a[i] for i in coordinates]
    point = MotionPoint(corrected, mean_speed, state.time + 0.5 * h, state.effect_states, 0.5 * h, gained)
    if equations.nonlinear_belts:
        forces = equations.add_drive_forces(
            equations.belt_forces(point, equations.belt_states(point)), motor_voltages
        )
    else:
        for belt, row in zip(belts, equations.extension_rows, strict=True):
            tension_change = belt.stiffness * sum(g * shift[i] for i, g in row.items())
            forces = [forces[i] - row.get(i, 0.0) * tension_change for i in coordinates]
    balance = equations.force_balance(point, motor_voltages, forces)

    # 3. Exact flow with friction.
    speed, travel = [], []
    for i in coordinates:
        ahead = _direction(v[i], balance.forces[i])
        viscous = [equations.viscous(i, side) for side in (ahead, -ahead)]
        flow = _flow(v[i], balance.forces[i], balance.coulomb[i], viscous, equations.mass(i), h)
        speed.append(flow[0])
        travel.append(p[i] + flow[1])  # the flow gives the distance traveled

    # 4. States of the effects.
    traveled = [travel[i] - p[i] for i in coordinates]
    gained = [speed[i] - v[i] for i in coordinates]
    effect_states = {
        k: equations.next_state(k, z, balance.arguments.get(k, {}), traveled, mean_speed, h, gained)
        for k, z in state.effect_states.items()
    }
    return MotionPoint(travel, speed, state.time + h, effect_states)


def _direction(v: float, f: float) -> float:
    """Return the sign of the motion, or of the force at rest."""
    return math.copysign(1.0, f if v == 0.0 else v)


def _friction(v: float, f: float, level: float) -> float:
    """Return the Coulomb friction force; at rest it equals f, limited to +-level."""
    return min(max(f, -level), level) if v == 0.0 else math.copysign(level, v)


def _acceleration(equations: Equations, i: int, v: float, balance: ForceBalance) -> float:
    """Return the acceleration of coordinate i, m/s^2."""
    f = balance.forces[i]
    viscous = equations.viscous(i, _direction(v, f))
    return (f - viscous * v - _friction(v, f, balance.coulomb[i])) / equations.mass(i)


def _flow(
    v: float, f: float, level: float, viscous: Sequence[float], m: float, h: float
) -> tuple[float, float]:
    """Return speed and travel after the time h of m dv/dt = f - b v - F sign v."""
    net = f - _friction(v, f, level)
    speed, travel = _exponential(v, net, viscous[0], m, h)
    if speed * v >= 0.0:
        return speed, travel
    # The speed changes its sign: move until rest, then stay there or leave in the direction of the force.
    b = viscous[0]
    stop = m / b * math.log1p(-b * v / net) if b else -m * v / net
    _, travel = _exponential(v, net, b, m, stop)
    speed, after = _exponential(0.0, f - _friction(0.0, f, level), viscous[1], m, h - stop)
    return speed, travel + after


def _exponential(v: float, net: float, b: float, m: float, t: float) -> tuple[float, float]:
    """Return speed and travel after the time t of m dv/dt = net - b v."""
    z = b * t / m
    if z < 0.5:  # series, because the closed forms cancel
        mean = sum((-z) ** k / math.factorial(k + 1) for k in range(16))
        ramp = sum((-z) ** k / math.factorial(k + 2) for k in range(16))
    else:
        mean, ramp = (1.0 - math.exp(-z)) / z, (z - 1.0 + math.exp(-z)) / (z * z)
    return v * math.exp(-z) + net * t / m * mean, v * t * mean + net * t * t / m * ramp
