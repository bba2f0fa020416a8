"""Creation of controllers by name: a registered name, `module:name`, or the folder of a trained agent."""

from __future__ import annotations

import warnings
from abc import ABC, abstractmethod
from pathlib import Path
from typing import Any, NamedTuple

from ..controllers import (
    CONTROLLERS,
    Controller,
    EnvironmentController,
    OutputFeedbackController,
    Policy,
    PolicyController,
    StateEstimator,
)
from ..envs import MachineLike, SensorsLike, TaskLike, action_space, as_sensors, observed_machine
from ..envs.environment_batch import EnvironmentBatch, batch_of
from ..errors import InputError, suggestion
from ..machine import Machine
from ..registry import Registry, load_plugins, names_module
from .scenario import Scenario


class ControllerFiles(NamedTuple):
    """Files of a controller that a `ControllerSource` provides, by which results identify it.

    Attributes:
        name: Name of the controller in results, for example "ppo-seed0".
        files: Files that determine the controller.
        sensors: Observation for which the controller was made: "state", or another sensor preset.
        algorithm: How it was trained, for example "ppo".
        model: What the controller knows of the declared machine, in a few words.
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
        """Create the controller for a name, such as a path; None if this source has no such controller."""

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
    name: str | Policy,
    machine: MachineLike | Scenario | Any = "hframe",
    *,
    task: TaskLike = "reach",
    sensors: SensorsLike = "state",
    period: float = 0.01,
) -> Controller:
    """Create a controller from its name or from your own policy.

    Controllers are designed from the machine's nominal parameters. If the environment observes sensors, a
    controller whose class attribute `feedback` is "estimated_state" (such as `pid`) is combined with a
    `StateEstimator`.

    Args:
        name: A registered name (`pid`, `adaptive-pid`, `textbook-pid`), `module:name` of one that a module
            registers, or a name that a registered `ControllerSource` accepts: a shipped agent or the folder
            of an agent. Or a policy: a function from observations of n machines, as the environment returns
            them, to actions, shape (n, drives). A policy needs the environment as the second argument; one
            with a memory has a method `reset(mask)`.
        machine: Machine, built-in name or machine.json; or a `Scenario`, or an environment of this package
            (single, vector or `HFrameVecEnv`, also in wrappers), which replace all further arguments. For an
            environment, the controller reads observations as the environment returns them, whatever
            `normalize` and `flat` are.
        task: Task (name or object) for which the controller is needed; selects among the agents in the
            package.
        sensors: What the controller observes: "state" (true full state), "rig" (encoders and lasers), or a
            sensor suite.
        period: Control period, s.

    Raises:
        InputError: If the name is unknown, or the controller cannot run on this machine or from these
            sensors. Also if a wrapper changes the observations or actions of the environment, or its task
            previews goals at other times than the ends of the next control periods.
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
                f"make_controller: controllers preview one goal per control period of {config.period:g} s; "
                f"make the environment with task={of_environment.controller_task!r}"
            )
        if callable(name):
            machine, full_state = of_environment.declared_machine, as_sensors(config.sensors) is None
            controller: Controller = PolicyController(name, batch.format, machine, config.period, full_state)
        else:
            controller = make_controller(name, of_environment)
        return EnvironmentController(controller, batch.format)
    if not isinstance(name, str):
        raise InputError(
            f"make_controller: {name!r} is no name; if it is a policy, a function of observations, give the "
            "environment whose observations it takes: make_controller(policy, env)"
        )
    scenario = (
        machine if isinstance(machine, Scenario) else Scenario(machine, task, sensors=sensors, period=period)
    )
    load_plugins()
    if name in CONTROLLERS or (names_module(name) and not Path(name).exists()):
        return _make_registered(name, scenario)
    for source_name in CONTROLLER_SOURCES:
        from_source = CONTROLLER_SOURCES.get(source_name).make(name, scenario)
        if from_source is not None:
            return from_source
    sources = [CONTROLLER_SOURCES.get(source_name).describe(scenario) for source_name in CONTROLLER_SOURCES]
    choices = [", ".join(CONTROLLERS), "module:name of a controller that a module registers", *sources]
    problem = " is unknown"
    if Path(name).is_file():
        problem = ": this file is no controller"
    elif name.endswith(".zip"):
        problem = ": there is no such file"
    elif "/" in name or "\\" in name:
        problem = ": there is no such folder"
    raise InputError(
        f"controller {name!r}{problem}; choose {'; or '.join(choices)}{suggestion(name, CONTROLLERS)}"
    )


def _observed_batch(environment: Any) -> EnvironmentBatch | None:
    """Return an environment's batch, None for other objects; raise InputError if a wrapper changes spaces."""
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
                f"make_controller: the wrapper {type(wrapper).__name__} changes observations or actions, "
                "so that no controller can read them; give the environment inside it"
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
            f"controller {name!r} needs the full state, and sensors are {scenario.sensors!r}; "
            "choose sensors 'state', or a controller with a state estimator, such as pid"
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
