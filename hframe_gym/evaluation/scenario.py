"""Scenarios for the comparison of controllers, creation of controllers by name, and recorded episodes."""

from __future__ import annotations

import dataclasses
import warnings
from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple, Unpack

import numpy as np

from ..arrays import Array
from ..controllers import (
    CONTROLLERS,
    Controller,
    EnvironmentController,
    OutputFeedbackController,
    StateEstimator,
    check_period,
)
from ..envs import (
    ActuatorsLike,
    EnvOptions,
    HFrameVectorEnv,
    MachineLike,
    RandomizationLike,
    SensorsLike,
    Task,
    TaskLike,
    action_space,
    as_machine,
    as_task,
    observed_machine,
)
from ..envs.environment_batch import EnvironmentBatch, batch_of
from ..errors import InputError, suggestion
from ..machine import METERS, AxisUnit, Machine
from ..registry import Registry, load_plugins, names_module

LONGEST_EPISODE = 3600.0  # s


@dataclass(frozen=True)
class Scenario:
    """Conditions under which controllers are compared.

    Episode b is the environment's episode of seed + b, whatever the controller: all controllers face the same starts,
    goals and machine parameters.

    Attributes:
        machine: Machine, preset name or path of a machine.json; `randomize` varies its parameters.
        task: "reach", "track", the name of another registered task, or a task object.
        randomize: Preset name ("none", "default", ...) or list of randomization rules for the machine's parameters.
        sensors: What controllers observe: "state" (true full state), "rig" (encoders and lasers), or a sensor suite.
            Scores always use the true position of the tool.
        episodes: Number of episodes, B.
        seed: Seed of the first episode.
        period: Control period, s.
        duration_s: Length of an episode, s; the default is twice the longest move.
        drives: What applies the voltages: "ideal", "rig" (12-bit converters, 12 A), "machine", or `Actuators(...)`.

    Raises:
        InputError: If the period, the number of episodes or the duration is not positive, the seed is negative, or an
            episode is shorter than one control period.
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
                f"period is {self.period:g} s and duration_s is {self.duration_s!r} s: an episode must last for "
                "at least one control period"
            )

    @property
    def periods(self) -> int:
        """Number of control periods in an episode: duration_s / period, rounded."""
        return round(self.duration_s / self.period)

    @cached_property
    def declared_machine(self) -> Machine:
        """Machine with its nominal parameters, before randomization; loaded at first use if given by name or path."""
        return as_machine(self.machine)

    @property
    def task_name(self) -> str:
        """Name of the task, for example "reach"."""
        return as_task(self.task).name

    @property
    def metrics(self) -> str:
        """Name of the task's metric set, a function registered in `METRICS` of metrics.py, for example "reach"."""
        return as_task(self.task).metrics

    @property
    def controller_task(self) -> Task:
        """Copy of the task in which a controller previews one future goal per control period.

        The preview extends as far, s, as that of the task. A task without preview is returned unchanged.
        """
        task = as_task(self.task, self.declared_machine.axis_unit)
        if not (dataclasses.is_dataclass(task) and hasattr(task, "previews") and hasattr(task, "preview_s")):
            return task
        previews = max(1, round(task.previews * task.preview_s / self.period))
        return dataclasses.replace(task, preview_s=self.period, previews=previews)


class Command(NamedTuple):
    """What the drives of a machine are commanded by in a simulation.

    Attributes:
        name: The quantity, such as "current"; "voltage" also for a duty cycle, which is a voltage in simulations.
        unit: Its unit; empty if those of the drives differ.
    """

    name: str = "voltage"
    unit: str = "V"

    @classmethod
    def of(cls, machine: Machine) -> Command:
        """Return what the drives of a machine are commanded by."""
        of_voltage = all(drive.command == "voltage" for drive in machine.drives)
        units = {machine.command_unit(drive) for drive in machine.drives}
        name = "voltage" if of_voltage else machine.commands_in_words.removesuffix("s")
        return cls(name, units.pop() if len(units) == 1 else "")

    @property
    def label(self) -> str:
        """Label of an axis, "voltage, V"."""
        return f"{self.name}, {self.unit}" if self.unit else self.name


VOLTAGE = Command()


@dataclass(frozen=True)
class Episodes:
    """Recorded episodes of one controller: B episodes of n samples and m control periods.

    Positions and distances are in m, or in rad for rotary axes (`unit`).

    Attributes:
        time_s: Sample times, s, shape (n,).
        position: True tool position, m, shape (B, n, axes).
        goal: Goal, m, shape (B, n, axes).
        contour: Distance of the tool to the path (contour error), m, shape (B, n); None for a task without a path.
        volts: Applied voltages, V, or other commands in the unit of `command`, shape (B, m, drives).
        rated: Rated voltages, V, or largest other commands, shape (drives,).
        energy_J: Energy from the supply minus energy fed back, J, shape (B,); None if drives take other commands than
            voltages, whose energy the simulation does not know.
        peak_belt_force_N: Largest difference between a belt's tension and its pretension, N, shape (B,).
        unit: Unit of the tool position.
        command: What the drives are commanded by.
    """

    time_s: Array
    position: Array
    goal: Array
    contour: Array | None
    volts: Array
    rated: Array
    energy_J: Array | None
    peak_belt_force_N: Array
    unit: AxisUnit = METERS
    command: Command = VOLTAGE

    @property
    def goal_error(self) -> Array:
        """Distances of the tool to its present goal at n samples of B episodes, m, shape (B, n)."""
        return np.linalg.norm(self.position - self.goal, axis=2)


class EpisodeConditions(NamedTuple):
    """Machine parameters, starts and goals of the B episodes of a scenario; they do not depend on the controller.

    Attributes:
        parameters: Sampled values of the P parameters in the order of `Machine.parameters`, SI, shape (B, P).
        start: Tool position at the start, m, shape (B, axes).
        goal: Tool goal at the start, m, shape (B, axes).
    """

    machine: Machine
    parameters: Array
    start: Array
    goal: Array


def environments_of(scenario: Scenario, **options: Unpack[EnvOptions]) -> HFrameVectorEnv:
    """Build the environments of a scenario, one per episode, without a limit on the number of steps, not reset yet.

    The further options are those of the environments. By default they observe the state, with a period of 10 ms.
    """
    common = EnvOptions(machine=scenario.machine, task=scenario.controller_task, randomize=scenario.randomize)
    return HFrameVectorEnv(
        scenario.episodes, max_episode_steps=None, **common | {"drives": scenario.drives} | options
    )


def episode_conditions(scenario: Scenario) -> EpisodeConditions:
    """Sample the machine parameters, starts and goals of a scenario's episodes, without simulating any motion.

    The `EpisodeConditions` state the shape of each.
    """
    envs = environments_of(scenario)
    observation, _ = envs.reset(seed=scenario.seed)
    goal = np.asarray(observation["desired_goal"], np.float64)
    return EpisodeConditions(
        envs.machine, envs.parameters, envs.batch.simulator.tool_positions().copy(), goal
    )


class ControllerFiles(NamedTuple):
    """Files of a controller that a `ControllerSource` provides, by which results identify it.

    Attributes:
        name: Name of the controller in results, for example "ppo-seed0".
        files: Files that determine the controller.
        sensors: What the controller was made to observe: "state", or another sensor preset.
        algorithm: How it was trained, for example "ppo".
        model: For what it uses the declared machine, a few words.
        training_steps: Environment steps of its training; None if unknown.
        training_cpu_s: Processor time of its training, s; None if unknown.
    """

    name: str
    files: tuple[Path, ...]
    sensors: str
    algorithm: str = ""
    model: str = "not stated"
    training_steps: int | None = None
    training_cpu_s: float | None = None


class ControllerSource(ABC):
    """A source of controllers that have no registered name, for example agents in folders.

    Subclasses are registered by `@CONTROLLER_SOURCES.register("name")` and never instantiated.
    """

    @staticmethod
    @abstractmethod
    def make(name: str, scenario: Scenario) -> Controller | None:
        """Create the controller that this source provides under a name, for example a path; None if it has none."""

    @staticmethod
    @abstractmethod
    def describe(scenario: Scenario) -> str:
        """Describe the names that this source accepts in a scenario, such as "the folder of a trained agent".

        The phrase completes the error message "controller 'x' is unknown; choose ...".
        """

    @staticmethod
    def files(name: str, scenario: Scenario) -> ControllerFiles | None:
        """List the files that determine a controller, so that results can identify it by their hash.

        None if this source does not provide the controller or it has no files.
        """
        return None


CONTROLLER_SOURCES: Registry[type[ControllerSource]] = Registry("controller source")


def make_controller(
    name: str,
    machine: MachineLike | Scenario | Any = "hframe",
    *,
    task: TaskLike = "reach",
    sensors: SensorsLike = "state",
    period: float = 0.01,
) -> Controller:
    """Create a controller by its name.

    Controllers are designed from the machine's nominal parameters. If the environment observes sensors, a controller
    whose class attribute `feedback` is "estimated_state" (such as `pid`) is combined with a `StateEstimator`.

    Args:
        name: A registered name (`pid`, `adaptive-pid`, `textbook-pid`), `module:name` of one that a module registers,
            or a name that a registered `ControllerSource` accepts: a shipped agent or the folder of an agent.
        machine: Machine, built-in name or machine.json; or a `Scenario`, or an environment of this package (single,
            vector or `HFrameVecEnv`, also in wrappers), which replace all further arguments. For an environment, the
            controller reads observations as the environment returns them, whatever `normalize` and `flat` are.
        task: Task (name or object) for which the controller is needed; selects among the agents in the package.
        sensors: What the controller observes: "state" (true full state), "rig" (encoders and lasers), or a sensor
            suite.
        period: Control period, s.

    Raises:
        InputError: If the name is unknown, or the controller cannot run on this machine or from these sensors. Also if
            a wrapper changes the observations or actions of the environment, or its task previews goals at other times
            than the ends of the next control periods.
    """
    batch = _observed_batch(machine)
    if batch is not None:
        config = batch.config
        of_environment = Scenario(
            config.machine,
            config.task,
            config.randomize,
            config.sensors,
            period=config.period,
            drives=config.drives,
        )
        if of_environment.controller_task != batch.task:
            raise InputError(
                f"make_controller: controllers preview one goal per control period of {config.period:g} s; make the "
                f"environment with task={of_environment.controller_task!r}"
            )
        return EnvironmentController(make_controller(name, of_environment), batch.format)
    scenario = (
        machine if isinstance(machine, Scenario) else Scenario(machine, task, sensors=sensors, period=period)
    )
    load_plugins()
    if name in CONTROLLERS or (names_module(name) and not Path(name).exists()):
        return _make_registered(name, scenario)
    for source_name in CONTROLLER_SOURCES:
        controller = CONTROLLER_SOURCES.get(source_name).make(name, scenario)
        if controller is not None:
            return controller
    sources = [CONTROLLER_SOURCES.get(source_name).describe(scenario) for source_name in CONTROLLER_SOURCES]
    choices = [", ".join(CONTROLLERS), "module:name of a controller that a module registers", *sources]
    problem = " is unknown"
    if name.endswith(".zip"):
        problem = ": there is no such file"
    elif "/" in name or "\\" in name:
        problem = ": there is no such folder"
    raise InputError(
        f"controller {name!r}{problem}; choose {'; or '.join(choices)}{suggestion(name, CONTROLLERS)}"
    )


def _observed_batch(environment: Any) -> EnvironmentBatch | None:
    """Return the batch of an environment, None for another object; raise InputError if a wrapper changes its spaces."""
    if isinstance(environment, str | Path | Machine | Scenario) or not hasattr(environment, "unwrapped"):
        return None
    batch, wrapper = batch_of(environment), environment
    while wrapper is not environment.unwrapped:
        observed = getattr(wrapper, "single_observation_space", wrapper.observation_space)
        commanded = getattr(wrapper, "single_action_space", wrapper.action_space)
        # VecNormalize of stable-baselines3 scales observations and leaves their space as it is.
        if (
            observed != batch.format.space
            or commanded != action_space(batch.machine)
            or hasattr(wrapper, "norm_obs")
        ):
            raise InputError(
                f"make_controller: the wrapper {type(wrapper).__name__} changes observations or actions, so that no "
                "controller can read them; give the environment inside it"
            )
        wrapper = wrapper.venv if hasattr(wrapper, "venv") else wrapper.env
    return batch


def _make_registered(name: str, scenario: Scenario) -> Controller:
    """Make a controller that is registered, with a state estimator if it needs one."""
    controller_class = CONTROLLERS.get(name)
    machine = scenario.declared_machine
    observed = observed_machine(machine, scenario.sensors)  # None: the full state
    if observed is not None and controller_class.feedback == "state":
        raise InputError(
            f"controller {name!r} needs the full state, and sensors are {scenario.sensors!r}; choose sensors 'state', "
            "or a controller with a state estimator, such as pid"
        )
    try:
        controller = controller_class(machine, scenario.period)
        concern = controller.concern()
        if concern:
            warnings.warn(concern, stacklevel=3)
        if observed is not None and controller_class.feedback == "estimated_state":
            return OutputFeedbackController(controller, StateEstimator(observed, scenario.period))
    except ValueError as error:
        raise InputError(str(error)) from None
    return controller
