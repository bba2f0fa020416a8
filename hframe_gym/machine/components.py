"""Components of a machine: coordinates, belts, drives and sensors.

Each attribute is declared once, here: its type, unit and bounds in the class, its meaning in the docstring.
The fields of machine.json and the parameters of the machine follow (`declaration`).
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, ClassVar

from typing_extensions import override

from ..errors import InputError
from ..registry import Registry
from .axis_unit import ARM
from .declaration import FIXED_UNITS, LARGEST, UNITS, Component, CoordinateKind, Number, Plain, Variant
from .drive_kinds import DRIVE_KINDS, DriveLaw
from .sensed_quantities import SENSED_QUANTITIES, SensedQuantity, SensorQuantity
from .sensor_kinds import SENSOR_KINDS

Row = Mapping[str, float]


@dataclass(frozen=True)
class Coordinate(Component):
    """One coordinate (degree of freedom) of the machine.

    Attributes:
        name: Name by which belts, drives, sensors and effects refer to the coordinate. The linear coordinates
            are the axes of the tool in the environment, in the order of the file, whatever their names.
            Without linear ones, the rotary coordinates are, one for each drive.
        mass: Everything that moves with the coordinate: mass, kg, or moment of inertia, kg m^2. The rotor of
            a motor behind a gear counts gear_ratio^2 times its inertia.
        viscous: Viscous friction coefficient, Ns/m or Nms (per rad/s). Without the back-EMF of the motor.
        coulomb: Coulomb friction, N or Nm.
        kind: "linear" (a carriage, positions in m) or "rotary" (a pulley, angles in rad).
        radius: Pitch radius of the pulley, m. A rotary coordinate on which a belt runs needs it, a linear one
            has none. If no belt runs on it (a motor, a servo with an arm), leave it out: it has no influence
            on the motion. Default in a file: 0.1 m.
        range: Lowest and highest position [low, high], m or rad. Default: unlimited. The environment needs
            the ranges of linear coordinates, which are its workspace; that of a rotary axis without a range
            is one turn to either side of zero.
    """

    name: Annotated[str, Plain("name")]
    mass: Annotated[float, Number("mass", role="parameter")]
    viscous: Annotated[float, Number("viscous", lower=0.0, role="parameter")] = 0.0
    coulomb: Annotated[float, Number("force", lower=0.0, role="parameter")] = 0.0
    kind: Annotated[CoordinateKind, Plain("text")] = "linear"
    radius: Annotated[float, Number("m", role="parameter", plausible=1.0)] = 1.0
    range: Annotated[tuple[float, float] | None, Number("position", -LARGEST, plausible=10.0)] = None

    @classmethod
    @override
    def variant(cls, coordinate: CoordinateKind, kind: str = "") -> Variant:
        absent = {"radius": 1.0} if coordinate == "linear" else {}
        defaults = {} if coordinate == "linear" else {"radius": ARM}
        return Variant(f"a {coordinate} coordinate", UNITS[coordinate], absent, defaults)

    @property
    def travel_per_unit(self) -> float:
        """Belt travel per unit of position: for a pulley its radius, m/rad; for a linear coordinate 1."""
        return self.radius if self.kind == "rotary" else 1.0

    def unit(self, quantity: str) -> str:
        """Return a quantity's unit at this coordinate: m, N, ... if linear, rad, Nm, ... if rotary.

        Args:
            quantity: A parameter of the coordinate ("mass", "viscous", "coulomb" or "radius"), or a key of
                `UNITS`, such as "position", "speed", "force", "stiffness", "drag" (force per squared speed)
                or "rad/position" (a phase per position). Keys of `FIXED_UNITS`, such as "voltage", have one
                unit at all coordinates.

        Raises:
            KeyError: If the quantity is none of these.
        """
        units = FIXED_UNITS | UNITS[self.kind]
        declared = self.numbers().get(quantity)
        return units[quantity] if declared is None else units.get(declared.unit, declared.unit)


@dataclass(frozen=True)
class Belt(Component):
    """One belt section.

    The travel p of a coordinate is its position (linear), or its angle times its radius (rotary), in m. The
    section has the extension s = sum(extension[c] * p[c]), m, the stiffness k = EA / (rest_length +
    sum(length[c] * p[c])), N/m, and the force k s (eq. 38-44 of Sollmann et al. 2010).

    Attributes:
        name: Name of the belt section.
        EA: Axial stiffness: Young's modulus times cross-section area, N. It is the force that would double
            the length.
        rest_length: Length of the section with all coordinates at zero, m.
        extension: Extension of the section per travel, m/m, by name of the coordinate. It is positive if a
            positive motion of this coordinate alone stretches the section. A pulley usually has 1 or -1; its
            radius is not part of it.
        length: Change of the section's unstretched length per travel, m/m, by name of the coordinate: a
            carriage that moves along the belt lengthens the section on one side of it. Usually the factors of
            the carriages in `extension`. Empty (default): constant stiffness.
    """

    name: Annotated[str, Plain("name")]
    EA: Annotated[float, Number("N", role="parameter")]
    rest_length: Annotated[float, Number("m", role="parameter", plausible=50.0)]
    extension: Row
    length: Row = field(default_factory=dict)


@dataclass(frozen=True)
class Drive(Component):
    """One drive: a DC motor with gear and amplifier, which moves one coordinate.

    With the voltage V, the resistance R and the speed w of the coordinate (rad/s or m/s), the torque (Nm) or
    force (N) on the coordinate is gear_ratio * Kt/R * (V - Ke * gear_ratio * w): eq. 17 of Sollmann et al.
    (2010) with the gear ratio that it omits.

    Attributes:
        name: Name of the drive.
        channel: Column of its command in recordings, for example v1_V, i1_A, torque1_Nm or command_rad. A
            positive command accelerates the coordinate in positive direction.
        coordinate: Name of the coordinate that it drives.
        Kt: Torque constant of the motor, Nm/A. For the kind "torque" the true torque per commanded torque,
            with the unit "1"; 1 if it is left out.
        Ke: Back-EMF constant of the motor, Vs/rad. Equal to Kt in these units, if the data sheet does not
            give it.
        resistance: Resistance between the terminals, ohm.
        gear_ratio: Angle of the motor shaft per unit of the coordinate: "1" (rad/rad) at a pulley, rad/m at a
            carriage. There it is 1 / radius for a belt and 2 pi / lead for a screw, times the ratio of the
            gear.
        voltage_range: Largest command of the converter in either direction, in its unit. Default: the rated
            one.
        rated_voltage: Command that an action of 1 in the environment gives, in the unit of the command.
        law_parameters: Values by name, SI, for kinds whose torque follows a law: gains and limits of the loop
            of the kinds "position" and "speed", holding torque of a "stepper". Those with a default may be
            left out.
        converter_bits: Bits of the digital-to-analog converter; 0 (default) for a continuous voltage.
        kind: What its command is, and what it makes of it. Default: "voltage".
        supply: Column of the measured supply voltage in recordings, V, for example vbus_V. Drives may share
            it. Without it, a duty cycle is one of the rated voltage.

    Raises:
        InputError: If the kind is not registered, or a parameter of its law is missing or unknown.
    """

    kinds: ClassVar[Registry[Any] | None] = DRIVE_KINDS

    name: Annotated[str, Plain("name")]
    channel: Annotated[str, Plain("column")]
    coordinate: str
    Kt: Annotated[float, Number("Nm/A", role="parameter")]
    Ke: Annotated[float, Number("Vs/rad", lower=0.0, role="parameter")]
    resistance: Annotated[float, Number("ohm", role="parameter")]
    gear_ratio: Annotated[float, Number("rad/position", role="parameter", older_unit="1")]
    voltage_range: Annotated[float | None, Number("command", role="device")] = field(
        default=None, kw_only=True
    )
    rated_voltage: Annotated[float, Number("command")]
    law_parameters: Annotated[Mapping[str, float], Plain("numbers", "omitted")] = field(
        default_factory=dict, kw_only=True
    )
    converter_bits: Annotated[int, Number("1", 0, 32, role="device", presence="written")] = 0
    kind: Annotated[str, Plain("text", "omitted")] = "voltage"
    supply: Annotated[str, Plain("column", "omitted")] = ""

    def __post_init__(self) -> None:
        """Complete the parameters of the law by their defaults."""
        kind = DRIVE_KINDS.get(self.kind)
        names = [p.name for p in kind.law.parameters] if kind.law else []
        values = {name: kind.defaults[name] for name in names if name in kind.defaults}
        values |= self.law_parameters
        problems = [f"{name} is missing" for name in names if name not in values]
        problems += [f"{name} is no parameter of it" for name in values if name not in names]
        if problems:
            takes = f"takes {', '.join(names)}" if names else "has no law"
            raise InputError(f"drive {self.name!r}: the kind {self.kind!r} {takes}: {', '.join(problems)}")
        object.__setattr__(self, "law_parameters", {name: values[name] for name in names})

    @classmethod
    @override
    def variant(cls, coordinate: CoordinateKind, kind: str = "voltage") -> Variant:
        of_kind = DRIVE_KINDS.get(kind)
        units = FIXED_UNITS | UNITS[coordinate]
        units["command"] = of_kind.unit(coordinate)
        absent: dict[str, Any] = dict(of_kind.fixed)
        if not of_kind.fraction:
            absent["supply"] = ""
        if of_kind.law is None:
            absent["law_parameters"] = {}
        else:
            units |= {p.name: units.get(p.unit, p.unit) for p in of_kind.law.parameters}
        return Variant(
            title=f"a drive of the kind {kind!r}",
            units={**units, **of_kind.units},
            absent=absent,
            defaults=of_kind.defaults,
            fields={"rated_voltage": f"rated_{of_kind.command}", "law_parameters": "parameters"},
        )

    @property
    @override
    def parameter_names(self) -> tuple[str, ...]:
        """Names of those parameters that a drive of its kind has, such as "Kt", then those of its law."""
        fixed = DRIVE_KINDS.get(self.kind).fixed
        of_motor = [name for name in super().parameter_names if name not in fixed]
        return (*of_motor, *self.law_parameters)

    @property
    @override
    def parameter_values(self) -> dict[str, float]:
        law = self.law_parameters
        return {name: law[name] if name in law else getattr(self, name) for name in self.parameter_names}

    @override
    def require_possible(self) -> None:
        """Raise an InputError if a number, or a parameter of the law, is not finite or outside its bounds."""
        super().require_possible()
        law = DRIVE_KINDS.get(self.kind).law
        if law:
            law.at(self.name, **self.law_parameters)

    @override
    def with_values(self, values: Mapping[str, Any]) -> Drive:
        """Return a copy with some attributes or law parameters replaced, by name, SI."""
        law = {name: values.get(name, value) for name, value in self.law_parameters.items()}
        others = {name: value for name, value in values.items() if name not in law}
        changed: Drive = super().with_values(others)
        return dataclasses.replace(changed, law_parameters=law) if law else changed

    @property
    def law(self) -> DriveLaw | None:
        """Torque law of the drive, for kinds such as servos; None for a plain motor."""
        definition = DRIVE_KINDS.get(self.kind).law
        return None if definition is None else DriveLaw(definition, self.name, self.law_parameters)

    @property
    def command(self) -> str:
        """Quantity that the drive's input commands: "voltage", "current", "torque", "position" or "speed"."""
        return DRIVE_KINDS.get(self.kind).command

    @property
    def gain(self) -> float:
        """Force (N/V) or torque (Nm/V) on the coordinate per volt, at rest: gear_ratio * Kt / resistance.

        For a drive with a law it is only a scale: the largest force divided by the rated command.
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
        """Viscous coefficient that the back-EMF adds: gear_ratio^2 * Kt * Ke / resistance, Ns/m or Nms."""
        return self.gain * self.emf_constant

    @property
    def damping(self) -> float:
        """Viscous coefficient, Ns/m or Nms, that the back-EMF adds, or the law of a drive that has one."""
        if self.law_parameters:
            return DRIVE_KINDS.get(self.kind).damping(self.gear_ratio, self.law_parameters)  # type: ignore[no-any-return]
        return self.back_emf

    @property
    def largest_speed(self) -> float:
        """Largest speed of the coordinate that the law permits, m/s or rad/s; infinite without a limit."""
        if self.law_parameters and self.command == "speed":
            return self.rated_voltage
        return self.law_parameters.get("speed_limit", math.inf)

    @property
    @override
    def device_parameters(self) -> dict[str, float]:
        """Parameters of the drive's D/A converter; `voltage_range` is by default the rated voltage."""
        limit = self.rated_voltage if self.voltage_range is None else self.voltage_range
        return super().device_parameters | {"voltage_range": limit}


@dataclass(frozen=True)
class Sensor(Component):
    """One sensor, which measures a weighted sum of positions, speeds, accelerations, currents or tensions.

    Its unit is that of the measured quantity at the coordinate with the largest coefficient.

    Attributes:
        channel: Column of its measurements in recordings; the name ends in the unit, for example _m, _rad,
            _m_s, _rad_s, _m_s2 or _A.
        row: Coefficient by name of a coordinate, usually {"x": 1.0}; or of a product of two: "y*yaw" adds the
            coefficient times y * yaw to the position. By name of a drive for a current, of a belt for a
            tension.
        noise: Standard deviation of the noise; 0 if it is below the resolution.
        resolution: Quantization step; 0 for a continuous sensor. An encoder on the motor shaft that is read
            in quadrature has 2 pi / (4 * lines * gear_ratio).
        kind: What it measures. Default in a file: "encoder" on a rotary coordinate, "laser" on a linear one.
        zero: Measurement of an encoder at position 0, if it was (nearly) the same in all runs from which the
            machine was identified. `std`, if given, is its standard deviation from run to run, caused by
            belts that friction holds stretched at rest. Default: unknown.
        zero_std: Standard deviation of `zero` from run to run, in the sensor's unit. None: `zero` is unknown,
            or no variation was found.
    """

    kinds: ClassVar[Registry[Any] | None] = SENSOR_KINDS

    channel: Annotated[str, Plain("column")]
    row: Row
    noise: Annotated[float, Number("measurement", lower=0.0, role="device", plausible=0.1)] = 0.0
    resolution: Annotated[float, Number("measurement", lower=0.0, role="device", plausible=0.1)] = 0.0
    kind: Annotated[str, Plain("text", "written")] = "laser"
    zero: Annotated[float | None, Number("position", lower=-LARGEST, std="zero_std")] = None
    zero_std: float | None = None

    @classmethod
    @override
    def variant(cls, coordinate: CoordinateKind, kind: str = "laser") -> Variant:
        quantity = SENSOR_KINDS.get(kind).quantity()
        units = FIXED_UNITS | UNITS[coordinate]
        return Variant(
            title=f"a sensor of the kind {kind!r}",
            units=units | {"measurement": SENSOR_KINDS.get(kind).unit or units[quantity]},
            absent={} if quantity == "position" else {"zero": None},
        )

    @property
    @override
    def label(self) -> str:
        """Name of the sensor in parameter names, its channel: "x_m" in "x_m.noise"."""
        return self.channel

    @property
    def incremental(self) -> bool:
        """Whether the sensor counts from power-on, so that its reading at position 0 is unknown."""
        return SENSOR_KINDS.get(self.kind).incremental

    @property
    def quantity(self) -> SensorQuantity:
        """Name of the measured quantity, such as "position", one of `SENSED_QUANTITIES`."""
        return SENSOR_KINDS.get(self.kind).quantity()

    @property
    def sensed(self) -> SensedQuantity:
        """Properties that all sensors of the measured quantity have in common, such as whether it jumps."""
        return SENSED_QUANTITIES[self.quantity]

    @property
    def has_direction(self) -> bool:
        """Whether the sensor measures a motion of coordinates, with its sign."""
        return self.sensed.component == "coordinate" and SENSOR_KINDS.get(self.kind).has_direction()

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
        """Range of a measurement that wraps around, in the channel's unit, such as 2 pi; else None."""
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
