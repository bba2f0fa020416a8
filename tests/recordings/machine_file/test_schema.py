"""The JSON Schema of machine.json and docs/machine.md: complete, valid for every preset, and up to date."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import jsonschema
import pytest

from hframe_gym.effects import EFFECTS
from hframe_gym.errors import InputError
from hframe_gym.machine import BUILTIN_MACHINES, UNITS, Machine
from hframe_gym.recordings import (
    TABLES,
    field_descriptions,
    load_machine,
    machine_json_schema,
    machine_to_dict,
)
from tools.tables.machine_page import schema_text, with_field_tables

DOCS = Path(__file__).parents[3] / "docs"


@pytest.fixture(scope="module")
def validator() -> Any:
    schema = machine_json_schema()
    jsonschema.Draft202012Validator.check_schema(schema)
    return jsonschema.Draft202012Validator(schema)


@pytest.mark.parametrize("name", sorted(BUILTIN_MACHINES))
def test_every_preset_fits_the_schema(name: str, validator: Any) -> None:
    validator.validate(json.loads(json.dumps(machine_to_dict(load_machine(name)))))


def test_a_machine_with_effects_fits_the_schema(validator: Any, hframe: Machine) -> None:
    machine = hframe.with_effects(EFFECTS["stribeck_friction"].at("x", dF=1.0, vs=0.03))
    validator.validate(json.loads(json.dumps(machine_to_dict(machine))))


@pytest.mark.parametrize(
    ("path", "value"),
    [
        (("coordinates", 0, "mass", "unit"), "g"),
        (("coordinates", 0, "mass", "value"), 0.0),
        (("coordinates", 0, "viscous", "value"), -1.0),
        (("drives", 0, "gear_ratio", "unit"), "rpm"),
        (("sensors", 0, "noise"), 0.1),
        (("belts", 0, "surprise"), 1),
    ],
)
def test_the_schema_refuses_what_the_reader_refuses(
    path: tuple[Any, ...], value: Any, validator: Any, hframe: Machine, tmp_path: Path
) -> None:
    content = json.loads(json.dumps(machine_to_dict(hframe)))
    place = content
    for key in path[:-1]:
        place = place[key]
    place[path[-1]] = value
    assert not validator.is_valid(content)
    (tmp_path / "m.json").write_text(json.dumps(content))
    with pytest.raises(InputError):
        load_machine(tmp_path / "m.json")


def test_every_field_has_a_description_and_none_is_described_that_is_not_there() -> None:
    for table in TABLES:
        fields = {info.alias or name for name, info in table.model_fields.items()}
        assert set(field_descriptions(table)) == fields, table.__name__


def test_the_schema_lists_the_units_of_both_kinds_of_coordinates() -> None:
    coordinate = machine_json_schema()["$defs"]["CoordinateEntry"]["properties"]
    for field, quantity in (("mass", "mass"), ("viscous", "viscous"), ("coulomb", "force")):
        assert coordinate[field]["properties"]["unit"]["enum"] == [UNITS[kind][quantity] for kind in UNITS]


def test_the_published_schema_is_up_to_date() -> None:
    assert (DOCS / "machine.schema.json").read_text("utf-8") == schema_text(), "run python -m tools.tables"


def test_the_field_tables_of_the_page_are_up_to_date() -> None:
    text = (DOCS / "machine.md").read_text("utf-8")
    assert with_field_tables(text) == text, "run python -m tools.tables"
    assert "`rest_length`" in text
