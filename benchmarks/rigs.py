"""What an H-frame stage can be made of, for the reference simulator: parameters and effects."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Four = tuple[float, float, float, float]
Three = tuple[float, float, float]
Two = tuple[float, float]

COORDINATES = ("x", "y", "phi1", "phi2")


@dataclass(frozen=True)
class Rig:
    """Parameters of one H-frame stage. Defaults: the paper's nonlinear model, gear ratio 5.9.

    Tuples of four follow COORDINATES, in SI units: forces [N] on x, y, torques [Nm] on phi1, phi2.
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
    drive_gain: Two = (1.0, 1.0)  # V at the motor per V commanded

    # Undeclared effects, all off.
    stribeck_force: Four = (0.0, 0.0, 0.0, 0.0)  # dF in F(v) = Fc + dF exp(-(v/vs)^2)
    stribeck_velocity: Four = (0.05, 0.05, 2.5, 2.5)  # vs, m/s and rad/s
    constant_force: Four = (0.0, 0.0, 0.0, 0.0)
    viscous_asymmetry: Four = (0.0, 0.0, 0.0, 0.0)  # a: b (1 + a) forward, b (1 - a) backward
    quadratic_drag: Four = (0.0, 0.0, 0.0, 0.0)  # c in c v |v|
    spring_stiffness: Four = (0.0, 0.0, 0.0, 0.0)  # k in k (q - q0), a trailing cable
    spring_rest: Four = (0.0, 0.0, 0.0, 0.0)  # q0
    cogging_torque: Two = (0.0, 0.0)  # A in A sin(n phi + p), Nm at the belt pulley
    cogging_order: Two = (10.0, 10.0)  # n, periods per turn of the belt pulley
    cogging_phase: Two = (0.0, 0.0)  # p, rad
    voltage_offset_V: Two = (0.0, 0.0)
    input_delay_s: Two = (0.0, 0.0)
    extra_force: Callable[[float, Array, Array], Array] | None = None
    """(time_s, q (4,), v (4,)) -> (4,) force added to each coordinate; smooth where it can be."""


def tables(rig: Rig) -> tuple[Array, Array, Array]:
    """A rig for the compiled right-hand side: coordinates (10, 4), drives (6, 2), belts (3, 8).

    A belt's row: EA, length at the origin, its length row (x, y), its extension row (four), radius.
    """
    coordinates = np.array(
        [
            rig.mass,
            rig.viscous,
            rig.viscous_asymmetry,
            rig.coulomb,
            rig.stribeck_force,
            rig.stribeck_velocity,
            rig.constant_force,
            rig.quadratic_drag,
            rig.spring_stiffness,
            rig.spring_rest,
        ],
        dtype=float,
    )
    dry = np.any(coordinates[3:5] != 0.0, axis=0)
    if np.any(coordinates[3, dry] < 0.0) or np.any((coordinates[3] + coordinates[4])[dry] <= 0.0):
        raise ValueError("dry friction needs a Coulomb level >= 0 and a breakaway level > 0")
    n, kt, ke = rig.gear_ratio, np.array(rig.torque_constant), np.array(rig.emf_constant)
    per_volt = n * kt / np.array(rig.resistance_ohm)
    drives = np.vstack(
        [
            per_volt * np.array(rig.drive_gain),
            per_volt * np.array(rig.voltage_offset_V),
            per_volt * ke * n,
            np.array(rig.cogging_torque),
            np.array(rig.cogging_order),
            np.array(rig.cogging_phase),
        ]
    )
    r, follow = rig.pulley_radius_m, 1.0 if rig.length_follows else 0.0
    belts = np.empty((3, 8))
    belts[:, 0], belts[:, 1] = rig.belt_EA_N, rig.belt_length_m
    belts[:, 2:4] = follow * np.array([[1.0, 1.0], [1.0, -1.0], [-2.0, 0.0]])
    belts[:, 4:] = [[1.0, 1.0, r, 0.0], [1.0, -1.0, 0.0, -r], [-2.0, 0.0, -r, r]]
    return coordinates, drives, belts
