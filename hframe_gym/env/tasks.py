"""Tasks: where an episode starts, where the tool should be while it lasts, and when that counts as done.

A task draws a *plan* at reset, a row of numbers an environment, and says from it where the goal is at any time.  For
`Reach` the plan is the target itself; a task whose goal moves keeps what its path needs.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Task(Protocol):
    """What the environment asks of a task.  Workspace: (2, 2) m, rows x and y, columns low and high."""

    @property
    def draws(self) -> int:
        """How many uniform numbers an episode takes."""

    @property
    def plan_size(self) -> int:
        """How many numbers an episode's plan holds."""

    @property
    def band(self) -> float:
        """Distance to the goal within which an episode is a success, m."""

    def check(self, workspace: Array) -> None:
        """Raises ValueError when the task does not fit into the workspace."""

    def begin(self, workspace: Array, uniforms: Array) -> tuple[Array, Array]:
        """Start positions (k, 2), m, and plans (k, plan_size) from uniforms (k, draws) in [0, 1)."""

    def goal(self, plan: Array, elapsed_s: Array) -> NDArray[np.float32]:
        """Where the tool should be, (n, 2) m, from plans (n, plan_size) after elapsed_s (n,)."""


@dataclass(frozen=True)
class Reach:
    """Go to a point and stay there.

    start, target: (x, y), m, or None for one drawn uniformly from the workspace less `margin` (m) all round.
    band: m, for success and the sparse reward.
    """

    start: tuple[float, float] | None = None
    target: tuple[float, float] | None = None
    margin: float = 0.02
    band: float = 1e-3

    draws: ClassVar[int] = 4
    plan_size: ClassVar[int] = 2

    def check(self, workspace: Array) -> None:
        if not self.band > 0.0:
            raise ValueError(f"task reach: band is {self.band!r}, it must be a positive number of metres")
        room = workspace[:, 1] - workspace[:, 0] - 2.0 * self.margin
        if not (self.margin >= 0.0 and np.all(room > 0.0)):
            raise ValueError(f"task reach: margin is {self.margin!r} m, it must leave room in the workspace")
        for name, point in (("start", self.start), ("target", self.target)):
            if point is not None:
                check_point(f"task reach: {name}", np.asarray(point, float), workspace)

    def begin(self, workspace: Array, uniforms: Array) -> tuple[Array, Array]:
        low, high = workspace[:, 0] + self.margin, workspace[:, 1] - self.margin
        points = [low + (high - low) * uniforms[:, i : i + 2] for i in (0, 2)]
        for i, point in enumerate((self.start, self.target)):
            if point is not None:
                points[i] = np.broadcast_to(np.asarray(point, float), points[i].shape)
        return points[0], points[1]

    def goal(self, plan: Array, elapsed_s: Array) -> NDArray[np.float32]:
        return plan.astype(np.float32)


def check_point(what: str, points: Array, workspace: Array) -> None:
    """Raises ValueError unless points (2,) or (k, 2) are finite positions in the workspace."""
    inside = (points >= workspace[:, 0]) & (points <= workspace[:, 1])
    if points.shape[-1:] != (2,) or not np.all(inside):
        (x0, x1), (y0, y1) = workspace
        raise ValueError(f"{what} must be (x, y) with x in [{x0:g}, {x1:g}] m and y in [{y0:g}, {y1:g}] m")


TaskLike: TypeAlias = Literal["reach"] | Task
TASKS: dict[str, type[Reach]] = {"reach": Reach}


def as_task(task: TaskLike) -> Task:
    """The task by its name with its defaults, or the task itself.

    Raises ValueError for an unknown name.
    """
    if not isinstance(task, str):
        return task
    if task not in TASKS:
        raise ValueError(f"task is {task!r}, choose one of {', '.join(TASKS)} or a Task")
    return TASKS[task]()
