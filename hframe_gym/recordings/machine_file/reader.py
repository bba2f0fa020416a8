"""Build a machine from the content of a machine.json; check names, units, signs, and plausibility."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...effects import EFFECTS, effect_sites, get_effect
from ...errors import InputError, suggestion
from ...machine import (
    DRIVE_KINDS,
    SENSED_QUANTITIES,
    SENSOR_KINDS,
    AppliedEffect,
    Attribute,
    Belt,
    Component,
    Coordinate,
    CoordinateKind,
    Drive,
    Effect,
    Machine,
    Number,
    Plain,
    Sensor,
    Uncertainty,
    Variant,
)
from ...registry import PLUGIN_VARIABLE, Registry
from .other_units import converted
from .plausibility import implausible_values
from .schema import EFFECT_FIELDS, EffectEntry, EffectField, MachineFile, QuantityEntry, UncertaintyEntry

_OWN_PART = f"if it is one of your own, name its Python file in the environment variable {PLUGIN_VARIABLE}"
MAX_TEXT = 1000  # characters of a name or description
# Signs that separate or quote the columns of files; "@" separates effects from sites.
_NOT_IN_COLUMNS = (",", ";", '"', "'", "@")


@dataclass(frozen=True)
class MachineReader:
    """Convert the content of one file to a machine; every error and warning names the file and the field.

    Attributes:
        path: The file, for messages.
        content: Its content, which has the right fields and types.
    """

    path: Path
    content: MachineFile

    def machine(self) -> Machine:
        """Convert the content of a machine.json to a machine; warn of each of the `implausible_values`.

        Raises:
            InputError: If a name, unit, sign, reference or covariance is wrong, or an effect cannot act at
                its site. The message names the file and the field.
        """
        machine = self._convert()
        for field, doubt in implausible_values(machine):
            warnings.warn(f"{self.path}: {field}: {doubt}", UserWarning, stacklevel=3)
        return machine

    def _convert(self) -> Machine:
        """Convert the content to a machine; raise an InputError if a name, unit, sign or site is wrong."""
        file = self.content
        for field, text in (("name", file.name), ("description", file.description)):
            self._check_text(field, text)
        if len(self._kinds) < len(file.coordinates):
            raise self._error("coordinates", "two have the same name; rename one of them")
        machine = Machine(
            name=file.name,
            coordinates=tuple(map(self._coordinate, file.coordinates)),
            belts=tuple(map(self._belt, file.belts)),
            drives=tuple(map(self._drive, file.drives)),
            sensors=tuple(map(self._sensor, file.sensors)),
            description=file.description,
        )
        names = [*self._kinds, *(b.name for b in machine.belts), *(d.name for d in machine.drives)]
        channels = [*machine.input_channels, *machine.supply_channels, *machine.output_channels]
        for what, labels in (("names of coordinates, belts and drives", names), ("channels", channels)):
            repeated = next((label for i, label in enumerate(labels) if label in labels[:i]), None)
            if repeated is not None:
                raise self._error(what, f"must all differ; {repeated!r} occurs twice")
        for entry in [*file.effects, *self._declared_effects(machine)]:
            machine = machine.replace(effects=(*machine.effects, self._effect(entry, machine)))
        for tied, (owner, _) in file.ties.items():
            if tied not in machine.parameters or owner not in machine.parameters or owner in file.ties:
                raise self._error(
                    f"ties.{tied}", f"{tied!r} and {owner!r} must be parameters, and {owner!r} not tied"
                )
        machine = machine.replace(ties=file.ties)
        if file.uncertainty is None:
            return machine
        return machine.replace(uncertainty=self._uncertainty(file.uncertainty, machine))

    @property
    def _kinds(self) -> dict[str, CoordinateKind]:
        """Kind of each coordinate by name."""
        return {c.name: c.kind for c in self.content.coordinates}

    def _error(self, field: str, reason: str) -> InputError:
        """Return an error that names the file and the field, e.g. "drives.motor1.Kt", and says what to do."""
        return InputError(f"{self.path}: {field}: {reason}")

    def _not_a_field(self, field: str, variant: Variant, kinds: Iterable[str]) -> InputError:
        """Return an error for a field that a component lacks, with the component's kinds that have it."""
        having = ", ".join(filter(None, dict.fromkeys(kinds)))
        return self._error(
            field, f"{variant.title} has none; delete it{having and f' (others have it: {having})'}"
        )

    def _check_text(self, field: str, text: str, *, column: bool = False) -> None:
        """Refuse texts that would break a line, control a terminal or break the header of a CSV file."""
        if len(text) > MAX_TEXT:
            raise self._error(field, f"is longer than {MAX_TEXT} characters")
        if not text.isprintable():
            raise self._error(
                field, "has a line break or another character that cannot be printed; remove it"
            )
        if column and (not text or text != text.strip() or set(text) & set(_NOT_IN_COLUMNS)):
            signs = " ".join(_NOT_IN_COLUMNS)
            raise self._error(
                field, f"must be the name of a column: no blanks at its ends and none of {signs}"
            )

    def _attributes(
        self, component: type[Component], entry: Any, variant: Variant, field: str
    ) -> dict[str, Any]:
        """Return a component's attributes by name; check that it has them, and their units and bounds."""
        own = {
            variant.field(a.name): a for a in component.attributes().values() if a.name not in variant.absent
        }
        known = {*own, *EFFECT_FIELDS.get(component, {}), "comment"}
        for key in sorted(set(type(entry).model_fields) - known):
            if getattr(entry, key) not in (None, {}):
                kinds = [
                    kind for (kind, _), other in component.variants().items() if key in other.own(component)
                ]
                raise self._not_a_field(f"{field}.{key}", variant, kinds)
        values = dict(variant.absent)
        for key, attribute in own.items():
            name, given = attribute.name, getattr(entry, key)
            if given is not None:
                values |= self._value(f"{field}.{key}", attribute, given, variant)
            elif name in variant.defaults:
                values[name] = variant.defaults[name]
            elif attribute.presence == "required":
                unit = variant.unit(name, component.numbers()[name])
                raise self._error(f"{field}.{key}", f'missing; write {{"value": ..., "unit": "{unit}"}}')
        return values

    def _value(self, field: str, attribute: Attribute, given: Any, variant: Variant) -> dict[str, Any]:
        """Return an attribute, and its standard deviation if given, by name; check unit, bounds and text."""
        name, declared = attribute.name, attribute.declared
        if isinstance(declared, Plain) and declared.form == "column":
            self._check_text(field, given, column=True)
        if not isinstance(declared, Number):
            return {name: given}
        if isinstance(given, tuple):
            self._check_interval(field, given)
        if not isinstance(given, QuantityEntry):
            return {name: given}
        self._check_quantity(field, given, declared, variant.unit(name, declared))
        return {name: given.value} | ({declared.std: given.std} if declared.std else {})

    def _check_quantity(self, field: str, given: QuantityEntry, declared: Number, unit: str) -> None:
        """Refuse a number that has another unit, or lies outside its bounds."""
        if given.unit not in (unit, declared.older_unit or unit):
            raise self._unit_error(field, given, unit)
        if not declared.lower <= given.value <= declared.upper:
            raise self._error(field, f"{given.value:g} must be {declared.limits(given.value)}")

    def _unit_error(self, field: str, given: QuantityEntry, unit: str) -> InputError:
        """Return the error about a wrong unit, with the value in the right one where it is known."""
        value = converted(given.value, given.unit, unit)
        remedy = "" if value is None else f'; write {{"value": {value:.6g}, "unit": "{unit}"}}'
        return self._error(field, f"unit is {given.unit!r}, must be {unit!r}{remedy}")

    def _check_interval(self, field: str, interval: tuple[float, float]) -> None:
        """Refuse an interval that ends before it begins."""
        if not interval[0] < interval[1]:
            raise self._error(field, "must be [lowest, highest]")

    def _check_kind(self, field: str, kind: str, registry: Registry[Any]) -> None:
        """Refuse a kind that is not registered; `Registry.get` would import "module" of "module:kind"."""
        if kind not in registry:
            choices = ", ".join(registry)
            raise self._error(
                field,
                f"{registry.kind} {kind!r} is not registered; choose one of {choices}; {_OWN_PART}"
                f"{suggestion(kind, registry)}",
            )

    def _check_row(
        self,
        field: str,
        row: Mapping[str, float],
        *,
        empty: bool = False,
        products: bool = False,
        of: str = "coordinate",
    ) -> None:
        """Refuse a row of coefficients that does not name coordinates, drives or belts of the file."""
        components = {
            "coordinate": self.content.coordinates,
            "drive": self.content.drives,
            "belt": self.content.belts,
        }
        names = [component.name for component in components[of]]
        for name in (factor for key in row for factor in (key.split("*") if products else (key,))):
            if name not in names:
                raise self._error(field, f"no {of} is called {name!r}; there are {', '.join(names)}")
        if products and any(key.count("*") > 1 for key in row):
            raise self._error(field, "a product has two factors at most")
        if not empty and not any(value for key, value in row.items() if "*" not in key):
            raise self._error(field, f"needs a coefficient other than zero for at least one {of}")

    def _coordinate(self, entry: Any) -> Coordinate:
        """Return a coordinate."""
        field = f"coordinates.{entry.name}"
        on_belt = entry.kind == "rotary" and any(entry.name in b.extension for b in self.content.belts)
        if on_belt and entry.radius is None:
            raise self._error(
                f"{field}.radius", "a rotary coordinate on which a belt runs needs its pitch radius"
            )
        return Coordinate(**self._attributes(Coordinate, entry, Coordinate.variant(entry.kind), field))

    def _belt(self, entry: Any) -> Belt:
        """Return a belt."""
        field = f"belts.{entry.name}"
        values = self._attributes(Belt, entry, Variant(), field)
        self._check_row(f"{field}.extension", entry.extension)
        self._check_row(f"{field}.length", entry.length or {}, empty=True)
        return Belt(**values)

    def _drive(self, entry: Any) -> Drive:
        """Return a drive."""
        field = f"drives.{entry.name}"
        if entry.coordinate not in self._kinds:
            raise self._error(f"{field}.coordinate", f"no coordinate is called {entry.coordinate!r}")
        name = "voltage" if entry.kind is None else entry.kind
        self._check_kind(f"{field}.kind", name, DRIVE_KINDS)
        kind, variant = DRIVE_KINDS.get(name), Drive.variant(self._kinds[entry.coordinate], name)
        values = self._attributes(Drive, entry, variant, field)
        self._check_effect_fields(Drive, entry, field, kind, variant)
        return Drive(**values | {"law_parameters": self._law_parameters(field, entry, variant, kind.law)})

    def _law_parameters(
        self, field: str, entry: Any, variant: Variant, law: Effect | None
    ) -> dict[str, float]:
        """Return the parameters of the law of a drive's kind; unstated ones have their defaults."""
        names = [p.name for p in law.parameters] if law else []
        given: dict[str, QuantityEntry] = entry.parameters or {}
        for key, quantity in given.items():
            place = f"{field}.parameters.{key}"
            if key not in names:
                reason = f"the kind {entry.kind!r} has no such parameter; it has {', '.join(names)}"
                raise self._error(place, reason)
            if quantity.unit != variant.units[key]:
                raise self._unit_error(place, quantity, variant.units[key])
        values = {key: variant.defaults[key] for key in names if key in variant.defaults}
        values |= {key: quantity.value for key, quantity in given.items()}
        missing = next((key for key in names if key not in values), None)
        if missing is not None:
            reason = f'missing; write {{"value": ..., "unit": "{variant.units[missing]}"}}'
            raise self._error(f"{field}.parameters.{missing}", reason)
        if law is None:
            return {}
        try:
            return dict(law.at(entry.name, **values).parameters)
        except InputError as error:
            raise self._error(f"{field}.parameters", str(error)) from None

    def _sensor(self, entry: Any) -> Sensor:
        """Return a sensor; without a kind, an encoder on a rotary coordinate and a laser on a linear one."""
        field = f"sensors.{entry.channel}"
        kind = "laser" if entry.kind is None else entry.kind
        self._check_text("sensors.channel", entry.channel, column=True)
        self._check_kind(f"{field}.kind", kind, SENSOR_KINDS)
        coordinate: CoordinateKind = "linear"  # currents and tensions have one unit
        component = SENSED_QUANTITIES[SENSOR_KINDS.get(kind).quantity()].component
        if component != "coordinate":
            self._check_row(f"{field}.row", entry.row, of=component)
        else:
            self._check_row(f"{field}.row", entry.row, products=True)
            coordinate = self._kinds[Sensor(entry.channel, entry.row).coordinate]
            if entry.kind is None and coordinate == "rotary":
                kind = "encoder"
        variant = Sensor.variant(coordinate, kind)
        values = self._attributes(Sensor, entry, variant, field)
        self._check_effect_fields(Sensor, entry, field, SENSOR_KINDS.get(kind), variant)
        return Sensor(**values | {"kind": kind})

    def _check_effect_fields(
        self, component: type[Component], entry: Any, field: str, kind: type, variant: Variant
    ) -> None:
        """Check the fields of a component that declare effects: kind of the component, unit and bounds."""
        for key, effect_field in EFFECT_FIELDS[component].items():
            given, place = getattr(entry, key), f"{field}.{key}"
            if given is None:
                continue
            if not effect_field.fits(kind):
                registry: Any = component.kinds
                kinds = [name for name in registry if effect_field.fits(registry.get(name))]
                raise self._not_a_field(place, variant, kinds)
            if effect_field.number is None:
                self._check_interval(place, given)
            else:
                self._check_quantity(place, given, effect_field.number, effect_field.number.unit)

    def _declared_effects(self, machine: Machine) -> list[EffectEntry]:
        """Return the effects that fields of sensors and drives declare (`EFFECT_FIELDS`)."""

        def declare(declared: EffectField, site: str, given: Any) -> EffectEntry:
            values = declared.parameters(*(given if isinstance(given, tuple) else (given.value,)))
            effect = AppliedEffect(get_effect(declared.effect), site, values)
            units = {key: machine.effect_unit(effect, key) for key in values}
            entries = {key: QuantityEntry(value=value, unit=units[key]) for key, value in values.items()}
            return EffectEntry(name=declared.effect, site=site, parameters=entries)

        effects = []
        for sensor in self.content.sensors:
            for key, declared in EFFECT_FIELDS[Sensor].items():
                if (given := getattr(sensor, key)) is not None:
                    effects.append(declare(declared, sensor.channel, given))
        drives = self.content.drives
        for key, declared in EFFECT_FIELDS[Drive].items():
            stated = {d.name: given for d in drives if (given := getattr(d, key)) is not None}
            equal = len(stated) == len(drives) and all(q == stated[drives[0].name] for q in stated.values())
            if equal and get_effect(declared.effect).site == "drives":
                stated = {"drives": stated[drives[0].name]}
            effects += [declare(declared, site, given) for site, given in stated.items()]
        return effects

    def _effect(self, entry: EffectEntry, machine: Machine) -> AppliedEffect:
        """Return an effect at its site."""
        field = f"effects.{entry.name}"
        try:
            definition = get_effect(entry.name)
        except KeyError:
            raise self._error(
                field,
                f"no such effect; there are {', '.join(EFFECTS)}; "
                f"{_OWN_PART}{suggestion(entry.name, EFFECTS)}",
            ) from None
        sites = effect_sites(definition, machine)
        # A file may declare sites that no search tries, and already has the components that a structural
        # effect adds.
        if definition.structure or definition.site in ("drive", "drives", "sensor"):
            sites = definition.possible_sites(machine)
        if entry.site not in sites:
            raise self._error(field, f"site {entry.site!r} is none of {', '.join(sites) or 'this machine'}")
        try:
            applied = definition.at(entry.site, **{key: q.value for key, q in entry.parameters.items()})
        except ValueError as error:
            raise self._error(field, str(error)) from None
        coordinates, belts = machine.coordinate_names, tuple(b.name for b in machine.belts)
        for kind, needed, names in (
            ("coordinate", applied.coordinate, coordinates),
            ("coordinate", definition.against.partition(" of ")[2], coordinates),
            ("belt", applied.added_belt, belts),
        ):
            if needed and needed not in names:
                raise self._error(
                    field, f"the effect needs a {kind} that is called {needed!r}; the file has none"
                )
        if any(applied.label == other.label for other in machine.effects):
            raise self._error(field, f"declared twice at {entry.site}; delete one of the declarations")
        for key, quantity in entry.parameters.items():
            unit = machine.effect_unit(applied, key)
            if quantity.unit != unit:
                raise self._unit_error(f"{field}.{key}", quantity, unit)
        return applied

    def _uncertainty(self, table: UncertaintyEntry, machine: Machine) -> Uncertainty:
        """Return the covariance of the parameters."""
        size = len(table.names)
        square = len(table.covariance) == size and all(len(row) == size for row in table.covariance)
        covariance = np.array(table.covariance, float).reshape(size, size) if square else np.zeros((0, 0))
        if not square or not np.allclose(covariance, covariance.T, rtol=1e-6):
            raise self._error(
                "uncertainty.covariance", f"must be a symmetric {size} x {size} matrix, one row per name"
            )
        if not np.all(np.diag(covariance) >= 0.0) or len(set(table.names)) < size:
            raise self._error("uncertainty", "must have distinct names and no negative variance")
        unknown = sorted(set(table.names) - set(machine.parameters))
        if unknown:
            raise self._error("uncertainty.names", f"the machine has no parameter {', '.join(unknown)}")
        return Uncertainty(tuple(table.names), covariance)
