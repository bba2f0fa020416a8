"""The file of a machine, machine.json: schema, reader with its messages and writer."""

from .machine_json import load_machine, machine_to_dict, save_machine
from .plausibility import implausible_values
from .schema import TABLES, Table, field_descriptions, field_units, fields, machine_json_schema

__all__ = [
    "TABLES",
    "Table",
    "field_descriptions",
    "field_units",
    "fields",
    "implausible_values",
    "load_machine",
    "machine_json_schema",
    "machine_to_dict",
    "save_machine",
]
