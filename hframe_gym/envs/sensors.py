"""Sensors of an environment: the machine's, as declared or changed to those of a rig.

The machine declares its sensors (channel, kind, noise, resolution; their range, delay, skew and scale are effects). The
option `sensors` uses them as they are, or first changes them to those of a rig. `measurements` simulates them.
"""

from __future__ import annotations

import dataclasses
import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..effects import EFFECTS
from ..errors import InputError
from ..machine import Machine, Sensor, rest_state

Array = NDArray[np.float64]
Index = NDArray[np.intp]


@dataclass(frozen=True)
class Encoders:
    """Incremental encoders on the shafts of the motors, homed where x = y = 0.

    Args:
        lines: Lines per motor turn; read in quadrature, four counts per line.
    """

    lines: int = 512

    def __post_init__(self) -> None:
        if not self.lines >= 1:
            raise InputError(f"sensors: lines is {self.lines!r}, it must be at least 1")

    def quantum(self, gear_ratio: float) -> float:
        """Return the angle of one count behind a gear.

        Args:
            gear_ratio: Turns of the motor per turn of the pulley.

        Returns:
            Angle, rad.
        """
        return 2.0 * math.pi / (4.0 * self.lines * gear_ratio)


@dataclass(frozen=True)
class Lasers:
    """Laser distance sensors on x and y. Beyond its range a laser shows the end of the range.

    Args:
        span: Length of the range, m; inf for an unlimited one.
        centre: Middle (x, y) of the range, m.
        noise: Standard deviation of the noise of each measurement, m.
    """

    span: float = 0.1
    centre: tuple[float, float] = (0.0, 0.0)
    noise: float = 20e-6

    def __post_init__(self) -> None:
        if not self.span > 0.0:
            raise InputError(f"sensors: span is {self.span!r}, it must be a positive number of meters")
        if not (math.isfinite(self.noise) and self.noise >= 0.0):
            raise InputError(f"sensors: noise is {self.noise!r}, it must be a number of meters that is not negative")
        if len(self.centre) != 2 or not all(map(math.isfinite, self.centre)):
            raise InputError(f"sensors: centre is {self.centre!r}, it must be (x, y) in m")


class SensorSuite(ABC):
    """Which sensors an environment has: how the machine's declaration changes, and what of it is observed."""

    @abstractmethod
    def apply(self, machine: Machine) -> Machine:
        """Declare these sensors.

        Args:
            machine: The machine.

        Returns:
            The machine with these sensors declared.
        """

    @abstractmethod
    def observed(self, machine: Machine) -> tuple[Sensor, ...]:
        """Return the sensors that an environment observes.

        Args:
            machine: A machine from `apply`.

        Returns:
            Sensors in the order of the observation.
        """


@dataclass(frozen=True)
class Sensors(SensorSuite):
    """Encoders and lasers of a rig, in place of what the machine declares for x, y and the driven coordinates.

    Effects at these channels that identification found (delay, skew, scale) stay; the range is that of `lasers`.

    Args:
        encoders: The encoders, or None for none.
        lasers: The lasers, or None for none.

    Raises:
        InputError: If there is neither.
    """

    encoders: Encoders | None = Encoders()
    lasers: Lasers | None = Lasers()

    def __post_init__(self) -> None:
        if self.encoders is None and self.lasers is None:
            raise InputError("sensors: neither encoders nor lasers; choose sensors='state' for the full state")

    def apply(self, machine: Machine) -> Machine:
        """Return the machine with this noise, resolution and range of x, y and the driven coordinates."""
        if self.encoders is not None:
            for drive in machine.drives:
                quantum = self.encoders.quantum(drive.gear_ratio)
                machine = _with_sensor(machine, drive.coordinate, noise=0.0, resolution=quantum, kind="encoder")
        if self.lasers is not None:
            for axis, middle in zip(("x", "y"), self.lasers.centre, strict=True):
                machine = _with_sensor(machine, axis, noise=self.lasers.noise, resolution=0.0, kind="laser")
                low, high = middle - self.lasers.span / 2, middle + self.lasers.span / 2
                machine = _with_range(machine, _sensor_of(machine, axis), low, high)
        return machine

    def observed(self, machine: Machine) -> tuple[Sensor, ...]:
        """Return the sensors of x and y, then those of the driven coordinates."""
        lasers = ("x", "y") if self.lasers is not None else ()
        encoders = tuple(d.coordinate for d in machine.drives) if self.encoders is not None else ()
        return tuple(machine.sensor(_sensor_of(machine, name)) for name in dict.fromkeys((*lasers, *encoders)))


@dataclass(frozen=True)
class DeclaredSensors(SensorSuite):
    """The sensors that the machine declares, as they are."""

    def apply(self, machine: Machine) -> Machine:
        """Return the machine unchanged."""
        return machine

    def observed(self, machine: Machine) -> tuple[Sensor, ...]:
        """Return all sensors: those of x, of y, of the driven coordinates, then the others."""
        first = ["x", "y", *(d.coordinate for d in machine.drives)]
        order = [*first, *(c for c in machine.coordinate_names if c not in first)]
        return tuple(sorted(machine.sensors, key=lambda sensor: order.index(sensor.coordinate)))


SensorsLike: TypeAlias = Literal["state", "rig", "machine"] | SensorSuite
# The paper's rig (section II): 512 lines before a gear of 5.9:1 and lasers with a range of 100 mm. The paper gives
# neither their noise nor their position.
SENSOR_PRESETS: dict[str, SensorSuite | None] = {"state": None, "rig": Sensors(), "machine": DeclaredSensors()}


def as_sensors(sensors: SensorsLike) -> SensorSuite | None:
    """Return the sensors of the option `sensors`.

    Args:
        sensors: Name of a preset, or sensors.

    Returns:
        The sensors; None for the full state.

    Raises:
        InputError: If the name is unknown or the object is of another type.
    """
    if isinstance(sensors, SensorSuite):
        return sensors
    if not isinstance(sensors, str) or sensors not in SENSOR_PRESETS:
        raise InputError(f"sensors is {sensors!r}; choose one of {', '.join(SENSOR_PRESETS)}, or give Sensors(...)")
    return SENSOR_PRESETS[sensors]


def observed_machine(machine: Machine, sensors: SensorsLike) -> Machine | None:
    """Return the machine whose declared sensors are those that an environment observes.

    Args:
        machine: The machine.
        sensors: The option `sensors`.

    Returns:
        A machine with these sensors in the order of the observation, with their ranges and delays as effects; None for
        the full state.

    Raises:
        InputError: If the option is invalid.
    """
    suite = as_sensors(sensors)
    if suite is None:
        return None
    changed = suite.apply(machine)
    observed = suite.observed(changed)
    others = set(changed.output_channels) - {sensor.channel for sensor in observed}
    return changed.replace(sensors=observed, effects=tuple(e for e in changed.effects if e.site not in others))


def _sensor_of(machine: Machine, coordinate: str) -> str:
    """Return the channel of the first sensor of a coordinate, or "" if there is none."""
    return next((s.channel for s in machine.sensors if s.coordinate == coordinate), "")


def _with_sensor(machine: Machine, coordinate: str, **fields: Any) -> Machine:
    """Return the machine with other fields of a coordinate's sensor, which is added if it has none."""
    channel = _sensor_of(machine, coordinate)
    if not channel:
        unit = machine.coordinate(coordinate).unit("position")
        added = Sensor(f"{coordinate}_{unit}", {coordinate: 1.0}, **fields)
        return machine.replace(sensors=(*machine.sensors, added))
    changed = [dataclasses.replace(s, **fields) if s.channel == channel else s for s in machine.sensors]
    return machine.replace(sensors=tuple(changed))


def _with_range(machine: Machine, channel: str, low: float, high: float) -> Machine:
    """Return the machine with a range of a sensor, in place of one that it has."""
    definition = EFFECTS["sensor_range"]
    bounds = {p.name: (p.lower, p.upper) for p in definition.parameters}
    limits = {"low": max(low, bounds["low"][0]), "high": min(high, bounds["high"][1])}
    effect = definition.at(channel, **limits)
    if f"{effect.label}.low" in machine.parameters:
        return machine.replace({f"{effect.label}.{name}": value for name, value in limits.items()})
    return machine if math.isinf(high - low) else machine.with_effects(effect)


def sensor_range_names(sensor: Sensor) -> tuple[str, str]:
    """Return the full names of the range of a sensor.

    Args:
        sensor: The sensor.

    Returns:
        Names of the parameters of its effect `sensor_range`: lower and upper end.
    """
    return f"sensor_range@{sensor.channel}.low", f"sensor_range@{sensor.channel}.high"


@dataclass(frozen=True)
class PositionFromSensors:
    """How the tool position follows from the measurements of n sensors.

    Attributes:
        belts: x and y per measurement on unstretched belts, shape (2, n); zero where the sensors do not determine it.
        direct: Index of a sensor that measures x, and of one that measures y; -1 for none. Shape (2,).
        scale: Tool position per measurement of these sensors, shape (2,).
    """

    belts: Array
    direct: Index
    scale: Array

    @classmethod
    def of(cls, machine: Machine, sensors: tuple[Sensor, ...]) -> PositionFromSensors:
        """Derive the map from the machine's nominal kinematics.

        Args:
            machine: The machine.
            sensors: The observed sensors.

        Returns:
            The map.

        Raises:
            InputError: If the sensors do not determine x or y.
        """
        direct, scale = np.full(2, -1, np.intp), np.ones(2)
        for axis, name in enumerate(("x", "y")):
            for j, sensor in enumerate(sensors):
                if sensor.coordinate == name and direct[axis] < 0:
                    direct[axis], scale[axis] = j, 1.0 / sensor.row[name]
        belts = np.zeros((2, len(sensors)))
        others = [j for j, sensor in enumerate(sensors) if sensor.coordinate not in ("x", "y")]
        if others:
            rows = np.array([machine.sensor_matrix[machine.output_channels.index(sensors[j].channel)] for j in others])
            linear = [c.name for c in machine.coordinates if c.kind == "linear"]
            count = len(machine.coordinates)
            unit = [rest_state(machine, [float(c == axis) for c in linear])[:count] for axis in ("x", "y")]
            per_position = rows @ np.stack(unit, axis=1)  # measurements per meter of x and of y, (others, 2)
            if len(others) == 2 and np.linalg.matrix_rank(per_position) == 2:
                belts[:, others] = np.linalg.inv(per_position)
            elif np.linalg.matrix_rank(per_position) == 2:
                belts[:, others] = np.linalg.pinv(per_position)
        for axis, name in enumerate(("x", "y")):
            if direct[axis] < 0 and not belts[axis].any():
                channels = ", ".join(sensor.channel for sensor in sensors) or "none"
                raise InputError(
                    f"sensors: the measurements of machine {machine.name!r} ({channels}) do not determine {name}; "
                    "declare a sensor of it, or choose sensors='state'"
                )
        return cls(belts, direct, scale)
