"""Plan view of a machine as shapes whose points move with the tool, and recorded motions to show in it."""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ..machine import RADIANS, DialGeometry, Machine, Point, StageGeometry, drawn_point, stage_geometry

FRAMES_PER_S = 100.0  # of a motion; a display has 60
_HALF_TOOL = 0.035  # m, half of the side of the square that is the tool

Part = tuple[str, str, list[Point]]  # kind and role of a shape, and its points, m


def drawing_of(machine: Machine) -> dict[str, Any] | None:
    """Describe the plan view of a machine.

    Every point of the view is an affine function of the point at which the tool is drawn. A point is the list
    (a, b, c, d, e, f) of x = a + b X + c Y, y = d + e X + f Y for the tool at (X, Y), all in m.

    Returns:
        `view` and `workspace`: smallest and largest x and y, m. `shapes`: dicts of `kind` ("box", "line" or
        "circle"), `role` (such as "belt") and `points`. `axes`: names of the tool's axes. `rest`: point at
        which the tool is drawn without a motion, m. None if the machine has no tool.
    """
    if not machine.tool_axes:
        return None
    geometry = stage_geometry(machine)
    single = len(machine.tool_axes) == 1 and machine.axis_unit is not RADIANS
    motors = {index for index, _ in geometry.motors}

    def parts(x: float, y: float) -> list[Part]:
        """Return everything that is drawn for a position of the tool, m."""
        y = 0.0 if single else y
        boxes = [("box", "rail", _corners(box)) for box in geometry.rails()]
        boxes += [("box", "bridge", _corners(box)) for box in geometry.bridge(x, y)]
        belts = [("line", "belt", line) for line in geometry.sections(x, y).values()]
        centers = enumerate(geometry.pulleys(x, y))
        pulleys = [("circle", "motor" if k in motors else "pulley", [center]) for k, center in centers]
        half = min(_HALF_TOOL, geometry.half_tool[0])
        tool = _corners((x - half, y - half, x + half, y + half))
        return [*boxes, *belts, *pulleys, ("box", "tool", tool)]

    shapes = [_shape(*part) for part in zip(parts(0.0, 0.0), parts(1.0, 0.0), parts(0.0, 1.0), strict=True)]
    workspace = [float(v) for v in (geometry.left, geometry.low, geometry.right, geometry.high)]
    return {
        "view": _limits(geometry, shapes),
        "workspace": workspace,
        "shapes": shapes,
        "axes": machine.tool_axes,
        "rest": _point_at_rest(machine, geometry),
    }


def _point_at_rest(machine: Machine, geometry: StageGeometry) -> Point:
    """Return where the tool is drawn without a motion: off the center, so that sections of belts differ."""
    if isinstance(geometry, DialGeometry):
        return drawn_point(machine.axis_unit, (0.5,))
    x = geometry.left + 0.62 * (geometry.right - geometry.left)
    return x, geometry.low + 0.42 * (geometry.high - geometry.low)


def _corners(box: tuple[float, float, float, float]) -> list[tuple[float, float]]:
    """Return the corners of a rectangle."""
    x0, y0, x1, y1 = box
    return [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]


def _shape(at_origin: Part, along_x: Part, along_y: Part) -> dict[str, Any]:
    """Return a shape with the affine functions that its points are, from three positions of the tool."""
    kind, role, origin = at_origin
    affine = [
        [round(v, 6) for v in (o[0], x[0] - o[0], y[0] - o[0], o[1], x[1] - o[1], y[1] - o[1])]
        for o, x, y in zip(origin, along_x[2], along_y[2], strict=True)
    ]
    return {"kind": kind, "role": role, "points": affine}


def _limits(geometry: StageGeometry, shapes: list[dict[str, Any]]) -> list[float]:
    """Return the smallest and largest x and y of everything that is drawn, m, with the tool in any corner."""
    corners = [(x, y) for x in (geometry.left, geometry.right) for y in (geometry.low, geometry.high)]
    xs, ys = [], []
    for shape in shapes:
        for a, b, c, d, e, f in shape["points"]:
            xs += [a + b * x + c * y for x, y in corners]
            ys += [d + e * x + f * y for x, y in corners]
    margin = 0.03
    return [min(xs) - margin, min(ys) - margin, max(xs) + margin, max(ys) + margin]


def read_motions(path: Path, machine: Machine) -> list[dict[str, Any]]:
    """Read a controller's motions of `hframe evaluate --motions`, in as many frames as a display shows.

    Returns:
        For each episode: `frame_s`, period of the frames, s; by frame, the points (x, y), m, at which `tool`
        and `goal` are drawn, their `distance`, in the `unit` "mm" or "mrad", and the voltages, V (`volts`).
    """
    axes, inputs, unit = machine.tool_axes, machine.input_channels, machine.axis_unit
    episodes: dict[str, list[dict[str, str]]] = {}
    with open(path, newline="", encoding="utf-8") as file:
        for row in csv.DictReader(file):
            episodes.setdefault(row["episode"], []).append(row)
    motions = []
    for rows in episodes.values():
        step = float(rows[1]["time_s"]) - float(rows[0]["time_s"])
        every = max(1, round(1.0 / (FRAMES_PER_S * step)))
        frames = [*rows[::every]]

        tool = _columns(frames, [f"{axis}_{unit.name}" for axis in axes])
        goal = _columns(frames, [f"{axis}_goal_{unit.name}" for axis in axes])
        motions.append(
            {
                "frame_s": step * every,
                "tool": [drawn_point(unit, point) for point in tool],
                "goal": [drawn_point(unit, point) for point in goal],
                "distance": [1e3 * math.dist(*points) for points in zip(tool, goal, strict=True)],
                "unit": unit.small,
                "volts": _columns(frames, inputs),
            }
        )
    return motions


def _columns(rows: Sequence[Mapping[str, str]], names: Sequence[str]) -> list[list[float]]:
    """Return some columns of the rows of a table."""
    return [[float(row[name]) for name in names] for row in rows]
