"""The file of a machine, machine.json: schema, reader with its messages, writer, and templates of new machines."""

from .machine_json import load_machine, machine_to_dict, save_machine
from .reader import implausible_values
from .schema import TABLES, Table, field_descriptions, field_units, fields, machine_json_schema
from .template import (
    TEMPLATES,
    MachineOptions,
    TemplateQuestion,
    new_machine,
    template_questions,
    write_machine_template,
)

__all__ = [
    "TABLES",
    "TEMPLATES",
    "MachineOptions",
    "Table",
    "TemplateQuestion",
    "field_descriptions",
    "field_units",
    "fields",
    "implausible_values",
    "load_machine",
    "machine_json_schema",
    "machine_to_dict",
    "new_machine",
    "save_machine",
    "template_questions",
    "write_machine_template",
]
