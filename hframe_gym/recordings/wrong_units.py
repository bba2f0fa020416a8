"""Values that are probably in another unit than their channel's, such as millimeters in place of meters."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..arrays import Array
from ..errors import InputError
from ..machine import Machine
from .tables.table_file import cell_text

# Units that recordings do not use, in words.
UNIT_WORDS = {
    "mm": "millimeters",
    "um": "micrometers",
    "deg": "degrees",
    "ms": "milliseconds",
    "%": "percent",
}
# The largest plausible measurement of a channel by the ending of its name (20 m, 2000 turns), and the unit of
# the value if it is larger.
_LARGEST = {"_m": (20.0, "mm"), "_rad": (2000 * 2 * np.pi, "deg")}
# A channel that spans more than this multiple of its coordinate's range is in another unit.
_MAX_SPAN = 3.0
# Ratios of measured to plausible travel that suggest degrees (57.3) and millimeters (1000); the limits leave
# room for noise and for a wrong radius.
_DEGREES = (25.0, 120.0)
_MILLIMETERS = (300.0, 2000.0)
_OUTLIERS = 0.01  # of the samples of a channel; single wrong samples are no evidence of a wrong unit
_MOVED = 1e-3  # m, standard deviation of the carriage's travel below which the ratio is not evaluated


class WrongUnitError(InputError):
    """Values of channels are probably in another unit than that of the channel.

    Attributes:
        problem: File, columns and values, in words.
        unit: Unit that the values probably have.
    """

    def __init__(self, problem: str, channels: tuple[str, ...], unit: str) -> None:
        """Create the error; its message ends with a question about the unit.

        Args:
            problem: File, columns and values, in words.
            unit: Unit that the values probably have: "mm", "um", "deg", "ms" or "%".
        """
        question = "is the column" if len(channels) == 1 else "are they"
        super().__init__(f"{problem}; {question} in {UNIT_WORDS[unit]}?")
        self.problem, self.channels, self.unit = problem, channels, unit

    def __reduce__(self) -> tuple[type[WrongUnitError], tuple[str, tuple[str, ...], str]]:
        """Return the arguments of the constructor for pickle, which would pass the message alone."""
        return type(self), (self.problem, self.channels, self.unit)


def refuse_wrong_units(path: Path, outputs: Array, machine: Machine) -> None:
    """Raise an error if position channels are probably in millimeters or degrees.

    These are channels with more than 1 % of the values beyond 20 m or 2000 turns, channels that span more
    than three times the range of their coordinate, and pulleys and carriages whose travels differ by 25 to
    120 times (degrees) or 300 to 2000 times (millimeters) from what unstretched belts allow.

    Args:
        path: File of the run, for the message.
        outputs: Measurements of the run, in the sensors' units, shape (n, sensors), NaN where not measured.

    Raises:
        WrongUnitError: If there are such channels; it names them and the unit that is likely.
    """
    for sensor, values in zip(machine.sensors, outputs.T, strict=True):
        if not sensor.of_position:
            continue
        for ending, (largest, suspect) in _LARGEST.items():
            if sensor.channel.endswith(ending):
                implausible = np.abs(np.nan_to_num(values)) > largest
                if implausible.sum() > _OUTLIERS * np.isfinite(values).sum():
                    cell = cell_text(path, sensor.channel, values, int(np.argmax(implausible)))
                    raise WrongUnitError(f"{cell} cannot be {ending[1:]}", (sensor.channel,), suspect)
        coordinate = machine.coordinate(sensor.coordinate)
        if coordinate.range is not None and np.isfinite(values).any():
            span, range_length = np.ptp(_without_extremes(values)), coordinate.range[1] - coordinate.range[0]
            if span > _MAX_SPAN * range_length:
                unit, suspect = ("m", "mm") if coordinate.kind == "linear" else ("rad", "deg")
                limit = (
                    f"the range of {coordinate.name} in the machine file is "
                    f"{range_length:.4g} {unit} (correct it, or leave it out, if the machine moves that far)"
                )
                problem = f"{path}, column {sensor.channel}: moves by {span:.4g} {unit}, but {limit}"
                raise WrongUnitError(problem, (sensor.channel,), suspect)
    ratio = _pulley_travel_ratio(outputs, machine)
    if ratio is None:
        return
    for kind, factor, limits, suspect in (
        ("rotary", ratio, _DEGREES, "deg"),
        ("linear", 1 / ratio if ratio else np.inf, _MILLIMETERS, "mm"),
    ):
        if limits[0] < factor < limits[1]:
            positions = [s for s in machine.sensors if s.of_position]
            channels = tuple(s.channel for s in positions if machine.coordinate(s.coordinate).kind == kind)
            problem = (
                f"{path}, columns {', '.join(channels)}: {factor:.0f} times the travel that the belts allow"
            )
            raise WrongUnitError(problem, channels, suspect)


def _without_extremes(values: Array) -> Array:
    """Return the measured values, limited to the range that all but the possible outliers have."""
    measured = values[np.isfinite(values)]
    low = np.quantile(measured, _OUTLIERS / 2, method="lower")
    high = np.quantile(measured, 1 - _OUTLIERS / 2, method="higher")
    return np.clip(measured, low, high)


def _pulley_travel_ratio(outputs: Array, machine: Machine) -> float | None:
    """Return the ratio of measured to expected pulley travel, or None if the carriage did not move.

    The expected travel follows from the measured motion of the carriage and unstretched belts.
    """
    column_of = {s.coordinate: j for j, s in enumerate(machine.sensors) if len(s.row) == 1 and s.of_position}
    expected, measured = 0.0, 0.0  # m, summed standard deviations
    for belt in machine.belts:
        rotary = [c for c in belt.extension if machine.coordinate(c).kind == "rotary"]
        if len(rotary) != 1 or any(c not in column_of for c in belt.extension):
            continue
        pulley = rotary[0]
        angle = outputs[:, column_of[pulley]]
        pulley_travel = angle * machine.coordinate(pulley).radius * belt.extension[pulley]
        others = {c: factor for c, factor in belt.extension.items() if c != pulley}
        carriage_travel = sum(factor * outputs[:, column_of[c]] for c, factor in others.items())
        rows = np.isfinite(pulley_travel + carriage_travel)
        if rows.sum() > 2:
            expected += float(np.std(_without_extremes(np.asarray(carriage_travel)[rows])))
            measured += float(np.std(_without_extremes(pulley_travel[rows])))
    return measured / expected if expected > _MOVED else None
