"""Define the schema of machine.json: its fields, their types, units and limits.

The descriptions in the JSON Schema and in docs/machine.md are the `Attributes` sections of the docstrings.
"""

from __future__ import annotations

import inspect
import re
from typing import Annotated, Any, Literal, get_args

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat

from ..machine import DRIVE_KINDS, FIXED_UNITS, UNITS, CoordinateKind, SensorQuantity

SCHEMA_VERSION = 1
QUANTITIES: tuple[SensorQuantity, ...] = get_args(SensorQuantity)
_MAX_PARTS = 100  # coordinates, belts, ...; the time to compile the equations grows with their number
# Quantities that may be zero; the zero of an encoder may also be negative, and all others are positive.
MAY_BE_ZERO = ("viscous", "coulomb", "Ke", "noise", "resolution")
MAY_BE_NEGATIVE = ("zero",)
# Quantities of the kind of a coordinate under another name than in `UNITS`, and units of effects that a field declares.
_QUANTITIES = {"coulomb": "force", "zero": "position"}
# Quantities in the unit of a sensor, which depends on its kind.
_OF_SENSOR = ("noise", "resolution")
_DECLARED_EFFECT_UNITS = {"current_limit": "A", "delay": "s", "bandwidth": "Hz"}


def field_units(field: str) -> tuple[str, ...]:
    """Return the units that a quantity in machine.json may have.

    Args:
        field: Name of the field, for example "mass".

    Returns:
        Accepted units. Where there are two, the first is for linear coordinates and the second for rotary ones. A gear
        ratio at a linear coordinate may also have the unit "1". Noise and resolution of a sensor have the unit of what
        it measures.

    Raises:
        KeyError: If no field of this name holds a quantity.
    """
    if field == "voltage_range":
        kinds = map(DRIVE_KINDS.get, DRIVE_KINDS)
        return tuple(dict.fromkeys(kind.unit(coordinate) for kind in kinds for coordinate in UNITS))
    if field == "Kt":
        return FIXED_UNITS[field], "1"
    if field == "gear_ratio":
        return tuple(UNITS[kind]["rad/position"] for kind in UNITS)
    if field in _OF_SENSOR:
        units = [
            FIXED_UNITS.get(quantity) or UNITS[kind][quantity] for quantity in QUANTITIES for kind in UNITS
        ]
        return tuple(dict.fromkeys(units))
    if field.startswith("rated_"):
        quantity = field.removeprefix("rated_")
        return tuple(dict.fromkeys(FIXED_UNITS.get(quantity) or UNITS[kind][quantity] for kind in UNITS))
    if field in FIXED_UNITS or field in _DECLARED_EFFECT_UNITS:
        return ((FIXED_UNITS | _DECLARED_EFFECT_UNITS)[field],)
    return tuple(UNITS[kind][_QUANTITIES.get(field, field)] for kind in UNITS)


def _quantity(field: str) -> Any:
    """Return the metadata of a field that holds a quantity: units and limits for the JSON Schema."""
    properties: dict[str, Any] = {"unit": {"enum": list(field_units(field))}}
    if field not in MAY_BE_NEGATIVE:
        properties["value"] = {"minimum" if field in MAY_BE_ZERO else "exclusiveMinimum": 0}
    return Field(json_schema_extra={"properties": properties})


class Table(BaseModel):
    """Base class of all objects in machine.json: unknown fields and implicit type conversions are errors.

    Attributes:
        comment: Text for the reader, a string or a list of lines. It is ignored, and not kept in files that the
            commands derive from this one.
    """

    model_config = ConfigDict(extra="forbid", strict=True)

    comment: str | list[str] | None = None


Name = Annotated[str, Field(pattern=r"^[A-Za-z_][A-Za-z0-9_]*$")]


class QuantityEntry(Table):
    """Number with its unit.

    Attributes:
        value: Value in the unit.
        unit: SI unit, such as "kg". Values are never converted, so each field accepts only one unit.
        std: Standard deviation of an identified value, in the unit. `hframe identify` writes it.
    """

    value: FiniteFloat
    unit: str
    std: FiniteFloat | None = None


class CoordinateEntry(Table):
    """One coordinate (degree of freedom) of the machine.

    Attributes:
        name: Name by which belts, drives, sensors and effects refer to the coordinate. The linear coordinates are the
            axes of the tool in the environment, in the order of the file, whatever their names. Without linear ones,
            the rotary coordinates are, one for each drive.
        kind: "linear" (a carriage, positions in m) or "rotary" (a pulley, angles in rad).
        mass: Everything that moves with the coordinate: mass, kg, or moment of inertia, kg m^2. The rotor of a motor
            behind a gear counts gear_ratio^2 times its inertia.
        viscous: Viscous friction coefficient, Ns/m or Nms (per rad/s). Without the back-EMF of the motor.
        coulomb: Coulomb friction, N or Nm.
        radius: Pitch radius of the pulley, m; required for a rotary coordinate on which a belt runs, not allowed for a
            linear one. If no belt runs on it (a motor, a servo with an arm), leave it out: it has no influence on the
            motion. Default: 0.1 m.
        range: Lowest and highest position [low, high], m or rad. Default: unlimited. The environment needs the ranges
            of linear coordinates, which are its workspace; that of a rotary axis without a range is one turn to either
            side of zero.
    """

    name: Name
    kind: CoordinateKind
    mass: Annotated[QuantityEntry, _quantity("mass")]
    viscous: Annotated[QuantityEntry, _quantity("viscous")]
    coulomb: Annotated[QuantityEntry, _quantity("coulomb")]
    radius: Annotated[QuantityEntry | None, _quantity("radius")] = None
    range: tuple[FiniteFloat, FiniteFloat] | None = None


class BeltEntry(Table):
    """One belt section.

    The travel of a coordinate is its position (linear), or its angle times its radius (rotary), in m. The section has
    the stiffness EA / (rest_length + change of length) and the force stiffness times extension.

    Attributes:
        name: Name of the belt section.
        EA: Axial stiffness: Young's modulus times cross-section area, N. It is the force that would double the length.
        rest_length: Length of the section with all coordinates at zero, m.
        extension: Extension of the section per travel, m/m, by name of the coordinate. It is positive if a positive
            motion of this coordinate alone stretches the section. A pulley usually has 1 or -1; its radius is not part
            of it.
        length: Change of the section's length per travel, m/m, by name of the coordinate. Usually the factors of the
            carriages in `extension`. Empty (default): constant stiffness.
    """

    name: Name
    EA: Annotated[QuantityEntry, _quantity("EA")]
    rest_length: Annotated[QuantityEntry, _quantity("rest_length")]
    extension: dict[str, FiniteFloat]
    length: dict[str, FiniteFloat] = {}


class DriveEntry(Table):
    """One drive: a DC motor with gear and amplifier.

    Attributes:
        name: Name of the drive.
        kind: What its command is: "voltage" (default), "duty-cycle" (fraction of the supply voltage, from -1 to 1),
            "current" or "torque" of an amplifier that controls it, "position" or "speed" of the coordinate for a servo
            that follows this set point, "stepper" for a motor that holds it, or a registered kind.
        channel: Column of its command in recordings, for example v1_V, i1_A, torque1_Nm or command_rad. A positive
            command accelerates the coordinate in positive direction.
        supply: Column of the measured supply voltage in recordings, V, for example vbus_V. Drives may share it. Only
            for the kind "duty-cycle"; without it, a duty cycle is one of the rated voltage.
        coordinate: Name of the coordinate that it drives.
        Kt: Torque constant of the motor, Nm/A. For the kind "torque" the true torque per commanded torque, with the
            unit "1"; 1 if it is left out. Not for kinds with a law.
        Ke: Back-EMF constant of the motor, Vs/rad. Equal to Kt in these units, if the data sheet does not give it. Only
            for the kinds "voltage" and "duty-cycle".
        resistance: Resistance between the terminals, ohm. Only for the kinds "voltage" and "duty-cycle".
        gear_ratio: Angle of the motor shaft per unit of the coordinate: "1" (rad/rad) at a pulley, rad/m at a carriage.
            There it is 1 / radius for a belt and 2 pi / lead for a screw, times the ratio of the gear.
        rated_voltage: Voltage that an action of 1 in the environment applies, V, for the kinds "voltage" and
            "duty-cycle".
        rated_current: Current that an action of 1 commands, A, for the kind "current".
        rated_torque: Torque of the motor shaft that an action of 1 commands, Nm, for the kind "torque".
        rated_position: Position of the coordinate that an action of 1 commands, m or rad, for the kinds "position" and
            "stepper".
        rated_speed: Speed of the coordinate that an action of 1 commands, m/s or rad/s, for the kind "speed".
        parameters: Values with units by name, for kinds whose torque follows a law: gains and limits of the loop of the
            kinds "position" and "speed", holding torque of a "stepper". Those with a default may be left out.
        converter_bits: Bits of the digital-to-analog converter; 0 (default) for a continuous voltage.
        voltage_range: Largest command of the converter in either direction, in its unit. Default: the rated one.
        current_limit: Largest current, A (declares the effect current_limit). Default: unlimited.
        bandwidth: Bandwidth of a drive that controls its current or torque, Hz: the time constant of the effect
            electrical_lag is 1 / (2 pi bandwidth). Default: unlimited.
        delay: Delay of the voltage, s (declares the effect input_delay). Default: no delay.
    """

    name: Name
    kind: str = "voltage"
    channel: str
    supply: str | None = None
    coordinate: str
    Kt: Annotated[QuantityEntry | None, _quantity("Kt")] = None
    Ke: Annotated[QuantityEntry | None, _quantity("Ke")] = None
    resistance: Annotated[QuantityEntry | None, _quantity("resistance")] = None
    gear_ratio: Annotated[QuantityEntry, _quantity("gear_ratio")]
    rated_voltage: Annotated[QuantityEntry | None, _quantity("rated_voltage")] = None
    rated_current: Annotated[QuantityEntry | None, _quantity("rated_current")] = None
    rated_torque: Annotated[QuantityEntry | None, _quantity("rated_torque")] = None
    rated_position: Annotated[QuantityEntry | None, _quantity("rated_position")] = None
    rated_speed: Annotated[QuantityEntry | None, _quantity("rated_speed")] = None
    parameters: dict[str, QuantityEntry] = {}
    converter_bits: Annotated[int, Field(ge=0, le=32)] = 0
    voltage_range: Annotated[QuantityEntry | None, _quantity("voltage_range")] = None
    current_limit: Annotated[QuantityEntry | None, _quantity("current_limit")] = None
    bandwidth: Annotated[QuantityEntry | None, _quantity("bandwidth")] = None
    delay: Annotated[QuantityEntry | None, _quantity("delay")] = None


class SensorEntry(Table):
    """One sensor, which measures the sum of coefficients times positions, speeds, accelerations or currents.

    Its unit is that of the quantity at the coordinate with the largest coefficient.

    Attributes:
        channel: Column of its measurements in recordings; the name ends in the unit, for example _m, _rad, _m_s,
            _rad_s, _m_s2 or _A.
        kind: "encoder" (incremental position, unknown zero), "laser" (fixed zero: any absolute position),
            "absolute-angle" (one turn, then anew), "speed", "unsigned-speed" (its absolute value), "acceleration",
            "current" (of a drive) or a registered kind. Default: encoder on a rotary coordinate, laser on a linear one.
        row: Coefficient by name of a coordinate, usually {"x": 1.0}; or of a product of two, such as "y*yaw". For the
            kind "current", by name of a drive.
        noise: Standard deviation of the noise; 0 if it is below the resolution.
        resolution: Quantization step; 0 for a continuous sensor. An encoder on the motor shaft that is read in
            quadrature has 2 pi / (4 * lines * gear_ratio).
        range: Lowest and highest measurement [low, high], in the sensor's unit (declares the effect sensor_range).
            Default: unlimited.
        delay: Delay of the measurement, s (declares the effect sensor_delay). Default: no delay.
        zero: Measurement of an encoder at position 0, if it was (nearly) the same in all runs from which the machine
            was identified. `std`, if given, is its standard deviation from run to run, caused by belts that friction
            holds stretched at rest. Default: unknown.
    """

    channel: str
    kind: str | None = None
    row: dict[str, FiniteFloat]
    noise: Annotated[QuantityEntry, _quantity("noise")]
    resolution: Annotated[QuantityEntry, _quantity("resolution")]
    range: tuple[FiniteFloat, FiniteFloat] | None = None
    delay: Annotated[QuantityEntry | None, _quantity("delay")] = None
    zero: Annotated[QuantityEntry | None, _quantity("zero")] = None


class EffectEntry(Table):
    """One effect (additional physical term) of the machine.

    Attributes:
        name: Name of the effect in the library (`hframe effects`).
        site: Where it acts: name of a coordinate, drive or sensor channel, or "drives", "belts", "machine".
        parameters: Quantities by name of the effect's parameter.
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
        schema: Version of the format.
        $schema: Path or address of the JSON Schema, for editors that complete and check fields; it is ignored.
        name: Name of the machine.
        description: Sentence about the machine.
        coordinates: Coordinates, at least one.
        belts: Belt sections. Default: none.
        drives: Drives, at least one; their order is that of the actions of the environment.
        sensors: Sensors, at least one.
        effects: Effects on the machine. Default: none.
        ties: Parameters that are a factor times another one, {name: [other name, factor]}, for example
            {"belt1_long.EA": ["belt1_short.EA", 1.0]}: they are not estimated or randomized separately.
        uncertainty: Covariance of the identified parameters. `hframe identify` writes it.
    """

    schema_: Literal[1] = Field(alias="schema")
    json_schema: str | None = Field(default=None, alias="$schema")
    name: str
    description: str = ""
    coordinates: list[CoordinateEntry] = Field(min_length=1, max_length=_MAX_PARTS)
    belts: list[BeltEntry] = Field(default=[], max_length=_MAX_PARTS)
    drives: list[DriveEntry] = Field(min_length=1, max_length=_MAX_PARTS)
    sensors: list[SensorEntry] = Field(min_length=1, max_length=_MAX_PARTS)
    effects: list[EffectEntry] = Field(default=[], max_length=_MAX_PARTS)
    ties: dict[str, tuple[str, FiniteFloat]] = {}
    uncertainty: UncertaintyEntry | None = None


TABLES: tuple[type[Table], ...] = (
    MachineFile,
    CoordinateEntry,
    BeltEntry,
    DriveEntry,
    SensorEntry,
    EffectEntry,
    UncertaintyEntry,
    QuantityEntry,
)


def field_descriptions(table: type[Table]) -> dict[str, str]:
    """Return the descriptions of the fields of one kind of object in machine.json, for example of a drive.

    The JSON Schema and docs/machine.md quote them. They are read from the `Attributes` sections of the docstrings of
    the object's class and of `Table`.

    Args:
        table: Class of the object, such as `DriveEntry` or `SensorEntry`.

    Returns:
        Description by name of the field in the file; the field `comment` is last.
    """
    descriptions: dict[str, str] = {}
    for documented in (table, Table):
        _, _, section = (inspect.getdoc(documented) or "").partition("Attributes:\n")
        entries = re.findall(r"^    (\S+): (.*(?:\n {8}.*)*)", section, re.MULTILINE)
        descriptions |= {name: " ".join(text.split()) for name, text in entries}
    return descriptions


def table_summary(table: type[Table]) -> str:
    """Return the description of one kind of object in machine.json, such as a drive, for the JSON Schema and the docs.

    Args:
        table: Class of the object, such as `DriveEntry` or `SensorEntry`.

    Returns:
        Text of the docstring before the section `Attributes`, in one line.
    """
    return " ".join((inspect.getdoc(table) or "").partition("Attributes:")[0].split())


def machine_json_schema() -> dict[str, Any]:
    """Return the JSON Schema (draft 2020-12) of machine.json, with the description and the units of every field.

    It describes types, units and signs. Other rules, such as that a belt refers to existing coordinates or that a unit
    suits a linear or rotary coordinate, are checked by `load_machine` alone.

    Returns:
        JSON Schema as dictionaries, lists, strings and numbers.
    """
    schema = MachineFile.model_json_schema(by_alias=True)
    definitions = schema.pop("$defs")
    for table in TABLES:
        definition = schema if table is MachineFile else definitions[table.__name__]
        definition["description"] = table_summary(table)
        descriptions = field_descriptions(table)
        for name, field in definition["properties"].items():
            field.pop("title", None)
            field["description"] = descriptions[name]
    schema["title"] = "machine.json of hframe_gym"
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema, "$defs": definitions}
