"""Define the schema of machine.json: its fields and their types."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat

from ..machine import CoordinateKind

SCHEMA_VERSION = 1


class Table(BaseModel):
    """Base of all objects in the file: unknown fields and implicit conversions are errors."""

    model_config = ConfigDict(extra="forbid", strict=True)


Name = Annotated[str, Field(pattern=r"^[A-Za-z_][A-Za-z0-9_]*$")]


class QuantityEntry(Table):
    """A value, its unit (SI, such as "kg") and, if identified, its standard deviation in that unit."""

    value: FiniteFloat
    unit: str
    std: FiniteFloat | None = None


class CoordinateEntry(Table):
    """One coordinate; only rotary ones have a `radius` (pulley), and `range` is [lowest, highest], m or rad."""

    name: Name
    kind: CoordinateKind
    mass: QuantityEntry
    viscous: QuantityEntry
    coulomb: QuantityEntry
    radius: QuantityEntry | None = None
    range: tuple[FiniteFloat, FiniteFloat] | None = None


class BeltEntry(Table):
    """One belt section; `extension` and `length` give its change per unit of belt travel of each coordinate."""

    name: Name
    EA: QuantityEntry
    rest_length: QuantityEntry
    extension: dict[str, FiniteFloat]
    length: dict[str, FiniteFloat] = {}


class DriveEntry(Table):
    """One drive; `current_limit` and `delay` declare the effects current_limit and input_delay."""

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
    """One sensor, whose measurement is the sum of coordinates times coefficients in `row`.

    `range` ([lowest, highest], m or rad) and `delay` declare the effects sensor_range and sensor_delay. `zero` is the
    measurement of an encoder at position 0 in the session from which the machine was identified, if it kept this zero;
    its `std` is the scatter from run to run, where belts stretched at rest caused one.
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
    """One effect at its site: the name of a coordinate, drive or sensor, or "machine"."""

    name: str
    site: str
    parameters: dict[str, QuantityEntry]


class UncertaintyEntry(Table):
    """Covariance matrix of the identified parameters, SI, with one row and column for each of `names`."""

    names: list[str]
    covariance: list[list[FiniteFloat]]


class MachineFile(Table):
    """Content of a machine.json; `ties` sets a parameter to a factor times another: {name: [other name, factor]}."""

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
