"""Drives of a new machine: values of the motors, and what is commanded."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import numpy as np

from ...arrays import Array
from ...errors import InputError, suggestion
from ...machine import DRIVE_KINDS, Drive, Machine, rest_positions_per_axis
from .options import MachineOptions

# Beginning of the columns of commands, by the kinds of drives that a motor may have; they end in the unit.
COMMANDS = {
    "voltage": "v",
    "duty-cycle": "duty",
    "current": "i",
    "torque": "torque",
    "position": "command",
    "speed": "command",
    "stepper": "command",
}
# The kinds that a drive of a template that follows a position may have instead.
FOLLOWING = ("position", "stepper")
# Loop of a drive that follows a set point. Its speed follows with 100 1/s (16 Hz), below the belt modes of
# small stages; the other corner frequencies are a quarter and a fifth of it, as is usual (Ellis 2012, Control
# System Design Guide).
_SPEED_BANDWIDTH, _INTEGRAL_RATE, _POSITION_GAIN = 100.0, 25.0, 20.0  # 1/s
_DAMPING = 0.1  # of the critical one: the vibration of a stepper motor with its load, without a damper
# What a DC motor has at rest at its rated voltage: A, Nm.
_AT_REST: dict[str, Callable[[Drive], float]] = {
    "current": lambda drive: drive.rated_voltage / drive.resistance,
    "torque": lambda drive: drive.Kt * drive.rated_voltage / drive.resistance,
}


def with_motor_values(machine: Machine, drive: Drive, options: MachineOptions) -> Drive:
    """Return a copy of a drive with the motor values that the options state; None keeps those of the drive.

    These are Kt (and with it Ke), resistance, rated voltage and gear ratio. For a drive of a linear
    coordinate, a pulley radius or travel per turn in the options gives the gear ratio, rad/m.
    """
    new: dict[str, float] = {}
    if options.Kt is not None:
        new |= {"Kt": options.Kt, "Ke": options.Kt}
    given = {
        "resistance": options.resistance,
        "rated_voltage": options.rated_voltage,
        "gear_ratio": options.gear_ratio,
    }
    new |= {key: value for key, value in given.items() if value is not None}
    radius = options.pulley_radius
    if options.travel_per_turn is not None:
        radius = options.travel_per_turn / (2.0 * math.pi)
    if radius is not None and machine.coordinate(drive.coordinate).kind == "linear":
        new["gear_ratio"] = (options.gear_ratio or 1.0) / radius
    return dataclasses.replace(drive, **new)  # type: ignore[arg-type]


def shaft_inertias(machine: Machine) -> Array:
    """Return the inertia that each motor shaft moves if the others are locked, kg m^2, shape (drives,)."""
    per_axis = rest_positions_per_axis(machine)  # (coordinates, axes)
    of_drives = per_axis[[machine.coordinate_names.index(d.coordinate) for d in machine.drives]]
    axes = np.linalg.inv(of_drives)  # travel of each axis per position of each drive
    masses = np.array([c.mass for c in machine.coordinates])
    along_drives = per_axis @ axes
    ratios = np.array([d.gear_ratio for d in machine.drives])
    return np.asarray(masses @ along_drives**2 / ratios**2)


def with_command(machine: Machine, drive: Drive, kind: str | None, inertia: float) -> Drive:
    """Return a drive of another kind with the same motor.

    Its channel, and its largest command or torque, follow from the motor.

    Args:
        kind: What is commanded, a key of `COMMANDS` such as "current" or "position". The drive itself is
            returned if this is its kind, or for None.
        inertia: What the motor shaft moves, kg m^2, from which the gains of a loop follow.

    Raises:
        InputError: If there is no such kind, or the motor of the template cannot have it.
    """
    if kind is None or kind == drive.kind:
        return drive
    if kind not in COMMANDS:
        raise InputError(
            f"--drive {kind}: choose one of {', '.join(COMMANDS)}{suggestion(kind, COMMANDS)}; "
            "docs/machine.md describes all kinds"
        )
    if drive.law is not None and kind not in FOLLOWING:
        raise InputError(
            f"--drive {kind}: the motors of this template follow a position; choose one of "
            f"{', '.join(FOLLOWING)}, or a template with DC motors, such as corexy"
        )
    of_kind = DRIVE_KINDS.get(kind)
    unit = "" if of_kind.fraction else of_kind.unit(machine.coordinate(drive.coordinate).kind)
    channel = f"{COMMANDS[kind]}{drive.name.removeprefix('motor')}{'_' * bool(unit)}{unit.replace('/', '_')}"
    if kind == "stepper":
        return _stepper(drive, channel)
    if of_kind.law is not None:
        return _set_point_drive(drive, kind, channel, inertia)
    drive = dataclasses.replace(drive, kind=kind, channel=channel)
    if kind not in _AT_REST:
        return drive
    largest = float(f"{_AT_REST[kind](drive):.4g}")
    fixed: dict[str, Any] = {**of_kind.fixed, **({"Kt": 1.0} if kind == "torque" else {})}
    return dataclasses.replace(drive, rated_voltage=largest, voltage_range=None, **fixed)


def _set_point_drive(drive: Drive, kind: str, channel: str, inertia: float) -> Drive:
    """Return a drive whose loop makes the motor follow positions or speeds; `inertia`: kg m^2."""
    values = {
        "speed_gain": _SPEED_BANDWIDTH * inertia,
        "integral_rate": _INTEGRAL_RATE,
        "torque_limit": _AT_REST["torque"](drive),
    }
    without_load = float(f"{drive.rated_voltage / drive.emf_constant:.4g}")  # m/s or rad/s
    if kind == "position":
        values |= {"position_gain": _POSITION_GAIN, "speed_limit": without_load}
    fixed: dict[str, Any] = dict(DRIVE_KINDS.get(kind).fixed)
    return dataclasses.replace(
        drive,
        kind=kind,
        channel=channel,
        rated_voltage=without_load,
        voltage_range=None,
        law_parameters={name: float(f"{value:.4g}") for name, value in values.items()},
        **fixed,
    )


def _stepper(drive: Drive, channel: str) -> Drive:
    """Return a stepper motor with the largest torque of a drive."""
    largest = drive.law_parameters["torque_limit"] if drive.law is not None else _AT_REST["torque"](drive)
    return dataclasses.replace(
        drive,
        kind="stepper",
        channel=channel,
        voltage_range=None,
        law_parameters={"holding_torque": float(f"{largest:.4g}")},
        **dict[str, Any](DRIVE_KINDS.get("stepper").fixed),
    )


def with_stepper_damping(machine: Machine, inertias: Array) -> Machine:
    """Return a machine whose stepper motors have the usual damping, as friction of their coordinates.

    It is the fraction `_DAMPING` of the critical damping of the motor's holding torque with the inertia that
    it moves.

    Args:
        inertias: What each motor shaft moves while other drives hold, kg m^2, shape (drives,).
    """
    for drive, inertia in zip(machine.drives, inertias, strict=True):
        if drive.kind == "stepper":
            law = {**DRIVE_KINDS.get("stepper").defaults, **drive.law_parameters}
            critical = 2.0 * math.sqrt(law["periods"] * law["holding_torque"] * inertia)  # Nms
            moved = machine.coordinate(drive.coordinate)
            viscous = moved.viscous + drive.gear_ratio**2 * _DAMPING * critical
            machine = machine.with_components(dataclasses.replace(moved, viscous=float(f"{viscous:.3g}")))
    return machine


def reaching_workspace(machine: Machine, drive: Drive) -> Drive:
    """Return a drive whose largest position command reaches the farthest corner of the workspace.

    If the drive's coordinate is not a tool axis, the command is rounded up to an integer (rad of a pulley).
    Drives that do not follow a position are returned unchanged.
    """
    if drive.command != "position":
        return drive
    per_axis = rest_positions_per_axis(machine)[machine.coordinate_names.index(drive.coordinate)]
    corner = [max(map(abs, limits)) if limits else 0.0 for limits in machine.axis_ranges]
    largest = float(abs(per_axis) @ corner)
    if drive.coordinate not in machine.tool_axes:
        largest = math.ceil(largest)
    return dataclasses.replace(drive, rated_voltage=float(largest))
