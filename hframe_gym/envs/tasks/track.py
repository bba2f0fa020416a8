"""`track`: follow a goal that moves along a path."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from ...errors import InputError
from ...recordings.path_file import read_path
from ..counter_rng import compiled
from .base import Array
from .curves import SHAPES, Curve, Polyline

# Columns of a plan: which path, its centre (m), +1 or -1 for the direction, arc length where it begins (m).
PATH, CENTRE, DIRECTION, BEGIN = 0, slice(1, 3), 3, 4


@dataclass(frozen=True)
class Track:
    """Follow a goal along a path, from rest at its beginning.

    path: "circle", "square", "lissajous", several of them (one is drawn each episode), or a file of points
        (`hframe_gym.recordings.path_file`), which is where it says and is run through in its own order.
    size: of a shape, m, across.  speed: m/s along the path, reached `lead_s` after the reset: the goal speeds up by
        3 u^2 - 2 u^3 of it, u = t / lead_s, so its acceleration has no step (at 0.3 m/s and 0.2 s: 2.3 m/s^2 at
        most, a twentieth of what full voltage gives).  An open path ends at rest likewise.  Points with times keep to
        their own, and to straight lines between them.
    centre: (x, y), m, or None for one drawn so that the shape keeps `margin` (m) from the workspace's edge.
    direction: 1 (anticlockwise), -1, or None for either.  phase: share of a lap where it begins, or None for any.
    previews: how many future goals the observation has, `preview_s` (s) apart.
    band: m, for success and the sparse reward: the distance to the goal itself, so to be late is to be off.

    Raises InputError for a path that cannot be read, ValueError for a shape that is not known.
    """

    path: str | Path | tuple[str, ...] = "circle"
    size: float = 0.05
    speed: float = 0.3
    centre: tuple[float, float] | None = None
    direction: int | None = None
    phase: float | None = None
    lead_s: float = 0.2
    previews: int = 10
    preview_s: float = 0.01
    margin: float = 0.02
    band: float = 1e-3

    draws: ClassVar[int] = 5
    plan_size: ClassVar[int] = 5

    def __post_init__(self) -> None:
        for name in ("size", "speed", "lead_s", "preview_s", "band"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0.0):
                raise ValueError(f"task track: {name} is {value!r}, it must be a positive number")
        if self.direction not in (None, 1, -1):
            raise ValueError(f"task track: direction is {self.direction!r}, choose 1, -1 or None")
        if self.phase is not None and not 0.0 <= self.phase <= 1.0:
            raise ValueError(f"task track: phase is {self.phase!r}, it must be a share of a lap, 0 to 1")
        if self.previews < 1:
            raise ValueError(f"task track: previews is {self.previews!r}, it must be at least 1")
        _ = self._curves  # a path that cannot be read is refused here and not at the first reset

    @cached_property
    def ahead_s(self) -> tuple[float, ...]:
        return tuple(self.preview_s * (i + 1) for i in range(self.previews))

    @cached_property
    def _curves(self) -> tuple[Curve, ...]:
        names = self.path if isinstance(self.path, tuple) else (self.path,)
        if not isinstance(self.path, tuple) and str(self.path).endswith(".csv"):
            return (self._from_file[0],)
        unknown = [str(name) for name in names if name not in SHAPES]
        if unknown or not names:
            raise ValueError(
                f"task track: path is {', '.join(unknown) or 'empty'}, choose from {', '.join(SHAPES)}, or a .csv file"
            )
        return tuple(SHAPES[str(name)](self.size) for name in names)

    @cached_property
    def _from_file(self) -> tuple[Polyline, Array | None]:
        points, time_s = read_path(str(self.path))
        try:
            return Polyline(points), time_s
        except ValueError as error:
            raise InputError(f"{self.path}: {error}") from None

    @property
    def _is_file(self) -> bool:
        return not isinstance(self.path, tuple) and self.path not in SHAPES

    def check(self, workspace: Array) -> None:
        if self._is_file:
            self._check_file(workspace)
            return
        room = workspace[:, 1] - workspace[:, 0] - 2.0 * self.margin - self.size
        if not (self.margin >= 0.0 and np.all(room >= 0.0)):
            raise ValueError(
                f"task track: a path {self.size:g} m across with a margin of {self.margin!r} m does not fit"
            )
        if self.centre is not None:
            edges = np.asarray(self.centre, float)[:, None] + 0.5 * self.size * np.array([-1.0, 1.0])
            if edges.shape != (2, 2) or np.any(edges[:, 0] < workspace[:, 0]) or np.any(edges[:, 1] > workspace[:, 1]):
                raise ValueError(f"task track: centre is {self.centre!r} m, there the path leaves the workspace")

    def _check_file(self, workspace: Array) -> None:
        points, _ = read_path(str(self.path))
        for j, column in enumerate(("x_m", "y_m")):
            low, high = workspace[j]
            outside = np.flatnonzero((points[:, j] < low) | (points[:, j] > high))
            if len(outside):
                row = int(outside[0])
                raise InputError(
                    f"{self.path}, row {row + 1}, column {column}: {points[row, j]:g} is outside the workspace, "
                    f"[{low:g}, {high:g}] m"
                )

    def begin(self, workspace: Array, uniforms: Array) -> tuple[Array, Array]:
        plan = np.zeros((len(uniforms), self.plan_size))
        plan[:, DIRECTION] = 1.0
        if not self._is_file:
            plan[:, PATH] = np.floor(uniforms[:, 0] * len(self._curves))
            edge = self.margin + 0.5 * self.size
            low, high = workspace[:, 0] + edge, workspace[:, 1] - edge
            drawn = low + (high - low) * uniforms[:, 1:3]
            plan[:, CENTRE] = drawn if self.centre is None else np.asarray(self.centre, float)
            either = np.where(uniforms[:, 3] < 0.5, 1.0, -1.0)
            plan[:, DIRECTION] = either if self.direction is None else self.direction
            lengths = np.array([curve.length for curve in self._curves])[plan[:, PATH].astype(np.intp)]
            plan[:, BEGIN] = lengths * (uniforms[:, 4] if self.phase is None else self.phase)
        return self.goal(plan, np.zeros(len(plan))), plan

    def aim(self, target: Array) -> Array:
        raise ValueError("task track has no target; choose where its path is with Track(centre=...)")

    def goal(self, plan: Array, elapsed_s: Array) -> Array:
        times = elapsed_s.reshape(len(plan), -1)
        out = np.empty((*times.shape, 2))
        for curve, rows in self._split(plan):
            s = self._arc(curve, plan[rows], times[rows])
            out[rows] = curve.point(s.ravel()).reshape(*s.shape, 2)
        _shift(out, plan[:, CENTRE])
        return out.reshape(*elapsed_s.shape, 2)

    def contour(self, plan: Array, points: Array, elapsed_s: Array) -> Array:
        out = np.empty(len(plan))
        for curve, rows in self._split(plan):
            s = self._arc(curve, plan[rows], elapsed_s[rows, None])[:, 0]
            out[rows] = curve.distance(points[rows] - plan[rows, CENTRE], s)
        return out

    def _split(self, plan: Array) -> list[tuple[Curve, slice | Array]]:
        """Each curve with the rows of the plans that follow it."""
        if len(self._curves) == 1:
            return [(self._curves[0], slice(None))]
        return [(curve, plan[:, PATH] == i) for i, curve in enumerate(self._curves)]

    def _arc(self, curve: Curve, plan: Array, elapsed_s: Array) -> Array:
        """Arc length (n, m) where the goal is, m."""
        timed = self._from_file if self._is_file else None
        if timed is not None and timed[1] is not None:
            return np.interp(elapsed_s, timed[1], timed[0].vertex_s)
        way = travelled(elapsed_s.ravel(), self.speed, self.lead_s, np.inf if curve.closed else curve.length)
        s: Array = way.reshape(elapsed_s.shape)
        s *= plan[:, DIRECTION, None]
        s += plan[:, BEGIN, None]
        return s


@compiled
def _shift(points: Any, centres: Any) -> None:
    """Move points (n, m, 2) by centres (n, 2), in place."""
    for i in range(points.shape[0]):
        for j in range(points.shape[1]):
            points[i, j, 0] += centres[i, 0]
            points[i, j, 1] += centres[i, 1]


@compiled
def travelled(elapsed_s: Any, speed: float, lead_s: float, length: float) -> Any:
    """Way (n,), m, after elapsed_s (n,) from rest: up to speed in lead_s, and at a finite length (m) down again.

    Where the length is too short for that the speed is what it allows.
    """
    speed = min(speed, length / lead_s)
    duration = length / speed + lead_s
    way = np.empty(len(elapsed_s))
    for i in range(len(elapsed_s)):
        t = elapsed_s[i]
        if t < 0.5 * duration:
            way[i] = _up(t, speed, lead_s)
        else:
            way[i] = length - _up(max(duration - t, 0.0), speed, lead_s)
    return way


@compiled
def _up(t: float, speed: float, lead_s: float) -> float:
    """Way after t from rest to speed, m."""
    u = min(1.0, t / lead_s)
    return speed * (lead_s * u * u * u * (1.0 - 0.5 * u) + max(t - lead_s, 0.0))
