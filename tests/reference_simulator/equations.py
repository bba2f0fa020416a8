"""Equations of motion, compiled: time derivative of the state for given modes of dry friction.

The state z of a stage with n coordinates and m belts has 5 n + m + 9 entries, in this order:
    positions q (n), velocities v (n), motor currents (2), friction bristles (n), cable hysteresis (n),
    normalized heat of the motors (2), position and velocity of the frame (2), age of the contacts (n),
    slip of the motors' pulleys (2), relative sag of the supply (1), relaxing tension of the belts (m).

The mode (n,) of a coordinate is 0 while it sticks, otherwise the direction, +1 or -1, in which it slides.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tests.reference_simulator.parameter_arrays import ParameterArrays
from tests.reference_simulator.rig import Array


def state_size(arrays: ParameterArrays) -> int:
    """Return the number of entries of the state.

    Args:
        arrays: Parameters of the stage.
    """
    return 5 * len(arrays.coordinates) + len(arrays.belts) + 9


@njit(cache=True)
def derivative(
    t: float,
    z: Array,
    volts: Array,
    mode: Array,
    arrays: ParameterArrays,
    dz: Array,
    force: Array,
    level: Array,
) -> None:  # pragma: no cover - compiled
    """Compute the state's derivative, the forces and the levels of dry friction, in place.

    Args:
        t: Time on the session's clock, s.
        z: State, shape (5 n + m + 9,).
        volts: Voltages at the drives, V, shape (2,).
        mode: Modes of dry friction, shape (n,).
        arrays: Parameters of the stage.
        dz: Output: derivative of the state, shape (5 n + m + 9,).
        force: Output: sum of all forces but rigid dry friction, N or Nm, shape (n,).
        level: Output: level of rigid dry friction, N or Nm, shape (n,).
    """
    coordinates = arrays.coordinates
    stage = arrays.stage[0]
    n = len(coordinates)
    for i in range(n):
        level[i] = dry_level(t, z, i, n, coordinates, stage)
        force[i] = _force_of_coordinate(z, i, n, coordinates[i], level[i], dz)
        if coordinates[i].bristle_stiffness != 0.0:
            level[i] = 0.0  # the bristle carries the friction
    _add_drives(z, n, volts, arrays.drives, stage, force, level, dz)
    _add_belts(z, n, arrays, stage, force, dz)
    for link in arrays.links:
        gap = z[link.first] - z[link.second]
        gap_rate = z[n + link.first] - z[n + link.second]
        deflection = gap - min(max(gap, -link.half_gap), link.half_gap)
        link_force = link.stiffness * deflection + link.viscous * gap_rate
        if link.half_gap > 0.0 and deflection * link_force <= 0.0:
            link_force = 0.0  # the teeth do not touch, and never pull
        force[link.first] -= link_force
        force[link.second] += link_force
    for i in range(n):
        dz[i] = dz[n + i] = 0.0
        if mode[i] != 0.0:
            dz[i] = z[n + i]
            dz[n + i] = (force[i] - mode[i] * level[i]) / coordinates[i].mass
    frame = 4 * n + 4
    dz[frame] = z[frame + 1]
    dz[frame + 1] = -stage.frame_w * (stage.frame_w * z[frame] + 2.0 * stage.frame_zeta * z[frame + 1])
    dz[frame + 1] -= stage.frame_ratio * dz[n]
    if stage.frame_ground != 0.0:
        x = coordinates[0]
        friction = force[0]  # while the bridge sticks
        if mode[0] != 0.0:
            friction = x.viscous * (1.0 + x.viscous_asymmetry * np.sign(z[n])) * z[n] + mode[0] * level[0]
        dz[frame + 1] -= stage.frame_ratio * stage.frame_ground * friction / x.mass


# Fields of `dry_level` that make dry friction; the others multiply it, or are 0 where these are.
DRY_FRICTION = (
    "coulomb",
    "stribeck_force",
    "friction_wave",
    "friction_slope",
    "friction_cross_position",
    "friction_cross_speed",
)


@njit(cache=True)
def dry_level(
    t: float, z: Array, i: int, n: int, coordinates: NDArray[Any], stage: Any
) -> float:  # pragma: no cover - compiled
    """Return the level of dry friction of coordinate i, N or Nm, not below zero."""
    c = coordinates[i]
    v = z[n + i]
    level = c.coulomb + c.friction_slope * z[i]
    if c.stribeck_force != 0.0:
        level += c.stribeck_force * math.exp(-(abs(v / c.stribeck_velocity) ** c.stribeck_exponent))
    if c.friction_wave != 0.0:
        level += c.friction_wave * math.sin(2.0 * math.pi * z[i] / c.friction_wavelength + c.friction_phase)
    if c.friction_cross_position != 0.0:
        level += c.friction_cross_position * z[i ^ 1]  # 0 with 1 and 2 with 3 are pairs
    if c.friction_cross_speed != 0.0:
        level += c.friction_cross_speed * abs(z[n + (i ^ 1)])
    if c.friction_age != 0.0:
        level *= 1.0 + c.friction_age * math.log1p(max(z[4 * n + 6 + i], 0.0) / c.friction_age_s)
    if c.friction_cold != 0.0:
        level *= 1.0 + c.friction_cold * math.exp(-t / stage.warm_up_s)
    if c.friction_stale != 0.0:
        level *= 1.0 + c.friction_stale * math.exp(-z[3 * n + 2 + i] / c.friction_stale_path)
    return max(level, 0.0)


@njit(cache=True)
def _force_of_coordinate(
    z: Array, i: int, n: int, c: Any, level: float, dz: Array
) -> float:  # pragma: no cover - compiled
    """Return the force that depends on coordinate i alone; write the rates of its bristle and cable to dz."""
    q, v = z[i], z[n + i]
    bristle, cable = 2 * n + 2 + i, 3 * n + 2 + i
    force = c.constant_force - c.viscous * (1.0 + c.viscous_asymmetry * np.sign(v)) * v
    force -= c.quadratic_drag * v * abs(v) + c.spring_stiffness * (q - c.spring_rest)
    force -= c.spring_square * (q - c.spring_rest) ** 2
    if c.wave_force != 0.0:
        harmonic = c.wave_second * math.sin(2.0 * c.wave_number * q)
        force += c.wave_force * (math.sin(c.wave_number * q + c.wave_phase) + harmonic)
    if c.catch_force != 0.0:
        u = (q - c.catch_position) / c.catch_width
        force -= c.catch_force * u * math.exp(0.5 - 0.5 * u * u)
    if c.brake_drag != 0.0:
        force -= c.brake_drag * v / (1.0 + (v / c.brake_speed) ** 2)
    age = 4 * n + 6 + i
    dz[age] = 1.0 - abs(v) * z[age] / c.friction_age_path if c.friction_age != 0.0 else 0.0
    dz[bristle] = dz[cable] = 0.0
    if c.bristle_stiffness != 0.0:
        dz[bristle] = v - c.bristle_stiffness * abs(v) * z[bristle] / level
        force -= c.bristle_stiffness * z[bristle] + c.bristle_damping * dz[bristle]
    if c.hysteresis_force != 0.0:
        w, travel = z[cable], c.hysteresis_travel
        dz[cable] = v - 0.5 * (abs(v) * abs(w) * w + v * w * w) / travel**2
        force -= c.hysteresis_force * w / travel
    if c.friction_stale != 0.0:
        dz[cable] = abs(v)  # the path traveled, in place of a cable's state
    if c.dahl_force != 0.0:
        dz[cable] = v - abs(v) * z[cable] / c.dahl_travel
        force -= c.dahl_force * z[cable] / c.dahl_travel
    return force


@njit(cache=True)
def _add_drives(
    z: Array, n: int, volts: Array, drives: NDArray[Any], stage: Any, force: Array, level: Array, dz: Array
) -> None:  # pragma: no cover - compiled
    """Add the motors' torques to the forces, and gear friction to the levels; write the drives' rates."""
    sag, bus_current = 5 * n + 8, 0.0
    for j in range(2):
        d = drives[j]
        voltage = d.drive_gain * min(max(volts[j], -d.voltage_limit_V), d.voltage_limit_V)
        voltage -= min(max(voltage, -d.dead_band_V), d.dead_band_V)
        duty = voltage / stage.supply_V
        lag, heat = 2 * n + j, 4 * n + 2 + j
        ohm = d.ohm * (1.0 + d.heating_ohm * z[heat])
        voltage = voltage * (1.0 - z[sag]) + d.voltage_offset_V
        closed = min(abs(voltage) / d.coasting_V, 1.0) if d.coasting_V > 0.0 else 1.0
        voltage -= closed * d.emf * z[n + d.coordinate]
        if d.dead_time_V != 0.0:
            # as long as the current is that small
            lost = voltage / (1.0 + ohm * d.dead_time_A / d.dead_time_V)
            voltage -= min(max(lost, -d.dead_time_V), d.dead_time_V)
        amps = voltage / ohm
        dz[lag] = 0.0
        if d.electrical_lag_s > 0.0:
            dz[lag] = (amps - z[lag]) / d.electrical_lag_s
            amps = z[lag]
        amps = min(max(amps, -d.current_limit_A), d.current_limit_A)
        torque = d.gain * amps * (1.0 - d.heating_loss * z[heat])
        if d.current_ripple != 0.0:
            torque *= 1.0 + d.current_ripple * math.sin(d.current_ripple_order * z[d.coordinate])
        torque /= 1.0 + (amps / d.torque_saturation_A) ** 2
        bus_current += duty * amps
        heated = d.heating_loss != 0.0 or d.heating_ohm != 0.0
        dz[heat] = (amps * amps - z[heat]) / d.heating_s if heated else 0.0
        force[d.coordinate] += torque
        level[d.coordinate] += d.load_friction * abs(torque)
    dz[sag] = 0.0
    if stage.supply_ohm != 0.0:
        dz[sag] = (stage.supply_ohm * bus_current / stage.supply_V - z[sag]) / stage.supply_s


@njit(cache=True)
def _add_belts(
    z: Array, n: int, arrays: ParameterArrays, stage: Any, force: Array, dz: Array
) -> None:  # pragma: no cover - compiled
    """Add the belts' forces; write the rates of slip and relaxing tensions.

    A belt of stiffness k(q) = EA / length(q) and extension s(q) stores the energy k G(s). It acts along its
    row with the tension k G'(s), and with -G dk/dq towards positions where it is more compliant.
    """
    coordinates = arrays.coordinates
    transmitted = np.zeros(2)  # by the teeth of the motors' pulleys
    for b in range(len(arrays.belts)):
        length = (
            arrays.belts[b, 1] + arrays.length_gradient[b, 0] * z[0] + arrays.length_gradient[b, 1] * z[1]
        )
        k = arrays.belts[b, 0] / length
        s = rate = 0.0
        for i in range(n):
            row = arrays.rows[b, i]
            if row != 0.0:
                c = coordinates[i]
                s += row * (c.radius * z[i] + c.eccentricity_m * math.sin(z[i] + c.eccentricity_phase))
                rate += row * z[n + i] * (c.radius + c.eccentricity_m * math.cos(z[i] + c.eccentricity_phase))
        for j in range(2):
            s += arrays.rows[b, 2 + j] * z[5 * n + 6 + j]
        s -= min(max(s, -stage.belt_play_m), stage.belt_play_m)
        s = max(s, -stage.belt_pretension_N / k)
        damping = stage.belt_damping_s * arrays.belts[b, 2]
        tension = k * (s * (1.0 + stage.belt_hardening * s * s) + damping * rate)
        relaxing = 5 * n + 9 + b
        dz[relaxing] = 0.0
        if stage.belt_relaxation != 0.0:
            dz[relaxing] = stage.belt_relaxation * k * rate - z[relaxing] / stage.belt_relaxation_s
            tension += z[relaxing]
        for j in range(2):
            transmitted[j] += tension * arrays.rows[b, 2 + j]
        for i in range(n):
            row = arrays.rows[b, i]
            if row != 0.0:
                c = coordinates[i]
                lever_arm = c.radius + c.eccentricity_m * math.cos(z[i] + c.eccentricity_phase)
                force[i] -= tension * row * lever_arm
        if stage.belt_energy_force == 0.0:
            continue
        energy_per_length = 0.5 * s * s * (1.0 + 0.5 * stage.belt_hardening * s * s) * k / length
        for i in range(2):
            force[i] += energy_per_length * arrays.length_gradient[b, i]
    for j in range(2):
        d = arrays.drives[j]
        dz[5 * n + 6 + j] = -d.belt_creep * transmitted[j]
        if d.mesh_force_N != 0.0:
            radius = coordinates[2 + j].radius
            wave = math.sin(2.0 * math.pi * radius * z[2 + j] / d.mesh_pitch_m + d.mesh_phase)
            force[2 + j] += (
                radius
                * d.mesh_force_N
                * (stage.mesh_unloaded + abs(transmitted[j]) / stage.mesh_tension_N)
                * wave
            )
