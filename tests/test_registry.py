"""Registries: registration, lookup and import by module name."""

from __future__ import annotations

from pathlib import Path

import pytest

from hframe_gym.errors import InputError
from hframe_gym.registry import Registry


def test_a_part_is_returned_by_its_name() -> None:
    shapes: Registry[type] = Registry("shape")

    @shapes.register("circle")
    class Circle:
        """A toy part."""

    assert shapes.get("circle") is Circle
    assert "circle" in shapes
    assert shapes.names == ("circle",)
    assert list(shapes) == ["circle"]


def test_a_name_cannot_be_registered_for_two_parts() -> None:
    numbers: Registry[object] = Registry("number")
    numbers.register("one")(1)
    with pytest.raises(ValueError, match="number 'one' is registered already"):
        numbers.register("one")(2)


def test_an_unknown_name_lists_the_registered_ones() -> None:
    numbers: Registry[object] = Registry("number")
    numbers.register("one")(1)
    with pytest.raises(InputError, match="number 'two' is unknown; choose one of one"):
        numbers.get("two")


def test_a_name_with_a_module_imports_the_module_first(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "toy_kinds.py").write_text(
        "from hframe_gym.machine import SENSOR_KINDS, SensorKind\n"
        "@SENSOR_KINDS.register('toy')\n"
        "class Toy(SensorKind):\n"
        "    incremental = True\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    from hframe_gym.machine import SENSOR_KINDS

    assert SENSOR_KINDS.get("toy_kinds:toy").incremental
    with pytest.raises(InputError, match="cannot import 'no_such_module'"):
        SENSOR_KINDS.get("no_such_module:toy")
