"""Components of a machine: coordinates, belts, drives and sensors, with the units of their parameters."""

from __future__ import annotations

import dataclasses
import inspect
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import Any, ClassVar, Literal, cast, get_args

import numpy as np
from numpy.typing import ArrayLike
from typing_extensions import override

from ..arrays import Array
from ..errors import InputError
from ..registry import Registry
from .effect import AppliedEffect, Effect

Row = Mapping[str, float]
CoordinateKind = Literal["linear", "rotary"]
SensorQuantity = Literal["position", "speed", "acceleration", "current"]

# Units of the quantities of a coordinate, by its kind. An effect states the unit of a parameter by one of these keys,
# because it is N at a carriage and Nm at a pulley, for example. Two keys need an explanation: "absolute position" is a
# place, such as that of a magnet, whereas "position" is a distance, such as a period, which a search scales by the
# typical travel; "rad/position" is a phase per position.
UNITS: dict[CoordinateKind, dict[str, str]] = {
    "linear": {
        "position": "m",
        "absolute position": "m",
        "speed": "m/s",
        "mass": "kg",
        "force": "N",
        "viscous": "Ns/m",
        "stiffness": "N/m",
        "drag": "Ns^2/m^2",
        "rad/position": "rad/m",
        "acceleration": "m/s^2",
        "s/position": "s/m",
    },
    "rotary": {
        "position": "rad",
        "absolute position": "rad",
        "speed": "rad/s",
        "mass": "kg m^2",
        "force": "Nm",
        "viscous": "Nms",
        "stiffness": "Nm/rad",
        "drag": "Nms^2",
        "rad/position": "1",
        "acceleration": "rad/s^2",
        "s/position": "s/rad",
    },
}
# Units of parameters that are the same for linear and rotary coordinates.
FIXED_UNITS = {
    "radius": "m",
    "EA": "N",
    "rest_length": "m",
    "Kt": "Nm/A",
    "Ke": "Vs/rad",
    "resistance": "ohm",
    "gear_ratio": "1",
    "rated_voltage": "V",
    "converter_bits": "1",
    "voltage_range": "V",
    "voltage": "V",
    "current": "A",
    "torque": "Nm",
}


@dataclass(frozen=True)
class Coordinate:
    """One degree of freedom of the machine.

    Attributes:
        name: Name by which belts, drives, sensors and effects refer to the coordinate.
        mass: Moving mass, kg, or moment of inertia, kg m^2.
        viscous: Viscous friction coefficient, Ns/m or Nms.
        coulomb: Coulomb friction force, N, or torque, Nm.
        kind: "linear" (a carriage) or "rotary" (a pulley).
        radius: Pitch radius of the pulley, m. It has no meaning for a linear coordinate. If no belt runs on a rotary
            one, it does not influence the motion, and `ARM` is a choice as good as any.
        range: Lowest and highest position, m or rad. None if the coordinate is not limited.
    """

    PARAMETERS: ClassVar[tuple[str, ...]] = ("mass", "viscous", "coulomb", "radius")

    name: str
    mass: float
    viscous: float = 0.0
    coulomb: float = 0.0
    kind: CoordinateKind = "linear"
    radius: float = 1.0
    range: tuple[float, float] | None = None

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of the parameters that can be identified or randomized."""
        return self.PARAMETERS

    @property
    def parameter_values(self) -> dict[str, float]:
        """Values of the parameters that can be identified or randomized, SI, by name."""
        return {name: getattr(self, name) for name in self.PARAMETERS}

    @property
    def travel_per_unit(self) -> float:
        """Belt travel per unit of position: for a pulley its radius, m/rad; for a linear coordinate 1."""
        return self.radius if self.kind == "rotary" else 1.0

    def unit(self, quantity: str) -> str:
        """Return the unit of a quantity at this coordinate: m, N, ... at a linear one, rad, Nm, ... at a rotary one.

        Args:
            quantity: A parameter of the coordinate ("mass", "viscous", "coulomb" or "radius"), or a key of `UNITS`,
                such as "position", "speed", "force", "stiffness", "drag" (force per squared speed) or "rad/position"
                (a phase per position). Keys of `FIXED_UNITS`, such as "voltage", have one unit at all coordinates.

        Raises:
            KeyError: If the quantity is none of these.
        """
        if quantity in FIXED_UNITS:
            return FIXED_UNITS[quantity]
        return UNITS[self.kind]["force" if quantity == "coulomb" else quantity]


@dataclass(frozen=True)
class Belt:
    """One elastic belt section.

    The belt travel p of a coordinate is its position (linear, m) or radius * angle (rotary, m). The extension of the
    section is s = sum(extension[c] * p[c]), m, and its stiffness k = EA / (rest_length + sum(length[c] * p[c])), N/m
    (eq. 38-44 of Sollmann et al. 2010).

    Attributes:
        name: Name of the section.
        EA: Axial stiffness, Young's modulus times cross section, N.
        rest_length: Unstretched length at zero travel, m.
        extension: Extension per belt travel, m/m, by coordinate name.
        length: Change of the section's unstretched length per belt travel, m/m, by coordinate name: a carriage that
            moves along the belt lengthens the section on one side of it. Empty for a section of constant stiffness.
    """

    PARAMETERS: ClassVar[tuple[str, ...]] = ("EA", "rest_length")

    name: str
    EA: float
    rest_length: float
    extension: Row
    length: Row = field(default_factory=dict)

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of the parameters that can be identified or randomized."""
        return self.PARAMETERS

    @property
    def parameter_values(self) -> dict[str, float]:
        """Values of the parameters that can be identified or randomized, SI, by name."""
        return {name: getattr(self, name) for name in self.PARAMETERS}


class DriveKind:
    """Base class of drive kinds: what the command of a drive is, and what the drive makes of it.

    A kind is a subclass that registers itself with `@DRIVE_KINDS.register("name")`. Kinds are never instantiated. The
    current that a command causes is (command - Ke * gear_ratio * w) / resistance, where a drive that controls its
    current has Ke 0 and resistance 1: its amplifier supplies whatever voltage is necessary. A kind with a `law` has
    another relation between command, motion and torque, for example the controller of a servo.

    Attributes:
        command: Quantity of the command in simulations: "voltage", "current", "torque" (of the motor shaft), or the
            "position" or "speed" of the coordinate.
        fraction: Whether recordings have the command as a fraction of the supply voltage, from -1 to 1.
        parameters: Parameters of a drive of this kind, without those of the law, that can be identified or randomized.
        fixed: Values of the parameters that a drive of this kind does not have.
        law: Torque of the motor shaft, Nm, as the formula `current` of an effect on a drive, which may have a state
            (`Effect`). None: the motor's equation above.
        defaults: Values of the law's parameters that a drive need not state; at its default, a parameter has no
            influence, and it is not identified.
        largest: Parameter of the law that is the largest torque, Nm.
        unit_of_force: Parameter of the law in proportion to which all torques are. Motion alone does not determine it:
            with all masses and friction forces in the same proportion, the motion is the same.
    """

    command: ClassVar[str] = "voltage"
    fraction: ClassVar[bool] = False
    parameters: ClassVar[tuple[str, ...]] = ("Kt", "Ke", "resistance", "gear_ratio")
    fixed: ClassVar[Mapping[str, float]] = {}
    law: ClassVar[Effect | None] = None
    defaults: ClassVar[Mapping[str, float]] = {}
    largest: ClassVar[str] = ""
    unit_of_force: ClassVar[str] = ""

    @classmethod
    def damping(cls, gear_ratio: Any, law_parameters: Mapping[str, Any]) -> Any:
        """Return how much a force of the law falls per speed of the coordinate within its limits, Ns/m or Nms.

        The integrator solves this part of the law exactly, so that a stiff loop needs no short steps.

        Args:
            gear_ratio: Gear ratio of the drive, rad/m or rad/rad: float, array of any shape or expression.
            law_parameters: Values of the parameters of the law, SI, of the same type.
        """
        return 0.0

    @classmethod
    def largest_jump(cls, gear_ratio: float, law_parameters: Mapping[str, float]) -> float:
        """Return by how much a commanded position may change at once, in the coordinate's unit.

        Args:
            gear_ratio: Gear ratio of the drive, rad/m or rad/rad.
            law_parameters: Values of the parameters of the law, SI.

        Returns:
            The change, m or rad, beyond which the drive does not follow; infinite if it always does.
        """
        return math.inf

    @classmethod
    def rated(cls) -> str:
        """Return the field of machine.json that states the command of an action of 1, for example rated_voltage."""
        return f"rated_{cls.command}"

    @classmethod
    def unit(cls, coordinate: CoordinateKind) -> str:
        """Return the unit of the command of a drive that moves a coordinate of a kind."""
        return FIXED_UNITS.get(cls.command) or UNITS[coordinate][cls.command]

    @classmethod
    def units_of_law(cls, coordinate: CoordinateKind) -> dict[str, str]:
        """Return the unit of each parameter of the law, for a drive that moves a coordinate of a kind."""
        known = FIXED_UNITS | UNITS[coordinate]
        return {p.name: known.get(p.unit, p.unit) for p in cls.law.parameters} if cls.law else {}


DRIVE_KINDS: Registry[type[DriveKind]] = Registry("drive kind", package="hframe_gym.drives")


@DRIVE_KINDS.register("voltage")
class VoltageDrive(DriveKind):
    """An amplifier or bridge that applies a voltage to the motor."""


@DRIVE_KINDS.register("duty-cycle")
class DutyCycleDrive(DriveKind):
    """A bridge whose recorded command is a duty cycle, from -1 to 1: the voltage is that fraction of the supply's.

    Reading a recording multiplies the duty cycle by the measured supply (`Drive.supply`), or by the rated voltage in a
    recording without that column. Everything else knows voltages only.
    """

    fraction = True


@DRIVE_KINDS.register("current")
class CurrentDrive(DriveKind):
    """An amplifier that controls the current of the motor; its bandwidth and limit are effects of the drive."""

    command = "current"
    parameters = ("Kt", "gear_ratio")
    fixed: ClassVar[Mapping[str, float]] = {"Ke": 0.0, "resistance": 1.0}


@DRIVE_KINDS.register("torque")
class TorqueDrive(DriveKind):
    """A drive that controls the torque of the motor shaft; its bandwidth and limit are effects of the drive.

    Its torque constant is 1: the true torque per commanded torque, which identification may correct.
    """

    command = "torque"
    parameters = ("Kt", "gear_ratio")
    fixed: ClassVar[Mapping[str, float]] = {"Ke": 0.0, "resistance": 1.0}


@dataclass(frozen=True)
class DriveLaw(AppliedEffect):
    """The law of a drive, which acts like an effect on it; its parameters are parameters of the drive."""

    @property
    @override
    def label(self) -> str:
        return self.site


@dataclass(frozen=True)
class Drive:
    """A DC motor with a gear that drives one coordinate.

    With the voltage V, the resistance R and the speed w of the coordinate (rad/s or m/s), the torque (Nm) or force (N)
    on the coordinate is gear_ratio * Kt/R * (V - Ke * gear_ratio * w): eq. 17 of Sollmann et al. (2010) with the gear
    ratio that it omits.

    Attributes:
        name: Name of the drive.
        channel: Column of the recordings that holds its command, for example v1_V.
        coordinate: Name of the coordinate that it moves.
        Kt: Torque constant, Nm/A.
        Ke: Back-EMF constant, Vs/rad.
        resistance: Resistance of the armature, ohm.
        gear_ratio: Angle of the motor shaft per unit of the coordinate, rad/rad or rad/m.
        rated_voltage: Rated voltage, V.
        converter_bits: Resolution of the digital-to-analog converter; 0 for a continuous voltage.
        voltage_range: Largest voltage of the converter in either direction, V. None for the rated voltage.
        kind: Name in `DRIVE_KINDS`. `rated_voltage` and `voltage_range` are in the unit of its command: currents, A, or
            torques, Nm, for the kinds "current" and "torque"; m or rad for "position"; m/s or rad/s for "speed".
        supply: Column of the recordings with the measured supply voltage, V, of a drive of the kind "duty-cycle"; "" if
            it is not measured. Drives may share it.
        law_parameters: Values of the parameters of the kind's law by name, SI; those with a default may be left out.

    Raises:
        InputError: If the kind is not registered, or a parameter of its law is missing or unknown.
    """

    name: str
    channel: str
    coordinate: str
    Kt: float
    Ke: float
    resistance: float
    gear_ratio: float
    rated_voltage: float
    converter_bits: int = 0
    voltage_range: float | None = None
    kind: str = "voltage"
    supply: str = ""
    law_parameters: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Complete the parameters of the law by their defaults."""
        kind = DRIVE_KINDS.get(self.kind)
        names = [p.name for p in kind.law.parameters] if kind.law else []
        values = {**kind.defaults, **self.law_parameters}
        if set(values) != set(names):
            takes = f"takes {', '.join(names)}" if names else "has no law"
            given = ", ".join(self.law_parameters) or "nothing"
            raise InputError(f"drive {self.name!r}: the kind {self.kind!r} {takes}, not {given}")
        object.__setattr__(self, "law_parameters", {name: values[name] for name in names})

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of the parameters that can be identified or randomized; the kind determines them."""
        return (*DRIVE_KINDS.get(self.kind).parameters, *self.law_parameters)

    @property
    def parameter_values(self) -> dict[str, float]:
        """Values of the parameters that can be identified or randomized, SI, by name."""
        return {
            name: self.law_parameters[name] if name in self.law_parameters else getattr(self, name)
            for name in self.parameter_names
        }

    def with_values(self, values: Mapping[str, Any]) -> Drive:
        """Return a copy with other values, SI, of attributes and of parameters of the law, by name."""
        law = {name: values.get(name, value) for name, value in self.law_parameters.items()}
        others = {name: value for name, value in values.items() if name not in law}
        return dataclasses.replace(self, law_parameters=law, **others)

    @property
    def law(self) -> DriveLaw | None:
        """Law of the kind with the values of this drive; None if the motor's equation holds."""
        definition = DRIVE_KINDS.get(self.kind).law
        return None if definition is None else DriveLaw(definition, self.name, self.law_parameters)

    @property
    def command(self) -> str:
        """Quantity of the command in simulations, by the kind: "voltage", "current", "torque", "position", "speed"."""
        return DRIVE_KINDS.get(self.kind).command

    @property
    def gain(self) -> float:
        """Force (N/V) or torque (Nm/V) on the coordinate per volt, at standstill: gear_ratio * Kt / resistance.

        Only a scale for a drive with a law: its largest force per rated command.
        """
        if self.law_parameters:
            largest = self.law_parameters[DRIVE_KINDS.get(self.kind).largest]
            return self.gear_ratio * largest / self.rated_voltage
        return self.gear_ratio * self.Kt / self.resistance

    @property
    def emf_constant(self) -> float:
        """Back-EMF per speed of the coordinate (not of the motor shaft): gear_ratio * Ke, Vs/m or Vs/rad."""
        return self.gear_ratio * self.Ke

    @property
    def back_emf(self) -> float:
        """Viscous friction coefficient equivalent to the back-EMF: gear_ratio^2 * Kt * Ke / resistance, Ns/m or Nms."""
        return self.gain * self.emf_constant

    @property
    def damping(self) -> float:
        """Viscous friction coefficient equivalent to the back-EMF or to the law, Ns/m or Nms."""
        if self.law_parameters:
            return DRIVE_KINDS.get(self.kind).damping(self.gear_ratio, self.law_parameters)  # type: ignore[no-any-return]
        return self.back_emf

    @property
    def device_parameters(self) -> dict[str, float]:
        """Parameters of the digital-to-analog converter by name; they do not enter the equations of motion.

        They are `converter_bits`, the number of bits (0: continuous voltage), and `voltage_range`, the largest voltage
        in either direction, V (by default the rated voltage).
        """
        limit = self.rated_voltage if self.voltage_range is None else self.voltage_range
        return {"converter_bits": self.converter_bits, "voltage_range": limit}


class SensorKind:
    """Base class of sensor kinds, such as encoders: what a sensor measures, as a formula of the motion.

    A kind is a subclass that registers itself with `@SENSOR_KINDS.register("name")`. Kinds are never instantiated.
    Simulation, linearization, state estimation, environments, identification and checks all read the formula `signal`.

    Attributes:
        incremental: Whether the sensor counts increments from its position at power-on. Its zero is then unknown, and
            elastic belts may lie between it and the tool.
        has_offset: Whether the measurements have an unknown constant offset, as those of an accelerometer do, which
            also feels gravity. Comparisons with a simulation then ignore the mean of the difference.
        turn: Size of the range after which the measurement begins anew, in the channel's unit; None if it does not.
    """

    incremental: ClassVar[bool] = False
    has_offset: ClassVar[bool] = False
    turn: ClassVar[float | None] = None

    @staticmethod
    def signal(position: Any) -> Any:
        """Compute the ideal measurement (without noise and rounding) from the quantity that the sensor responds to.

        The name of the argument selects the quantity: "position", "speed" or "acceleration" is the sum of the sensor's
        coefficients (`Sensor.row`) times those of the coordinates (m, rad; per second; per second squared); "current"
        is the sum of coefficients times the currents of the drives, A. A formula uses the operators + - * / and abs.

        Args:
            position: The quantity: float, array of any shape or symbolic expression.

        Returns:
            Ideal measurement in the unit of the quantity, of the same shape.
        """
        return position

    @classmethod
    def quantity(cls) -> SensorQuantity:
        """Return the quantity to which sensors of this kind respond, the name of the argument of `signal`.

        Raises:
            ValueError: If the argument has another name than one of the quantities.
        """
        return _quantity_of(cls.signal)

    @classmethod
    def has_direction(cls) -> bool:
        """Return whether the ideal measurement changes its sign with the quantity; an absolute value does not."""
        return bool(cls.signal(-1.0) == -cls.signal(1.0))

    @staticmethod
    def measure(reading: Array, noise: ArrayLike, resolution: ArrayLike, normal: ArrayLike) -> Array:
        """Convert ideal readings to measurements, m or rad: add noise, then round; the shapes broadcast.

        Args:
            reading: Ideal (noise-free, continuous) readings, m or rad, any shape.
            noise: Standard deviation of the noise, m or rad, any shape.
            resolution: Quantization step of the sensor, m or rad, any shape; 0 for a continuous sensor.
            normal: Samples of the standard normal distribution, dimensionless, any shape; they are multiplied
                by `noise`.
        """
        value = np.asarray(reading + np.asarray(noise) * normal)
        quantum = np.broadcast_to(np.asarray(resolution, float), value.shape)
        return np.where(
            quantum > 0.0, np.rint(value / np.where(quantum > 0.0, quantum, 1.0)) * quantum, value
        )


@cache
def _quantity_of(signal: Callable[[Any], Any]) -> SensorQuantity:
    """Return the quantity that a formula of a sensor kind takes."""
    names = list(inspect.signature(signal).parameters)
    quantities = get_args(SensorQuantity)
    if len(names) != 1 or names[0] not in quantities:
        raise ValueError(
            f"{signal.__qualname__}: has the arguments {names}; it must have one of {quantities}"
        )
    return cast(SensorQuantity, names[0])


SENSOR_KINDS: Registry[type[SensorKind]] = Registry("sensor kind")


@SENSOR_KINDS.register("encoder")
class Encoder(SensorKind):
    """An incremental encoder: it counts increments from its position at power-on, so its zero is unknown."""

    incremental = True


@SENSOR_KINDS.register("laser")
class Laser(SensorKind):
    """A laser distance sensor; it measures the absolute position, so its zero is known."""


@SENSOR_KINDS.register("speed")
class SpeedSensor(SensorKind):
    """A tachometer, or a drive or counter that reports a speed, in m/s or rad/s."""

    @staticmethod
    @override
    def signal(speed: Any) -> Any:
        return speed


@SENSOR_KINDS.register("unsigned-speed")
class UnsignedSpeedSensor(SensorKind):
    """A pulse counter without direction: it reports the absolute value of the speed, in m/s or rad/s."""

    @staticmethod
    @override
    def signal(speed: Any) -> Any:
        return abs(speed)


@SENSOR_KINDS.register("acceleration")
class AccelerationSensor(SensorKind):
    """An accelerometer on a carriage, such as an ADXL345, in m/s^2 or rad/s^2; its offset and gravity are unknown.

    It measures the acceleration just before the sample, under the voltages that have acted until then.
    """

    has_offset = True

    @staticmethod
    @override
    def signal(acceleration: Any) -> Any:
        return acceleration


@SENSOR_KINDS.register("current")
class CurrentSensor(SensorKind):
    """The measured current of a drive, A, just before the sample, under the voltages that have acted until then."""

    @staticmethod
    @override
    def signal(current: Any) -> Any:
        return current


@SENSOR_KINDS.register("absolute-angle")
class AbsoluteAngle(SensorKind):
    """An absolute encoder of one turn: the angle, whose zero is known, begins anew at 0 after 2 pi rad."""

    turn: ClassVar[float] = 2.0 * math.pi

    @staticmethod
    @override
    def measure(reading: Array, noise: ArrayLike, resolution: ArrayLike, normal: ArrayLike) -> Array:
        return np.mod(SensorKind.measure(reading, noise, resolution, normal), AbsoluteAngle.turn)


@dataclass(frozen=True)
class Sensor:
    """One measured channel, which responds to the sum of row[c] * q[c] over the positions q, or to another quantity.

    The kind of the sensor states the quantity: position, speed, acceleration, or current of the drives.

    Attributes:
        channel: Column of the recordings that holds the measurement, for example x_m or phi1_rad.
        row: Coefficient of each coordinate (of each drive for a current), by name. A key may be a product of two
            coordinates: "y*yaw" adds the coefficient times y * yaw to the position.
        noise: Standard deviation of the noise, in the channel's unit.
        resolution: Quantization step, in the channel's unit; 0 for a continuous sensor.
        kind: Name in `SENSOR_KINDS`: "encoder" (incremental position), "laser" (position with a fixed zero), "speed",
            ..., or a kind that a user registered.
        zero: Measurement of an incremental sensor at position 0, in the channel's unit, if it was the same in all
            recordings from which the machine was identified. None: unknown.
        zero_std: Standard deviation of `zero` from recording to recording, in the channel's unit. Belts that friction
            holds stretched at rest cause it. None: `zero` is unknown, or no variation was found.
    """

    channel: str
    row: Row
    noise: float = 0.0
    resolution: float = 0.0
    kind: str = "laser"
    zero: float | None = None
    zero_std: float | None = None

    @property
    def incremental(self) -> bool:
        """Whether the sensor counts increments from its position at power-on; its reading at position 0 is unknown."""
        return SENSOR_KINDS.get(self.kind).incremental

    @property
    def quantity(self) -> SensorQuantity:
        """Quantity to which the sensor responds: "position", "speed", "acceleration" or "current"."""
        return SENSOR_KINDS.get(self.kind).quantity()

    @property
    def of_position(self) -> bool:
        """Whether the sensor measures positions."""
        return self.quantity == "position"

    @property
    def of_velocity(self) -> bool:
        """Whether the sensor measures speeds with their direction."""
        return self.quantity == "speed" and SENSOR_KINDS.get(self.kind).has_direction()

    @property
    def turn(self) -> float | None:
        """Size of the range after which the measurement begins anew, in the channel's unit; None if it does not."""
        return SENSOR_KINDS.get(self.kind).turn

    @property
    def fixed(self) -> bool:
        """Whether the sensor measures positions from a fixed, known zero."""
        return self.of_position and not self.incremental

    @property
    def coordinate(self) -> str:
        """Name of the coordinate that the sensor mainly measures: it has the largest coefficient in `row`.

        The sign of a coefficient does not matter, and products of coordinates ("y*yaw") are ignored.
        """
        return max((name for name in self.row if "*" not in name), key=lambda name: abs(self.row[name]))

    @property
    def device_parameters(self) -> dict[str, float]:
        """Noise and resolution of the sensor by name; they do not enter the equations of motion.

        They are `noise`, its standard deviation, and `resolution`, its quantization step (0: continuous), m or rad.
        """
        return {"noise": self.noise, "resolution": self.resolution}


@dataclass(frozen=True)
class Uncertainty:
    """Covariance of the identified parameters of a machine.

    Attributes:
        names: Full names of the k parameters, for example x.mass.
        covariance: Covariance matrix, shape (k, k), in the products of the parameters' units.
    """

    names: tuple[str, ...]
    covariance: Array

    def std(self, name: str) -> float | None:
        """Return the standard deviation of a parameter in its unit, or None if it was not identified."""
        if name not in self.names:
            return None
        index = self.names.index(name)
        return float(np.sqrt(self.covariance[index, index]))

    @property
    def correlation(self) -> Array:
        """Correlation coefficients of the parameters, shape (k, k); 0 with a parameter without variance."""
        std = np.sqrt(np.maximum(np.diag(self.covariance), 1e-300))
        return self.covariance / np.outer(std, std)
