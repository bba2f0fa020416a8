"""Controllers by the names that a user gives: built ones, trained agents by folder, shipped ones by name."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

import numpy as np

from ..controllers import (
    CONTROLLERS,
    Channel,
    Controller,
    ModelBasedController,
    OutputFeedbackController,
    StateEstimator,
)
from ..envs.config import as_machine
from ..envs.sensors import Sensors, as_sensors, channels, sensed_entries
from ..errors import InputError
from ..machine import Machine
from .scenario import Scenario


def make_controller(name: str, trial: Scenario) -> Controller:
    """A controller for a trial: `pid`, `adaptive-pid`, `textbook-pid`, the folder of a trained agent, or the name of a
    shipped one.

    The PIDs are made of the trial's machine as it is declared.  From a rig's sensors `pid` goes through an observer.

    Raises InputError for what is none of these, or cannot control the trial's machine or see with its sensors.
    """
    sensors = as_sensors(trial.sensors)
    try:
        machine = as_machine(trial.machine)
        if name == "pid" and sensors is not None:
            observer = StateEstimator(machine, trial.period, sensor_channels(machine, sensors))
            return OutputFeedbackController(ModelBasedController(machine, trial.period), observer)
        if name in CONTROLLERS:
            if sensors is not None:
                raise InputError(f"controller {name!r} needs the full state, sensors are {trial.sensors!r}")
            return CONTROLLERS[name](machine, trial.period)
    except ValueError as error:
        raise InputError(str(error)) from None
    task = trial.task if isinstance(trial.task, str) else type(trial.task).__name__.lower()
    folder = Path(name) if Path(name).is_dir() else shipped(name, task)
    from ..agents.agent import Agent  # needs an extra, which the PIDs do not

    try:
        return Agent.load(folder)
    except ValueError as error:
        raise InputError(str(error)) from None


def shipped(name: str, task: str) -> Path:
    """The folder of an agent that comes with the package, by its task and its name or what that begins with, `ppo`.

    Raises InputError naming what there is.
    """
    root = Path(str(resources.files("hframe_gym.agents"))) / "shipped"
    there = {card.parent.name: card.parent for card in sorted(root.glob(f"{task}/*/agent.json"))}
    found = [folder for label, folder in there.items() if label == name or label.startswith(f"{name}-")]
    if not found:
        raise InputError(
            f"controller {name!r} is none of {', '.join(CONTROLLERS)}, no folder of a trained agent, and no agent that "
            f"comes with this version for {task} ({', '.join(there) or 'none does'})"
        )
    return found[0]


def sensor_channels(machine: Machine, sensors: Sensors) -> list[Channel]:
    """The positions that an environment's sensors read, in the order of its observation, as an observer takes them."""
    names = [e.coordinate for e in sensed_entries(machine, sensors) if not e.velocity]
    c = channels(machine, sensors)
    noise = np.hypot(c.noise, c.quanta / np.sqrt(12.0))
    rows = zip(names, noise.tolist(), c.least.tolist(), c.most.tolist(), strict=True)
    return [Channel(*row) for row in rows]
