"""Define the schema of machine.json: its fields and their types."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat

from ..machine import CoordinateKind

SCHEMA_VERSION = 1


class Table(BaseModel):
    """Base class of all objects in machine.json: unknown fields and implicit type conversions are errors."""

    model_config = ConfigDict(extra="forbid", strict=True)


Name = Annotated[str, Field(pattern=r"^[A-Za-z_][A-Za-z0-9_]*$")]


class QuantityEntry(Table):
    """Number with its unit.

    Attributes:
        value: Value in the unit.
        unit: SI unit, such as "kg".
        std: Standard deviation of an identified value, in the unit. None: unknown.
    """

    value: FiniteFloat
    unit: str
    std: FiniteFloat | None = None


class CoordinateEntry(Table):
    """One coordinate (degree of freedom) of the machine.

    Attributes:
        name: Name of the coordinate.
        kind: "linear" or "rotary".
        mass: Mass, kg, or moment of inertia, kg m^2.
        viscous: Viscous friction coefficient, N s/m or Nm s/rad.
        coulomb: Coulomb friction, N or Nm.
        radius: Pulley radius of a rotary coordinate, m. None for a linear one.
        range: Lowest and highest position, m or rad. None: unlimited.
    """

    name: Name
    kind: CoordinateKind
    mass: QuantityEntry
    viscous: QuantityEntry
    coulomb: QuantityEntry
    radius: QuantityEntry | None = None
    range: tuple[FiniteFloat, FiniteFloat] | None = None


class BeltEntry(Table):
    """One belt section.

    Belt travel is the displacement of a linear coordinate, or radius times angle of a rotary one, m.

    Attributes:
        name: Name of the belt section.
        EA: Young's modulus times cross-section area, N.
        rest_length: Length with all coordinates at zero, m.
        extension: Extension per unit of belt travel, by name of the coordinate, dimensionless.
        length: Change of the section's length per unit of belt travel, by name of the coordinate, dimensionless.
    """

    name: Name
    EA: QuantityEntry
    rest_length: QuantityEntry
    extension: dict[str, FiniteFloat]
    length: dict[str, FiniteFloat] = {}


class DriveEntry(Table):
    """One drive: a DC motor with gear and amplifier.

    Attributes:
        name: Name of the drive.
        channel: Column of its voltage in recordings.
        coordinate: Name of the coordinate that it drives.
        Kt: Torque constant of the motor, Nm/A.
        Ke: Back-EMF constant of the motor, V s/rad.
        resistance: Resistance of the winding, ohm.
        gear_ratio: Angle of the motor shaft per unit of the coordinate, rad/rad or rad/m.
        rated_voltage: Rated voltage, V.
        converter_bits: Bits of the digital-to-analog converter; 0 for a continuous voltage.
        voltage_range: Largest voltage of the converter in either direction, V. None: the rated voltage.
        current_limit: Largest current, A (declares the effect current_limit). None: unlimited.
        delay: Delay of the voltage, s (declares the effect input_delay). None: no delay.
    """

    name: Name
    channel: str
    coordinate: str
    Kt: QuantityEntry
    Ke: QuantityEntry
    resistance: QuantityEntry
    gear_ratio: QuantityEntry
    rated_voltage: QuantityEntry
    converter_bits: Annotated[int, Field(ge=0, le=32)] = 0
    voltage_range: QuantityEntry | None = None
    current_limit: QuantityEntry | None = None
    delay: QuantityEntry | None = None


class SensorEntry(Table):
    """One sensor, whose measurement is the sum of coordinates times coefficients.

    Attributes:
        channel: Column of its measurements in recordings; the ending gives the unit, m or rad.
        kind: "encoder" (incremental), "laser" (fixed zero) or a registered kind. None: follows from the coordinate.
        row: Coefficient by name of a coordinate, or of a product of two such as "y*yaw".
        noise: Standard deviation of the noise, m or rad.
        resolution: Quantization step, m or rad; 0 for none.
        range: Lowest and highest measurement, m or rad (declares the effect sensor_range). None: unlimited.
        delay: Delay of the measurement, s (declares the effect sensor_delay). None: no delay.
        zero: Measurement of an encoder at position 0 in the runs from which the machine was identified, if it kept this
            zero; its `std` is the scatter from run to run, where belts stretched at rest caused one. None: unknown.
    """

    channel: str
    kind: str | None = None
    row: dict[str, FiniteFloat]
    noise: QuantityEntry
    resolution: QuantityEntry
    range: tuple[FiniteFloat, FiniteFloat] | None = None
    delay: QuantityEntry | None = None
    zero: QuantityEntry | None = None


class EffectEntry(Table):
    """One effect (additional physical term) of the machine.

    Attributes:
        name: Name of the effect in the library.
        site: Name of the coordinate, drive or sensor on which it acts, or "machine".
        parameters: Values with units, by name of the effect's parameter.
    """

    name: str
    site: str
    parameters: dict[str, QuantityEntry]


class UncertaintyEntry(Table):
    """Uncertainty of the identified parameters.

    Attributes:
        names: Full names of k parameters, for example "x.coulomb".
        covariance: Covariance matrix, SI, k rows of k values in the order of the names.
    """

    names: list[str]
    covariance: list[list[FiniteFloat]]


class MachineFile(Table):
    """Content of a machine.json.

    Attributes:
        schema_: Version of the format, field "schema".
        name: Name of the machine.
        description: Sentence about the machine.
        coordinates: Coordinates, at least one.
        belts: Belt sections.
        drives: Drives, at least one.
        sensors: Sensors, at least one.
        effects: Effects on the machine.
        ties: Parameters that are a factor times another one: name -> (other name, factor).
        uncertainty: Covariance of the identified parameters. None for a declared machine.
    """

    schema_: Literal[1] = Field(alias="schema")
    name: str
    description: str = ""
    coordinates: list[CoordinateEntry] = Field(min_length=1)
    belts: list[BeltEntry] = []
    drives: list[DriveEntry] = Field(min_length=1)
    sensors: list[SensorEntry] = Field(min_length=1)
    effects: list[EffectEntry] = []
    ties: dict[str, tuple[str, FiniteFloat]] = {}
    uncertainty: UncertaintyEntry | None = None
