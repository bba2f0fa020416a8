"""Task `track`: follow a goal that moves along a path."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from ...arrays import Array, ElapsedTimes, GoalPlans, Workspace
from ...dynamics.codegen.compiled import compiled
from ...errors import InputError, is_integer, is_number, suggestion
from ...recordings import read_path
from .base import TASKS, Metrics, Task
from .curves import SHAPES, Curve, Polyline, point_at, traveled, write_distances

# Columns of a plan: index of the path, its center along each axis (m), direction (+1 or -1), arc length at
# the start (m), speed (m/s).
PATH, CENTER, DIRECTION, START, SPEED = 0, slice(1, -3), -3, -2, -1


@TASKS.register("track")
@dataclass(frozen=True)
class Track(Task):
    """Follow a goal along a path, from rest at its beginning.

    The goal speeds up over `lead_s` by v = speed (3 u^2 - 2 u^3), u = t / lead_s, so that its acceleration
    has no step (at 0.3 m/s and 0.2 s it is at most 2.3 m/s^2, a twentieth of what full voltage gives). At the
    end of an open path it slows down in the same way. A file with times keeps its times, with straight lines
    between the points.

    A machine with one axis follows the motion of a shape along x: a circle gives a sine, a square moves and
    pauses in turn. The way back is the way there, so that the distance to the path is that to the goal. The
    lengths are angles if the axes are rotary; the task "track" then has a size of 0.5 rad, 3 rad/s and a band
    of 10 mrad.

    Args:
        path: Name of a shape ("circle", "square", "lissajous"), a tuple of names (one is chosen at random per
            episode), or a CSV file of points (see `hframe_gym.recordings`), whose position and direction are
            not changed.
        size: Width of a shape, m, positive.
        speed: Speed along the path after the speed-up, m/s, positive; rules randomize it as `task.speed`.
        centre: Center (x, y) of a shape, m. Default: random, uniform where the shape is at least `margin`
            inside.
        direction: 1 (counterclockwise), -1, or None for a random one.
        phase: Fraction of a lap at which the goal starts, 0 to 1, or None for a random one.
        lead_s: Duration of the speed-up, s, positive.
        previews: Number of future goals in the observation, at least 1.
        preview_s: Time between future goals, s, positive.
        margin: Minimum distance of random shapes from the edge of the workspace, m, not negative.
        band: Distance to the moving goal that counts as a success, m, positive; a delay on the path is an
            error too.

    Raises:
        InputError: If a number is invalid, a shape is unknown or a path cannot be read.
    """

    path: str | Path | tuple[str, ...] = "circle"
    size: float = 0.05
    speed: float = 0.3
    centre: tuple[float, ...] | None = None
    direction: int | None = None
    phase: float | None = None
    lead_s: float = 0.2
    previews: int = 10
    preview_s: float = 0.01
    margin: float = 0.02
    band: float = 1e-3

    metrics: ClassVar[Metrics] = "track"
    draws: ClassVar[int] = 5
    plan_size: ClassVar[int] = 6
    lengths: ClassVar[tuple[str, ...]] = ("size", "speed", "margin", "band")

    def __post_init__(self) -> None:
        for name in ("size", "speed", "lead_s", "preview_s", "band"):
            value = getattr(self, name)
            if not (is_number(value) and value > 0.0):
                raise InputError(f"task track: {name} is {value!r}, it must be a positive number")
        if self.direction not in (None, 1, -1):
            raise InputError(f"task track: direction is {self.direction!r}, choose 1, -1 or None")
        if self.phase is not None and not (is_number(self.phase) and 0.0 <= self.phase <= 1.0):
            raise InputError(f"task track: phase is {self.phase!r}, it must be a fraction of a lap, 0 to 1")
        if not (is_integer(self.previews) and self.previews >= 1):
            raise InputError(f"task track: previews is {self.previews!r}, it must be an integer, at least 1")
        _ = self._curves  # refuses a path that cannot be read when the task is made, not at the first reset

    @property
    @override
    def ahead_s(self) -> tuple[float, ...]:
        """Time from now to each future goal in the observation `preview`, s, ascending."""
        return tuple(self.preview_s * (i + 1) for i in range(self.previews))

    @property
    @override
    def parameters(self) -> dict[str, float]:
        """Nominal value of the only parameter that can be randomized: `speed`, m/s."""
        return {"speed": self.speed}

    @cached_property
    def _curves(self) -> tuple[Curve, ...]:
        """The curves of which an episode follows one."""
        names = self.path if isinstance(self.path, tuple) else (self.path,)
        if not isinstance(self.path, tuple) and str(self.path).endswith(".csv"):
            return (self._from_file[0],)
        unknown = [str(name) for name in names if not isinstance(name, str) or name not in SHAPES]
        if unknown or not names:
            shapes = ", ".join(SHAPES)
            raise InputError(
                f"task track: path is {', '.join(unknown) or 'empty'}; choose from {shapes}, "
                f"or give a .csv file{suggestion(unknown[0], SHAPES) if unknown else ''}"
            )
        return tuple(SHAPES[str(name)](self.size) for name in names)

    @cached_property
    def _from_file(self) -> tuple[Polyline, Array | None]:
        """The curve of a path file, and the times of its points, s, where it has any."""
        points, time_s = read_path(str(self.path))
        try:
            return Polyline(points), time_s
        except ValueError as error:
            raise InputError(f"{self.path}: {error}") from None

    @property
    def _times(self) -> Array | None:
        """Times of the points of a path file, s, where it has any."""
        return self._from_file[1] if self._is_file else None

    @cached_property
    def _is_single_curve(self) -> bool:
        """Whether all episodes follow one curve, at their plans' speeds, so that compiled functions apply."""
        return len(self._curves) == 1 and self._times is None

    @property
    def _is_file(self) -> bool:
        return not isinstance(self.path, tuple) and self.path not in SHAPES

    @override
    def check(self, workspace: Workspace) -> None:
        """Check that the path with its margin fits into the workspace; raises an InputError if it does not.

        Of a path from a file, which needs a machine with two axes, each point must lie in the workspace.
        """
        if self._is_file:
            if len(workspace) != 2:
                raise InputError(
                    f"{self.path}: a file has points x, y, and the machine has one axis; choose one of "
                    f"{', '.join(SHAPES)}, of which it follows the motion along x"
                )
            self._check_file(workspace)
            return
        room = workspace[:, 1] - workspace[:, 0] - self.size
        if not (is_number(self.margin) and self.margin >= 0.0 and np.all(room >= 2.0 * self.margin)):
            raise InputError(
                f"task track: a path {self.size:g} across with a margin "
                f"of {self.margin!r} does not fit into the workspace, "
                f"{' by '.join(f'{side:g}' for side in np.ptp(workspace, axis=1))} (m, or rad if rotary)"
            )
        if self.centre is not None:
            edges = np.reshape(self.centre, (-1, 1)) + 0.5 * self.size * np.array([-1.0, 1.0])
            if (
                edges.shape != workspace.shape
                or np.any(edges[:, 0] < workspace[:, 0])
                or np.any(edges[:, 1] > workspace[:, 1])
            ):
                raise InputError(f"task track: centre is {self.centre!r}; the path would leave the workspace")

    def _check_file(self, workspace: Array) -> None:
        """Check the points of a path file; raises InputError with row and column of the first one outside."""
        points, _ = read_path(str(self.path))
        for j, column in enumerate(("x_m", "y_m")):
            low, high = workspace[j]
            outside = np.flatnonzero((points[:, j] < low) | (points[:, j] > high))
            if len(outside):
                row = int(outside[0])
                raise InputError(
                    f"{self.path}, row {row + 1}, column {column}: "
                    f"{points[row, j]:g} is outside the workspace, [{low:g}, {high:g}] m"
                )

    @override
    def begin(
        self, workspace: Workspace, uniforms: Array, parameters: Mapping[str, Array] | None = None
    ) -> tuple[Array, Array]:
        """Choose path, center, direction and phase (point of the path where the goal starts) of k episodes.

        What the attributes `path`, `centre`, `direction` and `phase` do not fix is random. A path from a file
        is followed from its first point. A row of the plan is: index of the path, center (m), direction (+1
        or -1), arc length at the start (m), speed (m/s).
        """
        axes = len(workspace)
        plan = np.zeros((len(uniforms), 4 + axes))
        plan[:, DIRECTION] = 1.0
        plan[:, SPEED] = self.speed if parameters is None else parameters["speed"]
        if not self._is_file:
            plan[:, PATH] = np.floor(uniforms[:, 0] * len(self._curves))
            edge = self.margin + 0.5 * self.size
            low, high = workspace[:, 0] + edge, workspace[:, 1] - edge
            random_center = low + (high - low) * uniforms[:, 1 : 1 + axes]
            plan[:, CENTER] = random_center if self.centre is None else np.asarray(self.centre, float)
            random_direction = np.where(uniforms[:, 3] < 0.5, 1.0, -1.0)
            plan[:, DIRECTION] = random_direction if self.direction is None else self.direction
            lengths = np.array([curve.length for curve in self._curves])[plan[:, PATH].astype(np.intp)]
            plan[:, START] = lengths * (uniforms[:, 4] if self.phase is None else self.phase)
        return self.goal(plan, np.zeros(len(plan))), plan

    @override
    def aim(self, target: Array) -> GoalPlans:
        """Raise an InputError: this task has no target; `Track(centre=(x, y))` places its path."""
        raise InputError("task track has no target; choose where its path lies with Track(centre=(x, y))")

    @override
    def goal(self, plan: GoalPlans, elapsed_s: Array) -> Array:
        times, axes = elapsed_s.reshape(len(plan), -1), plan.shape[1] - 4
        out = np.empty((*times.shape, axes))
        for curve, rows in self._rows_of_curves(plan):
            s = self._arc_length(curve, plan[rows], times[rows])
            out[rows] = curve.point(s.ravel()).reshape(*s.shape, 2)[..., :axes]
        out += plan[:, None, CENTER]
        return out.reshape(*elapsed_s.shape, axes)

    @override
    def write_goals(
        self,
        plan: GoalPlans,
        elapsed_s: ElapsedTimes,
        ahead_s: Array,
        goals: NDArray[np.float32],
        previews: NDArray[np.float32],
    ) -> None:
        """Write the goals; in compiled code unless the task has several shapes or a file with times."""
        if not self._is_single_curve:
            super().write_goals(plan, elapsed_s, ahead_s, goals, previews)
            return
        _write_goals(plan, elapsed_s, ahead_s, self.lead_s, self._curves[0].data, goals, previews)

    @override
    def contour(self, plan: GoalPlans, points: Array, elapsed_s: ElapsedTimes) -> Array:
        if points.shape[1] == 1:
            return np.asarray(np.abs(points - self.goal(plan, elapsed_s))[:, 0])
        out = np.empty(len(plan))
        if self._is_single_curve:
            _write_contours(plan, points, elapsed_s, self.lead_s, self._curves[0].data, out)
            return out
        for curve, rows in self._rows_of_curves(plan):
            s = self._arc_length(curve, plan[rows], elapsed_s[rows, None])[:, 0]
            out[rows] = curve.distance(points[rows] - plan[rows, CENTER], s)
        return out

    def _rows_of_curves(self, plan: Array) -> list[tuple[Curve, slice | Array]]:
        """Return each curve with the rows of the plans that follow it."""
        if len(self._curves) == 1:
            return [(self._curves[0], slice(None))]
        return [(curve, plan[:, PATH] == i) for i, curve in enumerate(self._curves)]

    def _arc_length(self, curve: Curve, plan: Array, elapsed_s: Array) -> Array:
        """Return the arc lengths (n, m) of the goals, m, at times elapsed_s (n, m), s."""
        if self._times is not None:
            return np.interp(elapsed_s, self._times, self._from_file[0].vertex_s)
        length = np.inf if curve.closed else curve.length
        return np.asarray(arc_lengths(plan, elapsed_s, self.lead_s, length))


@compiled
def arc_lengths(plan: Any, elapsed_s: Any, lead_s: float, length: float) -> Any:
    """Compute the arc lengths of the goals of n episodes along their paths at m times each.

    A goal starts at rest and reaches its speed after `lead_s`, by the cubic of `curves.traveled`. On an open
    path it slows down in the same way and stays at the end; its speed is limited to length / lead_s.

    Args:
        plan: Path of each episode, shape (n, 4 + axes). The last three columns are used: direction (+1 or
            -1; with -1 the arc length falls), arc length at the start (m) and speed (m/s). On an open path,
            the direction is +1 and the start 0.
        elapsed_s: Times since the reset, s, not negative, shape (n, m).
        lead_s: Duration of the speed-up and of the slow-down, s, positive.
        length: Length of the path, m; infinite for a closed path.

    Returns:
        Arc lengths from the beginning of the path, m, shape (n, m); they are not limited to one lap of a
        closed path, and may be negative.
    """
    out = np.empty(elapsed_s.shape)
    for i in range(elapsed_s.shape[0]):
        for j in range(elapsed_s.shape[1]):
            out[i, j] = _goal_arc_length(np.float64(elapsed_s[i, j]), plan[i], lead_s, length)
    return out


@compiled
def _goal_arc_length(t: float, plan: Any, lead_s: float, length: float) -> float:
    """Return the arc length, m, of an episode's goal with its plan at time t, s; else as `arc_lengths`."""
    return traveled(t, plan[SPEED], lead_s, length) * plan[DIRECTION] + plan[START]


@compiled
def _write_goals(
    plan: Any, elapsed_s: Any, ahead_s: Any, lead_s: float, curve: Any, goals: Any, previews: Any
) -> None:
    """Write goals (n, axes) at elapsed_s (n,), and previews (n, m, axes) ahead_s (m,) later, by plans."""
    length = math.inf if curve.closed else curve.vertex_s[-1]
    for i in range(len(plan)):
        for j in range(len(ahead_s) + 1):
            t = np.float64(elapsed_s[i]) + (ahead_s[j - 1] if j > 0 else 0.0)
            point = point_at(_goal_arc_length(t, plan[i], lead_s, length), curve)
            for axis in range(goals.shape[1]):
                if j == 0:
                    goals[i, axis] = point[axis] + plan[i, 1 + axis]
                else:
                    previews[i, j - 1, axis] = point[axis] + plan[i, 1 + axis]


@compiled
def _write_contours(
    plan: Any, points: Any, elapsed_s: Any, lead_s: float, curve: Any, distances: Any
) -> None:
    """Write distances (n,) of points (n, 2) to a curve near goals at elapsed_s (n,), by plans (n, 6)."""
    length = math.inf if curve.closed else curve.vertex_s[-1]
    relative, s = np.empty((len(plan), 2)), np.empty(len(plan))
    for i in range(len(plan)):
        relative[i, 0], relative[i, 1] = points[i, 0] - plan[i, 1], points[i, 1] - plan[i, 2]
    if curve.radius == 0.0:  # the distance to a circle does not depend on the arc length
        for i in range(len(plan)):
            s[i] = _goal_arc_length(np.float64(elapsed_s[i]), plan[i], lead_s, length)
    write_distances(relative, s, curve, distances)
