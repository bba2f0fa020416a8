"""Plane curves by arc length (circles, and straight segments for every other curve), and motion along them.

A curve is centered on the origin; the task moves it. The arc length s, m, continues over the laps of a closed
curve and stops at the ends of an open one.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from ...arrays import Array
from ...dynamics.codegen.compiled import compiled, compiled_only
from ..randomization.random_numbers import cos_sin_of_turns

# Segments of a Lissajous figure. At 50 mm across, the curve bulges at most 0.05 um from a segment.
SEGMENTS = 8192
COARSE_VERTICES = 128  # vertices that a wide search for the nearest point tries first


class CurveData(NamedTuple):
    """Hold the data of a curve in the form that compiled functions take.

    Attributes:
        radius: Radius of a circle, m; 0 for a curve of straight segments.
        closed: Whether the last point of the curve equals the first.
        vertices: Vertices x, y of the segments, m, shape (n, 2); empty for a circle.
        vertex_s: Arc length of every vertex, m, shape (n,); of a circle 0 and its circumference.
    """

    radius: float
    closed: bool
    vertices: Array
    vertex_s: Array


class Curve:
    """Plane curve of finite length, parametrized by its arc length.

    Attributes:
        closed: Whether the last point of the curve equals the first.
        length: Length of one lap of a closed curve, or from end to end of an open one, m.
    """

    def __init__(self, data: CurveData) -> None:
        self.data, self.closed = data, data.closed
        self.length = float(data.vertex_s[-1])

    def point(self, s: Array) -> Array:
        """Compute the points x, y at n arc lengths, m, shape (n, 2).

        Args:
            s: Arc lengths from the start of the curve, m, any real number, shape (n,). Beyond its ends, a
                closed curve repeats; on an open curve, the point stays at the end.
        """
        points = np.empty((len(s), 2))
        _write_points(s, self.data, points)
        return points

    def distance(self, points: Array, s: Array) -> Array:
        """Compute the distance of each point to the curve near a given arc length, m, shape (n,).

        Args:
            points: Points x, y, m, shape (n, 2).
            s: Approximate arc length of the nearest point of the curve, m, shape (n,).
        """
        distances = np.empty(len(points))
        write_distances(points, s, self.data, distances)
        return distances


class Polyline(Curve):
    """Curve of straight segments between vertices; closed if the last vertex equals the first.

    Args:
        vertices: Vertices x, y, m, shape (n, 2). A vertex that repeats the one before adds no segment.

    Attributes:
        vertex_s: Arc length of every vertex, repeated ones included, m, shape (n,).

    Raises:
        ValueError: If there are fewer than two different vertices.
    """

    def __init__(self, vertices: Array) -> None:
        steps = np.hypot(*np.diff(vertices, axis=0).T)
        self.vertex_s: Array = np.concatenate([[0.0], np.cumsum(steps)])
        distinct = np.concatenate([[True], steps > 0.0])
        if distinct.sum() < 2:
            raise ValueError("a path needs at least two different points")
        closed = bool(np.all(vertices[0] == vertices[-1]))
        super().__init__(
            CurveData(0.0, closed, np.ascontiguousarray(vertices[distinct]), self.vertex_s[distinct])
        )


@compiled
def _write_points(s: Any, curve: Any, points: Any) -> None:
    """Write the points (n, 2) of a `CurveData` at arc lengths s (n,)."""
    for i in range(len(s)):
        points[i, 0], points[i, 1] = point_at(s[i], curve)


@compiled_only
def point_at(s: float, curve: Any) -> Any:
    """Compute the point (x, y), m, of a `CurveData` at an arc length `s`, m; for compiled functions only."""
    if curve.radius > 0.0:
        cosine, sine = cos_sin_of_turns(s * (1.0 / curve.vertex_s[-1]))
        return curve.radius * cosine, curve.radius * sine
    return _point_of_polyline(s, curve)


@compiled
def write_distances(points: Any, s: Any, curve: Any, distances: Any) -> None:
    """Write the distances of n points to a curve.

    With d the distance from a point to the curve's point at s, the nearest point is searched from s - pi d to
    s + pi d. A branch that is close by, but farther along the curve, is therefore ignored. The formula for
    circles is exact.

    Args:
        points: Points x, y, m, shape (n, 2).
        s: Approximate arc length of the nearest point of the curve to each point, m, shape (n,); not used for
            a circle.
        curve: Radius, vertices and arc lengths of the curve (`CurveData`).
        distances: Output, distances, m, shape (n,).
    """
    x, y = points[:, 0], points[:, 1]
    if curve.radius > 0.0:
        for i in range(len(x)):
            distances[i] = abs(math.sqrt(x[i] * x[i] + y[i] * y[i]) - curve.radius)
        return
    for i in range(len(x)):
        distances[i] = _distance_to_polyline(x[i], y[i], s[i], curve)


@compiled
def _wrapped(s: float, curve: Any) -> float:
    """Return an arc length within [0, length]: modulo the length if the curve is closed, else clipped."""
    length = curve.vertex_s[-1]
    return float(s % length if curve.closed else min(length, max(0.0, s)))


@compiled
def _point_of_polyline(s: float, curve: Any) -> tuple[float, float]:
    """Return x and y at arc length s, m, of a curve of straight segments."""
    wrapped = _wrapped(s, curve)
    k = _segment(curve.vertex_s, wrapped)
    fraction = (wrapped - curve.vertex_s[k]) / (curve.vertex_s[k + 1] - curve.vertex_s[k])
    begin, end = curve.vertices[k], curve.vertices[k + 1]
    return begin[0] + fraction * (end[0] - begin[0]), begin[1] + fraction * (end[1] - begin[1])


@compiled
def _segment(vertex_s: Any, s: float) -> int:
    """Return the segment that holds arc length s."""
    segments = len(vertex_s) - 1
    # Segments of equal length: the fraction of the length gives the answer.
    k = min(segments - 1, max(0, int(s / vertex_s[segments] * segments)))
    if vertex_s[k] <= s < vertex_s[k + 1]:
        return k
    after: Any = np.searchsorted(vertex_s, s, "right")
    return int(min(segments - 1, max(0, after - 1)))


@compiled
def _squared_distance_to_segment(x: float, y: float, begin: Any, end: Any) -> float:
    """Return the squared distance, m^2, of the point x, y to the segment between two points, (2,) each."""
    a, b = end[0] - begin[0], end[1] - begin[1]
    u, v = x - begin[0], y - begin[1]
    fraction = min(1.0, max(0.0, (u * a + v * b) / (a * a + b * b)))
    return (u - fraction * a) ** 2 + (v - fraction * b) ** 2


@compiled
def _distance_to_polyline(x: float, y: float, s: float, curve: Any) -> float:
    """Return the distance of the point x, y to a curve near arc length s, as `write_distances` says."""
    vertices, vertex_s, segments = curve.vertices, curve.vertex_s, len(curve.vertex_s) - 1
    length = vertex_s[segments]
    center, (goal_x, goal_y) = _wrapped(s, curve), _point_of_polyline(s, curve)
    # At most half a circle whose chord is twice the distance to the goal lies between s and the nearest
    # point.
    window = math.pi * math.sqrt((x - goal_x) * (x - goal_x) + (y - goal_y) * (y - goal_y))
    window = min(window, length / 2 if curve.closed else length)
    low, high = center - window, center + window
    lap = math.floor(low / length) if curve.closed else 0
    first = lap * segments + _segment(vertex_s, low - lap * length)
    lap = math.floor(high / length) if curve.closed else 0
    last = lap * segments + _segment(vertex_s, high - lap * length)
    # The window is wide only for a distant point. Then the nearest of a few vertices narrows the search.
    stride = (last - first) // COARSE_VERTICES
    if stride > 1:
        best, nearest = np.inf, first
        for k in range(first, last + 1, stride):
            vertex = vertices[k % segments]
            squared = (x - vertex[0]) ** 2 + (y - vertex[1]) ** 2
            if squared < best:
                best, nearest = squared, k
        first, last = max(first, nearest - stride), min(last, nearest + stride)
    smallest = np.inf
    for k in range(first, last + 1):
        begin, end = vertices[k % segments], vertices[k % segments + 1]
        smallest = min(smallest, _squared_distance_to_segment(x, y, begin, end))
    return math.sqrt(smallest)


@compiled_only
def _speed_up(t: float, speed: float, lead_s: float) -> float:
    """Return the distance, m, after time t, s, from rest to speed."""
    u = t / lead_s if t / lead_s < 1.0 else 1.0
    return speed * (lead_s * u * u * u * (1.0 - 0.5 * u) + (t - lead_s if t - lead_s > 0.0 else 0.0))


@compiled_only
def traveled(t: float, speed: float, lead_s: float, length: float) -> float:
    """Compute how far, m, a goal has traveled along its path at time t; for compiled functions only.

    The goal starts at rest and reaches `speed` at t = lead_s, by v = speed (3 u^2 - 2 u^3) with u = t /
    lead_s. On a path of finite length it slows down in the same way, so that it comes to rest at the end of
    the path.

    Args:
        t: Time since the start, s, not negative.
        speed: Speed after the speed-up, m/s; limited to length / lead_s.
        lead_s: Duration of the speed-up and of the slow-down, s, positive.
        length: Length of the path, m; inf for a closed path, on which the goal does not slow down.
    """
    if length == math.inf:
        return _speed_up(t, speed, lead_s)
    limited = speed if speed < length / lead_s else length / lead_s
    duration = length / limited + lead_s
    # The second half is the first half reversed in time.
    if t < 0.5 * duration:
        return _speed_up(t, limited, lead_s)
    return length - _speed_up(duration - t if duration - t > 0.0 else 0.0, limited, lead_s)


def circle(size: float) -> Curve:
    """Create a closed curve: a circle of diameter `size`, m, counterclockwise from (size / 2, 0)."""
    radius = 0.5 * size
    return Curve(CurveData(radius, True, np.zeros((0, 2)), np.array([0.0, 2.0 * math.pi * radius])))


def square(size: float) -> Polyline:
    """Create a square of side `size`, m, around the origin, counterclockwise from its right side's middle."""
    corners = [(1, 0), (1, 1), (-1, 1), (-1, -1), (1, -1), (1, 0)]
    return Polyline(0.5 * size * np.array(corners, float))


def lissajous(size: float) -> Polyline:
    """Create a figure 8, x = size / 2 sin(a), y = size / 2 sin(2 a), of equal segments; `size` in m.

    It has 8192 (`SEGMENTS`) straight segments and begins at the center, where a = 0.
    """
    from scipy.interpolate import CubicSpline  # takes a tenth of a second, which a start without it saves

    angle = np.linspace(0.0, 2.0 * np.pi, 4 * SEGMENTS + 1)
    fine = 0.5 * size * np.stack([np.sin(angle), np.sin(2.0 * angle)], axis=1)
    s = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(fine, axis=0).T))])
    even = CubicSpline(s, angle)(np.linspace(0.0, s[-1], SEGMENTS + 1))
    even[[0, -1]] = 0.0  # the last point equals the first to the bit
    return Polyline(0.5 * size * np.stack([np.sin(even), np.sin(2.0 * even)], axis=1))


SHAPES: dict[str, Callable[[float], Curve]] = {"circle": circle, "square": square, "lissajous": lissajous}
