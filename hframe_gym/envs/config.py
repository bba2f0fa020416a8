"""Options of the environments: the keywords of `gym.make("HFrame-v0", ...)`."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Any, Literal, TypeAlias, TypedDict

from ..errors import InputError, is_number
from ..machine import Machine, require_machine
from .actuation.actuators import ActuatorsLike
from .observation.sensors import SensorsLike
from .randomization.domain_randomization import RandomizationLike
from .rewards import RewardLike
from .tasks import TaskLike

MachineLike: TypeAlias = Machine | str | Path
Ends = Literal["stops", "terminate"]

# Subtracted from the reward when an episode ends at the workspace's edge: as much as a hundred steps can
# lose, so that leaving does not pay.
PENALTY = 100.0
# s. After 0.4 s of random voltages up to 12 V the tool is off by 1.1 um (median; 3 um at most), with 0.25 ms
# by 0.2 um (0.8 um) (benchmarks/accuracy.py). That is a twentieth of a laser's noise, for half the time.
LONGEST_STEP = 0.5e-3
# Limits of the control period, s, and of its integration steps; beyond them a step of the environment takes
# minutes.
SHORTEST_PERIOD, LONGEST_PERIOD, MOST_STEPS = 1e-6, 10.0, 100_000


class EnvOptions(TypedDict, total=False):
    """Keywords of the environments, all optional; `EnvConfig` documents them and holds their defaults."""

    machine: MachineLike
    task: TaskLike
    reward: RewardLike | None
    randomize: RandomizationLike
    sensors: SensorsLike
    drives: ActuatorsLike
    privileged: bool
    normalize: bool
    flat: bool
    error: bool
    ends: Ends
    penalty: float
    period: float
    longest_step: float


@dataclass(frozen=True)
class EnvConfig:
    """Options of an environment.

    Args:
        machine: A `Machine`, the name of a machine preset ("hframe", ...) or the path of a machine.json.
        task: Registered name ("reach", "track"), `package.module:name`, or a `Task`.
        reward: Registered name ("dense", "sparse", "arrival", "progress"), `package.module:name`, or a
            function of achieved and desired tool positions, m or rad, shape (n, axes) each, that returns n
            rewards. Default: "dense", with `normalize` "progress".
        randomize: "none", "default", "wide", "identified" (from the covariance of a machine.json that
            `hframe identify` wrote), or a list of `RandomizeParameter` and `RandomizeIdentified`.
        sensors: What is observed: "state" (the true positions and velocities of x, y and the driven
            coordinates), "rig" (encoders and lasers of Sollmann et al. 2010, with noise and resolution),
            "machine" (the sensors that the machine declares), or `Sensors(...)`.
        drives: What applies the voltages: "ideal" (voltages are not quantized), "rig" (12-bit D/A converters,
            current limit 12 A), "machine" (the converters that the machine declares), or `Actuators(...)`.
            Dead times and current limits that the machine has as effects act in any case.
        privileged: Whether the observation also has the array `privileged` (true state and randomized
            parameters) for the critic of an actor-critic method.
        normalize: Whether observations and goals are (value - center) / scale, with center and scale of
            `env.unwrapped.entries`, so that every entry is about -1 to 1, as learning libraries with default
            hyperparameters need it.
        flat: Whether the observation is one array instead of a dict of arrays.
        error: Whether the observation also has the array `error`: the distance to the goal along each axis on
            a logarithmic scale, from -1 to 1, so that a network sees a tenth of a millimeter. Not for
            hindsight experience replay, which changes goals but not this array.
        ends: What happens at the workspace's edge: "stops" (rubber buffers stop the tool) or "terminate" (the
            episode ends and `penalty` is subtracted from the reward as soon as the position in
            `achieved_goal`, which is measured with `sensors`, is outside).
        penalty: Subtracted from the reward outside the workspace if `ends` is "terminate". A small penalty
            can be less than the negative rewards of a long episode; an agent then learns to end the episode
            early.
        period: Control period, s, from 1 us to 10 s.
        longest_step: Largest integration step, s, positive; stiff belts or teeth, strong dampers and drives
            that follow a set point may need shorter ones (`dynamics.resolved_step`). A control period is
            at most 100 000 of them.

    Raises:
        InputError: If `ends`, a switch or a number is invalid. The environment checks the other options.
    """

    machine: MachineLike = "hframe"
    task: TaskLike = "reach"
    reward: RewardLike | None = None
    randomize: RandomizationLike = "none"
    sensors: SensorsLike = "state"
    drives: ActuatorsLike = "ideal"
    privileged: bool = False
    normalize: bool = False
    flat: bool = False
    error: bool = False
    ends: Ends = "stops"
    penalty: float = PENALTY
    period: float = 0.01
    longest_step: float = LONGEST_STEP

    @property
    def chosen_reward(self) -> RewardLike:
        """The option `reward`. If it is None: "progress" with `normalize=True`, "dense" without."""
        return self.reward if self.reward is not None else "progress" if self.normalize else "dense"

    def __post_init__(self) -> None:
        if self.ends not in ("stops", "terminate"):
            raise InputError(f"ends is {self.ends!r}; choose 'stops' or 'terminate'")
        for name in ("privileged", "normalize", "flat", "error"):
            value = getattr(self, name)
            if not isinstance(value, bool):
                raise InputError(f"{name} is {value!r}, it must be True or False")
        for name in ("penalty", "period", "longest_step"):
            value = getattr(self, name)
            if not is_number(value):
                raise InputError(f"{name} is {value!r}, it must be a finite number")
        if not self.penalty >= 0.0:
            raise InputError(f"penalty is {self.penalty!r}, it must be a number that is not negative")
        if not SHORTEST_PERIOD <= self.period <= LONGEST_PERIOD:
            limits = f"{SHORTEST_PERIOD:g} to {LONGEST_PERIOD:g} s"
            raise InputError(
                f"period is {self.period!r}, it must be a positive number of seconds from {limits}"
            )
        if not self.longest_step * MOST_STEPS >= self.period:
            limits = f"number of seconds, at least {1 / MOST_STEPS:g} of the period"
            raise InputError(f"longest_step is {self.longest_step!r}, it must be a positive {limits}")


def check_keywords(
    constructor: str, options: dict[str, Any], others: tuple[str, ...] = ("render_mode",)
) -> None:
    """Raise a TypeError, with similar and valid names, for an option that no environment has.

    Args:
        constructor: Name of the class or function that received the options, for the message.
        options: Keywords to check; their values do not matter.
        others: Further keywords of this constructor, which the message lists. They are not accepted in
            `options`.
    """
    names = [field.name for field in dataclasses.fields(EnvConfig)]
    for keyword in options:
        if keyword not in names:
            similar = get_close_matches(keyword, (*names, *others), n=1)
            suggestion = f" Did you mean {similar[0]!r}?" if similar else ""
            raise TypeError(
                f"{constructor} got an unexpected keyword argument {keyword!r}.{suggestion} "
                f"Its keywords are {', '.join((*names, *others))}"
            )


def check_render_mode(mode: str | None, modes: Sequence[str]) -> str | None:
    """Return a render mode of `modes`, or None (no rendering), unchanged; an InputError refuses others."""
    if mode is not None and mode not in modes:
        raise InputError(f"render_mode is {mode!r}; choose one of {', '.join(modes)} or None")
    return mode


def as_machine(machine: MachineLike) -> Machine:
    """Return the machine that the environment option `machine` names.

    Args:
        machine: Name of a preset ("hframe"), path of a machine.json, or a `Machine`, which is returned
            unchanged.

    Raises:
        InputError: If there is no such preset or file, or a value of the machine is invalid.
    """
    if isinstance(machine, Machine):
        require_machine(machine)
        return machine
    from ..recordings import load_machine  # pydantic takes long to import and a Machine does not need it

    return load_machine(machine)
