"""The machines that come with the library: the paper's rig in its variants, and a single axis to copy.

Numbers: Sollmann, Jouaneh and Lavender, Tables 1, 3 and 4.  Errata that matter here are in docs/errata.md.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

from .machine import Belt, Coordinate, Drive, Machine, Sensor

RADIUS = 0.0194  # m, Table 1
AE = 5.5626e-6 * 2.50e9  # N, Table 4
SECTIONS = (0.781, 0.781, 0.3334, 0.3334, 0.3334, 0.3334, 0.281, 0.281, 0.6159)  # m, l1..l9, Table 4
STIFFNESS = {"left": 1.3167e4, "right": 1.0791e4, "bottom": 8.0492e3}  # N/m, Table 1
GEAR_RATIO = 5.9  # section II; missing from eq. 17
# Section II: 512 lines read in quadrature before the gear; laser noise is not given, 20 um is typical of the model.
ENCODER_QUANTUM = 2 * 3.141592653589793 / (4 * 512 * GEAR_RATIO)  # rad
WORKSPACE = {"x": (-0.28, 0.28), "y": (-0.19, 0.19)}  # m, section II: 560 mm by 380 mm
LASER_NOISE = 20e-6  # m


def _drives(gear_ratio: float, first: str = "phi1", second: str = "phi2") -> tuple[Drive, ...]:
    return tuple(
        Drive(f"motor{i}", f"v{i}_V", c, Kt=23e-3, Ke=23e-3, resistance=0.71, gear_ratio=gear_ratio, rated_voltage=12.0)
        for i, c in ((1, first), (2, second))
    )


def _sensors() -> tuple[Sensor, ...]:
    return (
        Sensor("phi1_rad", {"phi1": 1.0}, noise=0.0, resolution=ENCODER_QUANTUM, kind="encoder"),
        Sensor("phi2_rad", {"phi2": 1.0}, noise=0.0, resolution=ENCODER_QUANTUM, kind="encoder"),
        Sensor("x_m", {"x": 1.0}, noise=LASER_NOISE),
        Sensor("y_m", {"y": 1.0}, noise=LASER_NOISE),
    )


def hframe() -> Machine:
    """8th order, Coulomb and viscous friction (Table 3), belts that depend on position (eq. 43-44), gear 5.9."""
    l1, l2, l3, l4, l5, l6, l7, l8, l9 = SECTIONS
    return Machine(
        name="hframe",
        description="The paper's rig: 8th order, nonlinear friction, stiffness that follows the carriage.",
        coordinates=(
            Coordinate("x", mass=4.07, viscous=32.5114, coulomb=2.0, range=WORKSPACE["x"]),
            Coordinate("y", mass=1.0412, viscous=35.2944, coulomb=0.4, range=WORKSPACE["y"]),
            Coordinate("phi1", mass=1.12e-4, viscous=0.0036, coulomb=0.05, kind="rotary", radius=RADIUS),
            Coordinate("phi2", mass=1.12e-4, viscous=0.0036, coulomb=0.05, kind="rotary", radius=RADIUS),
        ),
        belts=(
            Belt("left", AE, l1 + l5 + l7, {"x": 1, "y": 1, "phi1": 1}, {"x": 1, "y": 1}),
            Belt("right", AE, l2 + l6 + l8, {"x": 1, "y": -1, "phi2": -1}, {"x": 1, "y": -1}),
            Belt("bottom", AE, l3 + l4 + l9, {"x": -2, "phi1": -1, "phi2": 1}, {"x": -2}),
        ),
        drives=_drives(GEAR_RATIO),
        sensors=_sensors(),
    )


def with_constant_stiffness(machine: Machine, stiffness: dict[str, float]) -> Machine:
    """The machine with belts of the given stiffness (N/m, by belt) wherever the carriage is."""
    belts = tuple(dataclasses.replace(b, rest_length=b.EA / stiffness[b.name], length={}) for b in machine.belts)
    return machine.replace(belts=belts)


def hframe_linear() -> Machine:
    """8th order, viscous friction only and constant stiffness (Table 1), gear 5.9: A, B, C, D of eq. 20-24."""
    base = hframe()
    friction = {"x": (46.4449, 0.0), "y": (45.5517, 0.0), "phi1": (0.0042, 0.0), "phi2": (0.0042, 0.0)}
    coordinates = tuple(
        dataclasses.replace(c, viscous=friction[c.name][0], coulomb=friction[c.name][1]) for c in base.coordinates
    )
    linear = base.replace(
        name="hframe-linear",
        description="The paper's linear 8th-order model (Table 1), viscous friction, constant stiffness.",
        coordinates=coordinates,
    )
    return with_constant_stiffness(linear, STIFFNESS)


def hframe_literal() -> Machine:
    """`hframe` with eq. 17 as printed, without the gear ratio: kept to show that it contradicts Fig. 7."""
    return hframe().replace(
        name="hframe-literal",
        description="Equation 17 taken literally (gear ratio 1): does not match the paper's own figures.",
        drives=_drives(1.0),
    )


def hframe_order20() -> Machine:
    """20th order, all eight pulleys (eq. 25-34 with errata), linear friction unlumped from Table 1 (eq. 4-8).

    Stiffness of each section at the position for which Table 1 holds (eq. 39-43), constant.
    """
    linear = hframe_linear()
    x, y = -0.2227, -0.1163
    inertia, viscous = linear.coordinate("phi1").mass / 2, linear.coordinate("phi1").viscous / 2
    lump = 4 / RADIUS**2
    bridge, cart = linear.coordinate("x"), linear.coordinate("y")
    pulleys = tuple(Coordinate(f"phi{i}", inertia, viscous, kind="rotary", radius=RADIUS) for i in range(1, 9))
    cart = dataclasses.replace(cart, mass=cart.mass - lump * inertia, viscous=cart.viscous - lump * viscous)
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
    grow = (0.0, 0.0, -x, -x, x, x, y, -y, 0.0)
    belts = tuple(
        Belt(f"s{i + 1}", AE, section + grow[i], row)
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


def axis() -> Machine:
    """A single motor-driven axis: one coordinate, one input, one output.  Copy it to describe a rig of your own."""
    return Machine(
        name="axis",
        description="One carriage on one motor-driven axis; copy and edit to describe a rig.",
        coordinates=(Coordinate("x", mass=1.0, viscous=5.0, coulomb=1.0),),
        belts=(),
        drives=(Drive("motor", "v_V", "x", Kt=0.05, Ke=0.05, resistance=1.0, gear_ratio=50.0, rated_voltage=12.0),),
        sensors=(Sensor("x_m", {"x": 1.0}, noise=20e-6),),
    )


BUILTIN_MACHINES: dict[str, Callable[[], Machine]] = {
    "hframe": hframe,
    "hframe-linear": hframe_linear,
    "hframe-literal": hframe_literal,
    "hframe-order20": hframe_order20,
    "axis": axis,
}
