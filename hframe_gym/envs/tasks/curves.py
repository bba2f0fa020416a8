"""Curves in the plane by their arc length: a circle in closed form, everything else as straight pieces.

A curve lies around the origin; the task moves it to its centre.  s: arc length, m, running on over the laps of a
closed curve and held at the ends of an open one.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from ..counter_rng import compiled, turn

Array = NDArray[np.float64]
# Pieces of a Lissajous figure: 50 mm across, the tightest chord is 0.05 um off the curve.
PIECES = 8192
COARSE = 128  # vertices that a wide search tries first


class Curve(Protocol):
    """A curve of a finite length."""

    @property
    def length(self) -> float:
        """m, of a lap or from end to end."""

    @property
    def closed(self) -> bool:
        """Whether it ends where it begins."""

    @property
    def extent(self) -> Array:
        """(2, 2) m: rows x and y, columns lowest and highest."""

    def point(self, s: Array) -> Array:
        """Points (n, 2) at arc length s (n,), m."""

    def distance(self, points: Array, s: Array) -> Array:
        """Distance (n,) of points (n, 2) to the curve, m; s (n,): about where on it."""


@dataclass(frozen=True)
class Circle:
    """Anticlockwise from (radius, 0).  radius: m."""

    radius: float
    closed: bool = True

    @property
    def length(self) -> float:
        return 2.0 * math.pi * self.radius

    @property
    def extent(self) -> Array:
        return np.array([[-self.radius, self.radius]] * 2)

    def point(self, s: Array) -> Array:
        points: Array = _on_circle(s, self.radius, self.length)
        return points

    def distance(self, points: Array, s: Array) -> Array:
        x, y = points.T
        return np.asarray(np.abs(np.sqrt(x * x + y * y) - self.radius))


class Polyline:
    """Straight pieces between vertices (n, 2), m; closed where the last is the first.

    Vertices that repeat the one before are left out; `vertex_s` (n,) has the arc length of all.

    Raises ValueError for fewer than two different vertices.
    """

    def __init__(self, vertices: Array) -> None:
        steps = np.hypot(*np.diff(vertices, axis=0).T)
        self.vertex_s: Array = np.concatenate([[0.0], np.cumsum(steps)])
        own = np.concatenate([[True], steps > 0.0])
        if own.sum() < 2:
            raise ValueError("a path needs at least two different points")
        self._s, self._vertices = self.vertex_s[own], np.ascontiguousarray(vertices[own])
        self.length = float(self._s[-1])
        self.closed = bool(np.all(vertices[0] == vertices[-1]))
        self.extent = np.stack([vertices.min(axis=0), vertices.max(axis=0)], axis=1)

    def _on(self, s: Array) -> Array:
        return np.mod(s, self.length) if self.closed else np.clip(s, 0.0, self.length)

    def point(self, s: Array) -> Array:
        points: Array = _on_pieces(self._vertices, self._s, self._on(s))
        return points

    def distance(self, points: Array, s: Array) -> Array:
        """No further along than the curve can turn back to the point: for one that crosses itself the other branch
        does not count."""
        on = self._on(s)
        off = np.linalg.norm(points - self.point(s), axis=1)
        # Half a circle through the goal and the point's mirror image is pi/2 of its chord, which is twice `off`.
        window = np.minimum(math.pi * off, self.length / 2 if self.closed else self.length)
        found: Array = _nearest(self._vertices, self._s, self.closed, points, on, window)
        return found


@compiled
def _on_circle(s: Any, radius: float, length: float) -> Any:
    """Points (n, 2) at arc length s (n,) on a circle."""
    out = np.empty((len(s), 2))
    turns = 1.0 / length
    for i in range(len(s)):
        cosine, sine = turn(s[i] * turns)
        out[i, 0], out[i, 1] = radius * cosine, radius * sine
    return out


@compiled
def _piece(vertex_s: Any, s: float) -> int:
    """The piece with arc length s on it."""
    pieces = len(vertex_s) - 1
    # Where pieces are alike, it is where its share of the length says.
    k = min(pieces - 1, max(0, int(s / vertex_s[pieces] * pieces)))
    if vertex_s[k] <= s < vertex_s[k + 1]:
        return k
    after: Any = np.searchsorted(vertex_s, s, "right")
    return int(min(pieces - 1, max(0, after - 1)))


@compiled
def _on_pieces(vertices: Any, vertex_s: Any, s: Any) -> Any:
    """Points (n, 2) at arc length s (n,), within [0, length], on straight pieces."""
    out = np.empty((len(s), 2))
    for i in range(len(s)):
        k = _piece(vertex_s, s[i])
        share = (s[i] - vertex_s[k]) / (vertex_s[k + 1] - vertex_s[k])
        for axis in range(2):
            out[i, axis] = vertices[k, axis] + share * (vertices[k + 1, axis] - vertices[k, axis])
    return out


@compiled
def _nearest(vertices: Any, vertex_s: Any, closed: bool, points: Any, s: Any, window: Any) -> Any:
    """Distance (n,) of points (n, 2) to the pieces that touch [s - window, s + window]."""
    pieces = len(vertex_s) - 1
    length = vertex_s[-1]
    out = np.empty(len(points))
    for b in range(len(points)):
        low, high = s[b] - window[b], s[b] + window[b]
        lap = math.floor(low / length) if closed else 0
        first = lap * pieces + _piece(vertex_s, low - lap * length)
        lap = math.floor(high / length) if closed else 0
        last = lap * pieces + _piece(vertex_s, high - lap * length)
        # Far off, the nearest of every so many vertices says where to look: the window is wide only there.
        stride = (last - first) // COARSE
        if stride > 1:
            best, near = np.inf, first
            for k in range(first, last + 1, stride):
                a = vertices[k % pieces]
                apart = (points[b, 0] - a[0]) ** 2 + (points[b, 1] - a[1]) ** 2
                if apart < best:
                    best, near = apart, k
            first, last = max(first, near - stride), min(last, near + stride)
        least = np.inf
        for k in range(first, last + 1):
            a, c = vertices[k % pieces], vertices[k % pieces + 1]
            x, y = c[0] - a[0], c[1] - a[1]
            u, v = points[b, 0] - a[0], points[b, 1] - a[1]
            along = min(1.0, max(0.0, (u * x + v * y) / (x * x + y * y)))
            least = min(least, (u - along * x) ** 2 + (v - along * y) ** 2)
        out[b] = math.sqrt(least)
    return out


def circle(size: float) -> Circle:
    """A circle of diameter size, m."""
    return Circle(size / 2)


def square(size: float) -> Polyline:
    """A square with sharp corners and sides of size, m, from the middle of its right side anticlockwise."""
    corners = [(1, 0), (1, 1), (-1, 1), (-1, -1), (1, -1), (1, 0)]
    return Polyline(0.5 * size * np.array(corners, float))


def lissajous(size: float) -> Polyline:
    """The figure of eight x = sin a, y = sin 2a, size (m) across both ways, in pieces of equal length."""
    angle = np.linspace(0.0, 2.0 * np.pi, 4 * PIECES + 1)
    fine = 0.5 * size * np.stack([np.sin(angle), np.sin(2.0 * angle)], axis=1)
    s = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(fine, axis=0).T))])
    even = CubicSpline(s, angle)(np.linspace(0.0, s[-1], PIECES + 1))
    even[[0, -1]] = 0.0  # the last point is the first, to the bit
    return Polyline(0.5 * size * np.stack([np.sin(even), np.sin(2.0 * even)], axis=1))


SHAPES: dict[str, Callable[[float], Curve]] = {"circle": circle, "square": square, "lissajous": lissajous}
