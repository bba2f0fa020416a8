"""What the environment asks of a task: where an episode starts and where the tool should be while it lasts.

A task draws a *plan* at reset, a row of numbers an environment, and says from it where the goal is at any time: a pure
function, so that the goal, its preview and the distance to its path never depend on what was asked before.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Task(Protocol):
    """Workspace: (2, 2) m, rows x and y, columns low and high.  Plans: (n, plan_size)."""

    @property
    def draws(self) -> int:
        """How many uniform numbers an episode takes."""

    @property
    def plan_size(self) -> int:
        """How many numbers an episode's plan holds."""

    @property
    def band(self) -> float:
        """Distance to the goal within which an episode is a success, m."""

    @property
    def ahead_s(self) -> tuple[float, ...]:
        """How far ahead the goals of `preview` are, s; empty for a goal that does not move."""

    def check(self, workspace: Array) -> None:
        """Raises ValueError when the task does not fit into the workspace."""

    def begin(self, workspace: Array, uniforms: Array) -> tuple[Array, Array]:
        """Start positions (k, 2), m, and plans (k, plan_size) from uniforms (k, draws) in [0, 1)."""

    def aim(self, target: Array) -> Array:
        """Plans for targets (k, 2), m, that a reset was given.  Raises ValueError where a task has no target."""

    def goal(self, plan: Array, elapsed_s: Array) -> Array:
        """Where the tool should be, (n, 2) m, elapsed_s (n,) after the reset; (n, m, 2) for times (n, m)."""

    def contour(self, plan: Array, points: Array, elapsed_s: Array) -> Array | None:
        """Distance of points (n, 2) to the path, (n,) m, whatever the time on it; None where there is no path."""


def check_point(what: str, points: Array, workspace: Array) -> None:
    """Raises ValueError unless points (2,) or (k, 2) are finite positions in the workspace."""
    inside = (points >= workspace[:, 0]) & (points <= workspace[:, 1])
    if points.shape[-1:] != (2,) or not np.all(inside):
        (x0, x1), (y0, y1) = workspace
        raise ValueError(f"{what} must be (x, y) with x in [{x0:g}, {x1:g}] m and y in [{y0:g}, {y1:g}] m")
