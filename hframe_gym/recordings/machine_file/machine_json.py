"""Read and write machine.json: a machine's parts with parameter values, units and standard deviations."""

from __future__ import annotations

import difflib
import json
from collections.abc import Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Any, get_args

from pydantic import ValidationError

from ...errors import InputError, suggestion
from ...files import read_document, write_text
from ...machine import BUILTIN_MACHINES, Component, Machine, Number, Plain, require_machine
from .reader import MachineReader
from .schema import COMPONENTS, SCHEMA_VERSION, MachineFile, QuantityEntry, Table, field_units, fields


def load_machine(source: str | Path | Machine) -> Machine:
    """Load a machine: a preset by name, or a machine.json by path.

    Warns:
        UserWarning: For each value of the file that is possible but not plausible, such as a length in mm.

    Args:
        source: Name of a preset (a key of `BUILTIN_MACHINES`, for example "hframe"), path of a machine.json,
            or a machine, which is returned unchanged.

    Raises:
        InputError: If the source is of another type, neither a file nor a preset, or a field of the file or a
            value of the machine is invalid. The message names the file and the field.
    """
    if isinstance(source, Machine):
        require_machine(source)
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
        inside = path / "machine.json"  # of a result or a folder of recordings
        meant = (
            f"; did you mean {str(inside)!r}?" if inside.is_file() else suggestion(source, BUILTIN_MACHINES)
        )
        if path.is_dir() and not meant:
            raise InputError(
                f"machine {str(source)!r} is a folder without machine.json; give the file of a machine"
            )
        raise InputError(
            f"machine {str(source)!r} is neither a file nor one of {', '.join(BUILTIN_MACHINES)}{meant}"
        )
    text = read_document(path)
    try:
        content = MachineFile.model_validate_json(text)
    except ValidationError as error:
        first = _cause(error.errors())
        field = _field_name(first["loc"], text) or "is not a machine.json"
        raise InputError(f"{path}: {field}: {_reason(first)}") from None
    return MachineReader(path, content).machine()


def save_machine(machine: Machine, path: str | Path) -> None:
    """Write a machine to a machine.json, which `load_machine` reads back with the same parameter values.

    Args:
        path: Path of the file; a missing folder is created, an existing file is replaced.

    Raises:
        InputError: If `machine` is no machine.
        OSError: If the file cannot be written.
    """
    require_machine(machine)
    write_text(path, json.dumps(machine_to_dict(machine), indent=1) + "\n")


def machine_to_dict(machine: Machine) -> dict[str, Any]:
    """Convert a machine to the content of its machine.json, with the fields of the schema (`MachineFile`).

    Every parameter has its unit, an identified one also its standard deviation.
    """
    effects = [
        {
            "name": e.name,
            "site": e.site,
            "parameters": {
                k: _quantity(machine, f"{e.label}.{k}", v, machine.effect_unit(e, k))
                for k, v in e.parameters.items()
            },
        }
        for e in machine.effects
    ]
    content: dict[str, Any] = {
        "schema": SCHEMA_VERSION,
        "name": machine.name,
        "description": machine.description,
    }
    content |= {
        section: [_component_entry(machine, component) for component in getattr(machine, section)]
        for section in COMPONENTS
    }
    content["effects"] = effects
    if machine.ties:
        content["ties"] = {name: list(tie) for name, tie in machine.ties.items()}
    if machine.uncertainty is not None:
        covariance = [[float(f"{value:.9g}") for value in row] for row in machine.uncertainty.covariance]
        content["uncertainty"] = {"names": list(machine.uncertainty.names), "covariance": covariance}
    return content


def _component_entry(machine: Machine, component: Component) -> dict[str, Any]:
    """Return a component as machine.json describes it: the attributes of its class, in their order."""
    variant = machine.variant(component)
    entry: dict[str, Any] = {}
    for key, attribute in variant.own(type(component)).items():
        value, declared = getattr(component, attribute.name), attribute.declared
        if isinstance(declared, Plain) and declared.form == "numbers":
            stated = {name: v for name, v in value.items() if variant.defaults.get(name) != v}
            value = {
                name: _quantity(machine, f"{component.label}.{name}", v, variant.units[name])
                for name, v in stated.items()
            }
        if attribute.presence == "omitted" and value in (None, attribute.default):
            continue
        if isinstance(declared, Number) and attribute.type is float:
            std = getattr(component, declared.std) if declared.std else None
            unit = variant.unit(attribute.name, declared)
            value = _quantity(machine, f"{component.label}.{attribute.name}", value, unit, std)
        elif isinstance(value, Mapping):
            value = dict(value)
        entry[key] = list(value) if isinstance(value, tuple) else value
    return entry


def _quantity(
    machine: Machine, name: str, value: float, unit: str, std: float | None = None
) -> dict[str, Any]:
    """Return value and unit of a parameter, and its standard deviation if it has one or was identified."""
    if machine.uncertainty and std is None:
        std = machine.uncertainty.std(name)
    return {"value": value, "unit": unit} | ({} if std is None else {"std": std})


def _field_name(location: tuple[int | str, ...], text: str) -> str:
    """Return the dotted name of a field, with names of components and channels instead of indices."""
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
    return ".".join(labels)


def _cause(errors: Sequence[Any]) -> Any:
    """Return pydantic's first error, or the unknown field beside it that is the mistyped missing one."""
    first = errors[0]
    *parents, field = first["loc"] or ("",)
    for error in errors if first["type"] == "missing" else ():
        *others, name = error["loc"]
        is_unknown = error["type"] == "extra_forbidden" and others == parents
        if is_unknown and difflib.get_close_matches(str(name), [str(field)]):
            return error
    return first


def _reason(error: dict[str, Any]) -> str:
    """Return what is wrong in a field, by an error of pydantic, and what to do."""
    *parents, field = error["loc"] or ("",)
    table = _table_at(parents)
    here = fields(table)
    if error["type"] == "extra_forbidden":
        similar = difflib.get_close_matches(str(field), list(here), 1)
        hint = f"did you mean {similar[0]!r}? " if similar else ""
        return f"unknown field; {hint}The fields here are {', '.join(sorted(here))}"
    if error["type"] == "missing":
        units = " or ".join(field_units(here[field])) if field in here else ""
        return f'missing; write {{"value": ..., "unit": "{units}"}}' if units else "missing"
    if error["type"] == "model_type" and _table_at(error["loc"]) is QuantityEntry:
        return 'must be a value with its unit: {"value": ..., "unit": "..."}'
    if error["type"] == "too_short":
        return f"has {error['ctx']['actual_length']} entries, must have {error['ctx']['min_length']} or more"
    if error["type"] == "finite_number":
        return "must be a finite number"
    if error["type"] == "json_invalid":
        return f'{error["msg"]}. JSON has no comments; write them as "comment": "..."'
    return str(error["msg"])


def _table_at(location: list[Any] | tuple[Any, ...]) -> type[Table]:
    """Return the table of the schema at a location in the file."""
    table: type[Table] = MachineFile
    for key in location:
        info = fields(table).get(str(key))
        pending = [info.annotation] if info else []
        while pending:  # a list, dictionary or optional contains the class of a table
            annotation = pending.pop()
            if isinstance(annotation, type) and issubclass(annotation, Table):
                table = annotation
            pending += get_args(annotation)
    return table
