"""Scenarios for the comparison of controllers, and the environments and conditions of their episodes."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, Unpack

import numpy as np

from ..arrays import Array
from ..controllers import check_period
from ..envs import (
    ActuatorsLike,
    EnvOptions,
    HFrameVectorEnv,
    MachineLike,
    RandomizationLike,
    SensorsLike,
    Task,
    TaskLike,
    as_machine,
    as_task,
)
from ..errors import InputError
from ..machine import Machine

LONGEST_EPISODE = 3600.0  # s


@dataclass(frozen=True)
class Scenario:
    """Conditions under which controllers are compared.

    Episode b is the environment's episode of seed + b, whatever the controller: all controllers face the same
    starts, goals and machine parameters.

    Attributes:
        machine: Machine, preset name or path of a machine.json; `randomize` varies its parameters.
        task: "reach", "track", the name of another registered task, or a task object.
        randomize: Preset name ("none", "default", ...) or list of randomization rules for the machine's
            parameters.
        sensors: What controllers observe: "state" (true full state), "rig" (encoders and lasers), or a sensor
            suite. Scores always use the true position of the tool.
        episodes: Number of episodes, B.
        seed: Seed of the first episode.
        period: Control period, s.
        duration_s: Length of an episode, s; the default is twice the longest move.
        drives: What applies the voltages: "ideal", "rig" (12-bit converters, 12 A), "machine", or
            `Actuators(...)`.

    Raises:
        InputError: If the period, the number of episodes or the duration is not positive, the seed is
            negative, or an episode is shorter than one control period.
    """

    machine: MachineLike = "hframe"
    task: TaskLike = "reach"
    randomize: RandomizationLike = "default"
    sensors: SensorsLike = "state"
    episodes: int = 512
    seed: int = 0
    period: float = 0.01
    duration_s: float = 1.5
    drives: ActuatorsLike = "ideal"

    def __post_init__(self) -> None:
        check_period(self.period)
        if self.episodes < 1:
            raise InputError(f"episodes is {self.episodes!r}, it must be at least 1")
        if self.seed < 0:
            raise InputError(f"seed is {self.seed!r}, it must not be negative")
        if not 0.0 < self.duration_s <= LONGEST_EPISODE or self.periods < 1:
            raise InputError(
                f"period is {self.period:g} s and duration_s is {self.duration_s!r} "
                "s: an episode must last for at least one control period"
            )

    @property
    def periods(self) -> int:
        """Number of control periods in an episode: duration_s / period, rounded."""
        return round(self.duration_s / self.period)

    @cached_property
    def declared_machine(self) -> Machine:
        """Machine with its nominal parameters, before randomization; a name or path is loaded when used."""
        return as_machine(self.machine)

    @property
    def task_name(self) -> str:
        """Name of the task, for example "reach"."""
        return as_task(self.task).name

    @property
    def metrics(self) -> str:
        """Name of the task's metric set, a function registered in `METRICS` of metrics.py, e.g. "reach"."""
        return as_task(self.task).metrics

    @property
    def controller_task(self) -> Task:
        """Copy of the task in which a controller previews one future goal per control period.

        The preview extends as far into the future as that of the task. A task without preview is returned
        unchanged.
        """
        task = as_task(self.task, self.declared_machine.axis_unit)
        if not (dataclasses.is_dataclass(task) and hasattr(task, "previews") and hasattr(task, "preview_s")):
            return task
        previews = max(1, round(task.previews * task.preview_s / self.period))
        return dataclasses.replace(task, preview_s=self.period, previews=previews)


class EpisodeConditions(NamedTuple):
    """Machine parameters, starts and goals of the B episodes of a scenario, equal for all controllers.

    Attributes:
        machine: Machine before randomization, with the converters and limits of the scenario.
        parameters: Sampled values of the P parameters in the order of `Machine.parameters`, SI, shape (B, P).
        start: Tool position at the start, m or rad, shape (B, axes).
        goal: Tool goal at the start, m or rad, shape (B, axes).
    """

    machine: Machine
    parameters: Array
    start: Array
    goal: Array


def environments_of(scenario: Scenario, **options: Unpack[EnvOptions]) -> HFrameVectorEnv:
    """Build the environments of a scenario, one per episode, without a limit of steps, not reset yet.

    The further options are those of the environments. By default they observe the state, with a period of
    10 ms.
    """
    common = EnvOptions(machine=scenario.machine, task=scenario.controller_task, randomize=scenario.randomize)
    return HFrameVectorEnv(
        scenario.episodes, max_episode_steps=None, **common | {"drives": scenario.drives} | options
    )


def episode_conditions(scenario: Scenario) -> EpisodeConditions:
    """Sample machine parameters, starts and goals of a scenario's episodes, without simulating any motion.

    The `EpisodeConditions` state the shape of each.
    """
    envs = environments_of(scenario)
    observation, _ = envs.reset(seed=scenario.seed)
    goal = np.asarray(observation["desired_goal"], np.float64)
    return EpisodeConditions(
        envs.machine, envs.parameters, envs.batch.simulator.tool_positions().copy(), goal
    )
