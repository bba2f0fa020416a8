"""Options of the environments: the keywords of `gym.make("HFrame-v0", ...)`."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Any, Literal, TypeAlias, TypedDict

import numpy as np
from numpy.typing import NDArray

from ..arrays import Array, Workspace
from ..errors import InputError
from ..machine import Machine
from .actuators import ActuatorsLike
from .domain_randomization import RandomizationLike
from .rewards import RewardLike
from .sensors import SensorsLike
from .tasks import Task, TaskLike, check_point

MachineLike: TypeAlias = Machine | str | Path
Ends = Literal["stops", "terminate"]

# Subtracted from the reward when an episode ends at the workspace's edge: as much as a hundred steps can lose, so that
# leaving does not pay.
PENALTY = 100.0
# s. After 0.4 s of random voltages up to 12 V the tool is off by 1.1 um (median; 3 um at most), with 0.25 ms by 0.2 um
# (0.8 um) (benchmarks/accuracy.py). That is a twentieth of a laser's noise, for half the time.
LONGEST_STEP = 0.5e-3
# Limits of the control period, s, and of its integration steps; beyond them a step of the environment takes minutes.
SHORTEST_PERIOD, LONGEST_PERIOD, MOST_STEPS = 1e-6, 10.0, 100_000

TRIED_EPISODES = 16  # for which the methods of a task are checked


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
        reward: Registered name ("dense", "sparse", "arrival", "progress"), `package.module:name`, or a function of
            achieved and desired tool positions, m, shape (n, axes) each, that returns n rewards. Default: "dense", with
            `normalize` "progress".
        randomize: "none", "default", "wide", "identified" (from the covariance of a machine.json that `hframe identify`
            wrote), or a list of `RandomizeParameter` and `RandomizeIdentified`.
        sensors: What is observed: "state" (the true positions and velocities of x, y and the driven coordinates), "rig"
            (encoders and lasers of Sollmann et al. 2010, with noise and resolution), "machine"
            (the sensors that the machine declares), or `Sensors(...)`.
        drives: What applies the voltages: "ideal" (voltages are not quantized), "rig" (12-bit D/A converters, current
            limit 12 A), "machine" (the converters that the machine declares), or `Actuators(...)`. Dead times and
            current limits that the machine has as effects act in any case.
        privileged: Whether the observation also has the array `privileged` (true state and randomized parameters) for
            the critic of an actor-critic method.
        normalize: Whether observations and goals are (value - center) / scale, with center and scale of
            `env.unwrapped.entries`, so that every entry is about -1 to 1, as learning libraries with default
            hyperparameters need it.
        flat: Whether the observation is one array instead of a dict of arrays.
        error: Whether the observation also has the array `error`: the distance to the goal along each axis on a
            logarithmic scale, from -1 to 1, so that a network sees a tenth of a millimeter. Not for hindsight
            experience replay, which changes goals but not this array.
        ends: What happens at the workspace's edge: "stops" (rubber buffers stop the tool) or "terminate" (the episode
            ends and `penalty` is subtracted from the reward as soon as the position in `achieved_goal`, which is
            measured with `sensors`, is outside).
        penalty: Subtracted from the reward outside the workspace if `ends` is "terminate". A small penalty can be less
            than the negative rewards of a long episode; an agent then learns to end the episode early.
        period: Control period, s, from 1 us to 10 s.
        longest_step: Largest integration step, s, positive; a control period is divided into at most 100 000 equal
            steps.

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
            is_number = isinstance(value, int | float | np.number) and not isinstance(value, bool)
            if not (is_number and abs(value) < np.inf):
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
    """Check that every keyword given to an environment is an option of `EnvConfig` or one of `others`.

    Raises:
        TypeError: If a keyword is unknown; the message suggests a similar one and lists all valid keywords.
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
    """Return a render mode (None: no rendering) after checking that the environment supports it.

    Raises:
        InputError: If `mode` is neither None nor in `modes`.
    """
    if mode is not None and mode not in modes:
        raise InputError(f"render_mode is {mode!r}; choose one of {', '.join(modes)} or None")
    return mode


def check_reset_options(
    options: Any, workspace: Workspace, count: int, others: Sequence[str] = ()
) -> dict[str, NDArray[np.float64]]:
    """Check the argument `options` of an environment's `reset`.

    Args:
        options: Dict with the optional keys `start` and `target`: positions of the tool and of the goal, m, shape
            (axes,) for all environments or (count, axes). None: no options.
        count: Number of environments that are reset.
        others: Further keys that are accepted and not checked, for example `parameters` and `state`.

    Returns:
        Positions by key, m, shape (count, axes); without the keys that are not given.

    Raises:
        InputError: If the options are not a dict or a key is unknown. Also if a position is not numeric, has another
            shape or is outside the workspace.
    """
    if options is None:
        return {}
    accepted = " and ".join(map(repr, ("start", "target", *others)))
    if not isinstance(options, Mapping):
        raise InputError(f"reset: options is {options!r}, it must be a dict, with the keys {accepted}")
    given = dict(options)
    unknown = [name for name in given if name not in ("start", "target", *others)]
    if unknown:
        raise InputError(f"reset: unknown option {', '.join(map(repr, unknown))}; it takes {accepted}")
    points, axes = {}, len(workspace)
    for name in (name for name in ("start", "target") if given.get(name) is not None):
        label = f"options[{name!r}]"
        try:
            values = np.asarray(given[name], np.float64)
        except (TypeError, ValueError):
            raise InputError(f"{label} is {given[name]!r}, it must be a position, numbers in m") from None
        check_point(label, values, workspace)
        if values.ndim > 1 and values.shape not in ((1, axes), (count, axes)):
            raise InputError(f"{label} has shape {values.shape}, it must be ({axes},) or ({count}, {axes})")
        points[name] = np.array(np.broadcast_to(values, (count, axes)))
    return points


def check_reset_parameters(
    given: Any, names: Sequence[str], lower: Array, upper: Array, count: int
) -> dict[str, NDArray[np.float64]]:
    """Check the option `parameters` of an environment's `reset`.

    Args:
        given: Values by full name ("x.mass"), SI: one for all environments, or one per environment that is reset.
        names: Names of the N parameters that the environment has.
        lower: Smallest value that each parameter may have, shape (N,).
        upper: Largest value that each parameter may have, shape (N,).
        count: Number of environments that are reset.

    Returns:
        Values by name, shape (count,).

    Raises:
        InputError: If a name is unknown, or a value has another shape, is not finite or outside its limits.
    """
    label = "reset: options['parameters']"
    if not isinstance(given, Mapping):
        raise InputError(
            f"{label} is {given!r}, it must be a dict of values by name, such as {{'{names[0]}': 1.0}}"
        )
    parameters = {}
    for name, value in given.items():
        if name not in names:
            similar = get_close_matches(str(name), names, n=3, cutoff=0.4) or names[:3]
            raise InputError(
                f"{label}: unknown parameter {name!r}; names are, for example, {', '.join(similar)}"
            )
        values = _numbers(f"{label}[{name!r}]", value, ((), (1,), (count,)), f"a number or {count} numbers")
        column = np.array(np.broadcast_to(values, (count,)))
        i = list(names).index(name)
        for outside in column[(column < lower[i]) | (column > upper[i])][:1]:
            raise InputError(
                f"{label}[{name!r}] is {outside:g}, it must be from {lower[i]:g} to {upper[i]:g}"
            )
        if name.endswith(".converter_bits") and (column != np.rint(column)).any():
            raise InputError(f"{label}[{name!r}] is {value!r}, it must be an integer")
        parameters[name] = column
    return parameters


def check_reset_state(given: Any, machine: Machine, workspace: Workspace, count: int) -> NDArray[np.float64]:
    """Check the option `state` of an environment's `reset`.

    Args:
        given: Positions of the n coordinates, then their velocities, in the order of `machine.coordinate_names`, m or
            rad and m/s or rad/s, shape (2 n,) for all environments, or (count, 2 n).
        count: Number of environments that are reset.

    Returns:
        States, shape (count, 2 n).

    Raises:
        InputError: If the state has another shape, is not finite, or the tool is outside the workspace.
    """
    label, size = "reset: options['state']", 2 * len(machine.coordinates)
    order = ", ".join(machine.coordinate_names)
    needed = f"positions of {order} and then their velocities, shape ({size},) or ({count}, {size})"
    values = _numbers(label, given, ((size,), (1, size), (count, size)), needed)
    tool = [machine.coordinate_names.index(axis) for axis in machine.tool_axes]
    check_point(f"{label}: the tool", values[..., tool], workspace)
    return np.array(np.broadcast_to(values, (count, size)))


def _numbers(label: str, given: Any, shapes: Sequence[tuple[int, ...]], needed: str) -> Array:
    """Return a finite array of one of some shapes; raise InputError with the label for another."""
    try:
        values = np.asarray(given, np.float64)
    except (TypeError, ValueError):
        raise InputError(f"{label} is {given!r}, it must be {needed}") from None
    if values.shape not in shapes:
        raise InputError(f"{label} has shape {values.shape}, it must be {needed}")
    if not np.isfinite(values).all():
        raise InputError(
            f"{label} has the value {values[~np.isfinite(values)].ravel()[0]}, it must be finite"
        )
    return values


def check_task(task: Task, workspace: Workspace) -> None:
    """Check that a task fits into a workspace and that its methods return arrays of the right shapes.

    The methods are called for a few trial episodes with fixed random numbers.

    Raises:
        InputError: If the task does not fit into the workspace, or a method returns another shape, a number that is not
            finite, or a start or goal outside the workspace.
    """
    task.check(workspace)
    axes, count, label = len(workspace), TRIED_EPISODES, f"task {task.name}"
    uniforms = np.random.default_rng(0).uniform(size=(count, task.draws))
    nominal = {name: np.full(count, value) for name, value in task.parameters.items()}
    episodes = task.begin(workspace, uniforms, nominal)
    if not (isinstance(episodes, tuple) and len(episodes) == 2):
        raise InputError(
            f"{label}: begin must return two arrays, the starts and the plans of {count} episodes"
        )
    start, plan = map(np.asarray, episodes)
    _check_array(f"{label}: begin must return starts", start, (count, axes))
    check_point(f"{label}: starts that begin returns", start, workspace)
    entries = plan.shape[1] if plan.ndim == 2 else task.plan_size
    _check_array(f"{label}: begin must return plans", plan, (count, entries))
    elapsed_s = np.zeros((count, 2))
    goals = np.asarray(task.goal(plan, elapsed_s[:, 0]))
    _check_array(f"{label}: goal must return, for times of shape ({count},), goals", goals, (count, axes))
    check_point(f"{label}: goals", goals, workspace)
    later = np.asarray(task.goal(plan, elapsed_s))
    _check_array(
        f"{label}: goal must return, for times of shape ({count}, 2), goals", later, (count, 2, axes)
    )
    if task.metrics == "track":
        contour = task.contour(plan, start, elapsed_s[:, 0])
        if contour is None:
            raise InputError(
                f"{label} has metrics 'track', so it must implement contour; the default returns None"
            )
        _check_array(f"{label}: contour must return distances", np.asarray(contour), (count,))


def _check_array(label: str, values: NDArray[Any], shape: tuple[int, ...]) -> None:
    """Raise InputError unless an array has a shape and finite numbers; the label is the beginning of the message."""
    is_number = values.dtype.kind in "fiu"
    if values.shape != shape or not is_number or not np.all(np.isfinite(values)):
        problem = (
            "not finite"
            if is_number and values.shape == shape
            else f"of shape {values.shape} and {values.dtype}"
        )
        raise InputError(f"{label} of shape {shape}, finite numbers; these are {problem}")


def as_machine(machine: MachineLike) -> Machine:
    """Convert the environment option `machine` (object, preset name or path of a machine.json) to a `Machine`.

    Raises:
        InputError: If no preset or file has this name, or the file is invalid.
    """
    if isinstance(machine, Machine):
        return machine
    from ..recordings import load_machine  # pydantic takes long to import and a Machine does not need it

    return load_machine(machine)
