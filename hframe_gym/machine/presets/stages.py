"""Typical stages, as templates for other machines: axes, tables and printers, with typical values."""

from __future__ import annotations

import math

from ..components import Belt, Coordinate, Drive, Sensor
from ..machine import Machine

# A belt axis with the motor of the CoreXY stage below; lengths at the center of its travel of 0.5 m.
BELT_AXIS_MOTOR_SIDE = 0.36  # m, from the pulley of the motor to the carriage
BELT_AXIS_IDLER_SIDE = 1.08  # m, from the pulley of the motor around the idler, 0.72 m away, to the carriage
# A CoreXY stage of the size of a desktop 3D printer. The values are typical ones, not those of a particular
# machine.
COREXY_RADIUS = 20 * 2e-3 / (2 * math.pi)  # m, pitch radius of a pulley of 20 teeth with a pitch of 2 mm
# N. A belt of 6 mm with glass cords stretches by about 1 % under a load of 10 kg (acceptance test of
# FarmBot's belt).
COREXY_EA = 1.0e4
COREXY_TRAVEL = 0.15  # m, to either side of the center, x and y
# m, from the motor to the carriage at the center: 0.23 m along the frame and 0.20 m along the bridge.
COREXY_SHORT = 0.43
COREXY_ENCODER_QUANTUM = 2 * math.pi / (4 * 1000)  # rad; 1000 lines, read in quadrature, on the motor shafts
COREXY_LONG = 1.35  # m, the other way around the frame, which is 0.46 m wide and deep


def axis() -> Machine:
    """Return a single carriage that a motor moves directly, as a template for other machines.

    Returns:
        The preset `axis`: coordinate x (1 kg, viscous friction 5 Ns/m, Coulomb friction 1 N, range
        -0.25 to 0.25 m), no belts, one drive of 12 V, sensor x_m.
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

    The bridge moves along x and carries the carriage, which moves along y; neither motor moves the other
    axis. With the gear ratio of `axis`, the belts of the motors are taken as stiff.

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


def belt_axis() -> Machine:
    """Return a carriage on a belt between a motor's pulley and an idler, as a template for other machines.

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


def corexy() -> Machine:
    """Return a CoreXY stage with two belts and two 24 V motors without gears.

    The carriage moves along x on the bridge, which moves along y. Both motors are at the front. Each belt has
    two sections from its motor to the carriage: a short one along its own side of the frame, and a long one
    around the rear and along the other side. With p = radius * phi the kinematics are x = (p1 + p2) / 2 and y
    = (p1 - p2) / 2.

    Returns:
        The preset `corexy`: 4 coordinates x, y (m), phi1, phi2 (rad), 4 belt sections, 2 drives, 4 sensors.
        Both sections of a belt have the same EA (`Machine.ties`).
    """
    motion = {"belt1": {"x": 1.0, "y": 1.0}, "belt2": {"x": 1.0, "y": -1.0}}  # belt travel at the motor
    belts = []
    for number, (name, row) in enumerate(motion.items(), start=1):
        # The short section of belt 1 becomes longer where that of belt 2 becomes shorter: the motors are at
        # its ends.
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
    # Stall torque 24 V * 0.04 Nm/A / 2 ohm = 0.48 Nm, the holding torque of a common 42 mm stepper; the
    # inertia is that of such a rotor with its pulley.
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
    """Return the CoreXY stage of a 3D printer: its stepper motors follow the positions of a planner.

    A stepper motor with 50 pole pairs acts as a spring to the commanded angle, with a stiffness per rad of 50
    times its holding torque. The holding torque here is 0.48 Nm, the stall torque of the preset `corexy`. Its
    natural damping is low: a tenth of the critical one for the rotor with the carriage. The kind "position"
    holds the torque at its limit; a drive of the kind "stepper" loses steps there, and needs commands at the
    rate of the steps.

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
