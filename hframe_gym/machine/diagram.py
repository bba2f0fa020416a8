"""Draw a machine with matplotlib (extra `report`): its plan view, and a table of its coefficients."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from ..errors import naming_extra
from .axis_unit import ARM, DEFAULT_TURNS, RADIANS
from .components import Row
from .machine import Machine
from .stage_geometry import DEFAULT_RANGE, Box, Point, StageGeometry, drawn_point, stage_geometry

_RAIL, _BODY, _CART, _INK = "#d6d9de", "#b0b7c1", "#5c6778", "#2c323c"
_COLORS = ("#d1495b", "#2b6cc4", "#2a7f62", "#ee8c14", "#7b4fa3", "#4f8a8b", "#a0522d", "#c2185b", "#6b8e23")
_POSITIVE, _NEGATIVE = "#f3c9cf", "#c9daf1"
_CELL_WIDTH, _CELL_HEIGHT, _VIEW_WIDTH = 0.62, 0.26, 5.2  # inch
_MIN_ROWS = 10  # of the table, so that few rows are not drawn higher


def draw_machine(machine: Machine) -> Any:
    """Draw a machine as a figure of matplotlib: a plan view, and a table of its coefficients.

    The plan view is drawn if the tool has one or two axes. The table has a column for each coordinate and a
    row for each belt (extension per travel of the coordinate, m/m), drive (force or torque per volt, N/V or
    Nm/V) and sensor (coefficient of the coordinate in the reading).

    Raises:
        ImportError: If matplotlib is missing; the message says how to install it.
    """
    with naming_extra("report", "the drawing needs matplotlib"):
        from matplotlib.figure import Figure
    rows = len(machine.belts) + len(machine.drives) + len(machine.sensors)
    table_width = 1.6 + _CELL_WIDTH * len(machine.coordinates)
    height = max(4.8, 1.4 + _CELL_HEIGHT * rows)
    figure = Figure(figsize=(_VIEW_WIDTH + table_width, height), layout="constrained")
    view, table = figure.subplots(1, 2, width_ratios=(_VIEW_WIDTH, table_width))
    linear = [c for c in machine.coordinates if c.kind == "linear"]
    if machine.axis_unit is RADIANS:
        _draw_dials(view, machine)
    elif len(machine.tool_axes) == 2:
        _draw_stage(view, machine, stage_geometry(machine))
    elif len(linear) == 1:
        _draw_axis(view, machine, linear[0].name)
    else:
        view.axis("off")
    _draw_factors(table, machine)
    figure.suptitle(": ".join(filter(None, (machine.name, machine.description))), fontsize=10)
    return figure


def _draw_stage(view: Any, machine: Machine, geometry: StageGeometry) -> None:
    """Draw the plan view of a stage, with its tool off the center so that the sections differ in length."""
    x = 0.65 * geometry.right + 0.35 * geometry.left
    y = 0.6 * geometry.high + 0.4 * geometry.low
    for boxes, color in ((geometry.rails(), _RAIL), (geometry.bridge(x, y), _BODY)):
        for box in boxes:
            _fill_box(view, box, color)
    colors = {b.name: _COLORS[i % len(_COLORS)] for i, b in enumerate(machine.belts)}
    labelled: set[str] = set()
    for name, points in geometry.sections(x, y).items():
        belt = geometry.belts.get(name)
        label = belt if belt not in labelled else None
        labelled |= {belt} if belt else set()
        line = np.array(points)
        view.plot(line[:, 0], line[:, 1], color=colors.get(belt or "", "gray"), lw=1.8, label=label, zorder=3)
    _fill_box(view, (x - 0.04, y - 0.025, x + 0.04, y + 0.025), _CART, layer=3.5)
    pulleys = geometry.pulleys(x, y)
    for center in pulleys:
        _circle(view, center, geometry.radius * 0.85, "white")
    for drive, (pulley, spin) in zip(machine.drives, geometry.motors, strict=False):
        _circle(view, pulleys[pulley], geometry.radius * 0.85, _INK)
        arrow = "\N{ANTICLOCKWISE OPEN CIRCLE ARROW}" if spin > 0 else "\N{CLOCKWISE OPEN CIRCLE ARROW}"
        offset = 14 if pulleys[pulley][1] > (geometry.y0 + geometry.y1) / 2 else -20
        view.annotate(
            f"{drive.name}: {drive.coordinate} {arrow}",
            pulleys[pulley],
            (0, offset),
            textcoords="offset points",
            ha="center",
            fontsize=8,
        )
    box = (geometry.left, geometry.low, geometry.right, geometry.high)
    _fill_box(view, box, "none", edge="gray", style=":")
    view.text(geometry.left, geometry.high, " workspace", fontsize=7, color="gray", va="top")
    _draw_axes(
        view, machine.tool_axes, (geometry.left, geometry.low), 0.25 * (geometry.right - geometry.left)
    )
    view.set_aspect("equal")
    view.margins(0.12)
    view.set(xlabel=f"{machine.tool_axes[0]}, m", ylabel=f"{machine.tool_axes[1]}, m")
    if labelled:
        view.legend(fontsize=8, loc="upper center", bbox_to_anchor=(0.5, -0.13), ncols=5, frameon=False)
    elif machine.belts:
        view.set_title("belts are not drawn: neither H-frame nor CoreXY", fontsize=8)


def _draw_axis(view: Any, machine: Machine, name: str) -> None:
    """Draw a single axis: a rail with its range, a carriage and its motor."""
    low, high = machine.coordinate(name).range or DEFAULT_RANGE
    span = high - low
    _fill_box(view, (low - 0.08 * span, -0.02 * span, high + 0.08 * span, 0.02 * span), _RAIL)
    middle = (low + high) / 2
    _fill_box(view, (middle - 0.08 * span, -0.05 * span, middle + 0.08 * span, 0.05 * span), _CART)
    arrow = {"arrowprops": {"arrowstyle": "->", "lw": 1.5}, "va": "center"}
    view.annotate("", (middle + 0.3 * span, 0.1 * span), (middle, 0.1 * span), **arrow)
    view.text(middle + 0.31 * span, 0.1 * span, f"{name}, positive voltage", va="center", fontsize=8)
    drives = ", ".join(f"{d.name} ({d.gear_ratio:.4g} rad/m)" for d in machine.drives if d.coordinate == name)
    view.text(middle, -0.1 * span, drives, ha="center", va="top", fontsize=8)
    limited = machine.coordinate(name).range is not None
    view.set(xlabel=f"{name}, m" + ("" if limited else " (no range is declared)"), yticks=[])
    view.set_aspect("equal")
    view.set(xlim=(low - 0.12 * span, high + 0.12 * span), ylim=(-0.3 * span, 0.3 * span))


def _draw_dials(view: Any, machine: Machine) -> None:
    """Draw the rotary axes along their shafts, one beside the other: positive direction, range and drives."""
    from matplotlib.patches import Arc

    for k, (name, limits) in enumerate(zip(machine.tool_axes, machine.axis_ranges, strict=True)):
        center = (3.0 * ARM * k, 0.0)
        _circle(view, center, 0.15 * ARM, _CART)
        tip = drawn_point(RADIANS, (0.5,))
        view.plot([center[0], center[0] + tip[0]], [0.0, tip[1]], color=_CART, lw=4, solid_capstyle="round")
        view.add_patch(Arc(center, 2.4 * ARM, 2.4 * ARM, theta1=30.0, theta2=120.0, color=_INK, lw=1.2))
        end = (center[0] + 1.2 * ARM * math.cos(2.09), 1.2 * ARM * math.sin(2.09))
        arrow = {"arrowstyle": "->", "color": _INK, "lw": 1.2}
        view.annotate("", (end[0] - 0.1 * ARM, end[1] - 0.07 * ARM), end, arrowprops=arrow)
        view.text(center[0], 1.35 * ARM, f"{name}, positive voltage", ha="center", fontsize=8)
        drives = [f"{d.name} (gear {d.gear_ratio:.4g})" for d in machine.drives if d.coordinate == name]
        low, high = limits or DEFAULT_TURNS
        declared = "" if machine.coordinate(name).range is not None else ", no range is declared"
        text = f"{', '.join(drives)}\n{low:.3g} to {high:.3g} rad{declared}"
        view.text(center[0], -0.5 * ARM, text, ha="center", va="top", fontsize=8)
        view.update_datalim([(center[0] - 1.4 * ARM, -1.1 * ARM), (center[0] + 1.4 * ARM, 1.5 * ARM)])
    view.autoscale_view()
    view.set_aspect("equal")
    view.axis("off")


def _draw_factors(axes: Any, machine: Machine) -> None:
    """Draw a table of the factors between components (rows) and coordinates (columns)."""
    columns = machine.coordinate_names
    rows: list[tuple[str, Row]] = [(f"stretch of {b.name}", b.extension) for b in machine.belts]
    for drive in machine.drives:
        unit = "N/V" if machine.coordinate(drive.coordinate).kind == "linear" else "Nm/V"
        rows.append((f"{drive.name}, {unit}", {drive.coordinate: drive.gain}))
    rows += [(s.channel, s.row) for s in machine.sensors]
    axes.axis("off")
    axes.set(xlim=(-2.4, len(columns)), ylim=(max(len(rows), _MIN_ROWS) + 0.2, -1.6))
    for j, column in enumerate(columns):
        unit = machine.coordinate(column).unit("position")
        axes.text(j + 0.5, -0.65, f"{column}\n{unit}", ha="center", va="center", fontsize=8, weight="bold")
    for i, (label, row) in enumerate(rows):
        axes.text(-0.1, i + 0.5, label, ha="right", va="center", fontsize=8)
        for j, column in enumerate(columns):
            factor = row.get(column, 0.0)
            color = _POSITIVE if factor > 0 else _NEGATIVE if factor < 0 else "white"
            _fill_box(axes, (j, i, j + 1, i + 1), color, edge="#d0d0d0", style="-")
            if factor:
                axes.text(j + 0.5, i + 0.5, f"{factor:+.3g}", ha="center", va="center", fontsize=8)


def _draw_axes(view: Any, names: Sequence[str], origin: Point, length: float) -> None:
    """Draw arrows along both axes of the tool from a point, of a length in m."""
    for name, (dx, dy) in zip(names, ((1.0, 0.0), (0.0, 1.0)), strict=True):
        end = (origin[0] + dx * length, origin[1] + dy * length)
        view.annotate("", end, origin, arrowprops={"arrowstyle": "->", "color": _INK, "lw": 1.2})
        view.text(end[0] + 0.01 * dx, end[1] + 0.01 * dy, f" {name}", fontsize=9, color=_INK, va="center")


def _fill_box(
    view: Any, box: Box, color: str, edge: str = "none", style: str = "-", layer: float = 1.0
) -> None:
    """Draw a filled box between two corners; a higher layer is in front."""
    from matplotlib.patches import Rectangle

    x0, y0, x1, y1 = box
    view.add_patch(Rectangle((x0, y0), x1 - x0, y1 - y0, fc=color, ec=edge, ls=style, zorder=layer))
    view.update_datalim([(x0, y0), (x1, y1)])


def _circle(view: Any, center: Point, radius: float, color: str) -> None:
    """Draw a pulley."""
    from matplotlib.patches import Circle

    view.add_patch(Circle(center, radius, facecolor=color, edgecolor=_INK, zorder=4))
    view.plot(*center, "o", color=_INK, ms=1.5, zorder=5)
