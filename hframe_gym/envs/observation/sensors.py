"""Sensors of an environment: those that the machine declares, or encoders and lasers instead.

The machine declares its sensors (channel, kind, noise, resolution). Their range, delay, skew and scale are
effects (modeled deviations from the basic machine). The option `sensors` uses the declared sensors, or
replaces them by those of a rig (a stage with its measuring equipment). The module `measurements` simulates
them.
"""

from __future__ import annotations

import dataclasses
import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import numpy as np
from typing_extensions import override

from ...arrays import Array, Index
from ...effects import EFFECTS
from ...errors import InputError, is_number, suggestion
from ...machine import Machine, Sensor, observed_coordinates, rest_positions_per_axis


@dataclass(frozen=True)
class Encoders:
    """Incremental encoders on the motor shafts, with angle 0 where x = y = 0.

    Args:
        lines: Lines per turn of the motor shaft, at least 1; quadrature decoding gives four counts per line.
    """

    lines: int = 512

    def __post_init__(self) -> None:
        if not (is_number(self.lines) and self.lines >= 1):
            raise InputError(f"sensors: lines is {self.lines!r}, it must be a number, at least 1")

    def resolution(self, gear_ratio: float) -> float:
        """Compute the pulley's rotation per count, rad; `gear_ratio` is motor speed / pulley speed."""
        return 2.0 * math.pi / (4.0 * self.lines * gear_ratio)


@dataclass(frozen=True)
class Lasers:
    """Laser distance sensors on x and y. Beyond its range a laser returns the end of the range.

    Args:
        span: Length of the measuring range of each axis, m, positive; inf for an unlimited range.
        centre: Middle of the measuring ranges of x and y, m.
        noise: Standard deviation of the noise of each measurement, m, not negative.

    Raises:
        InputError: If a number is invalid.
    """

    span: float = 0.1
    centre: tuple[float, float] = (0.0, 0.0)
    noise: float = 20e-6

    def __post_init__(self) -> None:
        if not (is_number(self.span) or self.span == math.inf) or self.span <= 0.0:
            raise InputError(f"sensors: span is {self.span!r}, it must be a positive number of meters")
        if not (is_number(self.noise) and self.noise >= 0.0):
            raise InputError(
                f"sensors: noise is {self.noise!r}, it must be a number of meters that is not negative"
            )
        if np.shape(self.centre) != (2,) or not all(map(is_number, self.centre)):
            raise InputError(f"sensors: centre is {self.centre!r}, it must be (x, y) in m")


class SensorSuite(ABC):
    """Base class for the option `sensors` of an environment.

    A suite puts its sensors into the machine (`apply`) and selects those in the observation (`observed`).
    """

    @abstractmethod
    def apply(self, machine: Machine) -> Machine:
        """Return a machine that has the sensors of this suite, with their ranges as effects `sensor_range`.

        The argument itself is not changed.
        """

    @abstractmethod
    def observed(self, machine: Machine) -> tuple[Sensor, ...]:
        """Select the sensors of the observation, in its order, from a machine that `apply` returned."""


@dataclass(frozen=True)
class Sensors(SensorSuite):
    """Encoders and lasers of a rig. They replace the declared sensors for x, y and driven coordinates.

    Delay, skew and scale, which are effects of the machine, remain; the range is that of `lasers`.

    Args:
        encoders: Encoders of all driven coordinates; None: not observed.
        lasers: Lasers on x and y; None: not observed.

    Raises:
        InputError: If both are None, or one is of another type.
    """

    encoders: Encoders | None = Encoders()
    lasers: Lasers | None = Lasers()

    def __post_init__(self) -> None:
        for name, kind in (("encoders", Encoders), ("lasers", Lasers)):
            if not isinstance(value := getattr(self, name), kind | None):
                raise InputError(f"sensors: {name} is {value!r}, it must be {kind.__name__}(...) or None")
        if self.encoders is None and self.lasers is None:
            raise InputError(
                "sensors: neither encoders nor lasers; choose sensors='state' for the full state"
            )

    @override
    def apply(self, machine: Machine) -> Machine:
        """Let lasers measure x and y, and encoders the driven coordinates, in place of the declared ones.

        Raises:
            InputError: If a drive acts on x or y itself, which would then have both a laser and an encoder.
        """
        both = [d.coordinate for d in machine.drives if d.coordinate in machine.tool_axes]
        if both and self.encoders is not None and self.lasers is not None:
            raise InputError(
                f"sensors: on machine {machine.name!r} encoder and laser would both measure {both[0]}; "
                "choose sensors='machine', or Sensors with encoders=None or lasers=None"
            )
        if self.encoders is not None:
            for drive in machine.drives:
                resolution = self.encoders.resolution(drive.gear_ratio)
                machine = _with_sensor(
                    machine, drive.coordinate, noise=0.0, resolution=resolution, kind="encoder"
                )
        if self.lasers is not None:
            for axis, middle in zip(machine.tool_axes, self.lasers.centre, strict=False):
                machine = _with_sensor(machine, axis, noise=self.lasers.noise, resolution=0.0, kind="laser")
                low, high = middle - self.lasers.span / 2, middle + self.lasers.span / 2
                machine = _with_range(machine, _sensor_of(machine, axis), low, high)
        return machine

    @override
    def observed(self, machine: Machine) -> tuple[Sensor, ...]:
        """Select the sensors that `apply` has set: by tool axis the lasers, then by drive the encoders."""
        lasers = machine.tool_axes if self.lasers is not None else ()
        encoders = tuple(d.coordinate for d in machine.drives) if self.encoders is not None else ()
        return tuple(
            machine.sensor(_sensor_of(machine, name)) for name in dict.fromkeys((*lasers, *encoders))
        )


@dataclass(frozen=True)
class DeclaredSensors(SensorSuite):
    """Observe all sensors that the machine declares, without changes."""

    @override
    def apply(self, machine: Machine) -> Machine:
        """Return the machine itself, unchanged."""
        return machine

    @override
    def observed(self, machine: Machine) -> tuple[Sensor, ...]:
        """Select all sensors, ordered by coordinate: tool axes, driven coordinates, then all others."""
        first = observed_coordinates(machine)
        order = [*first, *(c for c in machine.coordinate_names if c not in first)]
        return tuple(sorted(machine.sensors, key=lambda s: order.index(machine.coordinate_of_sensor(s))))


SensorsLike: TypeAlias = Literal["state", "rig", "machine"] | SensorSuite
# The rig of Sollmann et al. (2010), section II: encoders with 512 lines on the motor side of a gear of 5.9:1
# and lasers with a range of 100 mm. The paper gives neither their noise nor their position.
SENSOR_PRESETS: dict[str, SensorSuite | None] = {
    "state": None,
    "rig": Sensors(),
    "machine": DeclaredSensors(),
}


def as_sensors(sensors: SensorsLike) -> SensorSuite | None:
    """Convert the environment option `sensors` to a sensor suite.

    Args:
        sensors: "state" (the true state is observed), "rig" (`Sensors()`), "machine" (`DeclaredSensors()`),
            or a suite, which is returned unchanged.

    Returns:
        The suite; None for "state".

    Raises:
        InputError: If the option is anything else.
    """
    if isinstance(sensors, SensorSuite):
        return sensors
    if not isinstance(sensors, str) or sensors not in SENSOR_PRESETS:
        raise InputError(
            f"sensors is {sensors!r}; choose one of {', '.join(SENSOR_PRESETS)}, or, in Python, "
            f"give Sensors(...){suggestion(sensors, SENSOR_PRESETS)}"
        )
    return SENSOR_PRESETS[sensors]


def observed_machine(machine: Machine, sensors: SensorsLike) -> Machine | None:
    """Return a copy of the machine with only the observed sensors, as a state estimator needs it.

    All other sensors and their effects (such as range and delay) are removed. The result is None for the
    option `sensors` "state", with which the true state is observed.
    """
    suite = as_sensors(sensors)
    if suite is None:
        return None
    changed = suite.apply(machine)
    observed = suite.observed(changed)
    others = set(changed.output_channels) - {sensor.channel for sensor in observed}
    return changed.replace(
        sensors=observed, effects=tuple(e for e in changed.effects if e.site not in others)
    )


def _sensor_of(machine: Machine, coordinate: str) -> str:
    """Return the channel of the first sensor of a coordinate's position, or "" if there is none."""
    return next((s.channel for s in machine.sensors if s.of_position and s.coordinate == coordinate), "")


def _with_sensor(machine: Machine, coordinate: str, **fields: Any) -> Machine:
    """Return the machine with other fields of a coordinate's sensor, which is added if it has none."""
    channel = _sensor_of(machine, coordinate)
    if not channel:
        unit = machine.coordinate(coordinate).unit("position")
        return machine.with_components(Sensor(f"{coordinate}_{unit}", {coordinate: 1.0}, **fields))
    return machine.with_components(dataclasses.replace(machine.sensor(channel), **fields))


def _with_range(machine: Machine, channel: str, low: float, high: float) -> Machine:
    """Return the machine with a range of a sensor, in place of one that it has."""
    definition = EFFECTS["sensor_range"]
    limits = {
        "low": max(low, definition.parameter("low").lower),
        "high": min(high, definition.parameter("high").upper),
    }
    effect = definition.at(channel, **limits)
    if f"{effect.label}.low" in machine.parameters:
        return machine.replace({f"{effect.label}.{name}": value for name, value in limits.items()})
    return machine if math.isinf(high - low) else machine.with_effects(effect)


def sensor_range_names(sensor: Sensor) -> tuple[str, str]:
    """Return the names of the parameters (low, high) of a sensor's range, "sensor_range@x_m.low"."""
    return f"sensor_range@{sensor.channel}.low", f"sensor_range@{sensor.channel}.high"


@dataclass(frozen=True)
class PositionFromSensors:
    """Map the measurements of n sensors to the tool position.

    Attributes:
        belts: Matrix from the n measurements to the tool position (m or rad) with unstretched belts,
            shape (axes, n). It uses the sensors of other coordinates (encoders); zero where these do not
            determine the axis.
        direct: Index of the sensor that measures each axis itself, -1 if there is none, shape (axes,).
        scale: Factor from the measurement of the sensor `direct` to the tool position (m or rad), 1 if there
            is none, shape (axes,).
    """

    belts: Array
    direct: Index
    scale: Array

    @classmethod
    def of(cls, machine: Machine, sensors: tuple[Sensor, ...]) -> PositionFromSensors:
        """Derive how the tool position follows from the measurements, with unstretched belts.

        The position of an axis comes from a sensor of this axis and from the sensors of other coordinates
        (encoders); more of the latter than axes are combined by least squares. Sensors that do not measure a
        position, or whose angle begins anew after each turn, are not used.

        Raises:
            InputError: If the sensors do not determine every axis.
        """
        axes = machine.tool_axes
        # Where an angle begins anew after each turn, it does not tell the position of the tool.
        usable = [s.of_position and s.turn is None for s in sensors]
        direct, scale = np.full(len(axes), -1, np.intp), np.ones(len(axes))
        for axis, name in enumerate(axes):
            for j, sensor in enumerate(sensors):
                if usable[j] and sensor.coordinate == name and direct[axis] < 0:
                    direct[axis], scale[axis] = j, 1.0 / sensor.row[name]
        belts = np.zeros((len(axes), len(sensors)))
        others = [j for j, sensor in enumerate(sensors) if usable[j] and sensor.coordinate not in axes]
        if others:
            rows = np.array(
                [machine.sensor_matrix[machine.output_channels.index(sensors[j].channel)] for j in others]
            )
            # Measurements per meter of each axis, (others, axes).
            per_position = rows @ rest_positions_per_axis(machine)
            if np.linalg.matrix_rank(per_position) == len(axes):
                # More sensors than axes determine the position by least squares.
                belts[:, others] = (np.linalg.inv if len(others) == len(axes) else np.linalg.pinv)(
                    per_position
                )
        for axis, name in enumerate(axes):
            if direct[axis] < 0 and not belts[axis].any():
                channels = ", ".join(sensor.channel for sensor in sensors) or "none"
                raise InputError(
                    f"sensors: the measurements of machine {machine.name!r} ({channels}) "
                    f"do not determine {name}; declare a sensor of it, or choose sensors='state'"
                )
        return cls(belts, direct, scale)
