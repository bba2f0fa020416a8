"""Read and write machine.json: a machine's components with parameter values, units and standard deviations."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from ..atomic_files import write_text
from ..effects import EFFECTS, effect_sites, get_effect
from ..errors import InputError
from ..machine import (
    BUILTIN_MACHINES,
    FIXED_UNITS,
    SENSOR_KINDS,
    UNITS,
    AppliedEffect,
    Belt,
    Coordinate,
    CoordinateKind,
    Drive,
    Machine,
    Sensor,
    Uncertainty,
)
from .machine_schema import (
    SCHEMA_VERSION,
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

# All other parameters of the components must be positive.
_MAY_BE_ZERO = ("viscous", "coulomb", "Ke", "noise", "resolution")


def load_machine(source: str | Path | Machine) -> Machine:
    """Load a machine from a preset or a machine.json.

    Args:
        source: Name of a preset (a key of `BUILTIN_MACHINES`), path of a machine.json, or a machine, which is returned
            unchanged.

    Returns:
        The validated machine.

    Raises:
        InputError: If the source is neither a file nor a preset, or a field of the file is invalid. The message names
            the file and the field.
    """
    if isinstance(source, Machine):
        return source
    if str(source) in BUILTIN_MACHINES:
        return BUILTIN_MACHINES[str(source)]()
    path = Path(source)
    if not path.is_file():
        raise InputError(f"machine {str(source)!r} is neither a file nor one of {', '.join(BUILTIN_MACHINES)}")
    try:
        text = path.read_text(encoding="utf-8")
        content = MachineFile.model_validate_json(text)
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: not a machine.json: it is not a text file in UTF-8 ({error.reason})") from None
    except ValidationError as error:
        first = error.errors()[0]
        reason = "unknown field; delete it" if first["type"] == "extra_forbidden" else first["msg"]
        raise InputError(f"{path}: {_field_name(first['loc'], text)}: {reason}") from None
    return _FileReader(path, content).machine()


def save_machine(machine: Machine, path: str | Path) -> None:
    """Write a machine to a machine.json, which `load_machine` reads back with the same parameter values.

    Args:
        machine: Machine to write.
        path: Path of the file; its folder is created if necessary, and an existing file is replaced.

    Raises:
        OSError: If the file cannot be written.
    """
    write_text(path, json.dumps(machine_to_dict(machine), indent=1) + "\n")


def machine_to_dict(machine: Machine) -> dict[str, Any]:
    """Convert a machine to the content of its machine.json, with the unit of every parameter.

    Args:
        machine: Machine to convert.

    Returns:
        Content with the fields of `MachineFile`, made of dictionaries, lists, strings and numbers only.
    """

    def quantity(owner: str, key: str, value: float) -> dict[str, Any]:
        """Return value and unit, and the standard deviation of an identified parameter."""
        name = f"{owner}.{key}"
        entry: dict[str, Any] = {"value": value, "unit": machine.unit(name)}
        std = machine.uncertainty.std(name) if machine.uncertainty else None
        return entry | ({} if std is None else {"std": std})

    coordinates = []
    for coordinate in machine.coordinates:
        keys = [key for key in coordinate.PARAMETERS if key != "radius" or coordinate.kind == "rotary"]
        entry: dict[str, Any] = {"name": coordinate.name, "kind": coordinate.kind}
        entry |= {key: quantity(coordinate.name, key, getattr(coordinate, key)) for key in keys}
        coordinates.append(entry | ({"range": list(coordinate.range)} if coordinate.range else {}))
    belts = [
        {"name": b.name}
        | {key: quantity(b.name, key, getattr(b, key)) for key in b.PARAMETERS}
        | {"extension": dict(b.extension), "length": dict(b.length)}
        for b in machine.belts
    ]
    drives = []
    for drive in machine.drives:
        entry = {"name": drive.name, "channel": drive.channel, "coordinate": drive.coordinate}
        keys = [*drive.PARAMETERS, "rated_voltage", *(["voltage_range"] if drive.voltage_range is not None else [])]
        entry |= {key: quantity(drive.name, key, getattr(drive, key)) for key in keys}
        drives.append(entry | {"converter_bits": drive.converter_bits})
    sensors = [
        {"channel": s.channel, "kind": s.kind, "row": dict(s.row)}
        | {key: quantity(s.channel, key, value) for key, value in s.device_parameters.items()}
        | _zero_entry(s, machine.unit(f"{s.channel}.noise"))
        for s in machine.sensors
    ]
    effects = [
        {"name": e.name, "site": e.site, "parameters": {k: quantity(e.label, k, v) for k, v in e.parameters.items()}}
        for e in machine.effects
    ]
    content: dict[str, Any] = {"schema": SCHEMA_VERSION, "name": machine.name, "description": machine.description}
    content |= {"coordinates": coordinates, "belts": belts, "drives": drives, "sensors": sensors, "effects": effects}
    if machine.ties:
        content["ties"] = {name: list(tie) for name, tie in machine.ties.items()}
    if machine.uncertainty is not None:
        covariance = [[float(f"{value:.9g}") for value in row] for row in machine.uncertainty.covariance]
        content["uncertainty"] = {"names": list(machine.uncertainty.names), "covariance": covariance}
    return content


def _zero_entry(sensor: Sensor, unit: str) -> dict[str, Any]:
    """Return the field `zero` of a sensor whose zero is known, else nothing."""
    if sensor.zero is None:
        return {}
    std = {} if sensor.zero_std is None else {"std": sensor.zero_std}
    return {"zero": {"value": sensor.zero, "unit": unit} | std}


def _field_name(location: tuple[int | str, ...], text: str) -> str:
    """Return the dotted name of a field, with the names of components and channels instead of their indices."""
    labels = []
    value: Any = json.loads(text) if location else None
    for key in location:
        labels.append(str(key))
        try:
            value = value[key]
        except (KeyError, IndexError, TypeError):  # the field is missing
            value = None
        if isinstance(key, int) and isinstance(value, dict):
            labels[-1] = str(value.get("name", value.get("channel", key)))
    return ".".join(labels) or "file"


@dataclass(frozen=True)
class _FileReader:
    """Converts the content of one file to a machine; every error names the file and the field."""

    path: Path
    content: MachineFile

    def machine(self) -> Machine:
        """Return the machine of the file."""
        file = self.content
        if len(self.kinds) < len(file.coordinates):
            raise self.error("coordinates", "two have the same name; rename one of them")
        machine = Machine(
            name=file.name,
            coordinates=tuple(map(self.coordinate, file.coordinates)),
            belts=tuple(map(self.belt, file.belts)),
            drives=tuple(map(self.drive, file.drives)),
            sensors=tuple(map(self.sensor, file.sensors)),
            description=file.description,
        )
        names = [*self.kinds, *(b.name for b in machine.belts), *(d.name for d in machine.drives)]
        channels = [*machine.input_channels, *machine.output_channels]
        for what, labels in (("names of coordinates, belts and drives", names), ("channels", channels)):
            repeated = next((label for i, label in enumerate(labels) if label in labels[:i]), None)
            if repeated is not None:
                raise self.error(what, f"must all differ; {repeated!r} occurs twice")
        for entry in [*file.effects, *self.declared_effects(machine)]:
            machine = machine.replace(effects=(*machine.effects, self.effect(entry, machine)))
        for tied, (owner, _) in file.ties.items():
            if tied not in machine.parameters or owner not in machine.parameters or owner in file.ties:
                raise self.error(f"ties.{tied}", f"{tied!r} and {owner!r} must be parameters, and {owner!r} not tied")
        machine = machine.replace(ties=file.ties)
        if file.uncertainty is None:
            return machine
        return machine.replace(uncertainty=self.uncertainty(file.uncertainty, machine))

    @property
    def kinds(self) -> dict[str, CoordinateKind]:
        """Kind of each coordinate by name."""
        return {c.name: c.kind for c in self.content.coordinates}

    def error(self, field: str, reason: str) -> InputError:
        """Return an error that names the file and the field."""
        return InputError(f"{self.path}: {field}: {reason}")

    def values(self, field: str, table: Table, units: dict[str, str]) -> dict[str, float]:
        """Return the values of quantities by key after checking unit and sign."""
        values = {}
        for key, unit in units.items():
            quantity: QuantityEntry = getattr(table, key)
            if quantity.unit != unit:
                raise self.error(f"{field}.{key}", f"unit is {quantity.unit!r}, must be {unit!r}")
            if quantity.value < 0 or (quantity.value == 0 and key not in _MAY_BE_ZERO):
                sign = "zero or more" if key in _MAY_BE_ZERO else "positive"
                raise self.error(f"{field}.{key}", f"{quantity.value:g} must be {sign}")
            values[key] = quantity.value
        return values

    def row(
        self, field: str, row: dict[str, float], *, empty: bool = False, products: bool = False
    ) -> dict[str, float]:
        """Return a row of coefficients after checking that it names coordinates of the file."""
        for name in (factor for key in row for factor in (key.split("*") if products else (key,))):
            if name not in self.kinds:
                raise self.error(field, f"no coordinate is called {name!r}; there are {', '.join(self.kinds)}")
        if not empty and not any(value for key, value in row.items() if "*" not in key):
            raise self.error(field, "needs a coefficient other than zero for at least one coordinate")
        return row

    def coordinate(self, entry: CoordinateEntry) -> Coordinate:
        """Return a coordinate."""
        field = f"coordinates.{entry.name}"
        if (entry.radius is None) != (entry.kind == "linear"):
            raise self.error(f"{field}.radius", "a rotary coordinate needs a radius, a linear one has none")
        if entry.range is not None and not entry.range[0] < entry.range[1]:
            raise self.error(f"{field}.range", "must be [lowest, highest]")
        keys = [key for key in Coordinate.PARAMETERS if key != "radius" or entry.radius is not None]
        units = {key: Coordinate(entry.name, mass=0.0, kind=entry.kind).unit(key) for key in keys}
        return Coordinate(entry.name, kind=entry.kind, range=entry.range, **self.values(field, entry, units))

    def belt(self, entry: BeltEntry) -> Belt:
        """Return a belt."""
        field = f"belts.{entry.name}"
        values = self.values(field, entry, {key: FIXED_UNITS[key] for key in Belt.PARAMETERS})
        extension = self.row(f"{field}.extension", entry.extension)
        return Belt(
            entry.name, extension=extension, length=self.row(f"{field}.length", entry.length, empty=True), **values
        )

    def drive(self, entry: DriveEntry) -> Drive:
        """Return a drive."""
        field = f"drives.{entry.name}"
        if entry.coordinate not in self.kinds:
            raise self.error(f"{field}.coordinate", f"no coordinate is called {entry.coordinate!r}")
        keys = (*Drive.PARAMETERS, "rated_voltage", *(() if entry.voltage_range is None else ("voltage_range",)))
        values: dict[str, Any] = self.values(field, entry, {key: FIXED_UNITS[key] for key in keys})
        return Drive(entry.name, entry.channel, entry.coordinate, converter_bits=entry.converter_bits, **values)

    def sensor(self, entry: SensorEntry) -> Sensor:
        """Return a sensor; without a declared kind, an encoder on a rotary coordinate and a laser on a linear one."""
        field = f"sensors.{entry.channel}"
        coordinate_kind = self.kinds[
            Sensor(entry.channel, self.row(f"{field}.row", entry.row, products=True)).coordinate
        ]
        kind = entry.kind or ("encoder" if coordinate_kind == "rotary" else "laser")
        if kind not in SENSOR_KINDS:  # `SENSOR_KINDS.get` would import the module of a name such as "module:kind"
            choices = ", ".join(SENSOR_KINDS)
            raise self.error(f"{field}.kind", f"sensor kind {kind!r} is not registered; choose one of {choices}")
        if entry.range is not None and not entry.range[0] < entry.range[1]:
            raise self.error(f"{field}.range", "must be [lowest, highest]")
        unit = UNITS[coordinate_kind]["position"]
        values = self.values(field, entry, {"noise": unit, "resolution": unit})
        if entry.zero is None:
            return Sensor(entry.channel, entry.row, kind=kind, **values)
        if entry.zero.unit != unit:
            raise self.error(f"{field}.zero", f"unit is {entry.zero.unit!r}, must be {unit!r}")
        return Sensor(entry.channel, entry.row, kind=kind, zero=entry.zero.value, zero_std=entry.zero.std, **values)

    def declared_effects(self, machine: Machine) -> list[EffectEntry]:
        """Return the effects that the fields `range`, `delay` and `current_limit` of sensors and drives declare."""

        def effect(name: str, site: str, **parameters: QuantityEntry) -> EffectEntry:
            return EffectEntry(name=name, site=site, parameters=parameters)

        effects = []
        for sensor in self.content.sensors:
            if sensor.range is not None:
                unit = machine.unit(f"{sensor.channel}.noise")
                low, high = (QuantityEntry(value=limit, unit=unit) for limit in sensor.range)
                effects.append(effect("sensor_range", sensor.channel, low=low, high=high))
            if sensor.delay is not None:
                effects.append(effect("sensor_delay", sensor.channel, d=sensor.delay))
        drives = self.content.drives
        effects += [effect("current_limit", d.name, I=d.current_limit) for d in drives if d.current_limit is not None]
        delays = {d.name: d.delay for d in drives if d.delay is not None}
        if len(delays) == len(drives) and all(delay == drives[0].delay for delay in delays.values()):
            delays = {"drives": delays[drives[0].name]}
        return effects + [effect("input_delay", site, d=delay) for site, delay in delays.items()]

    def effect(self, entry: EffectEntry, machine: Machine) -> AppliedEffect:
        """Return an effect at its site."""
        field = f"effects.{entry.name}"
        try:
            definition = get_effect(entry.name)
        except KeyError:
            raise self.error(field, f"no such effect; there are {', '.join(EFFECTS)}") from None
        sites = effect_sites(definition, machine)
        # A file may declare sites that no search tries, and already has the components that a structural effect adds.
        if definition.structure or definition.site in ("drive", "drives"):
            sites = definition.possible_sites(machine)
        if entry.site not in sites:
            raise self.error(field, f"site {entry.site!r} is none of {', '.join(sites) or 'this machine'}")
        try:
            applied = definition.at(entry.site, **{key: q.value for key, q in entry.parameters.items()})
        except ValueError as error:
            raise self.error(field, str(error)) from None
        if any(applied.label == other.label for other in machine.effects):
            raise self.error(field, f"declared twice at {entry.site}; delete one of the declarations")
        for key, quantity in entry.parameters.items():
            unit = machine.effect_unit(applied, key)
            if quantity.unit != unit:
                raise self.error(f"{field}.{key}", f"unit is {quantity.unit!r}, must be {unit!r}")
        return applied

    def uncertainty(self, table: UncertaintyEntry, machine: Machine) -> Uncertainty:
        """Return the covariance of the parameters."""
        size = len(table.names)
        square = len(table.covariance) == size and all(len(row) == size for row in table.covariance)
        covariance = np.array(table.covariance, float).reshape(size, size) if square else np.zeros((0, 0))
        if not square or not np.allclose(covariance, covariance.T, rtol=1e-6):
            raise self.error("uncertainty.covariance", f"must be a symmetric {size} x {size} matrix, one row per name")
        unknown = sorted(set(table.names) - set(machine.parameters))
        if unknown:
            raise self.error("uncertainty.names", f"the machine has no parameter {', '.join(unknown)}")
        return Uncertainty(tuple(table.names), covariance)
