"""The stage's equations of motion, compiled: d/dt of everything it remembers, in given modes of dry friction.

State, with n coordinates: q (n), v (n), motor currents (2), friction bristles (n), cable hysteresis (n), the motors'
heat (2), the frame's place and speed. ``mode`` (n,) is 0 where a coordinate sticks, else the direction it slides in.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tests.reference_simulator.rig import Array
from tests.reference_simulator.tables import Tables

EXTRA = 6  # states beside four for every coordinate


@njit(cache=True)
def derivative(
    t: float, z: Array, volts: Array, mode: Array, tables: Tables, dz: Array, force: Array, level: Array
) -> None:  # pragma: no cover - compiled
    """Fill dz (4 n + 6,), and per coordinate (n,) every force but rigid dry friction, and that friction's level."""
    coordinates = tables.coordinates
    stage = tables.stage[0]
    n = len(coordinates)
    for i in range(n):
        level[i] = dry_level(t, z, i, n, coordinates, stage)
        force[i] = _own_force(z, i, n, coordinates[i], level[i], dz)
        if coordinates[i].bristle_stiffness != 0.0:
            level[i] = 0.0
    _add_drives(z, n, volts, tables.drives, force, dz)
    _add_belts(z, n, tables, stage, force)
    for link in tables.links:
        gap = z[link.first] - z[link.second]
        rate = z[n + link.first] - z[n + link.second]
        depth = gap - min(max(gap, -link.half_gap), link.half_gap)
        pull = link.stiffness * depth + link.viscous * rate
        force[link.first] -= pull
        force[link.second] += pull
    for i in range(n):
        dz[i] = dz[n + i] = 0.0
        if mode[i] != 0.0:
            dz[i] = z[n + i]
            dz[n + i] = (force[i] - mode[i] * level[i]) / coordinates[i].mass
    at = 4 * n + 4
    dz[at] = z[at + 1]
    dz[at + 1] = -stage.frame_w * (stage.frame_w * z[at] + 2.0 * stage.frame_zeta * z[at + 1])
    dz[at + 1] -= stage.frame_ratio * dz[n]


@njit(cache=True)
def dry_level(
    t: float, z: Array, i: int, n: int, coordinates: NDArray[Any], stage: Any
) -> float:  # pragma: no cover - compiled
    """Level of dry friction of coordinate i, N or Nm, zero at least."""
    c = coordinates[i]
    v = z[n + i]
    level = c.coulomb + c.friction_slope * z[i]
    if c.stribeck_force != 0.0:
        level += c.stribeck_force * math.exp(-((v / c.stribeck_velocity) ** 2))
    if c.friction_wave != 0.0:
        level += c.friction_wave * math.sin(2.0 * math.pi * z[i] / c.friction_wavelength + c.friction_phase)
    if c.friction_cross_place != 0.0:
        level += c.friction_cross_place * z[i ^ 1]
    if c.friction_cross_speed != 0.0:
        level += c.friction_cross_speed * abs(z[n + (i ^ 1)])
    if c.friction_cold != 0.0:
        level *= 1.0 + c.friction_cold * math.exp(-t / stage.warm_up_s)
    return max(level, 0.0)


@njit(cache=True)
def _own_force(z: Array, i: int, n: int, c: Any, level: float, dz: Array) -> float:  # pragma: no cover - compiled
    """What acts on coordinate i alone; its bristle's and its cable's rates go into dz."""
    q, v = z[i], z[n + i]
    bristle, cable = 2 * n + 2 + i, 3 * n + 2 + i
    force = c.constant_force - c.viscous * (1.0 + c.viscous_asymmetry * np.sign(v)) * v
    force -= c.quadratic_drag * v * abs(v) + c.spring_stiffness * (q - c.spring_rest)
    if c.wave_force != 0.0:
        force += c.wave_force * math.sin(c.wave_number * q + c.wave_phase)
    if c.catch_force != 0.0:
        u = (q - c.catch_place) / c.catch_width
        force -= c.catch_force * u * math.exp(0.5 - 0.5 * u * u)
    dz[bristle] = dz[cable] = 0.0
    if c.bristle_stiffness != 0.0:
        dz[bristle] = v - c.bristle_stiffness * abs(v) * z[bristle] / level
        force -= c.bristle_stiffness * z[bristle] + c.bristle_damping * dz[bristle]
    if c.hysteresis_force != 0.0:
        w, travel = z[cable], c.hysteresis_travel
        dz[cable] = v - 0.5 * (abs(v) * abs(w) * w + v * w * w) / travel**2
        force -= c.hysteresis_force * w / travel
    return force


@njit(cache=True)
def _add_drives(
    z: Array, n: int, volts: Array, drives: NDArray[Any], force: Array, dz: Array
) -> None:  # pragma: no cover - compiled
    for j in range(2):
        d = drives[j]
        wanted = d.drive_gain * volts[j]
        wanted -= min(max(wanted, -d.dead_band_V), d.dead_band_V)
        amps = (wanted + d.voltage_offset_V - d.emf * z[n + d.coordinate]) / d.ohm
        lag, heat = 2 * n + j, 4 * n + 2 + j
        dz[lag] = 0.0
        if d.electrical_lag_s > 0.0:
            dz[lag] = (amps - z[lag]) / d.electrical_lag_s
            amps = z[lag]
        amps = min(max(amps, -d.current_limit_A), d.current_limit_A)
        torque = d.gain * amps * (1.0 - d.heating_loss * z[heat])
        if d.current_ripple != 0.0:
            torque *= 1.0 + d.current_ripple * math.sin(d.current_ripple_order * z[d.coordinate])
        dz[heat] = (amps * amps - z[heat]) / d.heating_s if d.heating_loss != 0.0 else 0.0
        force[d.coordinate] += torque


@njit(cache=True)
def _add_belts(z: Array, n: int, tables: Tables, stage: Any, force: Array) -> None:  # pragma: no cover - compiled
    """Belts of energy k G(s): tension k G'(s) along their rows, and -G dk/dq, the pull to where the belt is softer."""
    coordinates = tables.coordinates
    for b in range(len(tables.belts)):
        length = tables.belts[b, 1] + tables.growth[b, 0] * z[0] + tables.growth[b, 1] * z[1]
        k = tables.belts[b, 0] / length
        s = rate = 0.0
        for i in range(n):
            row = tables.rows[b, i]
            if row != 0.0:
                c = coordinates[i]
                s += row * (c.radius * z[i] + c.eccentricity_m * math.sin(z[i] + c.eccentricity_phase))
                rate += row * z[n + i] * (c.radius + c.eccentricity_m * math.cos(z[i] + c.eccentricity_phase))
        s -= min(max(s, -stage.belt_play_m), stage.belt_play_m)
        s = max(s, -stage.belt_pretension_N / k)
        tension = k * (s * (1.0 + stage.belt_hardening * s * s) + stage.belt_damping_s * rate)
        for i in range(n):
            row = tables.rows[b, i]
            if row != 0.0:
                c = coordinates[i]
                arm = c.radius + c.eccentricity_m * math.cos(z[i] + c.eccentricity_phase)
                force[i] -= tension * row * arm
        softer = 0.5 * s * s * (1.0 + 0.5 * stage.belt_hardening * s * s) * k / length
        for i in range(2):
            force[i] += softer * tables.growth[b, i]
