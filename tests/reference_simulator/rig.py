"""Parameters of an H-frame stage, including the effects that no machine file declares."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
PerCoordinate = tuple[float, float, float, float]
PerBelt = tuple[float, float, float]
PerDrive = tuple[float, float]

COORDINATES = ("x", "y", "phi1", "phi2")
OFF: PerCoordinate = (0.0, 0.0, 0.0, 0.0)
INF = float("inf")


@dataclass(frozen=True)
class Yaw:
    """Rotation theta of the bridge about the vertical axis.

    The bridge's ends are at x + w theta and x - w theta (w = half_width_m), the tool is at x + y theta.
    """

    inertia: float = 0.06  # kg m^2
    stiffness: float = 4000.0  # Nm/rad
    viscous: float = 0.6  # Nms
    half_width_m: float = 0.3


@dataclass(frozen=True)
class Payload:
    """Mass that is attached to the cart along y by a spring and a damper."""

    mass_kg: float = 0.25
    stiffness: float = 160.0  # N/m
    viscous: float = 0.6  # Ns/m


@dataclass(frozen=True)
class Frame:
    """Heavy frame on soft feet, which the acceleration of the bridge excites along x.

    f'' = -w^2 f - 2 zeta w f' - ratio x'', with w = 2 pi hertz. The laser is mounted beside the frame, so it
    measures x + f. The frame's motion does not act back on the much lighter stage. Of the friction on the
    bridge, the frame does not bear the fraction `ground_friction`: x'' above is x'' + ground_friction *
    friction / mass.
    """

    hertz: float = 11.0
    damping: float = 0.05
    mass_ratio: float = 0.05
    ground_friction: float = 0.0


@dataclass(frozen=True)
class Rig:
    """Parameters of one H-frame stage.

    The defaults are the paper's nonlinear model with gear ratio 5.9 and without any undeclared effect. Tuples
    of four are in the order of `COORDINATES`, SI units: forces on x and y in N, torques on phi1 and phi2 in
    Nm. Tuples of two are per drive, tuples of three per belt (left, right, bottom). An effect is off where
    its amplitude is zero or its limit infinite.
    """

    mass: PerCoordinate = (4.07, 1.0412, 1.12e-4, 1.12e-4)  # kg, kg, kg m^2, kg m^2
    viscous: PerCoordinate = (32.5114, 35.2944, 0.0036, 0.0036)  # N s/m, N s/m, Nm s, Nm s
    coulomb: PerCoordinate = (2.0, 0.4, 0.05, 0.05)  # N, N, Nm, Nm
    pulley_radius_m: float = 0.0194
    belt_EA_N: PerBelt = (13906.5, 13906.5, 13906.5)
    belt_length_m: PerBelt = (1.3954, 1.3954, 1.2827)  # at x = y = 0
    # The free length changes with x and y; False: stiffness is EA / belt_length_m everywhere.
    length_follows: bool = True
    gear_ratio: float = 5.9
    torque_constant: PerDrive = (0.023, 0.023)  # Nm/A
    emf_constant: PerDrive = (0.023, 0.023)  # V s/rad
    resistance_ohm: PerDrive = (0.71, 0.71)

    # Dry friction level: F(q, v) = Fc + dF exp(-|v/vs|^d) + A sin(2 pi q/L + p) + slope q, clipped at zero.
    stribeck_force: PerCoordinate = OFF  # dF
    stribeck_velocity: PerCoordinate = (0.05, 0.05, 2.5, 2.5)  # vs, m/s and rad/s
    stribeck_exponent: PerCoordinate = (2.0, 2.0, 2.0, 2.0)  # d
    friction_wave: PerCoordinate = OFF  # A
    friction_wavelength: PerCoordinate = (0.1, 0.1, 2.0, 2.0)  # L, m and rad
    friction_phase: PerCoordinate = OFF  # p, rad
    friction_slope: PerCoordinate = OFF  # N/m, Nm/rad
    # Friction per unit of the other coordinate of the pair (x with y, phi1 with phi2): of its position, of
    # its speed.
    friction_cross_position: PerCoordinate = OFF
    friction_cross_speed: PerCoordinate = OFF
    friction_cold: PerCoordinate = OFF  # a in F (1 + a exp(-t/tau)), t on the session's clock
    # a in F (1 + a exp(-s/d)), s: path traveled since the start of the run; not together with a cable chain.
    friction_stale: PerCoordinate = OFF
    friction_stale_path: PerCoordinate = (0.1, 0.1, 5.0, 5.0)  # d, m and rad
    warm_up_s: float = 40.0  # tau
    # a in F (1 + a ln(1 + age/tau)), age' = 1 - |v| age/D: contacts that rest grow stronger (Dieterich and
    # Ruina).
    friction_age: PerCoordinate = OFF
    friction_age_s: PerCoordinate = (0.02, 0.02, 0.02, 0.02)  # tau
    friction_age_path: PerCoordinate = (3e-4, 3e-4, 0.015, 0.015)  # D, m and rad
    friction_per_run: float = 0.0  # relative increase of every Coulomb level from one run to the next
    # Presliding (LuGre; Dahl without damping and Stribeck): z' = v - s0 |v| z / F(v), friction force s0 z +
    # s1 z'.
    bristle_stiffness: PerCoordinate = OFF  # s0, N/m and Nm/rad; 0: rigid friction
    bristle_damping: PerCoordinate = OFF  # s1
    # Hysteresis of a cable chain (Bouc-Wen, n = 2): z' = v - (|v| |z| z + v z^2) / (2 Z^2), force -F z/Z.
    hysteresis_force: PerCoordinate = OFF  # F
    hysteresis_travel: PerCoordinate = (0.005, 0.005, 0.25, 0.25)  # Z, m and rad
    # Hysteresis after Dahl, in place of the former: z' = v - |v| z / Z, force -F z/Z.
    dahl_force: PerCoordinate = OFF  # F
    dahl_travel: PerCoordinate = (0.005, 0.005, 0.25, 0.25)  # Z, m and rad

    constant_force: PerCoordinate = OFF
    viscous_asymmetry: PerCoordinate = OFF  # a: coefficient b (1 + a) forward, b (1 - a) backward
    quadratic_drag: PerCoordinate = OFF  # c in -c v |v|
    brake_drag: PerCoordinate = OFF  # c in -c v / (1 + (v/v0)^2), an eddy-current brake
    brake_speed: PerCoordinate = (0.15, 0.15, 7.5, 7.5)  # v0
    spring_stiffness: PerCoordinate = OFF  # k in -k (q - q0), a trailing cable
    spring_rest: PerCoordinate = OFF  # q0
    spring_square: PerCoordinate = OFF  # k2 in -k2 (q - q0)^2, a cable that lifts off
    wave_force: PerCoordinate = OFF  # A in A sin(n q + p): cogging of a motor, magnets along a rail
    # n, rad/m; periods per revolution of the belt pulley
    wave_number: PerCoordinate = (40.0, 40.0, 10.0, 10.0)
    wave_phase: PerCoordinate = OFF  # p, rad
    wave_second: PerCoordinate = OFF  # c: the force above plus c A sin(2 n q), a second harmonic
    # A, maximum pull of a magnet at q0: -A sqrt(e) u exp(-u^2/2), u = (q - q0)/w.
    catch_force: PerCoordinate = OFF
    catch_position: PerCoordinate = OFF  # q0
    catch_width: PerCoordinate = (0.01, 0.01, 0.5, 0.5)  # w

    # Drives: V' = D(g V) + V0 with the dead band D(u) = u - sign(u) Vd outside, 0 inside; the current (V' -
    # e)/R is lagged by tau and limited.
    drive_gain: PerDrive = (1.0, 1.0)  # g
    voltage_offset_V: PerDrive = (0.0, 0.0)  # V0
    dead_band_V: PerDrive = (0.0, 0.0)  # Vd
    current_limit_A: PerDrive = (INF, INF)
    voltage_limit_V: PerDrive = (INF, INF)
    # U of a bridge that opens between its pulses, which last |V'|/U; 0: it shorts.
    coasting_V: PerDrive = (0.0, 0.0)
    electrical_lag_s: PerDrive = (0.0, 0.0)  # tau = L/R
    input_delay_s: PerDrive = (0.0, 0.0)
    # a in torque (1 - a h), tau h' = i^2 - h: relative loss per A^2 in steady state
    heating_loss: PerDrive = (0.0, 0.0)
    heating_s: PerDrive = (2.0, 2.0)  # tau
    heating_ohm: PerDrive = (0.0, 0.0)  # a in the resistance R (1 + a h), h as above
    torque_saturation_A: PerDrive = (INF, INF)  # I in torque / (1 + (i/I)^2): the iron saturates
    dead_time_V: PerDrive = (0.0, 0.0)  # voltage that a bridge loses against the direction of the current
    dead_time_A: PerDrive = (0.2, 0.2)  # current below which it loses proportionally less
    # A supply of `supply_V` with inner resistance and, with the capacitor behind it, a time constant. The
    # bridges draw i V/supply_V from it, and every voltage falls with it.
    supply_V: float = 12.0
    supply_ohm: float = 0.0
    supply_s: float = 0.005
    # mu: the dry friction of the drive's coordinate grows by mu |torque|
    load_friction: PerDrive = (0.0, 0.0)
    current_ripple: PerDrive = (0.0, 0.0)  # a in torque (1 + a sin(n phi)): Kt varies with the commutation
    current_ripple_order: PerDrive = (12.0, 12.0)  # n
    # Half the gap between the motor's gear, which the encoder measures, and the pulley.
    backlash_rad: PerDrive = (0.0, 0.0)
    backlash_stiffness: float = 300.0  # Nm/rad of the teeth
    backlash_damping: float = 0.0  # damping ratio of the pulley's inertia against the teeth
    # Fraction of the coordinate's inertia and friction on the motor's side of the gap.
    backlash_motor_fraction: float = 0.6
    backlash_motor_viscous: float = 0.6  # the same of its viscous friction

    # Belts.
    eccentricity_m: PerDrive = (0.0, 0.0)  # e: belt travel r phi + e sin(phi + p)
    eccentricity_phase: PerDrive = (0.0, 0.0)  # p, rad
    belt_play_m: float = 0.0  # half width of a dead zone in every extension
    belt_damping_s: float = 0.0  # c: tension + c k ds/dt
    belt_damping_factor: PerBelt = (1.0, 1.0, 1.0)  # of c, per belt
    belt_energy_force: bool = True  # the force 1/2 s^2 dk/dq of a belt whose stiffness k depends on position
    belt_pretension_N: float = INF  # the tension cannot fall by more than this
    belt_hardening: float = 0.0  # h: tension k s (1 + h s^2), 1/m^2
    # a: beside every belt a k ds/dt = dT/dt + T/tau, a spring in series with a damper.
    belt_relaxation: float = 0.0
    belt_relaxation_s: float = 0.02  # tau
    belt_creep: PerDrive = (0.0, 0.0)  # m/s of slip on a motor's pulley per N that it transmits
    # Teeth of a motor's pulley: force A (1 + |transmitted force| / T) sin(2 pi r phi / pitch) on the belt.
    mesh_force_N: PerDrive = (0.0, 0.0)  # A
    mesh_pitch_m: PerDrive = (0.002, 0.002)
    mesh_phase: PerDrive = (0.0, 0.0)
    mesh_unloaded: float = 1.0  # u in A (u + |load| / T) sin(2 pi r phi / pitch + phase)
    mesh_tension_N: float = 20.0  # T

    # Bodies beyond the 8th-order model.
    idlers: bool = False  # the 20th-order stage: eight pulleys, nine belt sections
    yaw: Yaw | None = None
    payload: Payload | None = None
    frame: Frame | None = None

    def at_run(self, index: int) -> Rig:
        """Return the rig as it is in a run of the session.

        Args:
            index: Number of the run, from 0.

        Returns:
            The rig with its Coulomb levels raised by `friction_per_run` times the index.
        """
        if not self.friction_per_run:
            return self
        level = 1.0 + self.friction_per_run * index
        a, b, c, d = (level * value for value in self.coulomb)
        return dataclasses.replace(self, coulomb=(a, b, c, d))
