"""Convert the units of columns in logs to those of the channels of a machine."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Literal, NamedTuple, get_args

import numpy as np

from ...arrays import Array
from ...machine import DRIVE_KINDS, Drive, Machine
from ..quantities import COUNT_UNITS, QUANTITIES, Factors, split_unit

TIME = "time_s"  # column of the sample times in recordings
Dimension = Literal[
    "time",
    "voltage",
    "duty cycle",
    "current",
    "torque",
    "force",
    "length",
    "angle",
    "linear speed",
    "angular speed",
    "linear acceleration",
    "angular acceleration",
]

UNITS: dict[Dimension, Factors] = {
    dimension: QUANTITIES[dimension].units for dimension in get_args(Dimension)
}
# Units of speeds, which `hframe import` integrates to positions.
SPEED_UNITS: dict[Dimension, Factors] = {
    "length": QUANTITIES["linear speed"].units,
    "angle": QUANTITIES["angular speed"].units,
}
ALL_SPEED_UNITS = tuple(unit for units in SPEED_UNITS.values() for unit in units)
SI_UNITS: dict[Dimension, str] = {dimension: next(iter(units)) for dimension, units in UNITS.items()}
SI_UNITS["duty cycle"] = "pu"
_DIMENSION_OF_UNIT: dict[str, Dimension] = {unit: dimension for dimension, unit in SI_UNITS.items()}
# Units of a duty cycle, which a log may have in place of a voltage: the value at which the drive's rated
# voltage is applied.
DUTY_UNITS = {"%": 100.0, "pu": 1.0}
# Inputs of amplifiers that control the current or the torque, by the unit at the end of the channel's name.
_COMMANDS: dict[str, Dimension] = {"A": "current", "Nm": "torque", "N": "force"}
# Unit of a number that is written to a converter or timer.
_BITS = re.compile(r"(\d{1,2})\s*bits?", re.IGNORECASE)
_INTEGRATED = "integrated from 0; an offset of the speed makes the position drift"
_RATE = re.compile(r"(?P<rate>\d+(\.\d+)?([eE][+-]?\d+)?)\s*(?P<prefix>k?)hz", re.IGNORECASE)


@dataclass(frozen=True)
class Conversion:
    """Conversion of the values of a column to another unit: value * numerator / denominator.

    Attributes:
        numerator: Factor, dimensionless.
        denominator: Divisor, dimensionless, applied after the factor.
    """

    numerator: float = 1.0
    denominator: float = 1.0

    def apply(self, values: Array) -> Array:
        """Convert `values` of a column, in the unit of the log, shape (rows,), to the unit of the channel."""
        scaled = values if self.numerator == 1.0 else values * self.numerator
        return scaled if self.denominator == 1.0 else scaled / self.denominator

    def scaled(self, factor: float) -> Conversion:
        """Combine this conversion with a dimensionless `factor`, not zero.

        If the inverse of the factor is a whole number, the conversion divides by it. This rounds correctly:
        0.001 itself is not exact in binary numbers.
        """
        inverse = round(1.0 / factor)
        if abs(inverse) > 1 and abs(inverse * factor - 1.0) < 1e-12:
            return Conversion(self.numerator, self.denominator * inverse)
        return Conversion(self.numerator * factor, self.denominator)


class UnitConversion(NamedTuple):
    """Conversion of a column in some unit to the values of a channel.

    Attributes:
        conversion: Conversion to the unit of the channel; for a speed, to that unit per second.
        integrate: Whether the column is a speed, whose integral over time is the channel.
        remark: The conversion in words; "" for the unit of the channel.
    """

    conversion: Conversion
    integrate: bool
    remark: str


def parse_rate(text: str) -> float | None:
    """Read a sampling rate such as "200Hz" or "1 kHz", Hz, positive; None if the text is something else."""
    rate = _RATE.fullmatch(text.strip())
    value = float(rate["rate"]) * (1e3 if rate["prefix"] else 1.0) if rate else 0.0
    return value if 0.0 < value < np.inf else None


def channel_dimension(machine: Machine, channel: str) -> Dimension:
    """Return the quantity of a channel.

    Returns:
        "time" for the times. For an output, the quantity of its unit, such as "length", "angular speed" or
        "current". For an input, the command of its drive: "duty cycle", "current", "torque", or for a set
        point "angle", "linear speed" and the like. For a drive of voltages, the end of the channel's name
        decides: "current" for _A, "torque" for _Nm, "force" for _N, else "voltage".
    """
    if channel == TIME:
        return "time"
    if channel in machine.input_channels:
        drive = machine.drives[machine.input_channels.index(channel)]
        if DRIVE_KINDS.get(drive.kind).fraction:
            return "duty cycle"
        if drive.law:
            return _DIMENSION_OF_UNIT[machine.command_unit(drive)]
        # A drive of voltages whose Ke is 0 may control the current, the torque or the force that its channel
        # names.
        unit = split_unit(channel)[1] if drive.command == "voltage" else machine.command_unit(drive)
        return _COMMANDS.get(unit, "voltage")
    if channel in machine.supply_channels:
        return "voltage"
    return _DIMENSION_OF_UNIT[machine.sensor_unit(machine.sensor(channel))]


def accepted_units(machine: Machine, channel: str) -> dict[str, UnitConversion]:
    """Return the units that a channel's column may have in a log, and each one's conversion to its unit.

    The column of a position may be a speed, which is integrated. For a motor encoder whose channel is the
    travel of a carriage, it may also be the angle or speed of the motor; so may the set point and the
    measured speed of a carriage that a motor moves directly. The column of an input may be a fraction of the
    drive's rated value, and for a drive without back-EMF (`Ke` 0, an amplifier that controls the current) a
    current or the torque of the motor.

    Returns:
        Conversions by unit: first the units of the channel's quantity, beginning with the SI unit, then units
        of the other quantities: speeds, angle and speed of the motor, currents and torques, fractions of the
        rated value.
    """
    dimension = channel_dimension(machine, channel)
    conversions: dict[str, UnitConversion] = {}
    for unit, factors in UNITS[dimension].items():
        remark = f"{unit} to {SI_UNITS[dimension]}" if unit != SI_UNITS[dimension] else ""
        conversions[unit] = UnitConversion(Conversion(*factors), False, remark)
    speeds = SPEED_UNITS.get(dimension, {}) if channel in machine.output_channels else {}
    for unit, factors in speeds.items():
        conversions[unit] = UnitConversion(Conversion(*factors), True, f"speed in {unit}, {_INTEGRATED}")
    conversions |= _motor_units(machine, channel, dimension)
    if channel in machine.output_channels and machine.sensor(channel).incremental:
        drive = _direct_drive(machine, channel)  # whose shaft the encoder measures
        if drive is not None:
            conversions |= _units_of_motor(drive, "angle", integrate=False)
            conversions |= _units_of_motor(drive, "angular speed", integrate=True)
    if channel in machine.input_channels and dimension != "duty cycle":
        conversions |= _input_units(machine, channel, dimension)
    return conversions


def _motor_units(machine: Machine, channel: str, dimension: Dimension) -> dict[str, UnitConversion]:
    """Return the units of the motor that a carriage's set point or speed may have, such as rpm."""
    counterparts: dict[Dimension, Dimension] = {"length": "angle", "linear speed": "angular speed"}
    motor = counterparts.get(dimension)
    if channel in machine.input_channels:
        drive: Drive | None = machine.drives[machine.input_channels.index(channel)]
    else:
        drive = _direct_drive(machine, channel) if dimension == "linear speed" else None
    return {} if motor is None or drive is None else _units_of_motor(drive, motor, integrate=False)


def _units_of_motor(drive: Drive, quantity: Dimension, *, integrate: bool) -> dict[str, UnitConversion]:
    """Return the units of a motor's angle or speed, converted to those of the carriage that it moves."""
    gear = f"converted by its gear ratio, {drive.gear_ratio:.6g} rad/m" + f", {_INTEGRATED}" * integrate
    name = f"{quantity.removeprefix('angular ')} of {drive.name}"
    return {
        unit: UnitConversion(
            Conversion(*factors).scaled(1.0 / drive.gear_ratio), integrate, f"{name} in {unit}, {gear}"
        )
        for unit, factors in UNITS[quantity].items()
    }


def _input_units(machine: Machine, channel: str, dimension: Dimension) -> dict[str, UnitConversion]:
    """Return the units that an input may have beside those of its quantity."""
    drive = machine.drives[machine.input_channels.index(channel)]
    conversions: dict[str, UnitConversion] = {}
    if drive.Ke == 0.0 and dimension in ("voltage", "current"):
        # The motor's torque is Kt times its current, which is the input over the resistance (1 ohm for an
        # input in A).
        torque = Conversion().scaled(drive.resistance / drive.Kt)
        for unit, factors in UNITS["torque"].items():
            conversions[unit] = UnitConversion(
                Conversion(torque.numerator * factors[0], torque.denominator * factors[1]),
                False,
                f"torque of {drive.name} in {unit}, converted by its Kt and resistance",
            )
    if drive.Ke == 0.0 and dimension == "voltage":
        for unit, factors in UNITS["current"].items():
            current = Conversion(factors[0] * drive.resistance, factors[1])
            conversions[unit] = UnitConversion(
                current, False, f"current of {drive.name} in {unit}, which Ke 0 allows"
            )
    si_unit = SI_UNITS[dimension]
    what = "duty cycle" if dimension == "voltage" else dimension
    remark = f"{what}, 100 % is {drive.rated_voltage:.6g} {si_unit}, the rated {dimension} of {drive.name}"
    for unit, full in DUTY_UNITS.items():
        conversions[unit] = UnitConversion(Conversion(drive.rated_voltage, full), False, remark)
    return conversions


def wrong_unit_message(machine: Machine, channel: str, unit: str) -> str:
    """Write the message on an impossible unit, such as mm for a voltage, without file and column.

    It proposes the options --unit, with the possible units, and --scale. For encoder counts, it also proposes
    a factor, the declared resolution of the sensor; for a number of bits, the factor of a duty cycle.

    Args:
        channel: Name of the channel, or "time_s".
        unit: The impossible unit as the log or the user states it.
    """
    factor = f"a factor to {SI_UNITS[channel_dimension(machine, channel)]} by --scale {channel}=FACTOR"
    resolution = machine.sensor(channel).resolution if channel in machine.output_channels else 0.0
    if unit.lower() in COUNT_UNITS and resolution > 0.0:
        factor += f" (FACTOR is {resolution:.6g} if a count is the declared resolution)"
    bits = _BITS.fullmatch(unit)
    if bits and channel_dimension(machine, channel) == "duty cycle":
        largest = 2 ** int(bits[1]) - 1
        factor += f" (FACTOR is {1 / largest:.5g} if {largest} is the full duty cycle)"
    if unit in UNITS["length"] and channel_dimension(machine, channel) == "angle":
        factor += f" (FACTOR is 1 / radius of what rolls, in {unit})"
    units = ", ".join(accepted_units(machine, channel))
    return f"{unit!r} is not a unit of {channel}; state it by --unit {channel}=UNIT ({units}), or {factor}"


def scaled_speed_message(machine: Machine, channel: str, unit: str) -> str:
    """Write the message on a column of speed with a factor (--scale) but no unit, without file and column.

    Such a column is refused, because it is not known whether its values times the factor are speeds or
    positions. The message proposes the option --unit with which the speed is integrated.
    """
    dimension = channel_dimension(machine, channel)
    problem = f"{unit} is a speed, not {'a length' if dimension == 'length' else 'an angle'}"
    if unit in accepted_units(machine, channel):
        return f"{problem}. Add --unit {channel}={unit} to integrate it to {channel}"
    si_unit = next(iter(SPEED_UNITS[dimension]))
    advice = (
        f"If the factor converts it to {si_unit}, add --unit {channel}={si_unit} to integrate it to {channel}"
    )
    return f"{problem}. {advice}"


def _direct_drive(machine: Machine, channel: str) -> Drive | None:
    """Return the drive that moves the carriage which a sensor measures.

    None if the channel is not an output, if the sensor measures something else, or if the carriage has
    several drives of different gear ratios.
    """
    if channel not in machine.output_channels:
        return None
    sensor = machine.sensor(channel)
    if sensor.row != {sensor.coordinate: 1.0} or machine.coordinate(sensor.coordinate).kind != "linear":
        return None
    drives = [drive for drive in machine.drives if drive.coordinate == sensor.coordinate]
    return drives[0] if len({drive.gear_ratio for drive in drives}) == 1 else None
