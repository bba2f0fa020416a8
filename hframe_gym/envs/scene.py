"""What a picture shows of one environment: positions, tensions, goal, trail."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from .environment_batch import EnvironmentBatch

Point = tuple[float, float]

TRAIL_LENGTH = 300  # points
PATH_S = 3.0  # s of an episode for which the path of a moving goal is drawn


@dataclass(frozen=True)
class Scene:
    """Hold the positions, tensions and goal of one environment that a picture shows."""

    position: Point  # of the tool, m
    target: Point  # m
    band: float  # tolerance around the target, m
    angles: tuple[float, float]  # of the two motor pulleys, rad
    tensions: dict[str, float]  # beyond the pretension, by belt, N
    trail: Sequence[Point]  # past tool positions, m
    path: Sequence[Point]  # of a moving goal, m
    time_s: float  # since the reset, s
    distance: float  # from tool to target, m

    @classmethod
    def of(cls, batch: EnvironmentBatch, b: int, trail: Sequence[Point]) -> Scene:
        """Collect what a picture of one environment needs.

        Args:
            batch: Batch of environments.
            b: Index of the environment, from 0.
            trail: Past tool positions (x, y), m, oldest first.

        Returns:
            Present position, angles, tensions and goal of this environment.
        """
        index = np.array([b])
        position = batch.simulator.positions(b)
        # A drive without a pulley is drawn at rest.
        drives = [d.coordinate for d in batch.machine.drives if batch.machine.coordinate(d.coordinate).kind == "rotary"]
        angles = [position[c] for c in drives[:2]] + [0.0, 0.0]
        period = batch.config.period
        return cls(
            position=tool_point(batch, b),
            target=_in_plane(batch.references.goals(index)[0].tolist()),
            band=batch.task.band,
            angles=(angles[0], angles[1]),
            tensions=batch.simulator.tensions(b),
            trail=list(trail),
            path=[_in_plane(point) for point in batch.references.path(b, np.arange(0.0, PATH_S, period)).tolist()],
            time_s=float(batch.elapsed[b] * period),
            distance=float(batch.distance(index)[0]),
        )


def tool_point(batch: EnvironmentBatch, b: int) -> Point:
    """Return the tool position of environment b of a batch in the picture, x and y in m; y is 0 with one axis."""
    position = batch.simulator.positions(b)
    return _in_plane([position[name] for name in batch.machine.tool_axes])


def _in_plane(point: Sequence[float]) -> Point:
    """Return a point of one or two axes as (x, y), m."""
    return point[0], point[1] if len(point) > 1 else 0.0
