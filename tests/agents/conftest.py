"""Provide an untrained agent on disk: fast to make, and with the files of a trained one."""

from __future__ import annotations

from pathlib import Path

import pytest

from hframe_gym.agents import train


@pytest.fixture
def untrained_agent(tmp_path: Path) -> Path:
    """Return the folder of a PPO agent after its first rollout on the built-in machine."""
    folder = tmp_path / "untrained"
    train("ppo", steps=1, out=folder, log=lambda line: None)
    return folder
