"""Sensors of a new machine: encoders by their lines, and sensors of further kinds."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping

from ...errors import InputError, suggestion
from ...machine import SENSED_QUANTITIES, SENSOR_KINDS, Machine, Sensor
from ...registry import load_plugins
from .options import MachineOptions

QUADRATURE = 4  # edges per line of an encoder


def sensors_of(
    machine: Machine, gear_ratios: Mapping[str, float], options: MachineOptions
) -> tuple[Sensor, ...]:
    """Return the sensors of a new machine: encoders on the motor shafts, then those of the carriages.

    Args:
        machine: The new machine with its drives, still with the template's sensors.
        gear_ratios: Gear ratio of the template's drive, rad of the motor per rad or m, by coordinate; where
            the new one differs, the resolution of a kept encoder changes in inverse proportion.
        options: Its `encoder_lines` (None: the template's encoders; 0: none) and `linear_sensor` (False: no
            sensors of carriages) decide.
    """
    carriages = [s for s in machine.sensors if s.kind != "encoder"] if options.linear_sensor else []
    if options.encoder_lines is None:
        ratio = {d.coordinate: gear_ratios[d.coordinate] / d.gear_ratio for d in machine.drives}
        encoders = [s for s in machine.sensors if s.kind == "encoder"]
        encoders = [dataclasses.replace(s, resolution=s.resolution * ratio[s.coordinate]) for s in encoders]
        return (*encoders, *carriages)
    encoders = []
    for drive in machine.drives if options.encoder_lines else ():
        kind = machine.coordinate(drive.coordinate).kind
        channel = (
            f"{drive.coordinate}_rad"
            if kind == "rotary"
            else f"{drive.coordinate}{'_encoder' * bool(carriages)}_m"
        )
        quantum = 2 * math.pi / (QUADRATURE * options.encoder_lines * drive.gear_ratio)
        encoders.append(Sensor(channel, {drive.coordinate: 1.0}, resolution=quantum, kind="encoder"))
    return (*encoders, *carriages)


def _parts(machine: Machine, kind: str) -> tuple[str, tuple[str, ...]]:
    """Return where sensors of a kind measure, such as "drive", and a machine's components of this type."""
    component = SENSED_QUANTITIES[SENSOR_KINDS.get(kind).quantity()].component
    if component == "drive":
        return component, tuple(drive.name for drive in machine.drives)
    if component == "belt":
        return component, tuple(belt.name for belt in machine.belts)
    if SENSOR_KINDS.get(kind).turn is not None:  # an angle within one turn
        return "rotary coordinate", tuple(c.name for c in machine.coordinates if c.kind == "rotary")
    return component, machine.coordinate_names


def further_sensors(machine: Machine) -> dict[str, str]:
    """Return the sensors that a machine may have in addition to its own.

    Returns:
        What each measures and its unit, such as "speed of x, m/s", by its text KIND@PART, such as "speed@x".
    """
    load_plugins()  # may register kinds
    present = [(sensor.kind, sensor.row) for sensor in machine.sensors]
    choices = {}
    for kind in SENSOR_KINDS:
        for part in _parts(machine, kind)[1]:
            if (kind, {part: 1.0}) not in present:
                unit = machine.sensor_unit(Sensor("", {part: 1.0}, kind=kind))
                choices[f"{kind}@{part}"] = f"{kind.replace('-', ' ')} of {part}, {unit}"
    return choices


def further_sensor(machine: Machine, text: str) -> Sensor:
    """Create the sensor that a text KIND@PART describes, without noise and resolution.

    Args:
        machine: Machine to which it will be added; it is not changed.
        text: Kind of sensor and part of the machine, such as "speed@x" or "current@motor1". The channel is
            named by the part and the unit, and by the kind if another channel has this name.

    Raises:
        InputError: If the text, the kind or the part is wrong, or the machine has this sensor.
    """
    kind, separator, part = text.partition("@")
    if not separator:
        raise InputError(f"--sensor {text}: write KIND@PART, for example speed@{machine.tool_axes[0]}")
    try:
        component, parts = _parts(machine, kind)
    except InputError as error:
        raise InputError(f"--sensor {text}: {error}") from None
    if part not in parts:
        available = f"choose one of {', '.join(parts)}" if parts else "the machine has none"
        raise InputError(
            f"--sensor {text}: {kind} is measured at a {component}, and {part!r} is none; {available}"
            f"{suggestion(part, parts)}"
        )
    twin = next((s for s in machine.sensors if s.kind == kind and s.row == {part: 1.0}), None)
    if twin is not None:
        raise InputError(f"--sensor {text}: {twin.channel} is this sensor already; give each sensor once")
    ending = machine.sensor_unit(Sensor("", {part: 1.0}, kind=kind)).replace("^", "").replace("/", "_")
    channel = f"{part}_{ending}"
    if channel in machine.input_channels + machine.output_channels:
        channel = f"{part}_{kind.replace('-', '_')}_{ending}"
    return Sensor(channel, {part: 1.0}, kind=kind)
