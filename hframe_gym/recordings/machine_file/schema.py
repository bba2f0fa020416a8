"""The schema of machine.json: its fields, their types, units and limits.

The tables of coordinates, belts, drives and sensors follow from the declarations of the components
(`machine.declaration`). The descriptions of all fields are the `Attributes` sections of docstrings.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeAlias, get_origin

from pydantic import BaseModel, ConfigDict, Field, create_model
from pydantic.fields import FieldInfo

from ...machine import (
    Attribute,
    Belt,
    Component,
    Coordinate,
    Drive,
    Number,
    Plain,
    Sensor,
    Variant,
    descriptions,
    summary,
)

SCHEMA_VERSION = 1
_MAX_PARTS = 100  # coordinates, belts, ...; the time to compile the equations grows with their number


class Table(BaseModel):
    """Base class of all objects in machine.json: unknown fields and implicit type conversions are errors.

    Attributes:
        comment: Text for the reader, a string or a list of lines. It is ignored, and not kept in files that
            the commands derive from this one.
    """

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)

    comment: str | list[str] | None = None


Name = Annotated[str, Field(pattern=r"^[A-Za-z_][A-Za-z0-9_]*$")]


class QuantityEntry(Table):
    """Number with its unit.

    Attributes:
        value: Value in the unit.
        unit: SI unit, such as "kg". Values are never converted, so each field accepts only one unit.
        std: Standard deviation of an identified value, in the unit. `hframe identify` writes it.
    """

    value: float
    unit: str
    std: float | None = None


@dataclass(frozen=True)
class EffectField:
    """Field of a component that declares an effect on it, as data sheets state it.

    Attributes:
        effect: Name of the effect.
        description: What the field means.
        number: Unit and bounds of the value; None for a pair [low, high] in the unit of the sensor.
        parameters: Function value(s) -> values of the effect's parameters by name, SI.
        fits: Predicate (kind of drive or sensor): whether one of that kind may have it.
    """

    effect: str
    description: str
    number: Number | None
    parameters: Callable[..., Mapping[str, float]]
    fits: Callable[[Any], bool] = lambda kind: True


EFFECT_FIELDS: dict[type[Component], dict[str, EffectField]] = {
    Drive: {
        "current_limit": EffectField(
            "current_limit",
            "Largest current, A (declares the effect current_limit). Default: unlimited.",
            Number("A", lower=0.0),
            lambda value: {"I": value},
            fits=lambda kind: kind.law is None and kind.command != "torque",
        ),
        "bandwidth": EffectField(
            "electrical_lag",
            "Bandwidth of a drive that controls its current or torque, Hz: the time constant of the effect "
            "electrical_lag is 1 / (2 pi bandwidth). Default: unlimited.",
            Number("Hz"),
            lambda value: {"tau": 1.0 / (2.0 * math.pi * value)},
            fits=lambda kind: kind.command != "voltage",
        ),
        "delay": EffectField(
            "input_delay",
            "Delay of the voltage, s (declares the effect input_delay). Default: no delay.",
            Number("s", lower=0.0),
            lambda value: {"d": value},
        ),
    },
    Sensor: {
        "range": EffectField(
            "sensor_range",
            "Lowest and highest measurement [low, high], in the sensor's "
            "unit (declares the effect sensor_range). Default: unlimited.",
            None,
            lambda low, high: {"low": low, "high": high},
        ),
        "delay": EffectField(
            "sensor_delay",
            "Delay of the measurement, s (declares the effect sensor_delay). Default: no delay.",
            Number("s", lower=0.0),
            lambda value: {"d": value},
        ),
    },
}


def _description(component: type[Component], attribute: Attribute, having: set[str]) -> str:
    """Return the description of a field with the kinds that have it; the kind's tells what each kind is."""
    if component.kinds is None:
        return attribute.description
    # Those of this package only: plugins do not change the published schema.
    kinds = {name: component.kinds.get(name) for name in component.kinds}
    kinds = {name: kind for name, kind in kinds.items() if kind.__module__.startswith("hframe_gym.")}
    if attribute.name == "kind":
        each = [f'"{name}": {summary(kind).partition(". ")[0].rstrip(".")}.' for name, kind in kinds.items()]
        return " ".join([attribute.description, *each, "Or a registered kind."])
    own = [f'"{name}"' for name in kinds if name in having]
    if len(own) == len(kinds):
        return attribute.description
    return f"{attribute.description} Only for the kind{'s'[: len(own) - 1]} {', '.join(own)}."


def _form(attribute: Attribute, variants: list[Variant]) -> tuple[Any, dict[str, Any]]:
    """Return the type of a field that holds an attribute, and what else pydantic needs to know of it."""
    declared = attribute.declared
    if isinstance(declared, Number) and attribute.type is float:
        units = [variant.unit(attribute.name, declared) for variant in variants]
        return QuantityEntry, _limits([*units, *filter(None, [declared.older_unit])], declared.lower)
    if isinstance(declared, Number) and attribute.type is int:
        return int, {"ge": int(declared.lower), "le": int(declared.upper)}
    if isinstance(declared, Plain) and declared.form == "numbers":
        return dict[str, QuantityEntry], {}
    if isinstance(declared, Plain) and declared.form == "name":
        return Name, {}
    return dict[str, float] if get_origin(attribute.type) is Mapping else attribute.type, {}


def _limits(units: Iterable[str], lower: float) -> dict[str, Any]:
    """Return the part of the JSON Schema that states units and sign of a quantity."""
    properties: dict[str, Any] = {"unit": {"enum": list(dict.fromkeys(units))}}
    if lower >= 0.0:
        properties["value"] = {"exclusiveMinimum" if lower > 0.0 else "minimum": 0}
    return {"json_schema_extra": {"properties": properties}}


def _component_table(component: type[Component]) -> type[Table]:
    """Create the table of a component in machine.json from the declarations of its attributes."""
    having: dict[str, list[tuple[str, Variant]]] = {}  # kinds and variants that have a field, by its name
    attributes: dict[str, Attribute] = {}
    for (kind, _), variant in component.variants().items():
        for key, attribute in variant.own(component).items():
            attributes[key] = attribute
            having.setdefault(key, []).append((kind, variant))
    columns: dict[str, Any] = {}
    order = list(component.attributes())
    for key, attribute in sorted(attributes.items(), key=lambda item: order.index(item[1].name)):
        variants = [variant for _, variant in having[key]]
        form, info = _form(attribute, variants)
        info["description"] = _description(component, attribute, {kind for kind, _ in having[key]})
        everywhere = len(variants) == len(component.variants())
        needed = everywhere and not any(attribute.name in variant.defaults for variant in variants)
        if attribute.presence == "required" and needed:
            columns[key] = form, Field(**info)
        else:
            columns[key] = form | None, Field(default=None, **info)
    for key, declared in EFFECT_FIELDS.get(component, {}).items():
        number = declared.number
        form = QuantityEntry if number else tuple[float, float]
        info = _limits([number.unit], number.lower) if number else {}
        columns[key] = form | None, Field(default=None, description=declared.description, **info)
    return create_model(f"{component.__name__}Entry", __base__=Table, __doc__=summary(component), **columns)


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
    covariance: list[list[float]]


COMPONENTS: dict[str, type[Component]] = {
    "coordinates": Coordinate,
    "belts": Belt,
    "drives": Drive,
    "sensors": Sensor,
}
if TYPE_CHECKING:
    CoordinateEntry: TypeAlias = Any
    BeltEntry: TypeAlias = Any
    DriveEntry: TypeAlias = Any
    SensorEntry: TypeAlias = Any
else:
    CoordinateEntry, BeltEntry, DriveEntry, SensorEntry = map(_component_table, COMPONENTS.values())


class MachineFile(Table):
    """Content of a machine.json.

    Attributes:
        schema: Version of the format.
        $schema: Path or address of the JSON Schema, for editors that complete and check fields; it is
            ignored.
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
    ties: dict[str, tuple[str, float]] = {}
    uncertainty: UncertaintyEntry | None = None


TABLES: tuple[type[Table], ...] = (
    *(MachineFile, CoordinateEntry, BeltEntry, DriveEntry, SensorEntry),
    *(EffectEntry, UncertaintyEntry, QuantityEntry),
)


def fields(table: type[Table]) -> dict[str, FieldInfo]:
    """Return the fields of one kind of object in machine.json by their names in the file.

    Args:
        table: Class of the object, such as `MachineFile` or `EffectEntry`.

    Returns:
        What pydantic knows of each field (type, default, limits) by its name, such as "schema" for `schema_`.
    """
    return {info.alias or name: info for name, info in table.model_fields.items()}


def field_units(info: FieldInfo) -> tuple[str, ...]:
    """Return the possible units of a field of machine.json; none for a field without a quantity.

    Of two units, the first is for linear coordinates and the second for rotary ones. Noise and resolution of
    a sensor have the unit of its measurement.

    Args:
        info: One of the fields that `fields` returns.
    """
    extra: Any = info.json_schema_extra or {}
    return tuple(extra.get("properties", {}).get("unit", {}).get("enum", ()))


def field_descriptions(table: type[Table]) -> dict[str, str]:
    """Return the descriptions of the fields of one kind of object in machine.json, for example of a drive.

    The JSON Schema and docs/machine.md quote them. They are read from the `Attributes` sections of the
    docstrings of the components, of the object's class and of `Table`.

    Returns:
        Description by name of the field in the file; the field `comment` is last.
    """
    declared = {name: info.description for name, info in fields(table).items() if info.description}
    return declared | descriptions(table) | descriptions(Table)


def machine_json_schema() -> dict[str, Any]:
    """Return the JSON Schema (draft 2020-12) of machine.json, with description and units of every field.

    It describes types, units and signs. Other rules, such as that a belt refers to existing coordinates or
    that a unit suits a linear or rotary coordinate, are checked by `load_machine` alone.
    """
    schema = MachineFile.model_json_schema(by_alias=True)
    definitions = schema.pop("$defs")
    for table in TABLES:
        definition = schema if table is MachineFile else definitions[table.__name__]
        definition["description"] = summary(table)
        described = field_descriptions(table)
        for name, field in definition["properties"].items():
            field.pop("title", None)
            field["description"] = described[name]
    schema["title"] = "machine.json of hframe_gym"
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema, "$defs": definitions}
