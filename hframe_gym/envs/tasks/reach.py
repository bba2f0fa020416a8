"""`reach`: go to a point and stay there."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from .base import Array, check_point


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
    ahead_s: ClassVar[tuple[float, ...]] = ()

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

    def aim(self, target: Array) -> Array:
        return target

    def goal(self, plan: Array, elapsed_s: Array) -> Array:
        return plan if elapsed_s.ndim == 1 else np.repeat(plan[:, None], elapsed_s.shape[1], axis=1)

    def contour(self, plan: Array, points: Array, elapsed_s: Array) -> None:
        """A target is no path."""
