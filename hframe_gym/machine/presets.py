"""Preset machines: the variants of the H-frame rig of Sollmann et al. (2010), "the paper" below, axes and motors.

The values of the others are typical ones, not those of a particular machine. `hframe_gym.effects` adds the pendulum,
whose weight is an effect of the library.

References:
    Sollmann, Jouaneh and Lavender (2010), Tables 1, 3 and 4; errata in docs/errata.md.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable

from .axis_unit import ARM
from .components import Belt, Coordinate, Drive, Sensor
from .machine import Machine

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

    It has Coulomb and viscous friction (Table 3), position-dependent belt stiffness (eq. 43-44) and a gear ratio of
    5.9; the coordinates are x, y (m), and phi1, phi2 (rad, pulley side of the gears).
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
    """Return the preset `hframe` with eq. 17 of Sollmann et al. (2010) as printed, that is, without the gear ratio.

    It documents an error of the paper: with the equation as printed, the simulated motion contradicts Fig. 7, and with
    the gear ratio of 5.9 (preset `hframe`) it agrees.

    Returns:
        The preset `hframe-literal`: `hframe` with gear ratio 1.
    """
    return hframe().replace(
        name="hframe-literal",
        description="Equation 17 taken literally (gear ratio 1): does not match the figures of the paper.",
        drives=_drives(1.0),
    )


def hframe_order20() -> Machine:
    """Return the linear 20th-order model of Sollmann et al. (2010) with all eight pulleys (eq. 25-34, corrected).

    Table 1 adds the inertia and friction of the six idlers to the values of the cart (y) and of the motor pulleys (eq.
    4-8); here every pulley is a coordinate with the same inertia and friction. Each section has the constant stiffness
    of x = -0.2227 m, y = -0.1163 m, for which Table 1 holds (eq. 39-43). docs/errata.md lists the corrections.

    Returns:
        The preset `hframe-order20`: 10 coordinates x, y (m) and phi1..phi8 (rad), 9 belt sections, 2 drives, 4 sensors.
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


def axis() -> Machine:
    """Return a single carriage that a motor moves directly, as a template for other machines.

    Returns:
        The preset `axis`: coordinate x (1 kg, viscous friction 5 Ns/m, Coulomb friction 1 N, range -0.25 to 0.25 m), no
        belts, one drive of 12 V, sensor x_m.
    """
    return Machine(
        name="axis",
        description="One carriage on one motor-driven axis; copy it and edit it to describe a machine.",
        coordinates=(Coordinate("x", mass=1.0, viscous=5.0, coulomb=1.0, range=(-0.25, 0.25)),),
        belts=(),
        drives=(
            Drive("motor", "v_V", "x", Kt=0.05, Ke=0.05, resistance=1.0, gear_ratio=50.0, rated_voltage=12.0),
        ),
        sensors=(Sensor("x_m", {"x": 1.0}, noise=20e-6),),
    )


def xy_table() -> Machine:
    """Return a stage with a motor for each direction, as CNC routers, gantries and plotters have it.

    The bridge moves along x and carries the carriage, which moves along y; neither motor moves the other axis. With the
    gear ratio of `axis`, the belts of the motors are taken as stiff.

    Returns:
        The preset `xy-table`: coordinates x, y (m), no belts, two drives of 24 V, sensors x_m and y_m.
    """
    return Machine(
        name="xy-table",
        description="An XY table: one motor for each direction, as in a CNC router or a gantry.",
        coordinates=(
            Coordinate("x", mass=4.0, viscous=10.0, coulomb=3.0, range=(-0.25, 0.25)),
            Coordinate("y", mass=1.5, viscous=5.0, coulomb=1.5, range=(-0.2, 0.2)),
        ),
        belts=(),
        drives=tuple(
            Drive(
                f"motor_{axis}",
                f"v_{axis}_V",
                axis,
                Kt=0.05,
                Ke=0.05,
                resistance=1.0,
                gear_ratio=50.0,
                rated_voltage=24.0,
            )
            for axis in ("x", "y")
        ),
        sensors=tuple(Sensor(f"{axis}_m", {axis: 1.0}, noise=20e-6) for axis in ("x", "y")),
    )


# A belt axis with the motor of the CoreXY stage below; lengths at the center of its travel of 0.5 m.
BELT_AXIS_MOTOR_SIDE = 0.36  # m, from the pulley of the motor to the carriage
BELT_AXIS_IDLER_SIDE = 1.08  # m, from the pulley of the motor around the idler, 0.72 m away, to the carriage


def belt_axis() -> Machine:
    """Return a carriage on a belt between the pulley of a motor and an idler, as a template for other machines.

    Returns:
        The preset `belt-axis`: coordinates x (m) and phi (rad), two sections of one belt, whose EA is tied
        (`Machine.ties`), one drive of 24 V, an encoder on the motor shaft and a linear sensor.
    """
    pulley = Coordinate("phi", mass=6e-6, viscous=2e-5, coulomb=0.01, kind="rotary", radius=COREXY_RADIUS)
    sections = (("motor_side", BELT_AXIS_MOTOR_SIDE, 1.0), ("idler_side", BELT_AXIS_IDLER_SIDE, -1.0))
    return Machine(
        name="belt-axis",
        description="One carriage on a belt, driven by one motor; copy it and edit it to describe a machine.",
        coordinates=(Coordinate("x", mass=1.0, viscous=4.0, coulomb=1.5, range=(-0.25, 0.25)), pulley),
        belts=tuple(
            Belt(name, COREXY_EA, length, {"x": sign, "phi": -sign}, length={"x": sign})
            for name, length, sign in sections
        ),
        drives=(
            Drive(
                "motor", "v_V", "phi", Kt=0.04, Ke=0.04, resistance=2.0, gear_ratio=1.0, rated_voltage=24.0
            ),
        ),
        sensors=(
            Sensor("phi_rad", {"phi": 1.0}, resolution=COREXY_ENCODER_QUANTUM, kind="encoder"),
            Sensor("x_m", {"x": 1.0}, noise=20e-6),
        ),
        ties={"idler_side.EA": ("motor_side.EA", 1.0)},
    )


# A CoreXY stage of the size of a desktop 3D printer. The values are typical ones, not those of a particular machine.
COREXY_RADIUS = 20 * 2e-3 / (2 * math.pi)  # m, pitch radius of a pulley of 20 teeth with a pitch of 2 mm
# N. A belt of 6 mm with glass cords stretches by about 1 % under a load of 10 kg (acceptance test of FarmBot's belt).
COREXY_EA = 1.0e4
COREXY_TRAVEL = 0.15  # m, to either side of the center, x and y
# m, from the motor to the carriage at the center: 0.23 m along the frame and 0.20 m along the bridge.
COREXY_SHORT = 0.43
COREXY_ENCODER_QUANTUM = 2 * math.pi / (4 * 1000)  # rad; 1000 lines, read in quadrature, on the motor shafts
COREXY_LONG = 1.35  # m, the other way around the frame, which is 0.46 m wide and deep


def corexy() -> Machine:
    """Return a CoreXY stage with two belts and two 24 V motors without gears.

    The carriage moves along x on the bridge, which moves along y. Both motors are at the front. Each belt has two
    sections from its motor to the carriage: a short one along its own side of the frame, and a long one around the rear
    and along the other side. With p = radius * phi the kinematics are x = (p1 + p2) / 2 and y = (p1 - p2) / 2.

    Returns:
        The preset `corexy`: 4 coordinates x, y (m), phi1, phi2 (rad), 4 belt sections, 2 drives, 4 sensors. Both
        sections of a belt have the same EA (`Machine.ties`).
    """
    motion = {"belt1": {"x": 1.0, "y": 1.0}, "belt2": {"x": 1.0, "y": -1.0}}  # belt travel at the motor
    belts = []
    for number, (name, row) in enumerate(motion.items(), start=1):
        # The short section of belt 1 becomes longer where that of belt 2 becomes shorter: the motors are at its ends.
        sign = 1.0 if number == 1 else -1.0
        sections = (("short", COREXY_SHORT, sign), ("long", COREXY_LONG, -sign))
        for section, length, direction in sections:
            change = {axis: direction * factor for axis, factor in row.items()}
            belts.append(
                Belt(
                    f"{name}_{section}",
                    COREXY_EA,
                    length,
                    {**change, f"phi{number}": -direction},
                    length=change,
                )
            )
    # Stall torque 24 V * 0.04 Nm/A / 2 ohm = 0.48 Nm, the holding torque of a common 42 mm stepper; the inertia is that
    # of such a rotor with its pulley.
    drives = tuple(
        Drive(
            f"motor{i}",
            f"v{i}_V",
            f"phi{i}",
            Kt=0.04,
            Ke=0.04,
            resistance=2.0,
            gear_ratio=1.0,
            rated_voltage=24.0,
        )
        for i in (1, 2)
    )
    pulleys = (
        Coordinate(f"phi{i}", mass=6e-6, viscous=2e-5, coulomb=0.01, kind="rotary", radius=COREXY_RADIUS)
        for i in (1, 2)
    )
    travel = (-COREXY_TRAVEL, COREXY_TRAVEL)
    return Machine(
        name="corexy",
        description="A CoreXY stage: two belts, two 24 V motors, carriage along x on a bridge along y.",
        coordinates=(
            # Friction of recirculating ball rails: one along x, two along y.
            Coordinate("x", mass=0.35, viscous=4.0, coulomb=1.0, range=travel),
            Coordinate("y", mass=1.1, viscous=8.0, coulomb=2.0, range=travel),
            *pulleys,
        ),
        belts=tuple(belts),
        drives=drives,
        sensors=(
            Sensor("phi1_rad", {"phi1": 1.0}, resolution=COREXY_ENCODER_QUANTUM, kind="encoder"),
            Sensor("phi2_rad", {"phi2": 1.0}, resolution=COREXY_ENCODER_QUANTUM, kind="encoder"),
            Sensor("x_m", {"x": 1.0}, noise=20e-6),
            Sensor("y_m", {"y": 1.0}, noise=20e-6),
        ),
        ties={f"{name}_long.EA": (f"{name}_short.EA", 1.0) for name in motion},
    )


def printer() -> Machine:
    """Return the CoreXY stage of a 3D printer: its stepper motors follow the positions that a planner commands.

    The torque of a stepper motor with 50 pole pairs grows with the angle behind the command by 50 times its holding
    torque per rad, here 0.48 Nm, the stall torque of the preset `corexy`. Its natural damping is low: a tenth of the
    critical one for the rotor with the carriage. The kind "position" holds the torque at its limit; a drive of the kind
    "stepper" loses steps there, and needs commands at the rate of the steps.

    Returns:
        The preset `printer`: `corexy` with drives of the kind "position" and sensors of x and y only.
    """
    machine = corexy()
    holding, pole_pairs, damping = 0.48, 50, 4.4e-3  # Nm, -, Nms
    reach = 2.0 * COREXY_TRAVEL / COREXY_RADIUS  # rad, in a corner of the workspace
    drives = tuple(
        Drive(
            f"motor{i}",
            f"command{i}_rad",
            f"phi{i}",
            Kt=1.0,
            Ke=0.0,
            resistance=1.0,
            gear_ratio=1.0,
            rated_voltage=math.ceil(reach),
            kind="position",
            law_parameters={
                "position_gain": pole_pairs * holding / damping,
                "speed_gain": damping,
                "torque_limit": holding,
            },
        )
        for i in (1, 2)
    )
    return machine.replace(
        name="printer",
        description="A CoreXY 3D printer: two belts, two stepper motors that follow commanded positions.",
        drives=drives,
        sensors=tuple(s for s in machine.sensors if s.kind != "encoder"),
    )


def motor() -> Machine:
    """Return a DC motor with an encoder, without a load.

    Returns:
        The preset `motor`: coordinate shaft (rad), one drive of 12 V, sensor shaft_rad.
    """
    return Machine(
        name="motor",
        description="A DC motor with an encoder of 500 lines, driven by a voltage.",
        coordinates=(Coordinate("shaft", mass=2e-5, viscous=1e-5, coulomb=3e-3, kind="rotary", radius=ARM),),
        belts=(),
        drives=(
            Drive(
                "motor", "v_V", "shaft", Kt=0.05, Ke=0.05, resistance=1.0, gear_ratio=1.0, rated_voltage=12.0
            ),
        ),
        sensors=(Sensor("shaft_rad", {"shaft": 1.0}, resolution=2 * math.pi / (4 * 500), kind="encoder"),),
    )


def wheel() -> Machine:
    """Return a wheel of a small mobile robot behind a gear motor, which a bridge drives with a duty cycle.

    A wheel of 35 mm carries half of a robot of 1 kg, 6e-4 kg m^2 of the total, and the rotor counts 900 times.

    Returns:
        The preset `wheel`: coordinate wheel (rad), one drive of the kind "duty-cycle" with a supply of 6 V and a gear
        of 30:1, sensor wheel_rad, an encoder of 3 lines on the motor.
    """
    gear = 30.0
    return Machine(
        name="wheel",
        description="A wheel of a mobile robot: gear motor, duty cycle, encoder on the motor.",
        coordinates=(Coordinate("wheel", mass=1e-3, viscous=5e-4, coulomb=0.03, kind="rotary", radius=ARM),),
        belts=(),
        drives=(
            Drive(
                "motor",
                "duty",
                "wheel",
                Kt=6e-3,
                Ke=6e-3,
                resistance=3.0,
                gear_ratio=gear,
                rated_voltage=6.0,
                kind="duty-cycle",
            ),
        ),
        sensors=(
            Sensor("wheel_rad", {"wheel": 1.0}, resolution=2 * math.pi / (4 * 3 * gear), kind="encoder"),
        ),
    )


def servo() -> Machine:
    """Return a hobby servo with an arm: it follows a commanded angle, and a sensor measures the angle.

    Returns:
        The preset `servo`: coordinate horn (rad), range +-90 degrees, one drive of the kind "position" with at most
        0.2 Nm and 10 rad/s at the horn, sensor horn_rad with a known zero.
    """
    return Machine(
        name="servo",
        description="A hobby servo that follows a commanded angle.",
        coordinates=(
            Coordinate(
                "horn", mass=2e-4, viscous=1e-3, coulomb=0.01, kind="rotary", radius=ARM, range=(-1.57, 1.57)
            ),
        ),
        belts=(),
        drives=(
            Drive(
                "servo",
                "command_rad",
                "horn",
                Kt=1.0,
                Ke=0.0,
                resistance=1.0,
                gear_ratio=1.0,
                rated_voltage=1.57,
                kind="position",
                law_parameters={
                    "position_gain": 20.0,
                    "speed_limit": 10.0,
                    "speed_gain": 0.02,
                    "torque_limit": 0.2,
                },
            ),
        ),
        sensors=(Sensor("horn_rad", {"horn": 1.0}, noise=1e-3, resolution=1.5e-3, kind="laser"),),
    )


BUILTIN_MACHINES: dict[str, Callable[[], Machine]] = {
    "hframe": hframe,
    "hframe-linear": hframe_linear,
    "hframe-literal": hframe_literal,
    "hframe-order20": hframe_order20,
    "axis": axis,
    "belt-axis": belt_axis,
    "xy-table": xy_table,
    "corexy": corexy,
    "printer": printer,
    "motor": motor,
    "wheel": wheel,
    "servo": servo,
}
