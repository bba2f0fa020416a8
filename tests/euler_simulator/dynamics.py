"""Parameters of the stage and the compiled loop over its steps.

Coordinates: x, y, m; phi1, phi2, theta (yaw of the bridge), rad. Belts: left, right, bottom. SI units.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]
COORDINATES, DRIVES = 5, 2
YAW = 4

# Rows of the table of parameters. Its five columns are the coordinates; belts use the first three, drives the
# first two, what belongs to none of them the first one. An effect is absent where its amplitude is zero or
# its limit infinite.
FIELDS = (
    "mass",
    "viscous",
    "coulomb",
    "stribeck_force",
    "stribeck_velocity",
    "stribeck_exponent",
    "friction_wave",
    "friction_wavelength",
    "friction_phase",
    "friction_slope",
    "friction_cold",
    "bristle_stiffness",
    "bristle_damping",
    "hysteresis_force",
    "hysteresis_travel",
    "dahl_force",
    "dahl_travel",
    "constant_force",
    "viscous_asymmetry",
    "quadratic_drag",
    "spring_stiffness",
    "spring_rest",
    "wave_force",
    "wave_number",
    "wave_phase",
    "wave_second",
    "catch_force",
    "catch_position",
    "catch_width",
    "belt_EA_N",
    "belt_length_m",
    "belt_damping_s",
    "drive_gain",
    "voltage_offset_V",
    "dead_band_V",
    "voltage_limit_V",
    "current_limit_A",
    "electrical_lag_s",
    "torque_per_ampere",
    "emf_per_speed",
    "resistance_ohm",
    "load_friction",
    "eccentricity_m",
    "eccentricity_phase",
    "radius_m",
    "half_width_m",
    "play_m",
    "pretension_N",
    "hardening",
    "energy_force",
    "warm_up_s",
    "frame_rate",
    "frame_damping",
    "frame_ratio",
)
(
    MASS,
    VISCOUS,
    COULOMB,
    STRIBECK_FORCE,
    STRIBECK_VELOCITY,
    STRIBECK_EXPONENT,
    FRICTION_WAVE,
    FRICTION_WAVELENGTH,
    FRICTION_PHASE,
    FRICTION_SLOPE,
    FRICTION_COLD,
    BRISTLE_STIFFNESS,
    BRISTLE_DAMPING,
    HYSTERESIS_FORCE,
    HYSTERESIS_TRAVEL,
    DAHL_FORCE,
    DAHL_TRAVEL,
    CONSTANT_FORCE,
    VISCOUS_ASYMMETRY,
    QUADRATIC_DRAG,
    SPRING_STIFFNESS,
    SPRING_REST,
    WAVE_FORCE,
    WAVE_NUMBER,
    WAVE_PHASE,
    WAVE_SECOND,
    CATCH_FORCE,
    CATCH_POSITION,
    CATCH_WIDTH,
    BELT_EA_N,
    BELT_LENGTH_M,
    BELT_DAMPING_S,
    DRIVE_GAIN,
    VOLTAGE_OFFSET_V,
    DEAD_BAND_V,
    VOLTAGE_LIMIT_V,
    CURRENT_LIMIT_A,
    ELECTRICAL_LAG_S,
    TORQUE_PER_AMPERE,
    EMF_PER_SPEED,
    RESISTANCE_OHM,
    LOAD_FRICTION,
    ECCENTRICITY_M,
    ECCENTRICITY_PHASE,
    RADIUS_M,
    HALF_WIDTH_M,
    PLAY_M,
    PRETENSION_N,
    HARDENING,
    ENERGY_FORCE,
    WARM_UP_S,
    FRAME_RATE,
    FRAME_DAMPING,
    FRAME_RATIO,
) = range(len(FIELDS))

# State: positions, velocities, bristles, hystereses (5 each), currents (2), position and velocity of the
# frame.
BRISTLE = 2 * COORDINATES
HYSTERESIS = 3 * COORDINATES
CURRENT = 4 * COORDINATES
FRAME = 4 * COORDINATES + DRIVES
STATE = FRAME + 2


@njit(cache=True)
def friction_level(i: int, q: float, v: float, t: float, p: Array) -> float:  # pragma: no cover - compiled
    """Return the level of dry friction of a coordinate, N or Nm."""
    level = p[COULOMB, i] + p[FRICTION_SLOPE, i] * q
    if p[STRIBECK_FORCE, i] != 0.0:
        level += p[STRIBECK_FORCE, i] * math.exp(
            -(math.fabs(v / p[STRIBECK_VELOCITY, i]) ** p[STRIBECK_EXPONENT, i])
        )
    if p[FRICTION_WAVE, i] != 0.0:
        level += p[FRICTION_WAVE, i] * math.sin(
            2.0 * math.pi * q / p[FRICTION_WAVELENGTH, i] + p[FRICTION_PHASE, i]
        )
    if p[FRICTION_COLD, i] != 0.0:
        level += level * p[FRICTION_COLD, i] * math.exp(-t / p[WARM_UP_S, 0])
    return level if level > 0.0 else 0.0


@njit(cache=True)
def applied_force(i: int, q: float, v: float, p: Array) -> float:  # pragma: no cover - compiled
    """Return a coordinate's forces by its position and speed only, without dry friction, N or Nm."""
    b = p[VISCOUS, i]
    if v > 0.0:
        b *= 1.0 + p[VISCOUS_ASYMMETRY, i]
    elif v < 0.0:
        b *= 1.0 - p[VISCOUS_ASYMMETRY, i]
    force = p[CONSTANT_FORCE, i] - v * (b + p[QUADRATIC_DRAG, i] * math.fabs(v))
    force -= p[SPRING_STIFFNESS, i] * (q - p[SPRING_REST, i])
    if p[WAVE_FORCE, i] != 0.0:
        angle = p[WAVE_NUMBER, i] * q
        force += p[WAVE_FORCE, i] * (
            math.sin(angle + p[WAVE_PHASE, i]) + p[WAVE_SECOND, i] * math.sin(2.0 * angle)
        )
    if p[CATCH_FORCE, i] != 0.0:
        u = (q - p[CATCH_POSITION, i]) / p[CATCH_WIDTH, i]
        force -= p[CATCH_FORCE, i] * u * math.exp(0.5 * (1.0 - u * u))
    return force


@njit(cache=True)
def belt_forces(
    b: int, s: float, rate: float, length: float, p: Array
) -> tuple[float, float]:  # pragma: no cover - compiled
    """Return the tension of a belt and its force towards a greater length, N.

    Args:
        b: Number of the belt.
        s: Extension, m.
        rate: Its rate, m/s.
        length: Free length, m.
        p: Parameters, shape (len(FIELDS), 5).

    Returns:
        Tension, N.
        Force, N: the energy is the stiffness k times a function of s, and dk/dlength = -k / length.
    """
    k, play = p[BELT_EA_N, b] / length, p[PLAY_M, 0]
    if play > 0.0:
        s = s - play if s > play else (s + play if s < -play else 0.0)
    slack = -p[PRETENSION_N, 0] / k
    if s < slack:
        s = slack
    stiffening = p[HARDENING, 0] * s * s
    tension = k * (s + s * stiffening + p[BELT_DAMPING_S, b] * rate)
    return tension, p[ENERGY_FORCE, 0] * (0.5 + 0.25 * stiffening) * s * s * k / length


@njit(cache=True)
def add_belts(state: Array, p: Array, force: Array) -> None:  # pragma: no cover - compiled
    """Add the forces of the three belts to those on the coordinates."""
    x, y, theta = state[0], state[1], state[YAW]
    vx, vy, omega = state[5], state[6], state[5 + YAW]
    r, w = p[RADIUS_M, 0], p[HALF_WIDTH_M, 0]
    # Of the two pulleys: belt drawn in, m, and its derivative with respect to the angle, m/rad.
    angle1, angle2 = state[2] + p[ECCENTRICITY_PHASE, 0], state[3] + p[ECCENTRICITY_PHASE, 1]
    travel1 = r * state[2] + p[ECCENTRICITY_M, 0] * math.sin(angle1)
    travel2 = r * state[3] + p[ECCENTRICITY_M, 1] * math.sin(angle2)
    arm1, arm2 = r + p[ECCENTRICITY_M, 0] * math.cos(angle1), r + p[ECCENTRICITY_M, 1] * math.cos(angle2)
    rate1, rate2 = arm1 * state[7], arm2 * state[8]
    lengths = p[BELT_LENGTH_M, 0] + x + y, p[BELT_LENGTH_M, 1] + x - y, p[BELT_LENGTH_M, 2] - 2.0 * x
    left, push_left = belt_forces(0, travel1 + x + w * theta + y, rate1 + vx + w * omega + vy, lengths[0], p)
    right, push_right = belt_forces(
        1, -travel2 + x - w * theta - y, -rate2 + vx - w * omega - vy, lengths[1], p
    )
    bottom, push_bottom = belt_forces(2, travel2 - travel1 - 2.0 * x, rate2 - rate1 - 2.0 * vx, lengths[2], p)
    force[0] += -left - right + 2.0 * bottom + push_left + push_right - 2.0 * push_bottom
    force[1] += -left + right + push_left - push_right
    force[2] += arm1 * (bottom - left)
    force[3] += arm2 * (right - bottom)
    force[4] += w * (right - left)


@njit(cache=True)
def add_drives(
    state: Array, volts: Array, h: float, p: Array, force: Array, load: Array
) -> None:  # pragma: no cover - compiled
    """Add the motors' torques, set their friction; advance their currents by the implicit Euler rule."""
    for j in range(DRIVES):
        u = p[DRIVE_GAIN, j] * min(max(volts[j], -p[VOLTAGE_LIMIT_V, j]), p[VOLTAGE_LIMIT_V, j])
        band = p[DEAD_BAND_V, j]
        if band > 0.0:
            u = u - band if u > band else (u + band if u < -band else 0.0)
        current = (u + p[VOLTAGE_OFFSET_V, j] - p[EMF_PER_SPEED, j] * state[7 + j]) / p[RESISTANCE_OHM, j]
        if p[ELECTRICAL_LAG_S, j] > 0.0:
            part = h / (h + p[ELECTRICAL_LAG_S, j])
            state[CURRENT + j] += part * (current - state[CURRENT + j])
            current = state[CURRENT + j]
        limit = p[CURRENT_LIMIT_A, j]
        current = limit if current > limit else (-limit if current < -limit else current)
        force[2 + j] += p[TORQUE_PER_AMPERE, j] * current
        load[2 + j] = p[LOAD_FRICTION, j] * math.fabs(p[TORQUE_PER_AMPERE, j] * current)


@njit(cache=True)
def advance(t: float, h: float, steps: int, state: Array, volts: Array, p: Array) -> None:  # pragma: no cover
    """Take steps of constant length under constant voltages, in place.

    Args:
        t: Time at the beginning, s.
        h: Length of a step, s.
        steps: Number of steps.
        state: State, shape (STATE,).
        volts: Voltages at the drives, V, shape (2,).
        p: Array.
    """
    force, load = np.empty(COORDINATES), np.zeros(COORDINATES)
    for n in range(steps):
        for i in range(COORDINATES):
            force[i] = applied_force(i, state[i], state[5 + i], p)
        add_belts(state, p, force)
        add_drives(state, volts, h, p, force, load)
        before = state[5]
        for i in range(COORDINATES):
            _move(i, t + n * h, h, state, force[i], load[i], p)
        rate, damping = p[FRAME_RATE, 0], p[FRAME_DAMPING, 0]
        swing = -rate * (rate * state[FRAME] + 2.0 * damping * state[FRAME + 1])
        state[FRAME + 1] += h * swing - p[FRAME_RATIO, 0] * (state[5] - before)
        state[FRAME] += h * state[FRAME + 1]


@njit(cache=True)
def _move(
    i: int, t: float, h: float, state: Array, force: float, load: float, p: Array
) -> None:  # pragma: no cover - compiled
    """Advance one coordinate: velocity without dry friction, impulse of friction, then position."""
    q, v = state[i], state[5 + i]
    level = friction_level(i, q, v, t, p) + load
    if p[HYSTERESIS_FORCE, i] != 0.0:
        travel = p[HYSTERESIS_TRAVEL, i]
        w = state[HYSTERESIS + i] / travel  # from -1 to 1
        force -= p[HYSTERESIS_FORCE, i] * w
        state[HYSTERESIS + i] += h * (v - 0.5 * w * (math.fabs(v * w) + v * w))
    if p[DAHL_FORCE, i] != 0.0:  # in place of the hysteresis above, with the same state
        z, travel = state[HYSTERESIS + i], p[DAHL_TRAVEL, i]
        state[HYSTERESIS + i] = (z + h * v) / (1.0 + h * math.fabs(v) / travel)
        force -= p[DAHL_FORCE, i] * z / travel
    if p[BRISTLE_STIFFNESS, i] != 0.0:
        # dz/dt = v - s0 |v| z / F, implicit in z.
        z = state[BRISTLE + i]
        state[BRISTLE + i] = (z + h * v) / (1.0 + h * p[BRISTLE_STIFFNESS, i] * math.fabs(v) / level)
        force -= p[BRISTLE_STIFFNESS, i] * state[BRISTLE + i]
        force -= p[BRISTLE_DAMPING, i] * (state[BRISTLE + i] - z) / h
        level = 0.0  # the bristle carries the friction
    v += h / p[MASS, i] * force
    impulse = h / p[MASS, i] * level
    v = v - impulse if v > impulse else (v + impulse if v < -impulse else 0.0)
    state[5 + i] = v
    state[i] = q + h * v
