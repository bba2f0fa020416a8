"""Read and write machine.json: a machine's components with parameter values, units and standard deviations."""

from __future__ import annotations

import difflib
import json
from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import Any, get_args

from pydantic import ValidationError

from ..atomic_files import write_text
from ..errors import InputError, suggestion
from ..file_limits import read_document
from ..machine import BUILTIN_MACHINES, DRIVE_KINDS, Machine, Sensor
from .machine_reader import MachineReader
from .machine_schema import SCHEMA_VERSION, MachineFile, QuantityEntry, Table, field_units


def load_machine(source: str | Path | Machine) -> Machine:
    """Load a machine: a preset by name, or a machine.json by path.

    Args:
        source: Name of a preset (a key of `BUILTIN_MACHINES`, for example "hframe"), path of a machine.json, or a
            machine, which is returned unchanged.

    Returns:
        The machine.

    Raises:
        InputError: If the source is of another type, neither a file nor a preset, or a field of the file is invalid.
            The message names the file and the field.

    Warns:
        UserWarning: For each value of the file that is possible but not plausible, such as a length in millimeters.
    """
    if isinstance(source, Machine):
        return source
    if not isinstance(source, str | PathLike):
        presets = ", ".join(BUILTIN_MACHINES)
        raise InputError(
            f"machine is {source!r}; give one of {presets}, the path of a machine.json, or a Machine"
        )
    if str(source) in BUILTIN_MACHINES:
        return BUILTIN_MACHINES[str(source)]()
    path = Path(source)
    if not path.is_file():
        raise InputError(
            f"machine {str(source)!r} is neither a file nor one of {', '.join(BUILTIN_MACHINES)}"
            f"{suggestion(source, BUILTIN_MACHINES)}"
        )
    text = read_document(path)
    try:
        content = MachineFile.model_validate_json(text)
    except ValidationError as error:
        first = _cause(error.errors())
        raise InputError(f"{path}: {_field_name(first['loc'], text)}: {_reason(first)}") from None
    return MachineReader(path, content).machine()


def save_machine(machine: Machine, path: str | Path) -> None:
    """Write a machine to a machine.json, which `load_machine` reads back with the same parameter values.

    Args:
        machine: Machine to write.
        path: Path of the file; a missing folder is created, an existing file is replaced.

    Raises:
        OSError: If the file cannot be written.
    """
    write_text(path, json.dumps(machine_to_dict(machine), indent=1) + "\n")


def machine_to_dict(machine: Machine) -> dict[str, Any]:
    """Convert a machine to the content of its machine.json.

    Args:
        machine: Machine to convert.

    Returns:
        Content with the fields of the schema (`MachineFile`), made of dictionaries, lists, strings and numbers only.
        Every parameter has its unit, an identified one also its standard deviation.
    """

    def quantity(owner: str, key: str, value: float) -> dict[str, Any]:
        """Return value and unit, and the standard deviation of an identified parameter."""
        name = f"{owner}.{key}"
        entry: dict[str, Any] = {"value": value, "unit": machine.unit(name)}
        std = machine.uncertainty.std(name) if machine.uncertainty else None
        return entry | ({} if std is None else {"std": std})

    coordinates = []
    for coordinate in machine.coordinates:
        keys = [key for key in coordinate.parameter_names if key != "radius" or coordinate.kind == "rotary"]
        entry: dict[str, Any] = {"name": coordinate.name, "kind": coordinate.kind}
        entry |= {key: quantity(coordinate.name, key, getattr(coordinate, key)) for key in keys}
        coordinates.append(entry | ({"range": list(coordinate.range)} if coordinate.range else {}))
    belts = [
        {"name": b.name}
        | {key: quantity(b.name, key, getattr(b, key)) for key in b.parameter_names}
        | {"extension": dict(b.extension), "length": dict(b.length)}
        for b in machine.belts
    ]
    drives = []
    for drive in machine.drives:
        entry = {"name": drive.name, "channel": drive.channel, "coordinate": drive.coordinate}
        if drive.kind != "voltage":
            entry["kind"] = drive.kind
        if drive.supply:
            entry["supply"] = drive.supply
        kind = DRIVE_KINDS.get(drive.kind)
        keys = [*kind.parameters, *(["voltage_range"] if drive.voltage_range is not None else [])]
        entry |= {key: quantity(drive.name, key, getattr(drive, key)) for key in keys}
        entry[kind.rated()] = quantity(drive.name, "rated_voltage", drive.rated_voltage)
        stated = {
            key: value for key, value in drive.law_parameters.items() if kind.defaults.get(key) != value
        }
        if stated:
            entry["parameters"] = {key: quantity(drive.name, key, value) for key, value in stated.items()}
        drives.append(entry | {"converter_bits": drive.converter_bits})
    sensors = [
        {"channel": s.channel, "kind": s.kind, "row": dict(s.row)}
        | {key: quantity(s.channel, key, value) for key, value in s.device_parameters.items()}
        | _zero_entry(s, machine.unit(f"{s.channel}.noise"))
        for s in machine.sensors
    ]
    effects = [
        {
            "name": e.name,
            "site": e.site,
            "parameters": {k: quantity(e.label, k, v) for k, v in e.parameters.items()},
        }
        for e in machine.effects
    ]
    content: dict[str, Any] = {
        "schema": SCHEMA_VERSION,
        "name": machine.name,
        "description": machine.description,
    }
    content |= {
        "coordinates": coordinates,
        "belts": belts,
        "drives": drives,
        "sensors": sensors,
        "effects": effects,
    }
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
    try:
        value: Any = json.loads(text) if location else None
    except ValueError:  # an integer of thousands of digits, which pydantic reads
        value = None
    for key in location:
        labels.append(str(key))
        try:
            value = value[key]
        except (KeyError, IndexError, TypeError):  # the field is missing
            value = None
        if isinstance(key, int):
            names = value if isinstance(value, dict) else {}
            labels[-1] = str(names.get("name", names.get("channel", f"entry {key + 1}")))
    return ".".join(labels) or "file"


def _cause(errors: Sequence[Any]) -> Any:
    """Return the first error of pydantic, or the unknown field beside it that is the missing one, mistyped."""
    first = errors[0]
    *parents, field = first["loc"] or ("",)
    for error in errors if first["type"] == "missing" else ():
        *others, name = error["loc"]
        is_unknown = error["type"] == "extra_forbidden" and others == parents
        if is_unknown and difflib.get_close_matches(str(name), [str(field)]):
            return error
    return first


def _reason(error: dict[str, Any]) -> str:
    """Return what is wrong in a field and what to do.

    Args:
        error: Error of pydantic, with its type, location, message and input.
    """
    *parents, field = error["loc"] or ("",)
    table = _table_at(parents)
    fields = [info.alias or name for name, info in table.model_fields.items()]
    if error["type"] == "extra_forbidden":
        similar = difflib.get_close_matches(str(field), fields, 1)
        hint = f"did you mean {similar[0]!r}? " if similar else ""
        return f"unknown field; {hint}The fields here are {', '.join(sorted(fields))}"
    if error["type"] == "missing":
        annotations = {info.alias or name: info.annotation for name, info in table.model_fields.items()}
        units = ""
        if annotations.get(str(field)) is QuantityEntry:
            units = f'; write {{"value": ..., "unit": "{" or ".join(field_units(field))}"}}'
        return f"missing{units}"
    if error["type"] == "model_type" and _table_at(error["loc"]) is QuantityEntry:
        return 'must be a value with its unit: {"value": ..., "unit": "..."}'
    if error["type"] == "json_invalid":
        return f'{error["msg"]}. JSON has no comments; write them as "comment": "..."'
    return str(error["msg"])


def _table_at(location: list[Any] | tuple[Any, ...]) -> type[Table]:
    """Return the table of the schema at a location in the file."""
    table: type[Table] = MachineFile
    for key in location:
        by_name = {info.alias or name: info.annotation for name, info in table.model_fields.items()}
        pending = [by_name.get(key)]
        while pending:  # a list, dictionary or optional contains the class of a table
            annotation = pending.pop()
            if isinstance(annotation, type) and issubclass(annotation, Table):
                table = annotation
            pending += get_args(annotation)
    return table
