"""Trained agents as controllers: agents in a folder, and the agents that come with the package."""

from __future__ import annotations

import warnings
from importlib import resources
from pathlib import Path

from ..envs.config import as_machine
from ..errors import InputError
from ..evaluation import Scenario
from .agent import Agent


def make_agent_controller(name: str, scenario: Scenario) -> Agent:
    """Load a trained agent to be evaluated.

    Warns if the agent was trained on another machine or with another control period.

    Args:
        name: Folder of a trained agent, or the name of a shipped agent ("ppo-seed1"), or how it begins ("ppo").
        scenario: Episodes of the evaluation.

    Returns:
        The agent.

    Raises:
        InputError: If there is no such agent or its files are damaged.
        ImportError: If the extra `agents` is not installed.
    """
    folder = Path(name) if Path(name).is_dir() else shipped_agent_folder(name, _task_name(scenario))
    agent = Agent.load(folder)
    mismatch = agent.mismatch(as_machine(scenario.machine), scenario.period)
    if mismatch:
        warnings.warn(mismatch, stacklevel=2)
    return agent


def shipped_agent_folder(name: str, task: str) -> Path:
    """Find an agent that comes with the package.

    Args:
        name: Name of the agent, or how it begins: "ppo" is the first of "ppo-seed0", "ppo-seed1", ...
        task: Name of the task.

    Returns:
        The folder of the agent.

    Raises:
        InputError: If there is none; the message lists the agents of the task.
    """
    folders = _shipped_folders(task)
    matches = [folder for label, folder in folders.items() if label == name or label.startswith(f"{name}-")]
    if not matches:
        raise InputError(
            f"{name!r} is neither the folder of a trained agent nor a shipped agent for the task {task} "
            f"({', '.join(folders) or 'there are none'})"
        )
    return matches[0]


def _shipped_folders(task: str) -> dict[str, Path]:
    """Return the folders of the shipped agents of a task by name, sorted."""
    shipped = Path(str(resources.files(__package__))) / "shipped"
    return {file.parent.name: file.parent for file in sorted(shipped.glob(f"{task}/*/agent.json"))}


def _task_name(scenario: Scenario) -> str:
    """Return the name under which a scenario's task has shipped agents."""
    return scenario.task if isinstance(scenario.task, str) else type(scenario.task).__name__.lower()
