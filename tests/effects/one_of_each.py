"""Every effect of the library at one site, with the same effect of the independent simulator.

Each effect has a single site, so that all its tests use one compiled kernel.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from hframe_gym.effects import EFFECTS
from hframe_gym.machine import AppliedEffect
from tests.reference_simulator import Frame, Payload, Rig, Yaw, simulate
from tests.reference_simulator.sensors import Sensors

START = (0.08, -0.05)  # position of the tool at the start of a run, m
REST_ROWS = 80  # samples at rest; the mean of the later half determines the zero of a laser to 3 um


@dataclass(frozen=True)
class Case:
    """An effect with parameters, and the equivalent fields of the independent simulator.

    Attributes:
        name: Name of the effect.
        site: Its site.
        parameters: Its parameters.
        rig: Fields of the simulator's rig.
        sensors: Fields of the simulator's sensors.
        drift: Rate a at which the actual steps grow beyond those of the log's clock, 1/s.
    """

    name: str
    site: str
    parameters: dict[str, float]
    rig: dict[str, Any] = field(default_factory=dict)
    sensors: dict[str, Any] = field(default_factory=dict)
    drift: float = 0.0

    @property
    def effect(self) -> AppliedEffect:
        """The effect at its site."""
        return EFFECTS[self.name].at(self.site, **self.parameters)

    def run(self, time_s: np.ndarray, inputs: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return positions, velocities, ideal readings (phi1, phi2, x, y), each (n, 4), of a rig."""
        logged_s = time_s - time_s[0]
        actual_s = time_s[0] + np.expm1(self.drift * logged_s) / self.drift if self.drift else time_s
        positions, velocities = simulate(dataclasses.replace(Rig(), **self.rig), actual_s, inputs, START)
        return positions, velocities, Sensors(**self.sensors).ideal(actual_s, positions, velocities)


def history(seed: int, seconds: float = 0.45, hold_s: float = 0.01) -> tuple[np.ndarray, np.ndarray]:
    """Return times (n,) at 1 kHz and random voltages (n, 2) up to 8 V, held `hold_s`, after 80 ms of rest."""
    time_s = np.arange(round(seconds * 1000) + 1) * 1e-3
    rows = round(hold_s * 1000)
    levels = np.random.default_rng(seed).uniform(-8.0, 8.0, (len(time_s) // rows + 1, 2))
    inputs = np.repeat(levels, rows, axis=0)[: len(time_s)]
    inputs[:REST_ROWS] = 0.0
    return time_s, inputs


def _x(value: float) -> tuple[float, ...]:
    return (value, 0.0, 0.0, 0.0)


def _turned(value: float) -> tuple[float, ...]:
    return (0.0, 0.0, value, 0.0)


def _with_payload(hertz: float, zeta: float, ratio: float) -> dict[str, Any]:
    """Return the fields of a rig whose declared mass of the cart includes a swinging payload."""
    x, y, *motors = Rig().mass
    carriage, w = y / (1.0 + ratio), 2.0 * np.pi * hertz
    mass = ratio * carriage
    return {"mass": (x, carriage, *motors), "payload": Payload(mass, mass * w * w, 2.0 * zeta * w * mass)}


_CASES = (
    Case(
        "stribeck_friction",
        "x",
        {"dF": 3.0, "vs": 0.04},
        {"stribeck_force": _x(3.0), "stribeck_velocity": (0.04,) * 4},
    ),
    Case(
        "tustin_friction",
        "x",
        {"dF": 2.5, "vs": 0.05},
        {"stribeck_force": _x(2.5), "stribeck_velocity": (0.05,) * 4, "stribeck_exponent": (1.0,) * 4},
    ),
    Case(
        "dwell_friction",
        "x",
        {"dF": 0.8 * Rig().coulomb[0], "tau": 0.02, "D": 1.5e-3},
        {"friction_age": _x(0.8), "friction_age_s": (0.02,) * 4, "friction_age_path": (1.5e-3,) * 4},
    ),
    Case("constant_force", "phi1", {"size": 0.03}, {"constant_force": _turned(0.03)}),
    Case("asymmetric_viscous", "phi1", {"a": -0.4}, {"viscous_asymmetry": _turned(-0.4)}),
    Case("quadratic_drag", "x", {"c": 40.0}, {"quadratic_drag": _x(40.0)}),
    Case("eddy_brake", "x", {"c": 25.0, "v0": 0.1}, {"brake_drag": _x(25.0), "brake_speed": _x(0.1)}),
    Case(
        "cable_spring", "x", {"k": 60.0, "q0": 0.05}, {"spring_stiffness": _x(60.0), "spring_rest": _x(0.05)}
    ),
    Case(
        "position_friction",
        "x",
        {"A": 1.2, "L": 0.03, "p": 1.0},
        {"friction_wave": _x(1.2), "friction_wavelength": (0.03,) * 4, "friction_phase": _x(1.0)},
    ),
    Case("friction_slope", "x", {"s": 8.0}, {"friction_slope": _x(8.0)}),
    Case(
        "presliding",
        "x",
        {"s0": 1e4, "s1": 60.0},
        {"bristle_stiffness": _x(1e4), "bristle_damping": _x(60.0)},
    ),
    Case(
        "friction_warm_up", "machine", {"a": 0.9, "tau": 0.5}, {"friction_cold": (0.9,) * 4, "warm_up_s": 0.5}
    ),
    Case(
        "bouc_wen_hysteresis",
        "x",
        {"F": 4.0, "L": 8e-3},
        {"hysteresis_force": _x(4.0), "hysteresis_travel": _x(8e-3)},
    ),
    Case("dahl_hysteresis", "x", {"F": 2.2, "L": 6e-3}, {"dahl_force": _x(2.2), "dahl_travel": _x(6e-3)}),
    Case(
        "cogging",
        "motor1",
        {"A": 0.03, "n": 23.6, "p": 0.5},
        {"wave_force": _turned(0.03), "wave_number": (23.6,) * 4, "wave_phase": _turned(0.5)},
    ),
    Case(
        "belt_mesh",
        "motor2",
        {"A": 1.5 / 20.0, "n": 2.0 * math.pi * 0.0194 / 1e-2, "p": 0.5},
        {
            "mesh_force_N": (0.0, 1.5),
            "mesh_pitch_m": (1e-2, 1e-2),
            "mesh_phase": (0.0, 0.5),
            "mesh_unloaded": 0.0,
        },
    ),
    Case(
        "second_cogging",
        "motor1",
        {"A": 0.02, "n": 47.2, "p": 1.5},
        {"wave_force": _turned(0.02), "wave_number": (47.2,) * 4, "wave_phase": _turned(1.5)},
    ),
    Case(
        "unbalance",
        "phi1",
        {"A": 0.03, "p": 0.5},
        {"wave_force": _turned(0.03), "wave_number": (1.0,) * 4, "wave_phase": _turned(0.5)},
    ),
    Case("load_friction", "motor1", {"mu": 0.12}, {"load_friction": (0.12, 0.0)}),
    Case(
        "eccentric_pulley",
        "motor2",
        {"e": 0.2e-3, "p": 0.7},
        {"eccentricity_m": (0.0, 0.2e-3), "eccentricity_phase": (0.0, 0.7)},
    ),
    Case("voltage_offset", "motor1", {"V0": 0.15}, {"voltage_offset_V": (0.15, 0.0)}),
    Case("gain_mismatch", "motor2", {"g": -0.1}, {"drive_gain": (1.0, 0.9)}),
    Case("dead_band", "motor1", {"Vd": 0.4, "drop": 1.0}, {"dead_band_V": (0.4, 0.0)}),
    Case("voltage_limit", "motor1", {"U": 4.0}, {"voltage_limit_V": (4.0, np.inf)}),
    Case("coasting_bridge", "motor1", {"U": 12.0}, {"coasting_V": (12.0, 0.0)}),
    Case(
        "inverter_dead_time",
        "motor1",
        {"Vd": 0.4, "i0": 0.1},
        {"dead_time_V": (0.4, 0.0), "dead_time_A": (0.1, 0.2)},
    ),
    Case("current_limit", "motor1", {"I": 4.5}, {"current_limit_A": (4.5, np.inf)}),
    Case("torque_saturation", "motor1", {"s": 0.01}, {"torque_saturation_A": (10.0, np.inf)}),
    Case(
        "commutation_ripple",
        "motor1",
        {"a": 0.12, "n": 23.6, "p": 0.0},
        {"current_ripple": (0.12, 0.0), "current_ripple_order": (23.6, 12.0)},
    ),
    Case(
        "winding_heat",
        "motor1",
        {"a": 0.01, "tau": 0.1},
        {"heating_ohm": (0.01, 0.0), "heating_s": (0.1, 2.0)},
    ),
    Case(
        "supply_sag",
        "drives",
        {"g": 0.2 / 12.0**2, "tau": 6e-3},
        {"supply_V": 12.0, "supply_ohm": 0.2, "supply_s": 6e-3},
    ),
    Case("clock_drift", "machine", {"a": 0.03}, drift=0.03),
    Case("electrical_lag", "motor2", {"tau": 1.5e-3}, {"electrical_lag_s": (0.0, 1.5e-3)}),
    Case("input_delay", "drives", {"d": 2.3e-3}, {"input_delay_s": (2.3e-3, 2.3e-3)}),
    Case("belt_play", "belts", {"d": 0.15e-3}, {"belt_play_m": 0.15e-3}),
    # The far side has 0.3 of the motor's inertia and dry friction, and 0.2 of its viscous friction.
    Case(
        "gear_backlash",
        "motor1",
        {
            "d": 2e-3,
            "J": 0.3 * Rig().mass[2],
            "F": 0.3 * Rig().coulomb[2],
            "B": 0.2 * Rig().viscous[2],
            "K": 100.0,
            "Z": 0.4,
        },
        {
            "backlash_rad": (2e-3, 0.0),
            "backlash_motor_fraction": 0.7,
            "backlash_motor_viscous": 0.8,
            "backlash_stiffness": 100.0,
            "backlash_damping": 0.4,
        },
    ),
    Case("belt_damping", "belts", {"c": 1e-3}, {"belt_damping_s": 1e-3}),
    Case("belt_slack", "belts", {"T0": 15.0}, {"belt_pretension_N": 15.0}),
    Case("belt_hardening", "belts", {"h": 5e4}, {"belt_hardening": 5e4}),
    Case(
        "bridge_yaw",
        "machine",
        {"J": 0.06, "k": 4000.0, "c": 0.6, "w": 0.3},
        {"yaw": Yaw(inertia=0.06, stiffness=4000.0, viscous=0.6, half_width_m=0.3)},
    ),
    Case(
        "frame_resonance",
        "x",
        {"f0": 19.0, "zeta": 0.05, "r": 0.05, "s": 0.8},
        {"frame": Frame(hertz=19.0, damping=0.05, mass_ratio=0.05, ground_friction=0.8)},
    ),
    Case("payload_swing", "y", {"f0": 6.0, "zeta": 0.05, "r": 0.25}, _with_payload(6.0, 0.05, 0.25)),
    # The idlers of the simulator have half of the inertia and friction of each motor.
    Case(
        "idler_inertia",
        "machine",
        {"J_left": 0.56e-4, "J_right": 0.56e-4, "B_left": 0.0018, "B_right": 0.0018},
        {"idlers": True},
    ),
    Case("sensor_skew", "y_m", {"a": 5e-3}, sensors={"skew": (0.0, 5e-3)}),
    Case("sensor_scale", "x_m", {"g": 0.005}, sensors={"scale": (1.0, 1.0, 1.005, 1.0)}),
    Case(
        "eccentric_encoder",
        "phi1_rad",
        {"A": 0.01, "p": 0.7},
        sensors={"wave": (0.01, 0.0, 0.0, 0.0), "wave_phase": (0.7, 0.0, 0.0, 0.0)},
    ),
    Case(
        "interpolation_error",
        "y_m",
        {"A": 1e-4, "n": 2.0 * np.pi / 7e-3, "p": 0.7},
        sensors={
            "wave": (0.0, 0.0, 0.0, 1e-4),
            "wave_period": (2.0 * np.pi, 2.0 * np.pi, 1.0, 7e-3),
            "wave_phase": (0.0, 0.0, 0.0, 0.7),
        },
    ),
    Case("sensor_range", "x_m", {"low": 0.077, "high": 0.083}, sensors={"range_x_m": (0.077, 0.083)}),
    Case("sensor_delay", "x_m", {"d": 2.3e-3}, sensors={"delay_s": (0.0, 0.0, 2.3e-3, 0.0)}),
)
CASES = {case.name: case for case in _CASES}
# Effects that the H-frame cannot have, by name: a preset that can, and the case; each has tests of its own.
ELSEWHERE = {"servo_dead_band": ("servo", Case("servo_dead_band", "servo", {"s": 1.0, "d": 0.02}))}
