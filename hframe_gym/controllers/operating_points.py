"""Places of the workspace for which gains are worked out, because the belts' stiffness depends on them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..machine import Machine

Array = NDArray[np.float64]
AXES = ("x", "y")
GRID = (9, 7)  # the stiffness at a place is within 5 % of any that is nearer to it than to the others


class OperatingPointGrid:
    """A grid over the workspace.  Attributes: points (63, 2), m; span (2,), m.

    Raises ValueError for a machine whose workspace has no range.
    """

    def __init__(self, machine: Machine) -> None:
        ranges = [r for r in (machine.coordinate(axis).range for axis in AXES) if r is not None]
        if len(ranges) < len(AXES):
            raise ValueError(f"machine {machine.name!r}: x and y need a range to be controlled in")
        self._lines = [np.linspace(low, high, count) for (low, high), count in zip(ranges, GRID, strict=True)]
        self.points: Array = np.array([[x, y] for x in self._lines[0] for y in self._lines[1]])
        self.span: Array = np.array([line[-1] - line[0] for line in self._lines])

    def nearest(self, goal: Array) -> NDArray[np.intp]:
        """The place (B,) that is nearest to each goal (B, 2), m."""
        i, j = (np.abs(goal[:, k : k + 1] - line).argmin(axis=1) for k, line in enumerate(self._lines))
        return i * GRID[1] + j
