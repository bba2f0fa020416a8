"""Task `reach`: move the tool to a point and keep it there."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from typing_extensions import override

from ...arrays import Array, GoalPlans, Workspace
from ...errors import InputError, is_number
from .base import TASKS, Task, check_point


@TASKS.register("reach")
@dataclass(frozen=True)
class Reach(Task):
    """Move the tool to a point and keep it there.

    The lengths are angles for a machine with rotary axes; the task "reach" then has a margin of 0.2 rad and a
    band of 10 mrad.

    Args:
        start: Start position (x, y), or (x,) with one axis, m. Default: random, uniform in the workspace
            reduced by `margin`.
        target: Target position, likewise.
        margin: Minimum distance of random positions from the edge of the workspace, m, not negative.
        band: Distance to the target that counts as a success, m, positive.
    """

    start: tuple[float, float] | None = None
    target: tuple[float, float] | None = None
    margin: float = 0.02
    band: float = 1e-3

    draws: ClassVar[int] = 4
    plan_size: ClassVar[int] = 2  # the target
    moving: ClassVar[bool] = False
    lengths: ClassVar[tuple[str, ...]] = ("margin", "band")

    @override
    def check(self, workspace: Workspace) -> None:
        """Check band, margin, and that start and target lie in the workspace.

        Raises:
            InputError: If one of them is invalid.
        """
        if not (is_number(self.band) and self.band > 0.0):
            raise InputError(f"task reach: band is {self.band!r}, it must be a positive number, m or rad")
        size = workspace[:, 1] - workspace[:, 0]
        if not (is_number(self.margin) and self.margin >= 0.0 and np.all(size > 2.0 * self.margin)):
            raise InputError(f"task reach: margin is {self.margin!r}, it must leave room in the workspace")
        for name, point in (("start", self.start), ("target", self.target)):
            if point is not None:
                check_point(f"task reach: {name}", np.asarray(point), workspace)

    @override
    def begin(
        self, workspace: Workspace, uniforms: Array, parameters: Mapping[str, Array] | None = None
    ) -> tuple[Array, Array]:
        """Choose start and target positions, which are the plans, of k episodes.

        Both are random, at least `margin` inside the workspace, unless the attributes `start` and `target`
        fix them.
        """
        low, high = workspace[:, 0] + self.margin, workspace[:, 1] - self.margin
        points = [low + (high - low) * uniforms[:, i : i + len(low)] for i in (0, 2)]
        for i, point in enumerate((self.start, self.target)):
            if point is not None:
                points[i] = np.broadcast_to(np.asarray(point, float), points[i].shape)
        return points[0], points[1]

    @override
    def aim(self, target: Array) -> GoalPlans:
        """Return the targets: they are the plans of this task."""
        return target

    @override
    def goal(self, plan: GoalPlans, elapsed_s: Array) -> Array:
        """Return the targets as goals; they do not change over time."""
        return plan if elapsed_s.ndim == 1 else np.repeat(plan[:, None], elapsed_s.shape[1], axis=1)
