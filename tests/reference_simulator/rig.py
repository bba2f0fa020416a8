"""What an H-frame stage can be made of: parameters, and what no machine file declares."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Four = tuple[float, float, float, float]
Three = tuple[float, float, float]
Two = tuple[float, float]

COORDINATES = ("x", "y", "phi1", "phi2")
NONE: Four = (0.0, 0.0, 0.0, 0.0)
INF = float("inf")


@dataclass(frozen=True)
class Yaw:
    """A bridge that racks by theta: ends at x + w theta and x - w theta, tool at x + y theta."""

    inertia: float = 0.06  # kg m^2
    stiffness: float = 4000.0  # Nm/rad
    viscous: float = 0.6  # Nms
    half_width_m: float = 0.3


@dataclass(frozen=True)
class Payload:
    """A mass that hangs on the cart (along y) by a spring and a damper."""

    mass_kg: float = 0.25
    stiffness: float = 160.0  # N/m
    viscous: float = 0.6  # Ns/m


@dataclass(frozen=True)
class Frame:
    """A heavy frame on soft feet: it moves along x when the bridge accelerates, and the laser stands beside it.

    f'' = -w^2 f - 2 zeta w f' - ratio x''; the frame's motion does not act back on the much lighter stage.
    """

    hertz: float = 11.0
    damping: float = 0.05
    mass_ratio: float = 0.05


@dataclass(frozen=True)
class Rig:
    """One H-frame stage. Defaults: the paper's nonlinear model, gear ratio 5.9, and no undeclared effect.

    Tuples of four follow COORDINATES in SI units: forces [N] on x, y, torques [Nm] on phi1, phi2. Tuples of two are
    drives, tuples of three belts (left, right, bottom). An effect is off at amplitude zero (limits: infinite).
    """

    mass: Four = (4.07, 1.0412, 1.12e-4, 1.12e-4)  # kg, kg, kg m^2, kg m^2
    viscous: Four = (32.5114, 35.2944, 0.0036, 0.0036)  # N s/m, N s/m, Nm s, Nm s
    coulomb: Four = (2.0, 0.4, 0.05, 0.05)  # N, N, Nm, Nm
    pulley_radius_m: float = 0.0194
    belt_EA_N: Three = (13906.5, 13906.5, 13906.5)
    belt_length_m: Three = (1.3954, 1.3954, 1.2827)  # at x = y = 0
    length_follows: bool = True  # False: stiffness stays EA / belt_length_m
    gear_ratio: float = 5.9
    torque_constant: Two = (0.023, 0.023)  # Nm/A
    emf_constant: Two = (0.023, 0.023)  # V s/rad
    resistance_ohm: Two = (0.71, 0.71)

    # Dry friction: F(v) = Fc + dF exp(-(v/vs)^2) + A sin(2 pi q/L + p) + slope q, never below zero.
    stribeck_force: Four = NONE  # dF
    stribeck_velocity: Four = (0.05, 0.05, 2.5, 2.5)  # vs, m/s and rad/s
    friction_wave: Four = NONE  # A
    friction_wavelength: Four = (0.1, 0.1, 2.0, 2.0)  # L
    friction_phase: Four = NONE  # p, rad
    friction_slope: Four = NONE  # N/m, Nm/rad
    friction_cross_place: Four = NONE  # added per m (rad) of the other axis (motor): x with y, phi1 with phi2
    friction_cross_speed: Four = NONE  # added per m/s (rad/s) of the other axis (motor), whatever its direction
    friction_cold: Four = NONE  # share added when cold: F (1 + a exp(-t/tau)), t on the session's clock
    warm_up_s: float = 40.0  # tau
    friction_per_run: float = 0.0  # share of every Coulomb level added from one run to the next
    # Presliding (LuGre; Dahl with no damping and no Stribeck): z' = v - s0 |v| z / F(v), friction s0 z + s1 z'.
    bristle_stiffness: Four = NONE  # s0, N/m and Nm/rad; 0: friction is rigid
    bristle_damping: Four = NONE  # s1
    # A cable chain's hysteresis (Bouc-Wen, n = 2): z' = v - (|v| |z| z + v z^2) / (2 Z^2), force -F z/Z.
    hysteresis_force: Four = NONE  # F
    hysteresis_travel: Four = (0.005, 0.005, 0.25, 0.25)  # Z, m and rad

    constant_force: Four = NONE
    viscous_asymmetry: Four = NONE  # a: b (1 + a) forward, b (1 - a) backward
    quadratic_drag: Four = NONE  # c in -c v |v|
    spring_stiffness: Four = NONE  # k in -k (q - q0), a trailing cable
    spring_rest: Four = NONE  # q0
    wave_force: Four = NONE  # A in A sin(n q + p): cogging of a motor, magnets along a rail
    wave_number: Four = (40.0, 40.0, 10.0, 10.0)  # n, rad/m; periods per turn of the belt pulley
    wave_phase: Four = NONE  # p, rad
    catch_force: Four = NONE  # A, greatest pull of a magnet at q0: -A sqrt(e) u exp(-u^2/2), u = (q - q0)/w
    catch_place: Four = NONE  # q0
    catch_width: Four = (0.01, 0.01, 0.5, 0.5)  # w

    # Drives: V' = g V + V0, less a dead band (V - sign(V) Vd outside, else 0); i = (V' - e)/R, late by tau, limited.
    drive_gain: Two = (1.0, 1.0)  # g
    voltage_offset_V: Two = (0.0, 0.0)  # V0
    dead_band_V: Two = (0.0, 0.0)  # Vd
    current_limit_A: Two = (INF, INF)
    electrical_lag_s: Two = (0.0, 0.0)  # tau = L/R
    input_delay_s: Two = (0.0, 0.0)
    heating_loss: Two = (0.0, 0.0)  # share of torque lost for good at 1 A: torque (1 - a h), tau h' = i^2 - h
    heating_s: Two = (2.0, 2.0)  # tau
    current_ripple: Two = (0.0, 0.0)  # a in torque (1 + a sin(n phi)), Kt that follows the commutation
    current_ripple_order: Two = (12.0, 12.0)  # n
    backlash_rad: Two = (0.0, 0.0)  # half gap between the motor's gear, which the encoder sees, and the pulley
    backlash_stiffness: float = 300.0  # Nm/rad of the teeth
    backlash_motor_share: float = 0.6  # of the coordinate's inertia and friction that sits before the gap

    # Belts.
    eccentricity_m: Two = (0.0, 0.0)  # e: belt travel r phi + e sin(phi + p)
    eccentricity_phase: Two = (0.0, 0.0)
    belt_play_m: float = 0.0  # half width of a dead zone in every extension
    belt_damping_s: float = 0.0  # c: tension + c k ds/dt
    belt_pretension_N: float = INF  # tension cannot fall further than this
    belt_hardening: float = 0.0  # h: tension k s (1 + h s^2), 1/m^2

    # More bodies than the 8th-order model has.
    idlers: bool = False  # the 20th-order stage: eight pulleys, nine belt sections
    yaw: Yaw | None = None
    payload: Payload | None = None
    frame: Frame | None = None

    def at_run(self, index: int) -> Rig:
        """The rig as it is in the session's run of this number, from 0."""
        if not self.friction_per_run:
            return self
        level = 1.0 + self.friction_per_run * index
        a, b, c, d = (level * value for value in self.coulomb)
        return dataclasses.replace(self, coulomb=(a, b, c, d))
