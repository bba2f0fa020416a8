"""Tables of docs/machine.md and the JSON Schema of machine.json, from pydantic models of the format."""

from __future__ import annotations

import json
import re

from pydantic.fields import FieldInfo

from hframe_gym.machine import summary
from hframe_gym.recordings import TABLES, Table, field_descriptions, field_units, fields, machine_json_schema
from tools.tables.result_tables import markdown

# Titles of the sections; the classes are private to the reader of the file.
TITLES = {
    "MachineFile": "The file",
    "CoordinateEntry": "Coordinates",
    "BeltEntry": "Belts",
    "DriveEntry": "Drives",
    "SensorEntry": "Sensors",
    "EffectEntry": "Effects",
    "UncertaintyEntry": "Uncertainty",
    "QuantityEntry": "Quantities",
}


def schema_text() -> str:
    """Return the content of docs/machine.schema.json."""
    return json.dumps(machine_json_schema(), indent=1, ensure_ascii=False) + "\n"


def with_field_tables(text: str) -> str:
    """Replace the field tables of docs/machine.md by present ones, one section per table of machine.json."""
    sections = "\n\n".join(map(_section, TABLES))
    return re.sub(
        r"<!-- fields -->.*?<!-- end -->",
        lambda _: f"<!-- fields -->\n{sections}\n<!-- end -->",
        text,
        flags=re.DOTALL,
    )


def _section(table: type[Table]) -> str:
    """Return the section of a table: what it describes, then its fields, without `comment`."""
    descriptions = field_descriptions(table)
    rows = []
    for field, info in fields(table).items():
        if field != "comment":
            required = "" if info.is_required() else ", optional"
            cells = (f"`{field}`", _value(info) + required, descriptions[field])
            rows.append([cell.replace("|", r"\|") for cell in cells])
    text = markdown(["field", "value", "meaning"], rows, "---")
    return f"### {TITLES[table.__name__]}\n\n{summary(table)}\n\n{text}"


def _value(info: FieldInfo) -> str:
    """Describe what a field contains: a quantity with its units, a list, an object or a plain value."""
    if units := field_units(info):
        return "quantity, " + " or ".join(f"`{unit}`" for unit in units)
    text = str(info.annotation)
    kinds = {
        "list[hframe_gym": "list of objects",
        "dict": "object",
        "UncertaintyEntry": "object",
        "list[list": "list of lists",
        "list": "list",
        "tuple": "list of two numbers",
        "Literal[1]": "`1`",
        "Literal": "text",
        "str": "text",
        "int": "whole number",
        "float": "number",
    }
    return next(kind for key, kind in kinds.items() if key in text)
