"""machine.json: the tables of a machine with units, values and what identification left uncertain."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, ValidationError

from ..atomic_files import write_text
from ..effects import EFFECTS, effect_sites, get_effect
from ..errors import InputError
from ..machine import BUILTIN_MACHINES, SENSOR_KINDS, Belt, Coordinate, Drive, Machine, Sensor, Uncertainty
from ..machine.machine import FIXED_UNITS, UNITS

SCHEMA = 1
Name = Annotated[str, Field(pattern=r"^[A-Za-z_][A-Za-z0-9_]*$")]


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True)


class _Quantity(_Table):
    value: FiniteFloat
    unit: str
    std: FiniteFloat | None = None


class _Coordinate(_Table):
    name: Name
    kind: Literal["linear", "rotary"]
    mass: _Quantity
    viscous: _Quantity
    coulomb: _Quantity
    radius: _Quantity | None = None
    range: tuple[FiniteFloat, FiniteFloat] | None = None


class _Belt(_Table):
    name: Name
    EA: _Quantity
    rest_length: _Quantity
    extension: dict[str, FiniteFloat]
    length: dict[str, FiniteFloat] = {}


class _Drive(_Table):
    name: Name
    channel: str
    coordinate: str
    Kt: _Quantity
    Ke: _Quantity
    resistance: _Quantity
    gear_ratio: _Quantity
    rated_voltage: _Quantity
    converter_bits: Annotated[int, Field(ge=0, le=32)] = 0
    voltage_range: _Quantity | None = None
    current_limit: _Quantity | None = None
    delay: _Quantity | None = None


class _Sensor(_Table):
    channel: str
    kind: str | None = None
    row: dict[str, FiniteFloat]
    noise: _Quantity
    resolution: _Quantity
    range: tuple[FiniteFloat, FiniteFloat] | None = None
    delay: _Quantity | None = None


class _AppliedEffect(_Table):
    name: str
    site: str
    parameters: dict[str, _Quantity]


class _Uncertainty(_Table):
    names: list[str]
    covariance: list[list[FiniteFloat]]


class _MachineFile(_Table):
    schema_: Literal[1] = Field(alias="schema")
    name: str
    description: str = ""
    coordinates: list[_Coordinate] = Field(min_length=1)
    belts: list[_Belt] = []
    drives: list[_Drive] = Field(min_length=1)
    sensors: list[_Sensor] = Field(min_length=1)
    effects: list[_AppliedEffect] = []
    ties: dict[str, tuple[str, FiniteFloat]] = {}
    uncertainty: _Uncertainty | None = None


def load_machine(source: str | Path | Machine) -> Machine:
    """A machine by built-in name, from a machine.json, or as it is.

    Raises InputError naming the file and the field at fault, or listing the built-in names.
    """
    if isinstance(source, Machine):
        return source
    if str(source) in BUILTIN_MACHINES:
        return BUILTIN_MACHINES[str(source)]()
    path = Path(source)
    if not path.is_file():
        raise InputError(f"machine {str(source)!r} is neither a file nor one of {', '.join(BUILTIN_MACHINES)}")
    try:
        file = _MachineFile.model_validate_json(path.read_text(encoding="utf-8"))
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: not a text file ({error.reason})") from None
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"])) or "file"
        raise InputError(f"{path}: {where}: {first['msg']}") from None
    return _to_machine(file, str(path))


def save_machine(machine: Machine, path: str | Path) -> None:
    """Write a machine.json that `load_machine` reads back to the same numbers."""
    write_text(path, json.dumps(machine_to_dict(machine), indent=1) + "\n")


def machine_to_dict(machine: Machine) -> dict[str, Any]:
    """The content of a machine's file as plain data."""

    def quantity(owner: str, key: str, value: float) -> dict[str, Any]:
        name = f"{owner}.{key}"
        entry: dict[str, Any] = {"value": value, "unit": machine.unit(name)}
        std = machine.uncertainty.std(name) if machine.uncertainty else None
        return entry | ({} if std is None else {"std": std})

    coordinates = []
    for c in machine.coordinates:
        keys = ("mass", "viscous", "coulomb", *(("radius",) if c.kind == "rotary" else ()))
        entry: dict[str, Any] = {"name": c.name, "kind": c.kind}
        entry |= {key: quantity(c.name, key, getattr(c, key)) for key in keys}
        coordinates.append(entry | ({"range": list(c.range)} if c.range else {}))
    belts = [
        {"name": b.name}
        | {key: quantity(b.name, key, getattr(b, key)) for key in ("EA", "rest_length")}
        | {"extension": dict(b.extension), "length": dict(b.length)}
        for b in machine.belts
    ]
    drives = [
        {"name": d.name, "channel": d.channel, "coordinate": d.coordinate}
        | {key: quantity(d.name, key, getattr(d, key)) for key in ("Kt", "Ke", "resistance", "gear_ratio")}
        | {"rated_voltage": {"value": d.rated_voltage, "unit": "V"}, "converter_bits": d.converter_bits}
        | ({} if d.voltage_range is None else {"voltage_range": {"value": d.voltage_range, "unit": "V"}})
        for d in machine.drives
    ]
    sensors = [
        {"channel": s.channel, "kind": s.kind, "row": dict(s.row)}
        | {
            key: {"value": getattr(s, key), "unit": machine.coordinate(s.coordinate).unit("position")}
            for key in ("noise", "resolution")
        }
        for s in machine.sensors
    ]
    effects = [
        {"name": e.name, "site": e.site, "parameters": {k: quantity(e.label, k, v) for k, v in e.parameters.items()}}
        for e in machine.effects
    ]
    content: dict[str, Any] = {"schema": SCHEMA, "name": machine.name, "description": machine.description}
    content |= {"coordinates": coordinates, "belts": belts, "drives": drives, "sensors": sensors, "effects": effects}
    if machine.ties:
        content["ties"] = {name: list(tie) for name, tie in machine.ties.items()}
    if machine.uncertainty is not None:
        covariance = [[float(f"{value:.9g}") for value in row] for row in machine.uncertainty.covariance]
        content["uncertainty"] = {"names": list(machine.uncertainty.names), "covariance": covariance}
    return content


def _to_machine(file: _MachineFile, path: str) -> Machine:
    def fail(where: str, why: str) -> InputError:
        return InputError(f"{path}: {where}: {why}")

    def value(where: str, quantity: _Quantity, unit: str, *, positive: bool = False) -> float:
        if quantity.unit != unit:
            raise fail(where, f"unit is {quantity.unit!r}, must be {unit!r}")
        if quantity.value < 0 or (positive and quantity.value == 0):
            raise fail(where, f"{quantity.value:g} must be {'positive' if positive else 'zero or more'}")
        return quantity.value

    kinds = {c.name: c.kind for c in file.coordinates}
    if len(kinds) < len(file.coordinates):
        raise fail("coordinates", "two have the same name")

    def row(where: str, entries: dict[str, float], *, empty: bool = False, products: bool = False) -> dict[str, float]:
        for name in (part for key in entries for part in (key.split("*") if products else (key,))):
            if name not in kinds:
                raise fail(where, f"no coordinate is called {name!r}")
        if not empty and not any(value for key, value in entries.items() if "*" not in key):
            raise fail(where, "names no coordinate")
        return entries

    coordinates = []
    for c in file.coordinates:
        units, where = UNITS[c.kind], f"coordinates.{c.name}"
        if (c.radius is None) != (c.kind == "linear"):
            raise fail(f"{where}.radius", "a rotary coordinate needs one, a linear one has none")
        if c.range is not None and not c.range[0] < c.range[1]:
            raise fail(f"{where}.range", "must be [low, high]")
        coordinates.append(
            Coordinate(
                name=c.name,
                kind=c.kind,
                mass=value(f"{where}.mass", c.mass, units["mass"], positive=True),
                viscous=value(f"{where}.viscous", c.viscous, units["viscous"]),
                coulomb=value(f"{where}.coulomb", c.coulomb, units["force"]),
                radius=value(f"{where}.radius", c.radius, "m", positive=True) if c.radius else 1.0,
                range=c.range,
            )
        )
    belts = [
        Belt(
            b.name,
            value(f"belts.{b.name}.EA", b.EA, "N", positive=True),
            value(f"belts.{b.name}.rest_length", b.rest_length, "m", positive=True),
            row(f"belts.{b.name}.extension", b.extension),
            row(f"belts.{b.name}.length", b.length, empty=True),
        )
        for b in file.belts
    ]
    drives = []
    for d in file.drives:
        if d.coordinate not in kinds:
            raise fail(f"drives.{d.name}.coordinate", f"no coordinate is called {d.coordinate!r}")
        numbers = {
            key: value(f"drives.{d.name}.{key}", getattr(d, key), FIXED_UNITS[key], positive=key != "Ke")
            for key in ("Kt", "Ke", "resistance", "gear_ratio")
        }
        rated = value(f"drives.{d.name}.rated_voltage", d.rated_voltage, "V", positive=True)
        voltage_range = None
        if d.voltage_range is not None:
            voltage_range = value(f"drives.{d.name}.voltage_range", d.voltage_range, "V", positive=True)
        drives.append(
            Drive(
                d.name,
                d.channel,
                d.coordinate,
                rated_voltage=rated,
                converter_bits=d.converter_bits,
                voltage_range=voltage_range,
                **numbers,
            )
        )
    sensors = []
    for s in file.sensors:
        where = f"sensors.{s.channel}"
        row(f"{where}.row", s.row, products=True)
        coordinate_kind = kinds[Sensor(s.channel, s.row).coordinate]
        unit = UNITS[coordinate_kind]["position"]
        noise, resolution = (value(f"{where}.{k}", getattr(s, k), unit) for k in ("noise", "resolution"))
        kind = s.kind or ("encoder" if coordinate_kind == "rotary" else "laser")
        try:
            SENSOR_KINDS.get(kind)
        except InputError as error:
            raise fail(f"{where}.kind", str(error)) from None
        sensors.append(Sensor(s.channel, s.row, noise, resolution, kind))
    names = [*kinds, *(b.name for b in belts), *(d.name for d in drives)]
    channels = [*(d.channel for d in drives), *(s.channel for s in sensors)]
    for what, found in (("names of coordinates, belts and drives", names), ("channels", channels)):
        if len(set(found)) < len(found):
            raise fail(what, "must all differ")
    machine = Machine(
        file.name, tuple(coordinates), tuple(belts), tuple(drives), tuple(sensors), description=file.description
    )
    numbers_of = {**machine.parameters}
    for e in [*file.effects, *_declared_effects(file, machine)]:
        where = f"effects.{e.name}"
        try:
            effect = get_effect(e.name)
        except KeyError:
            raise fail(where, f"no such effect; there are {', '.join(EFFECTS)}") from None
        # A structural effect has changed these tables already: they have no room for it any more.
        possible = ("machine",) if effect.structure else effect_sites(effect, machine)
        if effect.site == "drives":
            possible = (*possible, *(d.name for d in machine.drives))
        if e.site not in possible:
            raise fail(where, f"site {e.site!r} is none of {', '.join(possible) or 'this machine'}")
        try:
            applied = effect.at(e.site, **{k: q.value for k, q in e.parameters.items()})
        except ValueError as error:
            raise fail(where, str(error)) from None
        if any(applied.label == other.label for other in machine.effects):
            raise fail(where, f"declared twice at {e.site}; keep one of the two declarations")
        for key, quantity in e.parameters.items():
            expected = machine.effect_unit(applied, key)
            if quantity.unit != expected:
                raise fail(f"{where}.{key}", f"unit is {quantity.unit!r}, must be {expected!r}")
        machine = machine.replace(effects=(*machine.effects, applied))
        numbers_of |= {f"{applied.label}.{k}": v for k, v in applied.parameters.items()}
    for tied, (owner, _) in file.ties.items():
        if tied not in numbers_of or owner not in numbers_of or owner in file.ties:
            raise fail(
                f"ties.{tied}", f"{owner!r} to {tied!r}: both must be numbers of this machine, the owner a free one"
            )
    machine = machine.replace(ties=file.ties)
    if file.uncertainty is not None:
        machine = machine.replace(uncertainty=_to_uncertainty(file.uncertainty, machine, path))
    return machine


def _declared_effects(file: _MachineFile, machine: Machine) -> list[_AppliedEffect]:
    """Return the effects that the optional fields of sensors and drives stand for.

    A sensor's `range` and `delay` are the effects sensor_range and sensor_delay at its channel; a drive's
    `current_limit` and `delay` are current_limit and input_delay. One delay for all drives is input_delay at "drives".
    """
    effects = []
    for s in file.sensors:
        if s.range is not None:
            unit = machine.unit(f"{s.channel}.noise")
            limits = dict(zip(("low", "high"), s.range, strict=True))
            parameters = {key: _Quantity(value=limit, unit=unit) for key, limit in limits.items()}
            effects.append(_AppliedEffect(name="sensor_range", site=s.channel, parameters=parameters))
        if s.delay is not None:
            effects.append(_AppliedEffect(name="sensor_delay", site=s.channel, parameters={"d": s.delay}))
    for d in file.drives:
        if d.current_limit is not None:
            effects.append(_AppliedEffect(name="current_limit", site=d.name, parameters={"I": d.current_limit}))
    delays = [d.delay for d in file.drives]
    if delays[0] is not None and all(delay == delays[0] for delay in delays):
        effects.append(_AppliedEffect(name="input_delay", site="drives", parameters={"d": delays[0]}))
    else:
        effects += [
            _AppliedEffect(name="input_delay", site=d.name, parameters={"d": d.delay})
            for d in file.drives
            if d.delay is not None
        ]
    return effects


def _to_uncertainty(table: _Uncertainty, machine: Machine, path: str) -> Uncertainty:
    covariance = np.array(table.covariance, float) if table.covariance else np.zeros((0, 0))
    if covariance.shape != (len(table.names),) * 2 or not np.allclose(covariance, covariance.T, rtol=1e-6):
        raise InputError(
            f"{path}: uncertainty.covariance: must be a symmetric square over the {len(table.names)} names"
        )
    unknown = sorted(set(table.names) - set(machine.parameters))
    if unknown:
        raise InputError(f"{path}: uncertainty.names: the machine has no parameter {', '.join(unknown)}")
    return Uncertainty(tuple(table.names), covariance)
