"""The public names of the package, and what importing it loads."""

from __future__ import annotations

import subprocess
import sys
from importlib.metadata import version

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


def test_the_version_is_that_of_the_installed_package() -> None:
    assert hframe_gym.__version__ == version("hframe_gym")


def test_importing_registers_the_environments_without_loading_the_simulator() -> None:
    code = (
        "import sys, hframe_gym, gymnasium;"
        "assert {'HFrame-v0', 'HFrameTrack-v0'} <= set(gymnasium.registry);"
        "print([m for m in ('numba', 'scipy', 'pydantic', 'hframe_gym.dynamics') if m in sys.modules])"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.strip() == "[]"


@pytest.mark.parametrize("name", ["HFrame-v0", "HFrameTrack-v0"])
def test_registered_environments_can_be_made(name: str) -> None:
    environment = gym.make(name)
    assert isinstance(environment.unwrapped, hframe_gym.HFrameEnv)
    environment.close()
