"""The variants of the H-frame rig of Sollmann et al. (2010), "the paper" below.

References:
    Sollmann, Jouaneh and Lavender (2010), Tables 1, 3 and 4; errata in docs/errata.md.
"""

from __future__ import annotations

import dataclasses
import math

from ..components import Belt, Coordinate, Drive, Sensor
from ..machine import Machine

RADIUS = 0.0194  # m, pitch radius of the pulleys, Table 1
EA = 5.5626e-6 * 2.50e9  # N, Young's modulus times cross section of the belt, Table 4
# m, belt sections l1..l9, Table 4
SECTIONS = (0.781, 0.781, 0.3334, 0.3334, 0.3334, 0.3334, 0.281, 0.281, 0.6159)
STIFFNESS = {"left": 1.3167e4, "right": 1.0791e4, "bottom": 8.0492e3}  # N/m, belt sections, Table 1
GEAR_RATIO = 5.9  # section II; missing from eq. 17
# Section II: encoders with 512 lines, read in quadrature, on the motor side of the gear.
ENCODER_QUANTUM = 2 * math.pi / (4 * 512 * GEAR_RATIO)  # rad
WORKSPACE = {"x": (-0.28, 0.28), "y": (-0.19, 0.19)}  # m, section II: 560 mm by 380 mm
LASER_NOISE = 20e-6  # m; the paper does not state it, this value is typical of the laser model


def _drives(gear_ratio: float) -> tuple[Drive, ...]:
    """Return the two motors of the rig."""
    return tuple(
        Drive(
            name=f"motor{number}",
            channel=f"v{number}_V",
            coordinate=f"phi{number}",
            Kt=23e-3,
            Ke=23e-3,
            resistance=0.71,
            gear_ratio=gear_ratio,
            rated_voltage=12.0,
        )
        for number in (1, 2)
    )


def _sensors() -> tuple[Sensor, ...]:
    """Return the two motor encoders and the two lasers of the rig."""
    return (
        Sensor("phi1_rad", {"phi1": 1.0}, noise=0.0, resolution=ENCODER_QUANTUM, kind="encoder"),
        Sensor("phi2_rad", {"phi2": 1.0}, noise=0.0, resolution=ENCODER_QUANTUM, kind="encoder"),
        Sensor("x_m", {"x": 1.0}, noise=LASER_NOISE),
        Sensor("y_m", {"y": 1.0}, noise=LASER_NOISE),
    )


def hframe() -> Machine:
    """Return the nonlinear 8th-order model of Sollmann et al. (2010).

    It has Coulomb and viscous friction (Table 3), position-dependent belt stiffness (eq. 43-44) and a gear
    ratio of 5.9; the coordinates are x, y (m), and phi1, phi2 (rad, pulley side of the gears).
    """
    l1, l2, l3, l4, l5, l6, l7, l8, l9 = SECTIONS  # m, with both carriages at the center
    return Machine(
        name="hframe",
        description="The paper's rig: 8th order, nonlinear friction, position-dependent belt stiffness.",
        coordinates=(
            Coordinate("x", mass=4.07, viscous=32.5114, coulomb=2.0, range=WORKSPACE["x"]),
            Coordinate("y", mass=1.0412, viscous=35.2944, coulomb=0.4, range=WORKSPACE["y"]),
            Coordinate("phi1", mass=1.12e-4, viscous=0.0036, coulomb=0.05, kind="rotary", radius=RADIUS),
            Coordinate("phi2", mass=1.12e-4, viscous=0.0036, coulomb=0.05, kind="rotary", radius=RADIUS),
        ),
        belts=(
            # Rest length; extension and change of length per belt travel (eq. 38-42 of Sollmann et al. 2010).
            Belt("left", EA, l1 + l5 + l7, {"x": 1, "y": 1, "phi1": 1}, {"x": 1, "y": 1}),
            Belt("right", EA, l2 + l6 + l8, {"x": 1, "y": -1, "phi2": -1}, {"x": 1, "y": -1}),
            Belt("bottom", EA, l3 + l4 + l9, {"x": -2, "phi1": -1, "phi2": 1}, {"x": -2}),
        ),
        drives=_drives(GEAR_RATIO),
        sensors=_sensors(),
    )


def with_constant_stiffness(machine: Machine, stiffness: dict[str, float]) -> Machine:
    """Return a copy of a machine whose belt stiffness does not depend on the position, as in a linear model.

    EA of the belts is unchanged; the rest lengths become EA / stiffness.

    Args:
        stiffness: Stiffness of every belt of the machine by belt name, N/m.

    Raises:
        KeyError: If a belt has no entry in `stiffness`.
    """
    belts = tuple(
        dataclasses.replace(b, rest_length=b.EA / stiffness[b.name], length={}) for b in machine.belts
    )
    return machine.replace(belts=belts)


def hframe_linear() -> Machine:
    """Return the linear 8th-order model of Sollmann et al. (2010), eq. 20-24.

    It has viscous friction only and constant belt stiffness (Table 1), and a gear ratio of 5.9.

    Returns:
        The preset `hframe-linear`, with the coordinates, belts, drives and sensors of `hframe`.
    """
    base = hframe()
    friction = {"x": (46.4449, 0.0), "y": (45.5517, 0.0), "phi1": (0.0042, 0.0), "phi2": (0.0042, 0.0)}
    coordinates = tuple(
        dataclasses.replace(c, viscous=friction[c.name][0], coulomb=friction[c.name][1])
        for c in base.coordinates
    )
    linear = base.replace(
        name="hframe-linear",
        description="The paper's linear 8th-order model (Table 1), viscous friction, constant stiffness.",
        coordinates=coordinates,
    )
    return with_constant_stiffness(linear, STIFFNESS)


def hframe_literal() -> Machine:
    """Return the preset `hframe` with eq. 17 of Sollmann et al. (2010) as printed: no gear ratio.

    It documents an error of the paper: with the equation as printed, the simulated motion contradicts Fig. 7,
    and with the gear ratio of 5.9 (preset `hframe`) it agrees.

    Returns:
        The preset `hframe-literal`: `hframe` with gear ratio 1.
    """
    return hframe().replace(
        name="hframe-literal",
        description="Equation 17 taken literally (gear ratio 1): does not match the figures of the paper.",
        drives=_drives(1.0),
    )


def hframe_order20() -> Machine:
    """Return the linear 20th-order model of Sollmann et al. (2010), eight pulleys (eq. 25-34, corrected).

    Table 1 adds the inertia and friction of the six idlers to the values of the cart (y) and of the motor
    pulleys (eq. 4-8); here every pulley is a coordinate with the same inertia and friction. Each section has
    the constant stiffness of x = -0.2227 m, y = -0.1163 m, for which Table 1 holds (eq. 39-43).
    docs/errata.md lists the corrections.

    Returns:
        The preset `hframe-order20`: 10 coordinates x, y (m) and phi1..phi8 (rad), 9 belt sections, 2 drives,
        4 sensors.
    """
    linear = hframe_linear()
    x, y = -0.2227, -0.1163  # m, the position for which Table 1 holds
    inertia, viscous = linear.coordinate("phi1").mass / 2, linear.coordinate("phi1").viscous / 2
    lump = 4 / RADIUS**2  # 1/m^2, part of the cart's mass per inertia of an idler
    bridge, cart = linear.coordinate("x"), linear.coordinate("y")
    pulleys = tuple(
        Coordinate(f"phi{i}", inertia, viscous, kind="rotary", radius=RADIUS) for i in range(1, 9)
    )
    cart = dataclasses.replace(cart, mass=cart.mass - lump * inertia, viscous=cart.viscous - lump * viscous)
    # Extension of each section per belt travel of each coordinate.
    rows: tuple[dict[str, float], ...] = (
        {"phi1": 1, "phi3": -1},
        {"phi2": 1, "phi4": -1},
        {"x": 1, "phi1": 1, "phi5": 1},
        {"x": 1, "phi2": -1, "phi6": -1},
        {"x": 1, "phi3": 1, "phi7": 1},
        {"x": 1, "phi4": -1, "phi8": -1},
        {"y": 1, "phi7": -1},
        {"y": 1, "phi8": -1},
        {"phi5": 1, "phi6": -1},
    )
    added_length = (0.0, 0.0, -x, -x, x, x, y, -y, 0.0)  # m, by section at this position
    belts = tuple(
        Belt(f"s{i + 1}", EA, section + added_length[i], row)
        for i, (section, row) in enumerate(zip(SECTIONS, rows, strict=True))
    )
    return Machine(
        name="hframe-order20",
        description="The paper's 20th-order linear model: every pulley a coordinate, nine belt sections.",
        coordinates=(bridge, cart, *pulleys),
        belts=belts,
        drives=linear.drives,
        sensors=linear.sensors,
    )
