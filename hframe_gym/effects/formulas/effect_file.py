"""Turn a fitted formula into an effect: as Python source to review, and as a definition to use.

The definition is made by executing the source, so that what is evaluated is what is written.
"""

from __future__ import annotations

import inspect
import keyword
import re
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import InputError
from ...files import write_text
from ...machine import UNITS, AppliedEffect, CoordinateKind, Effect, EffectParameter, Machine
from ..smooth_table import HOOK_OF_KIND
from .regression import Formula
from .terms import ShapeRole

_LETTERS = "ABC"  # First letters of the amplitudes (factors) of the first, second and third term.
# Name of the formula's argument, by the kind of the variable. Other variables, and variables of another
# coordinate than the one on which the effect acts, are called u.
_ARGUMENT = {"position": "q", "velocity": "v", "time": "t"}
# A search on another machine starts at these multiples of the identified width or period,
_WIDTH_FACTORS = (0.5, 1.0, 2.0)
_CENTERS = 4  # and at so many centers over the range of the variable, besides the identified center.
_LARGE = 1e6  # SI; bound of parameters that physics does not limit.
# Typical size of an amplitude that is a force, a stiffness or a drag, in multiples of its typical value on a
# machine.
_TYPICAL_SCALE = 0.3
_LINE = 110  # Largest length of a line of the file, as in this package.
# Functions of `elementwise` that a formula may use; the file imports those that it does.
_FUNCTIONS = ("absolute", "cos", "exp", "maximum", "sin", "sqrt")
_REGISTRATION = """
# Delete this line and the import of register_effect where the file moves into the folder hframe_gym/effects.
register_effect(EFFECT)
"""


@dataclass(frozen=True)
class FormulaEffect:
    """Formula that replaces a table (a force or friction level interpolated between knots) of a machine.

    Attributes:
        name: Name of the new effect, a Python identifier.
        formula: The formula with its fitted parameters.
        table: The table that it replaces, at a coordinate.
        machine: Machine with this table.
        notes: Sentences about the origin and the accuracy, for the docstring of the file.
    """

    name: str
    formula: Formula
    table: AppliedEffect
    machine: Machine
    notes: Sequence[str] = ()

    def __post_init__(self) -> None:
        """Check the name; a ValueError says that it is no Python identifier in lower case."""
        if not re.fullmatch(r"[a-z][a-z0-9_]*", self.name) or keyword.iskeyword(self.name):
            raise ValueError(
                f"effect name {self.name!r}: use lower-case letters, digits and underscores only"
            )

    @property
    def text(self) -> str:
        """Equation of a force, "f = A * catch(q, center, width)", or of a Coulomb friction, "F - Fc = ...".

        Fc is the Coulomb friction without the effect, F that with it.
        """
        left = "f" if self._hook == "force" else "F - Fc"
        return f"{left} = {self._expression}"

    @property
    def values(self) -> dict[str, float]:
        """Fitted parameters by name, SI."""
        return {parameter.name: value for parameter, value in self._parameters()}

    def definition(self) -> Effect:
        """Return the definition of the effect, without registering it."""
        namespace: dict[str, Any] = {"__name__": f"hframe_formula_{self.name}"}
        exec(compile(self._definition_source(), f"<effect {self.name}>", "exec"), namespace)
        return namespace["EFFECT"]

    def applied(self) -> AppliedEffect:
        """Return the effect that replaces the table, with fitted parameters clipped to their bounds."""
        definition = self.definition()
        bounds = {p.name: (p.lower, p.upper) for p in definition.parameters}
        values = {name: float(np.clip(value, *bounds[name])) for name, value in self.values.items()}
        return definition.at(self.table.site, **values)

    def source(self) -> str:
        """Return the source of a Python module that defines the effect, and registers it when imported."""
        text = self._definition_source()
        imports = "from hframe_gym.effects import register_effect\nfrom hframe_gym.machine import"
        return text.replace("from hframe_gym.machine import", imports, 1) + _REGISTRATION

    @property
    def _hook(self) -> str:
        """Name of the effect's function with the formula: "force", or "coulomb" for a friction level."""
        return HOOK_OF_KIND[self.table.name.partition("[")[0]]

    @property
    def _variable(self) -> tuple[str, str]:
        """Kind and coordinate of the table's variable, such as ("velocity", "x"); ("time", "")."""
        variable, _, coordinate = self.table.definition.against.partition(" of ")
        return variable, coordinate

    @property
    def _argument(self) -> str:
        """Name of the formula's argument: q or v of the coordinate on which it acts, t, or u."""
        variable, coordinate = self._variable
        return _ARGUMENT.get(variable, "u") if coordinate in ("", self.table.site) else "u"

    @property
    def _kind(self) -> CoordinateKind:
        """Kind of the coordinate on which the effect acts, "linear" or "rotary"."""
        return self.machine.coordinate(self.table.site).kind

    def _names(self) -> Iterator[tuple[list[str], dict[str, str]]]:
        """Yield, for each term, the names of its amplitudes, and those of its shape parameters by role."""
        for index, term in enumerate(self.formula.terms):
            letter, suffix = _LETTERS[index], "" if index == 0 else str(index + 1)
            count = len(term.expressions)
            amplitudes = [letter] if count == 1 else [f"{letter}{i + 1}" for i in range(count)]
            yield amplitudes, {role: f"{role}{suffix}" for role in term.shapes}

    @property
    def _expression(self) -> str:
        """The formula as a Python expression."""
        summands = []
        for term, (amplitudes, shapes) in zip(self.formula.terms, self._names(), strict=True):
            for amplitude, expression in zip(amplitudes, term.expressions, strict=True):
                factor = expression.format(u=self._argument, **shapes)
                summands.append(amplitude if factor == "1.0" else f"{amplitude} * {factor}")
        return " + ".join(summands)

    def _parameters(self) -> Iterator[tuple[EffectParameter, float]]:
        """Yield the parameters of the effect with their fitted values."""
        values = iter(self.formula.amplitudes)
        for term, shapes, (amplitudes, names) in zip(
            self.formula.terms, self.formula.shapes, self._names(), strict=True
        ):
            for name, power in zip(amplitudes, term.powers, strict=True):
                value = next(values)
                unit = self._amplitude_unit(power)
                scale = _TYPICAL_SCALE if unit in UNITS[self._kind] else max(_rounded(abs(value)), 1e-6)
                yield EffectParameter(name, unit, -_LARGE, _LARGE, scale=scale, role="amplitude"), value
            by_role = dict(zip(term.shapes, shapes, strict=True))
            for role, value in by_role.items():
                yield self._shape_parameter(names[role], role, by_role), value

    def _shape_parameter(
        self, name: str, role: ShapeRole, shapes: Mapping[ShapeRole, float]
    ) -> EffectParameter:
        """Return the declaration of a shape parameter with starting values for a search.

        Args:
            name: Name of the parameter.
            role: What it is in its term: "center", "width" or "period", for example.
            shapes: Fitted values of all shape parameters of the term by role, SI.
        """
        unit, value = self._shape_unit(), shapes[role]
        if role == "period" and self._argument == "q":
            return EffectParameter(name, unit, 1e-6, _LARGE, scale=0.1, role="period")
        if role == "center":
            knots = [v for k, v in self.table.parameters.items() if k.startswith("k")]
            grid = [value, *np.linspace(min(knots), max(knots), _CENTERS + 2)[1:-1].tolist()]
            scale = _rounded(shapes.get("width", 0.1 * (max(knots) - min(knots))))
            lower = -_LARGE
        else:
            grid, scale, lower = [factor * value for factor in _WIDTH_FACTORS], 1.0, 1e-6
        if len(self.formula.terms) > 1:
            grid = [value]  # the combinations of several terms would be too many
        return EffectParameter(name, unit, lower, _LARGE, scale, tuple(map(_rounded, grid)))

    def _variable_unit(self) -> tuple[str, str]:
        """Return the unit of the table's variable, and "position" or "speed".

        The second word is empty for the time, and where the variable is an angle but the effect acts along a
        length, or the other way round.
        """
        variable, coordinate = self._variable
        if variable == "time":
            return "s", ""
        kind = self.machine.coordinate(coordinate).kind
        unit = "m" if kind == "linear" else "rad"
        key = "speed" if variable == "velocity" else "position"
        return (f"{unit}/s" if key == "speed" else unit), (key if kind == self._kind else "")

    def _shape_unit(self) -> str:
        """Return the unit of a shape parameter (center, width, period), or its key in `machine.UNITS`.

        For most units, starting values are multiples of a typical value of the machine. "absolute position"
        has no typical value, so that starting values are in m or rad; the unit "m" would stand for an
        extension of belts, which has one.
        """
        unit, key = self._variable_unit()
        return "absolute position" if key == "position" else unit

    def _amplitude_unit(self, power: float) -> str:
        """Return the unit of a factor A in A * variable**power, or its key in `machine.UNITS`."""
        unit, key = self._variable_unit()
        if power == 0:
            return "force"
        known = {("position", 1.0): "stiffness", ("speed", 1.0): "viscous", ("speed", 2.0): "drag"}
        force = "N" if self._kind == "linear" else "Nm"
        return known.get((key, power), f"{force}/({unit})^{power:g}")

    def _definition_source(self) -> str:
        """Return the source of a file that defines the effect but does not register it."""
        expression = self._expression
        helpers = dict.fromkeys(t.helper for t in self.formula.terms if t.helper is not None)
        body = "\n\n\n".join(inspect.getsource(helper).rstrip() for helper in helpers)
        variable, coordinate = self._variable
        functions = [self._hook_source(expression)]
        reads_another = self._argument == "u"  # a variable that is not the site's own
        if variable == "path":
            functions.append(
                "def next_state(z, dq):  # type: ignore[no-untyped-def]\n"
                '    """Return the path traveled since the start of the run; dq: distance of the step."""\n'
                "    return z + absolute(dq)"
            )
        same_kind = f'machine.coordinate(site).kind == "{self._kind}"'
        functions.append(self._predicate_source("fits_site", "machine, site", same_kind))
        if reads_another:
            present = f'"{coordinate}" in machine.coordinate_names'
            functions.append(self._predicate_source("fits", "machine", present if coordinate else "True"))
        code = "\n\n\n".join([*([body] if body else []), *functions])
        names = [name for name in _FUNCTIONS if re.search(rf"\b{name}\(", code)]
        head = [f'"""{self._docstring()}"""', ""]
        head += ["import math", ""] if "math." in code else []
        head += [f"from hframe_gym.dynamics.elementwise import {', '.join(names)}"] if names else []
        head += ["from hframe_gym.machine import Effect, EffectParameter", "", ""]
        return "\n".join(head) + "\n" + code + "\n\n\n" + self._effect_source(variable, reads_another)

    def _docstring(self) -> str:
        """Return the docstring of the file."""
        what = "force" if self._hook == "force" else "change of the Coulomb friction"
        against = self.table.definition.against
        title = f"{self.name.replace('_', ' ').capitalize()}: a {what} that depends on {_described(against)}."
        fitted = ", ".join(f"{name} = {value:.5g}" for name, value in self.values.items())
        paragraphs = [
            f"Proposed from the table {self.table.label}: {self.formula.name}. "
            f"Identified values, SI: {fitted}.",
            *self.notes,
            "A proposal, not physics: review the form, and replace this text by the cause once it is known.",
        ]
        wrapped = [
            textwrap.fill(p, _LINE, break_long_words=False, break_on_hyphens=False) for p in paragraphs
        ]
        return "\n\n".join([title, *wrapped]) + "\n"

    def _hook_source(self, expression: str) -> str:
        """Return the source of the function with the formula."""
        names = ", ".join([self._argument, *self.values])
        unit = "N" if self._kind == "linear" else "Nm"
        returned = "force" if self._hook == "force" else "change of the Coulomb friction"
        summands = expression.split(" + ")
        text = f"    return {expression}"
        if len(text) > _LINE:
            text = "    return (\n        " + "\n        + ".join(summands) + "\n    )"
        variable = _described(self.table.definition.against)
        return (
            f"def {self._hook}({names}):  # type: ignore[no-untyped-def]\n"
            f'    """Return the {returned}, {unit}; '
            f'{self._argument}: {variable}, {self._variable_unit()[0]}."""\n'
            f"{text}"
        )

    @staticmethod
    def _predicate_source(name: str, arguments: str, condition: str) -> str:
        """Return the source of a function that tells whether an effect can act at a site, or on a machine."""
        return (
            f"def {name}({arguments}):  # type: ignore[no-untyped-def]\n"
            '    """Return whether the effect can act there."""\n'
            f"    return {condition}"
        )

    def _effect_source(self, variable: str, reads_another: bool) -> str:
        """Return the source of the statement EFFECT = Effect(...)."""
        lines = [
            f'name="{self.name}"',
            'site="coordinate"',
            f'formula="{self.text}"',
            'source="proposed from recordings"',
            f"{self._hook}={self._hook}",
            *(["next_state=next_state"] if variable == "path" else []),
            *([f'against="{self.table.definition.against}"', "fits=fits"] if reads_another else []),
            "fits_site=fits_site",
        ]
        text = "EFFECT = Effect(\n" + "".join(f"    {line},\n" for line in lines) + "    parameters=(\n"
        for parameter, _ in self._parameters():
            limits = f"{parameter.lower:g}, {parameter.upper:g}".replace("e-06", "e-6").replace("e+06", "e6")
            arguments = [f'"{parameter.name}", "{parameter.unit}", {limits}, scale={parameter.scale!r}']
            if parameter.role != "shape":
                arguments.append(f'role="{parameter.role}"')
            if parameter.grid != (0.0,):
                end = ",)" if len(parameter.grid) == 1 else ")"
                arguments.append(f"grid=({', '.join(map(repr, parameter.grid))}{end}")
            line = f"        EffectParameter({', '.join(arguments)}),"
            if len(line) > _LINE:
                line = "        EffectParameter(\n            " + ", ".join(arguments) + "\n        ),"
            text += line + "\n"
        return text + "    ),\n)\n"


def write_effect_file(effect: FormulaEffect, path: Path) -> None:
    """Write a new Python file that defines and registers an effect.

    Raises:
        InputError: If the file exists already, which is not replaced, or cannot be written.
    """
    if path.exists():
        raise InputError(f"{path}: the file exists; remove it or choose another name with --out")
    try:
        write_text(path, effect.source())
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror})") from None


def _rounded(value: float) -> float:
    """Return a value rounded to five significant digits."""
    return float(f"{value:.5g}")


def _described(against: str) -> str:
    """Return a variable with an article: "the position of x", "the time since it was switched on"."""
    return "the time since the machine was switched on" if against == "time" else f"the {against}"
