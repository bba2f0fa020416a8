"""Registries: registration, lookup and import by module name."""

from __future__ import annotations

import importlib
import sys
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

from hframe_gym import registry
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


@pytest.mark.parametrize("part", [object(), object, len])
def test_a_part_that_does_not_inherit_from_the_base_is_refused(part: object) -> None:
    from hframe_gym.machine import SENSOR_KINDS

    with pytest.raises(TypeError, match=r"sensor kind 'thermometer': .* must be a subclass of SensorKind"):
        SENSOR_KINDS.register("thermometer")(part)
    assert "thermometer" not in SENSOR_KINDS


def test_classes_of_the_same_name_in_two_files_are_different(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    text = "from hframe_gym.machine import SENSOR_KINDS, SensorKind\n@SENSOR_KINDS.register('twice')\n"
    for name in ("first_plugin", "second_plugin"):
        (tmp_path / f"{name}.py").write_text(f"{text}class Twice(SensorKind):\n    incremental = True\n")
    monkeypatch.syspath_prepend(tmp_path)
    from hframe_gym.machine import SENSOR_KINDS

    first = importlib.import_module("first_plugin")
    importlib.reload(first)
    with pytest.raises(ValueError, match="'twice' is registered already"):
        importlib.import_module("second_plugin")
    assert SENSOR_KINDS.get("twice") is first.Twice
    SENSOR_KINDS.unregister("twice")


def test_an_unknown_name_lists_the_registered_ones() -> None:
    numbers: Registry[object] = Registry("number")
    numbers.register("one")(1)
    with pytest.raises(InputError, match="number 'two' is unknown; choose one of one"):
        numbers.get("two")


def test_a_name_with_a_module_imports_the_module_first(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
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


def test_modules_are_found_in_the_current_folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [folder for folder in sys.path if folder])
    text = (
        "from hframe_gym.machine import SENSOR_KINDS, SensorKind\n"
        "@SENSOR_KINDS.register({0!r})\n"
        "class FolderKind(SensorKind):\n"
        "    pass\n"
    )
    for module in ("folder_kinds", "folder_plugin"):
        Path(f"{module}.py").write_text(text.format(module.replace("_", "-")))
    Path("tomllib.py").write_text("raise AssertionError('an installed module comes first')\n")
    from hframe_gym.machine import SENSOR_KINDS

    with pytest.raises(InputError, match=r"cannot import 'folder_kids': .*change to that folder"):
        SENSOR_KINDS.get("folder_kids:folder-kinds")
    assert str(tmp_path) not in sys.path
    try:
        assert SENSOR_KINDS.get("folder_kinds:folder-kinds").__module__ == "folder_kinds"
        registry.import_plugin("folder_plugin")
        assert "folder-plugin" in SENSOR_KINDS
    finally:
        for name in ("folder-kinds", "folder-plugin"):
            SENSOR_KINDS.unregister(name)
    assert sys.path.count(str(tmp_path)) == 1
    with pytest.raises(
        InputError, match=r"sensor kind 'tomllib:nothing' is unknown in .*tomllib.__init__\.py; choose one"
    ):
        SENSOR_KINDS.get("tomllib:nothing")


def test_a_mistake_in_a_module_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "faulty_kinds.py").write_text("1 / 0\n")
    monkeypatch.syspath_prepend(tmp_path)
    shapes: Registry[type] = Registry("shape")
    with pytest.raises(
        InputError, match=r"cannot import 'faulty_kinds': ZeroDivisionError: division by zero$"
    ):
        shapes.get("faulty_kinds:toy")


def test_a_part_can_be_removed() -> None:
    numbers: Registry[object] = Registry("number")
    numbers.register("one")(1)
    numbers.unregister("one")
    assert "one" not in numbers
    with pytest.raises(KeyError):
        numbers.unregister("one")


def test_plugins_are_imported_for_an_unknown_name_and_broken_ones_reported(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "toy_plugin_parts.py").write_text(
        "from hframe_gym.effects import EFFECTS, register_effect\n"
        "from hframe_gym.envs import TASKS, Reach\n"
        "import dataclasses\n"
        "register_effect(dataclasses.replace(EFFECTS['cable_spring'], name='plugin_spring'))\n"
        "@TASKS.register('plugin-task')\n"
        "class PluginTask(Reach):\n"
        "    pass\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    from hframe_gym.effects import get_effect, unregister_effect
    from hframe_gym.envs import TASKS, HFrameEnv

    plugins = [
        EntryPoint("toy", "toy_plugin_parts", registry.PLUGIN_GROUP),
        EntryPoint("broken", "no_such_module", registry.PLUGIN_GROUP),
    ]
    monkeypatch.setattr(registry, "entry_points", lambda group: plugins)
    registry.load_plugins.cache_clear()
    try:
        with pytest.warns(UserWarning, match=r"plugin broken \(no_such_module\) was not loaded"):
            HFrameEnv(task="plugin-task")
        assert get_effect("plugin_spring").name == "plugin_spring"  # without a second warning
    finally:
        unregister_effect("plugin_spring")
        TASKS.unregister("plugin-task")
        registry.load_plugins.cache_clear()


def test_every_module_of_a_package_is_imported(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "toy_package").mkdir()
    (tmp_path / "toy_package/__init__.py").write_text(
        "from hframe_gym.registry import Registry, import_modules\n"
        "TOYS = Registry('toy')\n"
        "import_modules(__name__, __path__, skip=('third',))\n"
    )
    for name in ("first", "second"):
        (tmp_path / f"toy_package/{name}.py").write_text(
            f"from . import TOYS\nTOYS.register({name!r})({name!r})\n"
        )
    (tmp_path / "toy_package/third.py").write_text("import no_such_module\n")
    monkeypatch.syspath_prepend(tmp_path)
    toys = importlib.import_module("toy_package").TOYS
    assert toys.names == ("first", "second")
