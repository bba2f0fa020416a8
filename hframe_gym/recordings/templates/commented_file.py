"""The machine.json of a new machine, with comments that explain its fields."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ...files import write_text
from ...machine import RADIANS, Machine
from ...operating_system import quoted
from ..machine_file.machine_json import machine_to_dict
from ..machine_file.reader import MachineReader
from ..machine_file.schema import MachineFile
from .texts import BELT_COMMENT, DRIVE_COMMENTS, PULLEY_COMMENT, TEMPLATES, sensor_comment

_LINE = 100  # characters of a line of the file, comments excepted


def write_machine_template(like: str, machine: Machine, path: Path) -> None:
    """Write a new machine to a machine.json with comments that explain its fields.

    Args:
        like: Name of the machine's template, a key of `TEMPLATES`, which determines the comments.
        path: File to write; a missing folder is created, an existing file is replaced.

    Raises:
        InputError: If a value of the machine is not allowed, such as a negative mass; nothing is written
            then.
        OSError: If the file cannot be written.
    """
    content = machine_to_dict(machine)
    for entry in content["coordinates"]:
        if machine.axis_unit is RADIANS:  # no belt runs on it
            del entry["radius"]
    word = quoted(path.name)
    first = [
        "Machine description of hframe_gym. All values are in SI units; "
        "docs/machine.md describes every field.",
        TEMPLATES[like].comment,
        "Comments like this one are allowed in every object. They are ignored.",
        f"Next: hframe machines show {word}, then hframe check RUNS --machine {word}",
    ]
    comments = {
        "coordinates": lambda entry: TEMPLATES[like].coordinates.get(entry["name"], PULLEY_COMMENT),
        "belts": lambda entry: BELT_COMMENT,
        "drives": lambda entry: DRIVE_COMMENTS[entry.get("kind", "voltage")],
        "sensors": lambda entry: sensor_comment(entry["kind"]),
    }
    for key, comment in comments.items():
        content[key] = _commented(content[key], comment)
    schema = content.pop("schema")
    text = _compact_json({"schema": schema, "comment": first, **content}) + "\n"
    MachineReader(path, MachineFile.model_validate_json(text)).machine()  # checks the values
    write_text(path, text)


def _compact_json(value: Any, indent: int = 0) -> str:
    """Format JSON for people: an object or list is on one line if it fits there (100 characters)."""
    text = json.dumps(value, ensure_ascii=False)
    if len(text) + indent <= _LINE or not isinstance(value, dict | list):
        return text
    if isinstance(value, dict):
        lines = [f"{json.dumps(key)}: {_compact_json(item, indent + 2)}" for key, item in value.items()]
    else:
        lines = [_compact_json(item, indent + 2) for item in value]
    opening, closing = "{}" if isinstance(value, dict) else "[]"
    pad = " " * (indent + 2)
    return f"{opening}\n{pad}" + f",\n{pad}".join(lines) + f"\n{' ' * indent}{closing}"


def _commented(
    entries: list[dict[str, Any]], comment: Callable[[dict[str, Any]], str]
) -> list[dict[str, Any]]:
    """Return entries with comments after their first fields; a comment that would be repeated is left out."""
    result, used = [], set()
    for entry in entries:
        text = comment(entry)
        (first, value), *_ = entry.items()
        result.append({first: value} | ({} if text in used else {"comment": text}) | entry)
        used.add(text)
    return result
