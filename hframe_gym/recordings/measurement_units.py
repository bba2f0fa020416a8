"""Units of columns in logs: recognize them in a header and convert them to SI."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..machine import Drive, Machine

Array = NDArray[np.float64]
Dimension = Literal["time", "voltage", "length", "angle"]

# Factor to SI as numerator and denominator: dividing by 1000 rounds correctly, multiplying by 0.001 does not.
UNITS: dict[Dimension, dict[str, tuple[float, float]]] = {
    "time": {"s": (1, 1), "ms": (1, 1e3), "us": (1, 1e6), "ns": (1, 1e9), "min": (60, 1)},
    "voltage": {"V": (1, 1), "mV": (1, 1e3)},
    "length": {"m": (1, 1), "cm": (1, 1e2), "mm": (1, 1e3), "um": (1, 1e6), "in": (0.0254, 1)},
    "angle": {"rad": (1, 1), "mrad": (1, 1e3), "deg": (np.pi, 180), "rev": (2 * np.pi, 1)},
}
# Units of speeds, which `hframe import` integrates to positions.
SPEED_UNITS: dict[Dimension, dict[str, tuple[float, float]]] = {
    "length": {"m/s": (1, 1), "mm/s": (1, 1e3)},
    "angle": {"rad/s": (1, 1), "deg/s": (np.pi, 180), "rpm": (2 * np.pi, 60), "rev/s": (2 * np.pi, 1)},
}
SI_UNITS: dict[Dimension, str] = {dimension: next(iter(units)) for dimension, units in UNITS.items()}
DUTY_UNITS = {"%": 100.0, "pu": 1.0}  # of a voltage: fractions of the machine's rated voltage, which they give at 100 %

_SPELLINGS = {
    "sec": "s",
    "secs": "s",
    "second": "s",
    "seconds": "s",
    "msec": "ms",
    "millis": "ms",
    "milliseconds": "ms",
    "usec": "us",
    "µs": "us",
    "μs": "us",
    "micros": "us",
    "microseconds": "us",
    "nsec": "ns",
    "nanoseconds": "ns",
    "minutes": "min",
    "volt": "V",
    "volts": "V",
    "millivolts": "mV",
    "meter": "m",
    "meters": "m",
    "metres": "m",
    "millimeter": "mm",
    "millimeters": "mm",
    "millimetres": "mm",
    "µm": "um",
    "μm": "um",
    "micrometers": "um",
    "inch": "in",
    "inches": "in",
    "radian": "rad",
    "radians": "rad",
    "°": "deg",
    "degree": "deg",
    "degrees": "deg",
    "turn": "rev",
    "turns": "rev",
    "revs": "rev",
    "revolutions": "rev",
    "1/min": "rpm",
    "u/min": "rpm",
    "rps": "rev/s",
    "percent": "%",
    "pct": "%",
    "duty": "%",
    "p.u.": "pu",
}
_KNOWN = {unit.lower(): unit for table in (UNITS, SPEED_UNITS) for units in table.values() for unit in units}
_KNOWN |= {unit: unit for unit in DUTY_UNITS}
COUNT_UNITS = ("counts", "count", "cts", "inc", "incr")  # steps of an encoder
# Units of quantities that no channel has; they mark a row of units.
_OTHER = {"a", "ma", "n", "nm", "w", "hz", "°c", "degc", "c", "k", *COUNT_UNITS}
_OTHER |= {"m/s^2", "m/s²", "g", "bar", "bit", "lsb", "bool", "-", "1", "#"}
# Units that recordings do not use, in words.
UNIT_WORDS = {"mm": "millimeters", "um": "micrometers", "deg": "degrees", "ms": "milliseconds", "%": "percent"}
_RATE = re.compile(r"(?P<rate>\d+(\.\d+)?([eE][+-]?\d+)?)\s*(?P<prefix>k?)hz", re.IGNORECASE)
_BRACKETED = re.compile(r"(?P<name>.*?)[\s_]*[\[(<{]\s*(?P<unit>[^\])>}]*?)\s*[\])>}]\s*")
_SUFFIX = re.compile(r"(?P<name>.*[^\s_./])(?:[\s_./]+|\s+in\s+)(?P<unit>[^\s_./]+)")


@dataclass(frozen=True)
class Conversion:
    """Multiplication of a column by a factor.

    Attributes:
        numerator: Factor.
        denominator: Divisor, applied after the factor.
    """

    numerator: float = 1.0
    denominator: float = 1.0

    def apply(self, values: Array) -> Array:
        """Convert the values of a column to the unit of the channel.

        Args:
            values: Values of a column, in the unit of the log, shape (rows,).

        Returns:
            Values times the numerator, divided by the denominator, in the unit of the channel, shape (rows,).
        """
        scaled = values if self.numerator == 1.0 else values * self.numerator
        return scaled if self.denominator == 1.0 else scaled / self.denominator

    def scaled(self, factor: float) -> Conversion:
        """Return this conversion followed by a further factor.

        If the inverse of the factor is a whole number, the conversion divides by it. This rounds correctly: 0.001
        itself is not exact in binary numbers.

        Args:
            factor: Factor, dimensionless, not zero.

        Returns:
            The combined conversion.
        """
        inverse = round(1.0 / factor)
        if abs(inverse) > 1 and abs(inverse * factor - 1.0) < 1e-12:
            return Conversion(self.numerator, self.denominator * inverse)
        return Conversion(self.numerator * factor, self.denominator)


class WrongUnitError(InputError):
    """Values of channels are probably in another unit than that of the channel.

    Attributes:
        problem: File, columns and values, in words.
        channels: Names of the channels.
        unit: Unit that the values probably have.
    """

    problem: str
    channels: tuple[str, ...]
    unit: str


def wrong_unit_error(problem: str, channels: tuple[str, ...], unit: str) -> WrongUnitError:
    """Build the error about channels whose values are probably in another unit.

    Args:
        problem: File, columns and values, in words.
        channels: Names of the channels.
        unit: Unit that the values probably have: "mm", "um", "deg", "ms" or "%".

    Returns:
        The error; its message ends with a question about the unit.
    """
    question = "is the column" if len(channels) == 1 else "are they"
    error = WrongUnitError(f"{problem}; {question} in {UNIT_WORDS[unit]}?")
    error.problem, error.channels, error.unit = problem, channels, unit
    return error


def parse_factor(where: str, factor: object) -> float:
    """Read a factor that a user gave for a column of a log, by which the values of the column are multiplied.

    Args:
        where: File and field, or option, that has the factor, for the message.
        factor: Number or text, for example "0.001".

    Returns:
        The factor, dimensionless.

    Raises:
        InputError: If it is not a finite number other than zero.
    """
    try:
        value = float(factor)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        value = 0.0
    if not abs(value) > 0.0 or value in (float("inf"), float("-inf")):
        raise InputError(f"{where}: {factor!r} is not a factor; give a number such as 0.001")
    return value


def parse_rate(text: str) -> float | None:
    """Read a sampling rate such as "200Hz" or "1 kHz".

    Args:
        text: Number and unit.

    Returns:
        Rate, Hz, positive; None if the text is something else.
    """
    rate = _RATE.fullmatch(text.strip())
    value = float(rate["rate"]) * (1e3 if rate["prefix"] else 1.0) if rate else 0.0
    return value if 0.0 < value < np.inf else None


def normalize_unit(text: str) -> str:
    """Return the usual spelling of a unit, for example "mm" for "[Millimeters]".

    Args:
        text: Unit as written in a log or an option, possibly in brackets.

    Returns:
        Unit of time, voltage, length, angle or speed, "%" or "pu" (of the rated voltage), such as "ms", "V" or "rpm";
        the text without brackets if it is no known unit.
    """
    plain = text.strip().strip("[](){}<>").strip()
    lower = plain.lower()
    return _KNOWN.get(_SPELLINGS.get(lower, lower).lower(), plain)


def is_unit(text: str) -> bool:
    """Return whether a text is a unit; a row of such texts below the header of a table is a row of units.

    Args:
        text: Cell of the row.

    Returns:
        True for a known unit, including units such as "A" that no channel of a machine has.
    """
    unit = normalize_unit(text)
    return unit.lower() in _KNOWN or unit.lower() in _OTHER


def split_unit(header: str) -> tuple[str, str]:
    """Split the header of a column into name and unit: "Pos X [mm]", "x_mm", "x (mm)", "x in mm".

    Args:
        header: Cell of a header.

    Returns:
        name: Name without the unit.
        unit: Unit in its usual spelling, such as "mm" or "rpm"; "" if the header has none. Any text in brackets is a
            unit. Without brackets, only known units of time, voltage, length, angle, speed and duty are recognized.
    """
    match = _BRACKETED.fullmatch(header)
    if match and match["name"]:
        return match["name"].strip(), normalize_unit(match["unit"])
    match = _SUFFIX.fullmatch(header.strip())
    if match and normalize_unit(match["unit"]).lower() in _KNOWN:
        return re.sub(r"\s+in$", "", match["name"]).strip(), normalize_unit(match["unit"])
    return header.strip(), ""


def channel_dimensions(machine: Machine) -> dict[str, Dimension]:
    """Return whether each channel of a machine is a voltage, a length or an angle.

    Args:
        machine: Machine with its drives and sensors.

    Returns:
        "voltage", "length" or "angle" by name of the channel, inputs before outputs.
    """
    dimensions: dict[str, Dimension] = dict.fromkeys(machine.input_channels, "voltage")
    for sensor in machine.sensors:
        linear = machine.coordinate(sensor.coordinate).kind == "linear"
        dimensions[sensor.channel] = "length" if linear else "angle"
    return dimensions


def shaft_drive(machine: Machine, channel: str) -> Drive | None:
    """Return the drive whose shaft an encoder measures, where the encoder's channel is the travel of a carriage.

    A log may have the angle of such a shaft in place of the travel.

    Args:
        machine: Machine with its drives and sensors.
        channel: Name of a channel.

    Returns:
        The drive; None if the channel is none of an encoder, or of an angle.
    """
    sensor = next((sensor for sensor in machine.sensors if sensor.channel == channel), None)
    if sensor is None or sensor.kind != "encoder" or sensor.row != {sensor.coordinate: 1.0}:
        return None
    if machine.coordinate(sensor.coordinate).kind != "linear":
        return None
    return next((drive for drive in machine.drives if drive.coordinate == sensor.coordinate), None)


def units_of(machine: Machine, channel: str) -> list[str]:
    """List the units that the column of a channel may have in a log.

    Args:
        machine: Machine with its drives and sensors.
        channel: Name of a channel, or "time_s".

    Returns:
        Units, those of the channel's quantity first.
    """
    dimension: Dimension = channel_dimensions(machine).get(channel, "time")
    angles = UNITS["angle"] if shaft_drive(machine, channel) is not None else ()
    duty = DUTY_UNITS if dimension == "voltage" else ()
    return [*UNITS[dimension], *angles, *SPEED_UNITS.get(dimension, ()), *duty]


def unknown_unit_text(machine: Machine, channel: str, unit: str) -> str:
    """Write the message about a unit that a channel cannot have.

    Args:
        machine: Machine with its drives and sensors.
        channel: Name of the channel, or "time_s".
        unit: The unit.

    Returns:
        Text without file and column, with the options that state the unit; for counts also the factor of the encoder's
        declared resolution.
    """
    dimension: Dimension = channel_dimensions(machine).get(channel, "time")
    factor = f"a factor to {SI_UNITS[dimension]} by --scale {channel}=FACTOR"
    sensor = next((sensor for sensor in machine.sensors if sensor.channel == channel), None)
    if sensor is not None and unit.lower() in COUNT_UNITS and sensor.resolution > 0.0:
        factor += f" (FACTOR is {sensor.resolution:.6g} if a count is the declared resolution)"
    units = ", ".join(units_of(machine, channel))
    return f"{unit!r} is not a unit of {channel}; state it by --unit {channel}=UNIT ({units}), or {factor}"
