"""Provide an untrained agent on disk: fast to make, and with the files of a trained one."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from hframe_gym.agents import train


@pytest.fixture(scope="session")
def trained_one_step(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a PPO agent after a rollout on the built-in machine; tests change copies of it."""
    folder = tmp_path_factory.mktemp("agents") / "untrained"
    train("ppo", steps=1, out=folder, log=lambda line: None)
    return folder


@pytest.fixture
def untrained_agent(trained_one_step: Path, tmp_path: Path) -> Path:
    """Return a copy of the folder of an agent after its first rollout."""
    return Path(shutil.copytree(trained_one_step, tmp_path / "untrained"))
