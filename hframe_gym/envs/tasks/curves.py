"""Plane curves by arc length: a circle in closed form, every other curve as straight segments.

A curve is centered on the origin; the task moves it. The arc length s, m, continues over the laps of a closed curve and
stops at the ends of an open one.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from ..random_numbers import compiled, cos_sin_of_turns

Array = NDArray[np.float64]
# Segments of a Lissajous figure. At 50 mm across, the curve bulges at most 0.05 um from a segment.
SEGMENTS = 8192
COARSE_VERTICES = 128  # vertices that a wide search for the nearest point tries first


class CurveData(NamedTuple):
    """A curve as compiled functions take it.

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


class Curve(Protocol):
    """Interface of a plane curve of finite length, parametrized by its arc length."""

    @property
    def length(self) -> float:
        """Length of one lap of a closed curve, or from end to end of an open one, m."""

    @property
    def closed(self) -> bool:
        """Whether the last point of the curve equals the first."""

    @property
    def data(self) -> CurveData:
        """The curve as numbers, for compiled functions.

        These are the radius of a circle, m; of any other curve the vertices x, y, m, shape (n, 2), and the arc length
        at each, m, shape (n,).
        """

    @property
    def extent(self) -> Array:
        """Lowest and highest coordinate of the curve, rows x and y, m, shape (2, 2)."""

    def point(self, s: Array) -> Array:
        """Compute the points at n arc lengths.

        Args:
            s: Arc lengths from the start of the curve, m, any real number, shape (n,). Beyond its ends a closed curve
                repeats, an open one stops.

        Returns:
            Points x, y, m, shape (n, 2).
        """

    def distance(self, points: Array, s: Array) -> Array:
        """Compute the distances of n points to the curve.

        Args:
            points: Points x, y, m, shape (n, 2).
            s: Approximate arc length of the nearest point of the curve to each of `points`, m, shape (n,).

        Returns:
            Distances, m, shape (n,).
        """


@dataclass(frozen=True)
class Circle(Curve):
    """Circle around the origin, counterclockwise from (radius, 0).

    Args:
        radius: Radius, m, positive.
        closed: True for every circle; part of the interface `Curve`.
    """

    radius: float
    closed: bool = True

    @property
    def data(self) -> CurveData:
        """The circle as numbers, for compiled functions: radius, m, and no vertices, shape (0, 2)."""
        return CurveData(self.radius, True, np.zeros((0, 2)), np.array([0.0, self.length]))

    @property
    def length(self) -> float:
        """Circumference of the circle, m."""
        return 2.0 * math.pi * self.radius

    @property
    def extent(self) -> Array:
        """Lowest and highest coordinate of the circle, rows x and y, m, shape (2, 2)."""
        return np.array([[-self.radius, self.radius]] * 2)

    def point(self, s: Array) -> Array:
        """Compute the points at n arc lengths.

        Args:
            s: Arc lengths from the start of the curve, m, any real number (several laps), shape (n,).

        Returns:
            Points x, y, m, shape (n, 2).
        """
        return _new_points(self, s)

    def distance(self, points: Array, s: Array) -> Array:
        """Compute the distances of n points p to the circle, | |p| - radius |.

        Args:
            points: Points x, y, m, shape (n, 2).
            s: Approximate arc lengths of the nearest points, m, shape (n,); not used, because the formula is exact.

        Returns:
            Distances, m, shape (n,).
        """
        x, y = points.T
        return np.asarray(np.abs(np.sqrt(x * x + y * y) - self.radius))


class Polyline:
    """Curve of straight segments between vertices; closed if the last vertex equals the first.

    Args:
        vertices: Vertices x, y, m, shape (n, 2). A vertex that repeats the one before adds no segment.

    Attributes:
        vertex_s: Arc length of every vertex, repeated ones included, m, shape (n,).
        length: Total length, m.
        closed: Whether the last vertex equals the first.
        data: The curve for compiled functions.
        extent: Lowest and highest coordinate, rows x and y, m, shape (2, 2).

    Raises:
        ValueError: If there are fewer than two different vertices.
    """

    def __init__(self, vertices: Array) -> None:
        steps = np.hypot(*np.diff(vertices, axis=0).T)
        self.vertex_s: Array = np.concatenate([[0.0], np.cumsum(steps)])
        distinct = np.concatenate([[True], steps > 0.0])
        if distinct.sum() < 2:
            raise ValueError("a path needs at least two different points")
        self._s, self._vertices = self.vertex_s[distinct], np.ascontiguousarray(vertices[distinct])
        self.length = float(self._s[-1])
        self.closed = bool(np.all(vertices[0] == vertices[-1]))
        self.extent = np.stack([vertices.min(axis=0), vertices.max(axis=0)], axis=1)
        self.data = CurveData(0.0, self.closed, self._vertices, self._s)

    def _wrapped(self, s: Array) -> Array:
        """Return arc lengths within [0, length]: modulo the length if closed, else clipped."""
        return np.mod(s, self.length) if self.closed else np.clip(s, 0.0, self.length)

    def point(self, s: Array) -> Array:
        """Compute the points at n arc lengths.

        Args:
            s: Arc lengths from the start of the curve, m, any real number, shape (n,). Beyond its ends a closed curve
                repeats, an open one stops.

        Returns:
            Points x, y, m, shape (n, 2).
        """
        return _new_points(self, s)

    def distance(self, points: Array, s: Array) -> Array:
        """Compute the distances of n points to the part of the curve near s.

        With d the distance from a point to the curve's point at s, the nearest point is searched from s - pi d to
        s + pi d. A branch that is close by, but farther along the curve, is therefore ignored.

        Args:
            points: Points x, y, m, shape (n, 2).
            s: Approximate arc length of the nearest point of the curve to each of `points`, m, shape (n,).

        Returns:
            Distances, m, shape (n,).
        """
        wrapped = self._wrapped(s)
        offset = np.linalg.norm(points - self.point(s), axis=1)
        # At most half a circle with the chord 2 * offset lies between s and the nearest point: pi / 2 * (2 * offset).
        window = np.minimum(math.pi * offset, self.length / 2 if self.closed else self.length)
        result: Array = _nearest_distances(self._vertices, self._s, self.closed, points, wrapped, window)
        return result


def _new_points(curve: Curve, s: Array) -> Array:
    """Return the points (n, 2) of a curve at arc lengths s (n,)."""
    points = np.empty((len(s), 2))
    write_points(s, curve.data, *points.T)
    return points


@compiled
def write_points(s: Any, curve: Any, x: Any, y: Any) -> None:
    """Write the points of a curve at n arc lengths to two arrays.

    Args:
        s: Arc lengths from the start of the curve, m, any real number, shape (n,). Beyond its ends a closed curve
            repeats, an open one stops.
        curve: Radius, vertices and arc lengths of the curve (`CurveData`).
        x: Output, first coordinate of the points, m, shape (n,).
        y: Output, second coordinate of the points, m, shape (n,).
    """
    length = curve.vertex_s[-1]
    if curve.radius > 0.0:
        turns_per_meter = 1.0 / length
        for i in range(len(s)):
            cosine, sine = cos_sin_of_turns(s[i] * turns_per_meter)
            x[i], y[i] = curve.radius * cosine, curve.radius * sine
        return
    for i in range(len(s)):
        wrapped = s[i] % length if curve.closed else min(length, max(0.0, s[i]))
        k = _segment(curve.vertex_s, wrapped)
        fraction = (wrapped - curve.vertex_s[k]) / (curve.vertex_s[k + 1] - curve.vertex_s[k])
        begin, end = curve.vertices[k], curve.vertices[k + 1]
        x[i], y[i] = begin[0] + fraction * (end[0] - begin[0]), begin[1] + fraction * (end[1] - begin[1])


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
def _squared_distance_to_segment(point: Any, begin: Any, end: Any) -> float:
    """Return the squared distance, m^2, of a point to the segment between two points, (2,) each."""
    x, y = end[0] - begin[0], end[1] - begin[1]
    u, v = point[0] - begin[0], point[1] - begin[1]
    fraction = min(1.0, max(0.0, (u * x + v * y) / (x * x + y * y)))
    return (u - fraction * x) ** 2 + (v - fraction * y) ** 2


@compiled
def _nearest_distances(vertices: Any, vertex_s: Any, closed: bool, points: Any, s: Any, window: Any) -> Any:
    """Return the distances (n,) of points (n, 2) to the segments that touch [s - window, s + window]."""
    segments = len(vertex_s) - 1
    length = vertex_s[-1]
    out = np.empty(len(points))
    for b in range(len(points)):
        low, high = s[b] - window[b], s[b] + window[b]
        lap = math.floor(low / length) if closed else 0
        first = lap * segments + _segment(vertex_s, low - lap * length)
        lap = math.floor(high / length) if closed else 0
        last = lap * segments + _segment(vertex_s, high - lap * length)
        # The window is wide only for a distant point. Then the nearest of a few vertices narrows the search.
        stride = (last - first) // COARSE_VERTICES
        if stride > 1:
            best, nearest = np.inf, first
            for k in range(first, last + 1, stride):
                vertex = vertices[k % segments]
                squared = (points[b, 0] - vertex[0]) ** 2 + (points[b, 1] - vertex[1]) ** 2
                if squared < best:
                    best, nearest = squared, k
            first, last = max(first, nearest - stride), min(last, nearest + stride)
        smallest = np.inf
        for k in range(first, last + 1):
            begin, end = vertices[k % segments], vertices[k % segments + 1]
            smallest = min(smallest, _squared_distance_to_segment(points[b], begin, end))
        out[b] = math.sqrt(smallest)
    return out


def circle(size: float) -> Circle:
    """Create a circle around the origin, counterclockwise from (size / 2, 0).

    Args:
        size: Diameter, m, positive.

    Returns:
        Closed curve.
    """
    return Circle(size / 2)


def square(size: float) -> Polyline:
    """Create a square around the origin, counterclockwise from the middle of its right side.

    Args:
        size: Length of a side, m, positive.

    Returns:
        Closed curve.
    """
    corners = [(1, 0), (1, 1), (-1, 1), (-1, -1), (1, -1), (1, 0)]
    return Polyline(0.5 * size * np.array(corners, float))


def lissajous(size: float) -> Polyline:
    """Create the figure of eight x = size / 2 sin(a), y = size / 2 sin(2 a), in segments of equal length.

    Args:
        size: Extent along x and along y, m, positive.

    Returns:
        Closed curve that starts at the origin, toward positive x and y.
    """
    from scipy.interpolate import CubicSpline  # takes a tenth of a second, which a start without it saves

    angle = np.linspace(0.0, 2.0 * np.pi, 4 * SEGMENTS + 1)
    fine = 0.5 * size * np.stack([np.sin(angle), np.sin(2.0 * angle)], axis=1)
    s = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(fine, axis=0).T))])
    even = CubicSpline(s, angle)(np.linspace(0.0, s[-1], SEGMENTS + 1))
    even[[0, -1]] = 0.0  # the last point equals the first to the bit
    return Polyline(0.5 * size * np.stack([np.sin(even), np.sin(2.0 * even)], axis=1))


SHAPES: dict[str, Callable[[float], Curve]] = {"circle": circle, "square": square, "lissajous": lissajous}
