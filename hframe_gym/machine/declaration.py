"""How the components of a machine declare their attributes, once, for all other descriptions of them.

`viscous: Annotated[float, Number("viscous", lower=0.0)]` makes an attribute of a component a number with a
unit. From its declarations, and the descriptions in its docstring, follow the parameters of the machine that
can be identified or randomized, their units, and the fields of machine.json: schema, reader, writer and the
tables of the documentation.
"""

from __future__ import annotations

import dataclasses
import inspect
import itertools
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from types import NoneType
from typing import Annotated, Any, ClassVar, Literal, get_args, get_origin, get_type_hints

from ..errors import InputError
from ..registry import Registry

CoordinateKind = Literal["linear", "rotary"]
# "required": a file must state it, whether or not the class has a default. "written": a file may leave it
# out, but we write it always. "omitted": a file may leave it out, and we leave it out at its default.
Presence = Literal["required", "written", "omitted"]
Role = Literal["parameter", "device", ""]
POSITIVE, LARGEST = 1e-30, 1e30  # beyond these, products of a few parameters vanish or overflow

# Units of the quantities of a linear and of a rotary coordinate. An effect states the unit of a parameter by
# one of these keys, because it is N at a carriage and Nm at a pulley, for example. Two keys need an
# explanation: "absolute position" is a place, such as that of a magnet, whereas "position" is a distance,
# such as a period, which a search scales by the typical travel; "rad/position" is a phase per position.
_UNITS = {
    "position": ("m", "rad"),
    "absolute position": ("m", "rad"),
    "speed": ("m/s", "rad/s"),
    "mass": ("kg", "kg m^2"),
    "force": ("N", "Nm"),
    "viscous": ("Ns/m", "Nms"),
    "stiffness": ("N/m", "Nm/rad"),
    "drag": ("Ns^2/m^2", "Nms^2"),
    "rad/position": ("rad/m", "1"),
    "acceleration": ("m/s^2", "rad/s^2"),
    "s/position": ("s/m", "s/rad"),
}
UNITS: dict[CoordinateKind, dict[str, str]] = {
    "linear": {quantity: linear for quantity, (linear, _) in _UNITS.items()},
    "rotary": {quantity: rotary for quantity, (_, rotary) in _UNITS.items()},
}
# Units of quantities of motors and belts, which are the same at linear and rotary coordinates.
FIXED_UNITS = {"voltage": "V", "current": "A", "torque": "Nm", "tension": "N"}


def written_unit(unit: str) -> str:
    """Return a unit as it is written behind a number: "" for "1" (dimensionless), else the unit itself."""
    return "" if unit == "1" else unit


@dataclass(frozen=True)
class Number:
    """Declaration of a numeric attribute with its unit; for a pair [low, high] it holds for both numbers.

    Attributes:
        unit: Unit, or a key of `Variant.units`: "mass" is kg or kg m^2, depending on the coordinate.
        lower: Smallest value: `POSITIVE`, 0, or negative if every value is possible.
        upper: Largest value.
        role: "parameter": it enters the equations of motion, and can be identified and randomized. "device":
            it can be randomized only. "": neither.
        presence: Whether machine.json has it; a value that may be None is never "required".
        plausible: Largest plausible value of a length, m. A larger one is probably in millimeters.
        std: Name of the attribute that is its standard deviation, which machine.json states in the same
            object.
        older_unit: Unit that older files may have instead; it has the same meaning.
    """

    unit: str
    lower: float = POSITIVE
    upper: float = LARGEST
    role: Role = ""
    presence: Presence = "required"
    plausible: float = LARGEST
    std: str = ""
    older_unit: str = ""

    def limits(self, refused: float) -> str:
        """Describe the possible values in words, such as "zero or more, between 0 and 1".

        Args:
            refused: Value that a message refuses, SI. One that is not positive gives "positive" or "zero or
                more" alone, if the lower limit is not negative.
        """
        between = f"between {self.lower:g} and {self.upper:g}"
        if self.lower < 0.0:
            return between
        sign = "positive" if self.lower > 0.0 else "zero or more"
        return sign if refused <= 0.0 else f"{sign}, {between}"


@dataclass(frozen=True)
class Plain:
    """Declaration of an attribute that is no number.

    Attributes:
        form: "name" of a component: letters, digits and underscores. "column" of recordings. "text": any
            text. "numbers" by name; the kind of the component states their names, units and bounds.
        presence: Whether machine.json has it.
    """

    form: Literal["name", "column", "text", "numbers"]
    presence: Presence = "required"


@dataclass(frozen=True)
class Attribute:
    """Declared attribute of a component.

    Attributes:
        type: Its type, without the declaration and without None.
        default: Its default; `dataclasses.MISSING` if the class has none.
        presence: Whether machine.json has it.
        description: What the docstring of the class says of it.
    """

    name: str
    declared: Number | Plain | None
    type: Any
    default: Any
    presence: Presence
    description: str


@dataclass(frozen=True)
class Variant:
    """Properties of a component that depend on its kind and on the kind of its coordinate, linear or rotary.

    Attributes:
        title: Description for messages, such as "a linear coordinate".
        units: Units, by name of an attribute or by the key that a declaration states as its unit.
        absent: Values of the attributes that such a component does not have.
        defaults: Values of the attributes that machine.json need not state.
        fields: Names of attributes in machine.json, where they differ.
    """

    title: str = ""
    units: Mapping[str, str] = field(default_factory=dict)
    absent: Mapping[str, Any] = field(default_factory=dict)
    defaults: Mapping[str, Any] = field(default_factory=dict)
    fields: Mapping[str, str] = field(default_factory=dict)

    def unit(self, name: str, quantity: Number) -> str:
        """Return the unit of an attribute in this variant.

        Args:
            name: Name of the attribute.
            quantity: Its declaration, whose unit may be a key of `units`.
        """
        return self.units.get(name, self.units.get(quantity.unit, quantity.unit))

    def field(self, name: str) -> str:
        """Return the name of an attribute in machine.json; most have the same name there."""
        return self.fields.get(name, name)

    def own(self, component: type[Component]) -> dict[str, Attribute]:
        """Return the attributes that a component has in this variant, by their names in machine.json."""
        own = (a for a in component.attributes().values() if a.name not in self.absent)
        return {self.field(attribute.name): attribute for attribute in own}


class Component:
    """Base class of coordinates, belts, drives and sensors; the declared attributes determine the rest.

    Attributes:
        kinds: Registered kinds of such components; None if they have no kinds.
    """

    kinds: ClassVar[Registry[Any] | None] = None

    @classmethod
    def variant(cls, coordinate: CoordinateKind, kind: str = "") -> Variant:
        """Return what the kinds of component and coordinate determine: units, defaults, absent attributes.

        Args:
            coordinate: Kind of the coordinate itself, or of the one at which the component is, "linear" or
                "rotary".
            kind: Kind of the drive or sensor, such as "encoder"; "" for coordinates and belts.
        """
        return Variant()

    @classmethod
    def variants(cls) -> dict[tuple[str, CoordinateKind], Variant]:
        """Return all variants, by kind of the component ("" if it has none) and kind of the coordinate."""
        pairs = itertools.product(cls.kinds or ("",), UNITS)
        return {(kind, coordinate): cls.variant(coordinate, kind) for kind, coordinate in pairs}

    @classmethod
    @cache
    def attributes(cls) -> Mapping[str, Attribute]:
        """Return the declared attributes by name, in the order of machine.json: texts come first.

        Attributes that are the standard deviation of another one (`Number.std`) are left out.
        """
        hints = get_type_hints(cls, include_extras=True)
        described = descriptions(cls)
        found = []
        for info in dataclasses.fields(cls):  # type: ignore[arg-type]
            hint = hints[info.name]
            value_type, declared = get_args(hint) if get_origin(hint) is Annotated else (hint, None)
            default = info.default_factory() if callable(info.default_factory) else info.default
            presence: Presence = "required" if default is dataclasses.MISSING else "written"
            if declared is not None:
                presence = declared.presence
            if NoneType in get_args(value_type):
                value_type, presence = get_args(value_type)[0], "omitted"
            text = described.get(info.name, "")
            found.append(Attribute(info.name, declared, value_type, default, presence, text))
        deviations = {a.declared.std for a in found if isinstance(a.declared, Number)}
        found.sort(key=lambda a: not (a.type is str or get_origin(a.type) is Literal))
        return {a.name: a for a in found if a.name not in deviations}

    @classmethod
    @cache
    def numbers(cls) -> Mapping[str, Number]:
        """Return the declarations of all numeric attributes, by name."""
        declared = {name: attribute.declared for name, attribute in cls.attributes().items()}
        return {name: number for name, number in declared.items() if isinstance(number, Number)}

    @classmethod
    @cache
    def names(cls, role: Role) -> tuple[str, ...]:
        """Return the names of the numeric attributes that have a role.

        Args:
            role: "parameter" (enters the equations of motion), "device" (can only be randomized) or ""
                (neither).
        """
        return tuple(name for name, number in cls.numbers().items() if number.role == role)

    @property
    def label(self) -> str:
        """Name of the component in parameter names, such as "x" in "x.mass"."""
        return self.name  # type: ignore[attr-defined, no-any-return]

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of the parameters that can be identified or randomized, without the label, such as "mass"."""
        return self.names("parameter")

    @property
    def parameter_values(self) -> dict[str, float]:
        """Values of the parameters that can be identified or randomized, SI, by name."""
        return {name: getattr(self, name) for name in self.parameter_names}

    @property
    def device_parameters(self) -> dict[str, float]:
        """Values of the parameters that do not enter the equations of motion, by name, alphabetically."""
        return {name: getattr(self, name) for name in sorted(self.names("device"))}

    def require_possible(self) -> None:
        """Raise an InputError if a number is not finite or lies outside its bounds."""
        for name, declared in self.numbers().items():
            value = getattr(self, name)
            for number in value if isinstance(value, tuple) else (value,):
                if number is not None and not declared.lower <= number <= declared.upper:
                    raise InputError(
                        f"{self.label}.{name} is {number:g}; it must be {declared.limits(number)}"
                    )

    def with_values(self, values: Mapping[str, Any]) -> Any:
        """Return a copy with some attributes replaced, by name, SI; integer attributes are rounded."""
        whole = {name for name in values if self.attributes()[name].type is int}
        new = {name: round(value) if name in whole else value for name, value in values.items()}
        return dataclasses.replace(self, **new)  # type: ignore[type-var]


def summary(documented: type) -> str:
    """Return the part of a class's docstring before the section `Attributes`, as one line."""
    return " ".join((inspect.getdoc(documented) or "").partition("Attributes:")[0].split())


def descriptions(documented: type) -> dict[str, str]:
    """Return the entries of the section `Attributes` of a class's docstring, by name, each as one line."""
    _, _, section = (inspect.getdoc(documented) or "").partition("Attributes:\n")
    entries = re.findall(r"^    (\S+): (.*(?:\n {8}.*)*)", section, re.MULTILINE)
    return {name: " ".join(text.split()) for name, text in entries}
