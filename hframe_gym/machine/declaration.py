"""How the components of a machine declare their attributes, once: all other descriptions of them follow from this.

`viscous: Annotated[float, Number("viscous", lower=0.0)]` makes an attribute of a component a number with a unit. From
its declarations, and the descriptions in its docstring, follow the parameters of the machine that can be identified or
randomized, their units, and the fields of machine.json: schema, reader, writer and the tables of the documentation.
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

from ..registry import Registry

CoordinateKind = Literal["linear", "rotary"]
# "required": a file must state it, whether or not the class has a default. "written": a file may leave it out, but we
# write it always. "omitted": a file may leave it out, and we leave it out at its default.
Presence = Literal["required", "written", "omitted"]
Role = Literal["parameter", "device", ""]
POSITIVE, LARGEST = 1e-30, 1e30  # beyond these, products of a few parameters vanish or overflow

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
# Units of quantities of motors and belts, which are the same at linear and rotary coordinates.
FIXED_UNITS = {"voltage": "V", "current": "A", "torque": "Nm", "tension": "N"}


@dataclass(frozen=True)
class Number:
    """Declaration of a number with a unit; for an attribute that is a pair, of its lowest and highest value.

    Attributes:
        unit: Unit, or its name among `Variant.units`: "mass" is kg or kg m^2, depending on the coordinate.
        lower: Smallest value: `POSITIVE`, 0, or negative if every value is possible.
        upper: Largest value.
        role: "parameter": it enters the equations of motion, and can be identified and randomized. "device": it can
            be randomized only. "": neither.
        presence: Whether machine.json has it; a value that may be None is never "required".
        plausible: Largest plausible value of a length, m. A larger one is probably in millimeters.
        std: Name of the attribute that is its standard deviation, which machine.json states in the same object.
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


@dataclass(frozen=True)
class Numbers:
    """Declaration of several numbers by name; the kind of the component states names, units and bounds.

    Attributes:
        presence: Whether machine.json has them.
    """

    presence: Presence = "omitted"


@dataclass(frozen=True)
class Text:
    """Declaration of a text.

    Attributes:
        form: "name" of a component: letters, digits and underscores. "column" of recordings. "": any text.
        presence: Whether machine.json has it.
    """

    form: Literal["name", "column", ""] = ""
    presence: Presence = "required"


@dataclass(frozen=True)
class Attribute:
    """An attribute of a component.

    Attributes:
        name: Its name.
        declared: Its declaration, if it has one.
        type: Its type, without the declaration and without None.
        default: Its default; `dataclasses.MISSING` if the class has none.
        presence: Whether machine.json has it.
        description: What the docstring of the class says of it.
    """

    name: str
    declared: Number | Numbers | Text | None
    type: Any
    default: Any
    presence: Presence
    description: str

    @property
    def is_text(self) -> bool:
        """Whether it is a text, or one of several."""
        return self.type is str or get_origin(self.type) is Literal


@dataclass(frozen=True)
class Variant:
    """What follows from the kind of a component and that of the coordinate at which it is.

    Attributes:
        title: What the component is, for messages, such as "a linear coordinate".
        units: Units by the name of an attribute, or by the name that a declaration states in place of a unit.
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
        """Return the unit of an attribute from its name and declaration."""
        return self.units.get(name, self.units.get(quantity.unit, quantity.unit))

    def field(self, name: str) -> str:
        """Return the name of an attribute in machine.json."""
        return self.fields.get(name, name)


class Component:
    """Base class of coordinates, belts, drives and sensors: what follows from the declarations of their attributes.

    Attributes:
        kinds: Registered kinds of such components; None if they have no kinds.
    """

    kinds: ClassVar[Registry[Any] | None] = None

    @classmethod
    def variant(cls, coordinate: CoordinateKind, kind: str = "") -> Variant:
        """Return what follows from a kind of the component and the kind of the coordinate at which it is.

        Args:
            coordinate: Kind of the coordinate.
            kind: Name of the component's kind.
        """
        return Variant()

    @classmethod
    def variants(cls) -> dict[tuple[str, CoordinateKind], Variant]:
        """Return all variants of the component by the name of its kind, empty without kinds, and the coordinate's."""
        pairs = itertools.product(cls.kinds or ("",), UNITS)
        return {(kind, coordinate): cls.variant(coordinate, kind) for kind, coordinate in pairs}

    @property
    def label(self) -> str:
        """Name of the component in the full names of its parameters: its first attribute."""
        return str(getattr(self, next(iter(attributes(type(self))))))

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of the parameters that can be identified or randomized."""
        return names_of_role(type(self), "parameter")

    @property
    def parameter_values(self) -> dict[str, float]:
        """Values of the parameters that can be identified or randomized, SI, by name."""
        return {name: getattr(self, name) for name in self.parameter_names}

    @property
    def device_parameters(self) -> dict[str, float]:
        """Values of the parameters that do not enter the equations of motion, by name in alphabetical order."""
        return {name: getattr(self, name) for name in sorted(names_of_role(type(self), "device"))}

    def with_values(self, values: Mapping[str, Any]) -> Any:
        """Return a copy with other values of attributes, SI, by name; whole numbers are rounded."""
        whole = {name for name in values if attributes(type(self))[name].type is int}
        new = {name: round(value) if name in whole else value for name, value in values.items()}
        return dataclasses.replace(self, **new)  # type: ignore[type-var]


def attributes(component: type) -> Mapping[str, Attribute]:
    """Return the attributes of a component, texts first, then in the order of its class, which machine.json has too."""
    return _attributes(component)


@cache
def _attributes(component: type) -> Mapping[str, Attribute]:
    """Read the attributes of a component from its class."""
    hints = get_type_hints(component, include_extras=True)
    described = descriptions(component)
    found = []
    for info in dataclasses.fields(component):
        hint = hints[info.name]
        annotated, *declarations = get_args(hint) if get_origin(hint) is Annotated else (hint,)
        types = [part for part in get_args(annotated) if part is not NoneType]
        optional = NoneType in get_args(annotated)
        default = info.default_factory() if callable(info.default_factory) else info.default
        presence: Presence = "required" if default is dataclasses.MISSING else "written"
        declared = declarations[0] if declarations else None
        presence = "omitted" if optional else declared.presence if declared else presence
        value_type = types[0] if optional else annotated
        text = described.get(info.name, "")
        found.append(Attribute(info.name, declared, value_type, default, presence, text))
    deviations = {a.declared.std for a in found if isinstance(a.declared, Number)}
    own = [a for a in found if a.name not in deviations]
    return {a.name: a for a in sorted(own, key=lambda a: not a.is_text)}


def declared_numbers(component: type) -> dict[str, Number]:
    """Return the declared numbers of a component by name."""
    declared = {name: attribute.declared for name, attribute in attributes(component).items()}
    return {name: quantity for name, quantity in declared.items() if isinstance(quantity, Number)}


def names_of_role(component: type, role: Role) -> tuple[str, ...]:
    """Return the names of the parameters of a component that have a role."""
    return _names_of_role(component, role)


@cache
def _names_of_role(component: type, role: Role) -> tuple[str, ...]:
    """Collect the names of the parameters of a component that have a role."""
    return tuple(name for name, quantity in declared_numbers(component).items() if quantity.role == role)


def summary(documented: type) -> str:
    """Return the text of a docstring before its section `Attributes`, in one line."""
    return " ".join((inspect.getdoc(documented) or "").partition("Attributes:")[0].split())


def descriptions(documented: type) -> dict[str, str]:
    """Return the entries of the section `Attributes` of a docstring by name, each in one line."""
    _, _, section = (inspect.getdoc(documented) or "").partition("Attributes:\n")
    entries = re.findall(r"^    (\S+): (.*(?:\n {8}.*)*)", section, re.MULTILINE)
    return {name: " ".join(text.split()) for name, text in entries}
