"""Base class and registry of tasks, which define the start position and the goals of an episode."""

from __future__ import annotations

import dataclasses
from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar, Literal, TypeAlias, cast

import numpy as np
from numpy.typing import NDArray

from ...arrays import Array, ElapsedTimes, GoalPlans, Index, Workspace
from ...errors import InputError, suggestion
from ...machine import METERS, AxisUnit
from ...registry import Registry

Metrics = Literal["reach", "track"]


class Task(ABC):
    """Base class of tasks: where an episode starts, and where the goal of the tool is at every time.

    At reset a task makes a *plan* for each environment: a row of `plan_size` numbers that defines the goal at
    all times of the episode (for `reach` the target, for `track` path, center, direction, start and speed).
    All methods are pure functions: goals do not depend on earlier calls, and the arrays that a method
    receives are not changed, because they can be parts of those that the environment keeps. To add a task,
    write a subclass with `begin` and `goal` and register it:

        @TASKS.register("my-task")
        @dataclass(frozen=True)
        class MyTask(Task): ...

    Attributes:
        metrics: Set of evaluation metrics: "reach" for a goal that is reached (settling time, success at the
            end), "track" for a goal that moves along a path (contour and tracking errors), which needs
            `contour`.
        draws: Number of uniform random numbers per episode that `begin` uses.
        plan_size: Number of entries in a plan. Plans may be shorter for a machine with one axis.
        lengths: Names of the settings that are lengths or speeds along the axes. For a machine with rotary
            axes, `as_task` converts their defaults to rad and rad/s at the end of an arm of 0.1 m.
        band: Distance to the goal that counts as a success, m or rad.
        moving: Whether goals can move during an episode. False saves time in every step, because the goal at
            the reset is then that of the whole episode; not used for a task with previews or metrics "track".
    """

    metrics: ClassVar[Metrics] = "reach"
    draws: ClassVar[int] = 0
    plan_size: ClassVar[int] = 2
    moving: ClassVar[bool] = True
    lengths: ClassVar[tuple[str, ...]] = ("band",)
    band: float = 1e-3

    @property
    def ahead_s(self) -> tuple[float, ...]:
        """Time to each future goal in the observation `preview`, s, ascending; empty for a fixed goal."""
        return ()

    @property
    def name(self) -> str:
        """Registered name of the task's class; if it is not registered, the class name in lower case."""
        return next((name for name in TASKS if TASKS.get(name) is type(self)), type(self).__name__.lower())

    @property
    def parameters(self) -> dict[str, float]:
        """Nominal values, SI, of the parameters that rules can randomize, by name without "task."."""
        return {}

    def check(self, workspace: Workspace) -> None:  # noqa: B027  (optional)
        """Check that starts and goals of the task lie in the workspace; an InputError if not.

        Environments call it when they are created. This default checks nothing.
        """

    @abstractmethod
    def begin(
        self, workspace: Workspace, uniforms: Array, parameters: Mapping[str, Array] | None = None
    ) -> tuple[Array, Array]:
        """Choose start positions and plans of k episodes.

        Args:
            uniforms: Uniform random numbers in (0, 1), shape (k, draws).
            parameters: Values in the k episodes of all parameters that the property `parameters` of the task
                declares, SI, by name, shape (k,) each. Default: the nominal values, which it returns.

        Returns:
            start: Start positions of the tool, m or rad, shape (k, axes).
            plan: Plans (`GoalPlans`), shape (k, plan_size).
        """

    @abstractmethod
    def goal(self, plan: GoalPlans, elapsed_s: Array) -> Array:
        """Compute the goals of k episodes, m or rad, at one time or at m times each.

        Args:
            elapsed_s: Times since the reset, s, not negative, shape (k,) or (k, m).

        Returns:
            Goals of the tool, shape (k, axes) or (k, m, axes).
        """

    def write_goals(
        self,
        plan: GoalPlans,
        elapsed_s: ElapsedTimes,
        ahead_s: Array,
        goals: NDArray[np.float32],
        previews: NDArray[np.float32],
    ) -> None:
        """Write the present and future goals of k episodes to two arrays.

        This default calls `goal`; a task may override it with a faster method.

        Args:
            ahead_s: Times from the present to the m future goals in the observation, s, shape (m,), as the
                property `ahead_s` of the task.
            goals: Output, present goals, m or rad, shape (k, axes).
            previews: Output, future goals, m or rad, shape (k, m, axes).
        """
        goals[:] = self.goal(plan, elapsed_s)
        if len(ahead_s):
            previews[:] = self.goal(plan, elapsed_s[:, None] + ahead_s)

    def aim(self, target: Array) -> GoalPlans:
        """Make plans for given `target` positions, m or rad, shape (k, axes).

        Raises:
            InputError: If the task has no target.
        """
        raise InputError(f"task {self.name} has no target; reset takes only the option 'start'")

    def contour(self, plan: GoalPlans, points: Array, elapsed_s: ElapsedTimes) -> Array | None:
        """Compute the contour error: the distance from the tool to the goal's path, m or rad, shape (k,).

        None for a task without a path, which is the default.

        Args:
            points: One tool position per episode, m or rad, shape (k, axes).
            elapsed_s: Times since the reset. The nearest point is searched around the goals of these times,
                because a path may cross itself.
        """
        return None


TASKS: Registry[type[Task]] = Registry("task")
TaskLike: TypeAlias = Literal["reach", "track"] | str | Task


def as_task(task: TaskLike, unit: AxisUnit = METERS, **settings: Any) -> Task:
    """Convert the environment option `task` to a task.

    Args:
        task: Registered name ("reach", "track"), `package.module:name`, or a `Task`, which is returned
            unchanged: its lengths are in the unit of the machine's axes.
        unit: Unit of the machine's axes; the default lengths of a named task are converted to it.
        **settings: Keywords of the task's class, for example speed=0.2, if `task` is a name; otherwise
            ignored.

    Raises:
        InputError: If the name is unknown, the argument is not a task, or a setting is invalid.
        TypeError: If the task's class has no such keyword.
    """
    if isinstance(task, str):
        named = TASKS.get(task)(**settings)
        fields: Any = getattr(named, "__dataclass_fields__", {})
        lengths = [name for name in named.lengths if name in fields and name not in settings]
        defaults = {name: getattr(named, name) * unit.per_meter for name in lengths}
        return named if unit is METERS else cast(Task, dataclasses.replace(cast(Any, named), **defaults))
    if not isinstance(task, Task):
        raise InputError(
            f"task is {task!r}; choose one of {', '.join(TASKS)} or give a Task{suggestion(task, TASKS)}"
        )
    return task


def check_point(label: str, points: Array, workspace: Workspace) -> None:
    """Check that points lie in the workspace; its edge counts as inside.

    Args:
        label: What the points are, such as "goal"; begins the message of the error.
        points: Points, m or rad, shape (axes,) or (k, axes).

    Raises:
        InputError: If a point is not finite, lies outside the workspace, or does not have one coordinate per
            axis.
    """
    fits = points.dtype.kind in "fiu" and points.shape[-1:] == (len(workspace),)
    if not (fits and np.all((points >= workspace[:, 0]) & (points <= workspace[:, 1]))):
        names = ("x", "y")[: len(workspace)]
        ranges = " and ".join(
            f"{n} in [{low:g}, {high:g}]" for n, (low, high) in zip(names, workspace, strict=True)
        )
        point = f"({', '.join(names)}{',' * (len(names) == 1)})"
        raise InputError(f"{label} must be {point} with {ranges}, in m, or in rad for a rotary axis")


class ReferenceTrajectories:
    """Keep the plans of `count` environments and compute their goals over time.

    Args:
        period: Control period, s.
        axes: Number of axes of the tool.

    Attributes:
        moving: Whether goals move during an episode.
    """

    def __init__(self, task: Task, count: int, period: float, axes: int = 2) -> None:
        self._task, self._period = task, period
        # Time is counted once for all environments, in control periods; an episode remembers when it began.
        self._now = 0
        self._began = np.zeros(count, np.int64)
        self._elapsed_s = np.zeros(count)  # only for goals that move
        self.moving = task.moving or bool(task.ahead_s) or task.metrics == "track"
        self._plans = np.zeros((count, task.plan_size))
        # Goals at reset; all there is if goals do not move.
        self._fixed_goals = np.zeros((count, axes), np.float32)
        self._ahead_s = np.array(task.ahead_s)

    @property
    def elapsed(self) -> NDArray[np.int64]:
        """Number of control periods since each of `count` environments' reset, shape (count,); a copy."""
        return self._now - self._began

    def advance(self) -> None:
        """Advance the time of all environments by one control period."""
        self._now += 1
        if self.moving:
            np.multiply(self.elapsed, self._period, out=self._elapsed_s)

    def begin(self, index: Index, plans: GoalPlans) -> None:
        """Store the plans of new episodes in k environments and set their elapsed time to zero."""
        if plans.shape[1] != self._plans.shape[1]:
            self._plans = np.zeros((len(self._plans), plans.shape[1]))
        self._plans[index] = plans
        self._began[index] = self._now
        self._elapsed_s[index] = 0.0
        self._fixed_goals[index] = self._task.goal(plans, np.zeros(len(index)))

    def goals(self, index: Index | slice) -> NDArray[np.float32]:
        """Compute the present goals of k environments, m or rad, float32, shape (k, axes), a new array."""
        if not self.moving:
            return np.array(self._fixed_goals[index])
        return self._task.goal(self._plans[index], self._elapsed_s[index]).astype(np.float32)

    def add_blank(self, observation: dict[str, NDArray[np.float32]]) -> None:
        """Add arrays for the goals to `observation`; `write` fills them.

        `desired_goal`, m or rad, shape (count, axes), is added and, for a task with p future goals,
        `preview`, m or rad, shape (count, axes * p). They are not initialized, unless goals do not move:
        `desired_goal` then already holds the goals.
        """
        if not self.moving:
            observation["desired_goal"] = self._fixed_goals.copy()
            return
        count, axes = self._fixed_goals.shape
        size = axes * len(self._task.ahead_s)
        observation["desired_goal"] = np.empty((count, axes), np.float32)
        if size:
            observation["preview"] = np.empty((count, size), np.float32)

    def write(self, index: Index | slice, observation: dict[str, NDArray[np.float32]]) -> None:
        """Write the present and future goals of k environments to an observation.

        Args:
            observation: Arrays by key. Two are written: `desired_goal`, m or rad, shape (count, axes), and,
                for a task with p future goals, `preview`, m or rad, shape (count, axes * p): all axes of the
                first future goal, then of the second, ...
        """
        if not self.moving:
            observation["desired_goal"][index] = self._fixed_goals[index]
            return
        goals = observation["desired_goal"][index]  # a view of consecutive rows, a copy of others
        n, m = len(goals), len(self._ahead_s)
        previews = observation["preview"][index] if m else np.empty((n, 0), np.float32)
        plans, elapsed_s = self._plans[index], self._elapsed_s[index]
        self._task.write_goals(plans, elapsed_s, self._ahead_s, goals, previews.reshape(n, m, goals.shape[1]))
        if not isinstance(index, slice):
            observation["desired_goal"][index] = goals
            if m:
                observation["preview"][index] = previews

    def path(self, b: int, elapsed_s: Array) -> NDArray[np.float32]:
        """Compute the goals of environment b at times `elapsed_s`, s, shape (n,).

        They are in m or rad, of shape (n, axes), or (0, axes) if goals do not move.
        """
        if not self.moving:
            return np.zeros((0, self._fixed_goals.shape[1]), np.float32)
        return self._task.goal(self._plans[b : b + 1], elapsed_s[None])[0].astype(np.float32)

    def contour(self, index: Index | slice, tools: Array) -> Array | None:
        """Compute the distances of tool positions to the path, m or rad, shape (k,); None without a path.

        Args:
            tools: Positions of the tool in these k environments, m or rad, shape (k, axes).
        """
        if self._task.metrics != "track":
            return None
        return self._task.contour(self._plans[index], tools, self._elapsed_s[index])
