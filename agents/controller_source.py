"""Trained agents as controllers: agents in a folder, and the agents that come with the package.

Importing this module registers both, and the models of `sb3_zip`, with
`hframe_gym.evaluation.make_controller`; it is the plugin that the package declares in the entry-point group
`hframe_gym.plugins`.
"""

from __future__ import annotations

import json
import warnings
from collections.abc import Iterable, Mapping
from importlib import resources
from pathlib import Path
from typing import Any

from typing_extensions import override

from ..errors import InputError
from ..evaluation import CONTROLLER_SOURCES, ControllerFiles, ControllerSource, Scenario
from ..machine import Machine
from . import sb3_zip  # noqa: F401  (registers itself)
from .agent import Agent
from .agent_files import AGENT_FILES, read_agent_json
from .recipe import Recipe, recipe_task


@CONTROLLER_SOURCES.register("agents")
class AgentSource(ControllerSource):
    """Source of trained agents for `make_controller`: by folder, or by name for those of the package."""

    @staticmethod
    @override
    def make(name: str, scenario: Scenario) -> Agent | None:
        """Load a trained agent, and warn if it was trained with another machine, control period or sensors.

        The name is a folder, or an agent of the package, such as "ppo"; the scenario's task then selects the
        variant. Returns None for other names.

        Raises:
            InputError: If the package has the agent for other tasks only, the folder holds no agent, its
                files are damaged, or the training had other numbers of axes, observed coordinates or drives.
        """
        folder = _agent_folder(name, scenario.task_name)
        if folder is None:
            _refuse_other_task(name, scenario.task_name)
            return None
        agent = Agent.load(folder)
        obstacle = agent.structural_mismatch(scenario.declared_machine)
        if obstacle:
            trained_on = folder / "machine.json" if Path(name).is_dir() else agent.machine.name
            raise InputError(
                f"agent {name}: {obstacle}. Leave it out, evaluate it on its own (--machine {trained_on}), "
                "or train an agent for this one (hframe train ppo)"
            )
        mismatch = agent.mismatch(scenario.declared_machine, scenario.period, scenario.sensors)
        if mismatch:
            warnings.warn(mismatch, stacklevel=2)
        return agent

    @staticmethod
    @override
    def describe(scenario: Scenario) -> str:
        """Return "the folder of a trained agent", and the shipped agents for the scenario's task."""
        names = _recipes_of(_shipped_folders(scenario.task_name))
        if not names:
            return f"the folder of a trained agent (none was shipped for the task {scenario.task_name})"
        return (
            "the folder of a trained agent; "
            f"or a shipped agent ({', '.join(names)}, or one of them by NAME-seedN)"
        )

    @staticmethod
    @override
    def files(name: str, scenario: Scenario) -> ControllerFiles | None:
        """List the files that determine an agent, so that results can identify it by their hash.

        Returns None if the name is not that of an agent.
        """
        folder = _agent_folder(name, scenario.task_name)
        if folder is None:
            return None
        agent = read_agent_json(folder)
        environment, start = agent["settings"].get("env", {}), agent["settings"].get("start", "")
        files = tuple(folder / file for file in AGENT_FILES)
        steps, cpu_s = _training_cost(folder)
        return ControllerFiles(
            folder.resolve().name,
            files,
            str(environment.get("sensors", "state")),
            f"{agent['kind']}, continues {start}" if start else agent["kind"],
            _knowledge(agent),
            steps,
            cpu_s,
        )


def _training_cost(folder: Path) -> tuple[int | None, float | None]:
    """Return environment steps and the processor time, s, of an agent's training as its card states them."""
    try:
        last = json.loads((folder / "card.json").read_text("utf-8"))["curve"][-1]
        return int(last["steps"]), round(float(last["cpu_s"]), 1)
    except (OSError, ValueError, TypeError, LookupError):  # the card is not needed to run an agent
        return None, None


def _knowledge(agent: Mapping[str, Any]) -> str:
    """Return for what an agent, with this content of agent.json, uses the declared machine."""
    actuation = agent["settings"].get("actuation", {})
    if "base" in actuation:
        return f"corrects {actuation['base']}"
    uses = {
        "feedback laws": actuation.get("transfers") or agent["features"].get("gains"),
        "plans": actuation.get("plans"),
        "estimates parameters": actuation.get("estimates"),
    }
    return ", ".join(name for name, used in uses.items() if used) or "belt geometry"


def shipped_agent_folder(name: str, task: str) -> Path:
    """Find the folder of a trained agent that comes with the package.

    Args:
        name: Name of the agent, for example "ppo-seed1", or its first part: "ppo" selects "ppo-seed0".
        task: Name of the task, "reach" or "track".

    Raises:
        InputError: If there is no such agent; the message names the tasks that have it, or the agents of the
            task.
    """
    folder = _find_shipped(name, task)
    if folder is None:
        _refuse_other_task(name, task)
        raise InputError(
            f"no shipped agent {name!r} for the task {task}; choose one of: {_shipped_names(task)}"
        )
    return folder


def start_agent_folder(recipe: Recipe, task: str, machine: Machine, previews: int) -> Path:
    """Find the folder of the shipped agent from whose weights a recipe, such as "adapt", starts training.

    Args:
        recipe: Recipe whose attribute `start` names the agent.
        task: Name of the task on which training continues; `recipe_task` selects among the agents of the
            package.
        machine: Machine on which training continues.
        previews: Number of future goals that this task shows.

    Raises:
        InputError: If there is no such agent, or if it was trained on a machine with other numbers of axes,
            observed coordinates or drives, or with another number of future goals.
    """
    folder = shipped_agent_folder(recipe.start, recipe_task(task))
    agent = Agent.load(folder)
    obstacle = agent.structural_mismatch(machine)
    if not obstacle and previews != agent.card["previews"]:
        obstacle = (
            f"was trained with {agent.card['previews']} future goals, but the task {task} shows {previews}"
        )
    if obstacle:
        raise InputError(
            f"recipe {recipe.name}: continues the shipped agent {folder.name}, which {obstacle}. "
            "Train an agent from random weights instead: hframe train ppo, with the other options unchanged"
        )
    return folder


def shipped_agent_names() -> tuple[str, ...]:
    """List the trained agents of the package, of all tasks, sorted, each once and without "-seedN": "ppo"."""
    return tuple(sorted(_recipes_of(_shipped_folders("*"))))


def _agent_folder(name: str, task: str) -> Path | None:
    """Return the folder that a user's name of an agent means: this folder itself, or a shipped agent's."""
    return Path(name) if Path(name).is_dir() else _find_shipped(name, task)


def _find_shipped(name: str, task: str) -> Path | None:
    """Return the folder of the first shipped agent whose name is this one, or begins with it and a hyphen."""
    folders = _shipped_folders(task)
    return next((f for label, f in folders.items() if label == name or label.startswith(f"{name}-")), None)


def _refuse_other_task(name: str, task: str) -> None:
    """Raise InputError if the package has an agent of this name, but not for the task in question."""
    trained = [
        folder.name for folder in sorted(_shipped_root().iterdir()) if _find_shipped(name, folder.name)
    ]
    if not trained:
        return
    others = ", ".join(_recipes_of(_shipped_folders(task)))
    choices = [
        f"the task {' or '.join(trained)}",
        *([f"a shipped agent of {task} ({others})"] if others else []),
    ]
    raise InputError(
        f"agent {name}: was trained for the task {' and for '.join(trained)}, not for {task}; choose "
        f"{', '.join(choices)}, or train an agent for {task} (hframe train ppo)"
    )


def _recipes_of(labels: Iterable[str]) -> list[str]:
    """Return the names of shipped agents without "-seedN", each once, in order."""
    return list(dict.fromkeys(label.rpartition("-seed")[0] for label in labels))


def _shipped_names(task: str) -> str:
    """List the shipped agents of a task for a message."""
    return ", ".join(_shipped_folders(task)) or f"none for the task {task}"


def _shipped_folders(task: str) -> dict[str, Path]:
    """Return the folders of the shipped agents of a task by name, sorted."""
    return {file.parent.name: file.parent for file in sorted(_shipped_root().glob(f"{task}/*/agent.json"))}


def _shipped_root() -> Path:
    """Return the folder with one folder of agents per task."""
    return Path(str(resources.files(__package__))) / "shipped"
