"""Base class and registry of tasks: where an episode starts, and where the tool should be at every moment of it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ...errors import InputError
from ...registry import Registry

Array = NDArray[np.float64]
Index = NDArray[np.intp]
Metrics = Literal["reach", "track"]


class Task(ABC):
    """What an episode asks of the tool.

    At reset a task makes a *plan*, a row of numbers for each environment. All its methods are pure functions of plans,
    so that the goal, its preview and the distance to the path do not depend on the calls before. To add a task, write a
    subclass with `begin` and `goal` and register it:

        @TASKS.register("my-task")
        @dataclass(frozen=True)
        class MyTask(Task): ...

    Attributes:
        metrics: Which scores suit the task: "reach" for a goal that stays (settling time, success at the end), "track"
            for a goal that moves along a path (contour and tracking errors). A task of metrics "track" implements
            `contour`.
        draws: Uniform random numbers per episode.
        plan_size: Numbers in a plan.
        band: Distance to the goal within which an episode counts as a success, m.
        ahead_s: Times ahead of now for which `preview` shows the goal, s; empty for a goal that stays.
    """

    metrics: ClassVar[Metrics] = "reach"
    draws: ClassVar[int] = 0
    plan_size: ClassVar[int] = 2
    band: float = 1e-3

    @property
    def ahead_s(self) -> tuple[float, ...]:
        """Times ahead of now for which `preview` shows the goal, s; empty for a goal that stays."""
        return ()

    @property
    def name(self) -> str:
        """Registered name of the task's class, or else the class name in lower case."""
        return next((name for name in TASKS if TASKS.get(name) is type(self)), type(self).__name__.lower())

    @property
    def parameters(self) -> dict[str, float]:
        """Nominal values of what randomization may vary, by short name; `speed` is randomized as `task.speed`."""
        return {}

    def check(self, workspace: Array) -> None:  # noqa: B027  (optional)
        """Check that the task fits into the workspace.

        Args:
            workspace: Rows x and y, columns low and high, m, shape (2, 2).

        Raises:
            InputError: If it does not fit.
        """

    @abstractmethod
    def begin(
        self, workspace: Array, uniforms: Array, parameters: Mapping[str, Array] | None = None
    ) -> tuple[Array, Array]:
        """Begin k episodes.

        Args:
            workspace: Rows x and y, columns low and high, m, shape (2, 2).
            uniforms: Uniform random numbers in [0, 1), shape (k, draws).
            parameters: The task's parameters in each episode, (k,) each, by short name; default: nominal values.

        Returns:
            Start positions of the tool, m, shape (k, 2), and plans, shape (k, plan_size).
        """

    @abstractmethod
    def goal(self, plan: Array, elapsed_s: Array) -> Array:
        """Compute the goals of episodes.

        Args:
            plan: Plans, shape (n, plan_size).
            elapsed_s: Times since the reset, s, shape (n,) or (n, m).

        Returns:
            Goals, m, shape (n, 2) or (n, m, 2).
        """

    def aim(self, target: Array) -> Array:
        """Make plans for targets that a reset was given.

        Args:
            target: Targets, m, shape (k, 2).

        Returns:
            Plans, shape (k, plan_size).

        Raises:
            InputError: If the task has no target to choose.
        """
        raise InputError(f"task {self.name} has no target; reset takes only the option 'start'")

    def contour(self, plan: Array, points: Array, elapsed_s: Array) -> Array | None:
        """Compute the distance of points to the path, whatever the time.

        Args:
            plan: Plans, shape (n, plan_size).
            points: Points, m, shape (n, 2).
            elapsed_s: Times since the reset, s, shape (n,).

        Returns:
            Distances, m, shape (n,); None for a task without a path.
        """
        return None


TASKS: Registry[type[Task]] = Registry("task")
TaskLike: TypeAlias = Literal["reach", "track"] | str | Task


def as_task(task: TaskLike, **settings: Any) -> Task:
    """Return the task of the option `task`.

    Args:
        task: Registered name, `package.module:name`, or a task.
        **settings: Keywords of the task's class where a name is given.

    Returns:
        The task.

    Raises:
        InputError: If the name is unknown or the object is not a task.
    """
    if isinstance(task, str):
        return TASKS.get(task)(**settings)
    if not isinstance(task, Task):
        raise InputError(f"task is {task!r}; choose one of {', '.join(TASKS)} or give a Task")
    return task


def check_point(label: str, points: Array, workspace: Array) -> None:
    """Check that points are positions in the workspace.

    Args:
        label: What the points are, for the message.
        points: Points, m, shape (2,) or (k, 2).
        workspace: Rows x and y, columns low and high, m, shape (2, 2).

    Raises:
        InputError: If a point is not finite or outside the workspace, or the shape is another one.
    """
    inside = (points >= workspace[:, 0]) & (points <= workspace[:, 1]) if points.shape[-1:] == (2,) else np.False_
    if not np.all(inside):
        (x0, x1), (y0, y1) = workspace
        raise InputError(f"{label} must be (x, y) with x in [{x0:g}, {x1:g}] m and y in [{y0:g}, {y1:g}] m")


class ReferenceTrajectories:
    """Plans of `count` episodes of a task, and the goals that follow from them.

    Args:
        task: The task.
        count: Number of environments.
        period: Control period, s.

    Attributes:
        elapsed: Control periods since the reset of each environment, shape (count,).
        moving: Whether goals move.
    """

    def __init__(self, task: Task, count: int, period: float) -> None:
        self._task, self._period = task, period
        self.elapsed = np.zeros(count, np.int64)
        self.moving = bool(task.ahead_s) or task.metrics == "track"
        self._plans = np.zeros((count, task.plan_size))
        self._fixed_goals = np.zeros((count, 2), np.float32)  # goals at reset; all there is if goals do not move
        self._times = np.array([0.0, *task.ahead_s])

    def begin(self, index: Index, plans: Array) -> None:
        """Begin episodes.

        Args:
            index: Environments, shape (k,).
            plans: Their plans, shape (k, plan_size).
        """
        self._plans[index] = plans
        self.elapsed[index] = 0
        self._fixed_goals[index] = self._task.goal(plans, np.zeros(len(index)))

    def goals(self, index: Index | slice) -> NDArray[np.float32]:
        """Return the present goals.

        Args:
            index: Environments, shape (k,).

        Returns:
            Goals, m, shape (k, 2), a new array.
        """
        if not self.moving:
            return np.array(self._fixed_goals[index])
        return self._task.goal(self._plans[index], self._elapsed_s(index)).astype(np.float32)

    def blank(self) -> dict[str, NDArray[np.float32]]:
        """Allocate the goals of an observation.

        Returns:
            `desired_goal`, already filled in if goals do not move, and `preview`, first axis count.
        """
        if not self.moving:
            return {"desired_goal": self._fixed_goals.copy()}
        count, size = len(self._fixed_goals), 2 * len(self._task.ahead_s)
        arrays = {"desired_goal": np.empty((count, 2), np.float32)}
        return arrays | ({"preview": np.empty((count, size), np.float32)} if size else {})

    def write(self, index: Index | slice, observation: dict[str, NDArray[np.float32]]) -> None:
        """Write goals and previews of environments index (k,) to an observation.

        Args:
            index: Environments.
            observation: Output; `desired_goal`, m, shape (count, 2), and `preview`, m, shape (count, 2 * previews): x
                and y of the next future goal, then of the one after it, ...
        """
        if not self.moving:
            observation["desired_goal"][index] = self._fixed_goals[index]
            return
        times = self._elapsed_s(index)[:, None] + self._times
        goals = self._task.goal(self._plans[index], times).reshape(len(times), -1)
        observation["desired_goal"][index] = goals[:, :2]
        if "preview" in observation:
            observation["preview"][index] = goals[:, 2:]

    def path(self, b: int, elapsed_s: Array) -> NDArray[np.float32]:
        """Return the goals of one environment over time.

        Args:
            b: Index of the environment.
            elapsed_s: Times since its reset, s, shape (n,).

        Returns:
            Goals, m, shape (n, 2), or (0, 2) if they do not move.
        """
        if not self.moving:
            return np.zeros((0, 2), np.float32)
        return self._task.goal(self._plans[b : b + 1], elapsed_s[None])[0].astype(np.float32)

    def contour(self, index: Index | slice, tools: Array) -> Array | None:
        """Return the distances of tools to their paths.

        Args:
            index: Environments, shape (k,).
            tools: Tool positions, m, shape (k, 2).

        Returns:
            Distances, m, shape (k,); None for a task without a path.
        """
        if self._task.metrics != "track":
            return None
        return self._task.contour(self._plans[index], tools, self._elapsed_s(index))

    def _elapsed_s(self, index: Index | slice) -> Array:
        """Return the times since the reset of environments index (k,), s, shape (k,)."""
        return np.asarray(self.elapsed[index].astype(np.float64) * self._period)
