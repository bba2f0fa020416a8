"""Build a machine from the content of a machine.json; check names, units and signs, and warn of implausible values."""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..effects import EFFECTS, effect_sites, get_effect
from ..errors import InputError
from ..machine import (
    ARM,
    DRIVE_KINDS,
    FIXED_UNITS,
    SENSOR_KINDS,
    UNITS,
    AppliedEffect,
    Belt,
    Coordinate,
    CoordinateKind,
    Drive,
    DriveKind,
    Machine,
    Sensor,
    Uncertainty,
    pulley_names,
    rigid_motions,
)
from .machine_schema import (
    MAY_BE_ZERO,
    BeltEntry,
    CoordinateEntry,
    DriveEntry,
    EffectEntry,
    MachineFile,
    QuantityEntry,
    SensorEntry,
    Table,
    UncertaintyEntry,
)

# m; larger values are probably millimeters. Belt axes of more than 10 m exist, hence a warning and no error.
_LARGEST = {"range": 10.0, "rest_length": 50.0, "radius": 1.0, "noise": 0.1, "resolution": 0.1}
MAX_TEXT = 1000  # characters of a name or description
# Signs that separate or quote the columns of files; "@" separates effects from sites.
_NOT_IN_COLUMNS = (",", ";", '"', "'", "@")
# Beyond these, products of a few parameters vanish or overflow.
_SMALLEST_POSITIVE, _LARGEST_MAGNITUDE = 1e-30, 1e30
_OTHER_UNITS = ("_mm", "_um", "_cm", "_deg", "_counts")


@dataclass(frozen=True)
class MachineReader:
    """Convert the content of one file to a machine; every error and warning names the file and the field.

    Attributes:
        path: Path of the file.
        content: Its content, which has the right fields and types.
    """

    path: Path
    content: MachineFile

    def machine(self) -> Machine:
        """Convert the content of a machine.json to a machine; warn of each of the `implausible_values`.

        Returns:
            The machine.

        Raises:
            InputError: If a name, unit, sign, reference or covariance is wrong, or an effect cannot act at its site.
                The message names the file and the field.
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
        """Create an error that names the file and the field.

        Args:
            field: Dotted name of the field, such as "drives.motor1.Kt".
            reason: What is wrong and what to do.

        Returns:
            The error.
        """
        return InputError(f"{self.path}: {field}: {reason}")

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

    def _values(self, field: str, table: Table, units: dict[str, str]) -> dict[str, float]:
        """Check unit and sign of quantities.

        Args:
            field: Dotted name of the table.
            table: Table that has the quantities.
            units: Unit by name of the quantity.

        Returns:
            Value by name of the quantity.

        Raises:
            InputError: If a unit or sign is wrong.
        """
        values = {}
        for key, unit in units.items():
            quantity: QuantityEntry = getattr(table, key)
            # Older files have the unit "1" for every gear ratio.
            if quantity.unit != unit and not (key == "gear_ratio" and quantity.unit == "1"):
                raise self._error(f"{field}.{key}", f"unit is {quantity.unit!r}, must be {unit!r}")
            smallest, sign = (0.0, "zero or more") if key in MAY_BE_ZERO else (_SMALLEST_POSITIVE, "positive")
            if not smallest <= quantity.value <= _LARGEST_MAGNITUDE:
                limits = "" if quantity.value <= 0 else f", between {smallest:g} and {_LARGEST_MAGNITUDE:g}"
                raise self._error(f"{field}.{key}", f"{quantity.value:g} must be {sign}{limits}")
            values[key] = quantity.value
        return values

    def _row(
        self,
        field: str,
        row: dict[str, float],
        *,
        empty: bool = False,
        products: bool = False,
        of: str = "coordinate",
    ) -> dict[str, float]:
        """Return a row of coefficients after checking that it names coordinates, or drives, of the file."""
        names = list(self._kinds) if of == "coordinate" else [drive.name for drive in self.content.drives]
        for name in (factor for key in row for factor in (key.split("*") if products else (key,))):
            if name not in names:
                raise self._error(field, f"no {of} is called {name!r}; there are {', '.join(names)}")
        if products and any(key.count("*") > 1 for key in row):
            raise self._error(field, "a product has two factors at most")
        if not empty and not any(value for key, value in row.items() if "*" not in key):
            raise self._error(field, f"needs a coefficient other than zero for at least one {of}")
        return row

    def _coordinate(self, entry: CoordinateEntry) -> Coordinate:
        """Return a coordinate."""
        field = f"coordinates.{entry.name}"
        if entry.radius is not None and entry.kind == "linear":
            raise self._error(f"{field}.radius", "a linear coordinate has none; delete it")
        on_belt = entry.kind == "rotary" and any(entry.name in b.extension for b in self.content.belts)
        if on_belt and entry.radius is None:
            raise self._error(
                f"{field}.radius", "a rotary coordinate on which a belt runs needs its pitch radius"
            )
        if entry.range is not None and not entry.range[0] < entry.range[1]:
            raise self._error(f"{field}.range", "must be [lowest, highest]")
        keys = [key for key in Coordinate.PARAMETERS if key != "radius" or entry.radius is not None]
        units = {key: Coordinate(entry.name, mass=0.0, kind=entry.kind).unit(key) for key in keys}
        values = self._values(field, entry, units)
        if entry.kind == "rotary":
            values.setdefault("radius", ARM)
        return Coordinate(entry.name, kind=entry.kind, range=entry.range, **values)

    def _belt(self, entry: BeltEntry) -> Belt:
        """Return a belt."""
        field = f"belts.{entry.name}"
        values = self._values(field, entry, {key: FIXED_UNITS[key] for key in Belt.PARAMETERS})
        extension = self._row(f"{field}.extension", entry.extension)
        length = self._row(f"{field}.length", entry.length, empty=True)
        return Belt(entry.name, extension=extension, length=length, **values)

    def _drive(self, entry: DriveEntry) -> Drive:
        """Return a drive."""
        field = f"drives.{entry.name}"
        self._check_text(f"{field}.channel", entry.channel, column=True)
        if entry.coordinate not in self._kinds:
            raise self._error(f"{field}.coordinate", f"no coordinate is called {entry.coordinate!r}")
        if entry.kind not in DRIVE_KINDS:
            choices = ", ".join(DRIVE_KINDS)
            raise self._error(
                f"{field}.kind", f"drive kind {entry.kind!r} is not registered; choose one of {choices}"
            )
        kind = DRIVE_KINDS.get(entry.kind)
        rated, moved = kind.rated(), self._kinds[entry.coordinate]
        kinds = [DRIVE_KINDS.get(name) for name in DRIVE_KINDS]
        fields = {key for each in kinds for key in (*each.parameters, each.rated())}
        fields |= {"current_limit"} if kind.law else set()
        for key in sorted(fields - {*kind.parameters, rated}):
            if getattr(entry, key) is not None:
                raise self._error(f"{field}.{key}", f"a drive of the kind {entry.kind!r} has none; delete it")
        units = {key: FIXED_UNITS[key] for key in kind.parameters if key != "gear_ratio"}
        units |= {rated: kind.unit(moved), "gear_ratio": UNITS[moved]["rad/position"]}
        if kind.command == "torque":
            units["Kt"] = "1"
            if entry.Kt is None:
                del units["Kt"]
            if entry.current_limit is not None:
                raise self._error(
                    f"{field}.current_limit", "a torque has no limit in A; describe a drive of currents"
                )
        missing = next((key for key in units if getattr(entry, key) is None), None)
        if missing is not None:
            raise self._error(
                f"{field}.{missing}", f'missing; write {{"value": ..., "unit": "{units[missing]}"}}'
            )
        if entry.voltage_range is not None:
            units["voltage_range"] = kind.unit(moved)
        values: dict[str, Any] = {"Kt": 1.0, **kind.fixed} | self._values(field, entry, units)
        values["rated_voltage"] = values.pop(rated)
        values["law_parameters"] = self._law_parameters(field, entry, kind)
        if entry.supply is not None:
            self._check_text(f"{field}.supply", entry.supply, column=True)
            if not kind.fraction:
                raise self._error(f"{field}.supply", "only a drive of the kind 'duty-cycle' has one")
            values["supply"] = entry.supply
        if entry.bandwidth is not None and kind.command == "voltage":
            raise self._error(
                f"{field}.bandwidth", "only a drive that controls its current or torque has one"
            )
        return Drive(
            entry.name,
            entry.channel,
            entry.coordinate,
            kind=entry.kind,
            converter_bits=entry.converter_bits,
            **values,
        )

    def _law_parameters(self, field: str, entry: DriveEntry, kind: type[DriveKind]) -> dict[str, float]:
        """Return the parameters of the law of a drive's kind; those that are not stated have their defaults."""
        units = kind.units_of_law(self._kinds[entry.coordinate])
        for key, quantity in entry.parameters.items():
            if key not in units:
                choices = f"it has {', '.join(units)}" if units else "it has none"
                raise self._error(
                    f"{field}.parameters.{key}", f"the kind {entry.kind!r} has no such parameter; {choices}"
                )
            if quantity.unit != units[key]:
                raise self._error(
                    f"{field}.parameters.{key}", f"unit is {quantity.unit!r}, must be {units[key]!r}"
                )
        missing = next((key for key in units if key not in {**kind.defaults, **entry.parameters}), None)
        if missing is not None:
            raise self._error(
                f"{field}.parameters.{missing}",
                f'missing; write {{"value": ..., "unit": "{units[missing]}"}}',
            )
        if kind.law is None:
            return {}
        values = {**kind.defaults, **{key: q.value for key, q in entry.parameters.items()}}
        try:
            return dict(kind.law.at(entry.name, **values).parameters)
        except InputError as error:
            raise self._error(f"{field}.parameters", str(error)) from None

    def _sensor(self, entry: SensorEntry) -> Sensor:
        """Return a sensor; without a declared kind, an encoder on a rotary coordinate and a laser on a linear one."""
        self._check_text("sensors.channel", entry.channel, column=True)
        field = f"sensors.{entry.channel}"
        # `SENSOR_KINDS.get` would import the module of a name such as "module:kind".
        if entry.kind is not None and entry.kind not in SENSOR_KINDS:
            choices = ", ".join(SENSOR_KINDS)
            raise self._error(
                f"{field}.kind", f"sensor kind {entry.kind!r} is not registered; choose one of {choices}"
            )
        kind = entry.kind or "laser"
        quantity = SENSOR_KINDS.get(kind).quantity()
        if quantity == "current":
            self._row(f"{field}.row", entry.row, of="drive")
            unit = FIXED_UNITS[quantity]
        else:
            row = self._row(f"{field}.row", entry.row, products=True)
            coordinate_kind = self._kinds[Sensor(entry.channel, row).coordinate]
            unit = UNITS[coordinate_kind][quantity]
            if entry.kind is None and coordinate_kind == "rotary":
                kind = "encoder"
        if entry.range is not None and not entry.range[0] < entry.range[1]:
            raise self._error(f"{field}.range", "must be [lowest, highest]")
        values = self._values(field, entry, {"noise": unit, "resolution": unit})
        if entry.zero is not None and quantity != "position":
            raise self._error(f"{field}.zero", "only a sensor of positions has a zero")
        if entry.zero is None:
            return Sensor(entry.channel, entry.row, kind=kind, **values)
        if entry.zero.unit != unit:
            raise self._error(f"{field}.zero", f"unit is {entry.zero.unit!r}, must be {unit!r}")
        return Sensor(
            entry.channel, entry.row, kind=kind, zero=entry.zero.value, zero_std=entry.zero.std, **values
        )

    def _declared_effects(self, machine: Machine) -> list[EffectEntry]:
        """Return the effects that the fields `range`, `delay` and `current_limit` of sensors and drives declare."""

        def declare(name: str, site: str, **parameters: QuantityEntry) -> EffectEntry:
            return EffectEntry(name=name, site=site, parameters=parameters)

        effects = []
        for sensor in self.content.sensors:
            if sensor.range is not None:
                unit = machine.unit(f"{sensor.channel}.noise")
                low, high = (QuantityEntry(value=limit, unit=unit) for limit in sensor.range)
                effects.append(declare("sensor_range", sensor.channel, low=low, high=high))
            if sensor.delay is not None:
                effects.append(declare("sensor_delay", sensor.channel, d=sensor.delay))
        drives = self.content.drives
        effects += [
            declare("current_limit", d.name, I=d.current_limit) for d in drives if d.current_limit is not None
        ]
        for drive in drives:
            if drive.bandwidth is not None:
                if drive.bandwidth.unit != "Hz" or not 0.0 < drive.bandwidth.value < _LARGEST_MAGNITUDE:
                    raise self._error(f"drives.{drive.name}.bandwidth", "must be a positive number of Hz")
                tau = QuantityEntry(value=1.0 / (2.0 * math.pi * drive.bandwidth.value), unit="s")
                effects.append(declare("electrical_lag", drive.name, tau=tau))
        delays = {d.name: d.delay for d in drives if d.delay is not None}
        if len(delays) == len(drives) and all(delay == drives[0].delay for delay in delays.values()):
            delays = {"drives": delays[drives[0].name]}
        return effects + [declare("input_delay", site, d=delay) for site, delay in delays.items()]

    def _effect(self, entry: EffectEntry, machine: Machine) -> AppliedEffect:
        """Return an effect at its site."""
        field = f"effects.{entry.name}"
        try:
            definition = get_effect(entry.name)
        except KeyError:
            raise self._error(field, f"no such effect; there are {', '.join(EFFECTS)}") from None
        sites = effect_sites(definition, machine)
        # A file may declare sites that no search tries, and already has the components that a structural effect adds.
        if definition.structure or definition.site in ("drive", "drives", "sensor"):
            sites = definition.possible_sites(machine)
        if entry.site not in sites:
            raise self._error(field, f"site {entry.site!r} is none of {', '.join(sites) or 'this machine'}")
        try:
            applied = definition.at(entry.site, **{key: q.value for key, q in entry.parameters.items()})
        except ValueError as error:
            raise self._error(field, str(error)) from None
        needed = (applied.coordinate, definition.against.partition(" of ")[2])
        absent = next((name for name in needed if name and name not in machine.coordinate_names), None)
        if absent is not None:
            raise self._error(
                field, f"the effect needs a coordinate that is called {absent!r}; the file has none"
            )
        if any(applied.label == other.label for other in machine.effects):
            raise self._error(field, f"declared twice at {entry.site}; delete one of the declarations")
        for key, quantity in entry.parameters.items():
            unit = machine.effect_unit(applied, key)
            if quantity.unit != unit:
                raise self._error(f"{field}.{key}", f"unit is {quantity.unit!r}, must be {unit!r}")
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


def implausible_values(machine: Machine) -> list[tuple[str, str]]:
    """List values of a machine that are possible but probably mistakes, so that the user is warned of them.

    - Lengths so large that they were probably entered in millimeters, such as a pulley radius of more than 1 m.
    - Factors in `Belt.extension` (extension of the belt per radius * angle of a pulley) that are no multiple of 1/2.
    - Belts that would have a length of zero or less at an end of the coordinates' ranges.
    - Carriages (linear coordinates) that cannot move without stretching a belt.
    - The coordinate y listed before x.
    - Sensors whose names end in another unit than m or rad, such as x_mm.

    Args:
        machine: Machine as its file declares it.

    Returns:
        For each doubtful value: name of the field with dots, such as "belts.left.rest_length", and a sentence that says
        what is doubtful and what to do.
    """
    doubts = [*_large_lengths(machine), *_doubtful_belts(machine)]
    if machine.tool_axes == ("y", "x"):
        doubts.append(("coordinates", "y comes before x, so it is the first axis of the tool: list x first"))
    for sensor in machine.sensors:
        ending = next((ending for ending in _OTHER_UNITS if sensor.channel.endswith(ending)), None)
        unit = machine.unit(f"{sensor.channel}.noise")
        if ending is not None and sensor.of_position:
            advice = f"call the column {sensor.channel.removesuffix(ending)}_{unit} and convert its values"
            doubts.append(
                (f"sensors.{sensor.channel}", f"measurements are in {unit}, not in {ending[1:]}: {advice}")
            )
    return doubts


def _large_lengths(machine: Machine) -> list[tuple[str, str]]:
    """List lengths that are probably in millimeters."""
    lengths: list[tuple[str, tuple[float, ...]]] = []
    lengths += [
        (f"coordinates.{c.name}.range", c.range)
        for c in machine.coordinates
        if c.kind == "linear" and c.range
    ]
    lengths += [
        (f"coordinates.{c.name}.radius", (c.radius,)) for c in machine.coordinates if c.kind == "rotary"
    ]
    lengths += [(f"belts.{b.name}.rest_length", (b.rest_length,)) for b in machine.belts]
    for s in machine.sensors:
        if machine.unit(f"{s.channel}.noise") == "m":
            lengths += [
                (f"sensors.{s.channel}.{key}", (value,)) for key, value in s.device_parameters.items()
            ]
    largest = [(field, max(map(abs, values))) for field, values in lengths]
    text = "{:g} m: is it in millimeters? All lengths are in m"
    return [
        (field, text.format(size)) for field, size in largest if size > _LARGEST[field.rpartition(".")[2]]
    ]


def _doubtful_belts(machine: Machine) -> list[tuple[str, str]]:
    """List factors of belts that are not plausible, carriages that cannot move, and negative lengths."""
    doubts = []
    moving = np.any([*rigid_motions(machine).values(), np.zeros(len(machine.coordinates))], axis=0)
    for belt in machine.belts:
        for name, factor in belt.extension.items():
            if name in pulley_names(machine) and not float(2 * factor).is_integer():
                reason = (
                    "is not a small integer; it multiplies the belt travel, which is radius * angle already"
                )
                doubts.append(
                    (f"belts.{belt.name}.extension.{name}", f"{factor:g} {reason}: usually it is 1 or -1")
                )
        ranges = {c.name: c.range for c in machine.coordinates if c.range is not None and c.kind == "linear"}
        changes = [min(f * end for end in ranges[name]) for name, f in belt.length.items() if name in ranges]
        shortest = belt.rest_length + sum(changes)
        if shortest <= 0:
            reason = f"the section would be {shortest:.3g} m long at an end of the coordinates' ranges"
            doubts.append(
                (f"belts.{belt.name}.rest_length", f"{reason}: correct rest_length, length or the ranges")
            )
    for index, c in enumerate(machine.coordinates):
        if c.kind == "linear" and not moving[index] and c.name not in machine.spring_loaded:
            reason = "cannot move without stretching a belt: check the signs of the factors in `extension`"
            doubts.append((f"coordinates.{c.name}", reason))
    return doubts
