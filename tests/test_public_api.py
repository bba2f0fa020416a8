"""The public names of the package, and what importing it loads."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import gymnasium as gym
import pytest

import hframe_gym


@pytest.mark.parametrize("name", hframe_gym.__all__)
def test_every_public_name_exists_and_is_documented(name: str) -> None:
    value = getattr(hframe_gym, name)
    assert name in dir(hframe_gym)
    if callable(value):
        assert value.__doc__


def test_an_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="has no attribute 'no_such_name'"):
        hframe_gym.no_such_name  # noqa: B018


def test_the_version_is_the_newest_of_the_changelog() -> None:
    changelog = (Path(__file__).parents[1] / "CHANGELOG.md").read_text("utf-8")
    versions = re.findall(r"^## (\d\S*) - \d{4}-\d{2}-\d{2}$", changelog, re.MULTILINE)
    assert versions[0] == hframe_gym.__version__
    assert f"\nversion: {versions[0]}\n" in (Path(__file__).parents[1] / "CITATION.cff").read_text("utf-8")


def test_importing_registers_the_environments_without_loading_the_simulator() -> None:
    code = (
        "import sys, hframe_gym, gymnasium;"
        "assert {'HFrame-v0', 'HFrameTrack-v0'} <= set(gymnasium.registry);"
        "heavy = ('numba', 'scipy', 'torch', 'matplotlib', 'pydantic', "
        "'pygame', 'rich', 'hframe_gym.dynamics');print([m for m in heavy if m in sys.modules])"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.strip() == "[]"


@pytest.mark.parametrize("option", ["--help", "--version"])
def test_help_and_version_of_the_command_load_no_simulator(option: str) -> None:
    code = (
        "import sys; from hframe_gym.cli import main;"
        f"sys.argv[1:] = [{option!r}];"
        "heavy = ('numba', 'scipy', 'torch', 'matplotlib', 'pydantic', 'hframe_gym.dynamics');\n"
        "try: main()\n"
        "except SystemExit: print('loaded', [m for m in heavy if m in sys.modules])"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.strip().endswith("loaded []")


def test_gymnasium_imports_the_package_by_its_name_in_the_id() -> None:
    code = "import gymnasium, sys; gymnasium.make('hframe_gym:HFrame-v0').reset(seed=1); print('made')"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.strip() == "made"


@pytest.mark.parametrize("name", ["HFrame-v0", "HFrameTrack-v0"])
def test_registered_environments_can_be_made(name: str) -> None:
    environment = gym.make(name)
    assert isinstance(environment.unwrapped, hframe_gym.HFrameEnv)
    environment.close()
