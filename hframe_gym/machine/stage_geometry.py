"""Plan views of stages: rails, bridge, pulleys and the belts' path, for pictures of a machine from above.

Points are (x, y) in m along the axes of the tool. Which axis the bridge moves along follows from the masses:
the bridge carries the carriage, so that the mass of its axis is larger. Sizes that a machine.json does not
declare (frame, bridge, pulleys) are chosen for a readable picture.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from .axis_unit import ARM, RADIANS, AxisUnit
from .machine import Machine
from .motion import pulley_names, rigid_motions

Point = tuple[float, float]
Box = tuple[float, float, float, float]  # x and y of one corner, then of the opposite one, m

PULLEY_RADIUS = 0.0194  # m, of the H-frame's pulleys
SMALL_RADIUS = 0.011  # m, as drawn for the pulleys of a CoreXY stage
HALF_BRIDGE = 0.045  # m, from the bridge's middle to the belts at its sides
CLEARANCE = 0.075  # m, from the workspace to the frame
DEFAULT_RANGE = (-0.25, 0.25)  # m, drawn for an axis without a range
HALF_PI = math.pi / 2

# The lumped belts of the 8th-order H-frame and the belt sections of the 20th-order one that each consists of.
LUMPED_SECTIONS = {"left": ("s1", "s5", "s7"), "right": ("s2", "s6", "s8"), "bottom": ("s3", "s4", "s9")}


class StageGeometry:
    """Plan view of a stage without belts: two rails, a bridge, a carriage. Those with belts derive from it.

    Args:
        workspace: Rows x and y, columns low and high, m, shape (2, 2).
        bridge_axis: Axis along which the bridge moves, 0 (x) or 1 (y). None: a single axis along x without a
            bridge.

    Attributes:
        left, right, low, high: Ends of the workspace, m: `left` and `right` along x, `low` and `high` along
            y.
        x0, x1, y0, y1: Smallest and largest x and y of the rails and of the corner pulleys, m.
        radius: Radius of the pulleys, m.
        motors: For each drive, index of its pulley in the result of `pulleys`, and the direction in which a
            positive angle turns it: 1 counterclockwise, -1 clockwise.
        belts: Name of the belt of the machine that each drawn section belongs to, by name of the section
            (`sections`). Sections that cannot be assigned to one belt have no entry.
    """

    radius = PULLEY_RADIUS
    clearance = CLEARANCE  # m, from the workspace to the frame, on the sides to which the bridge reaches
    # m, of the bridge's end plates: half width, and length beyond and inside the rails
    plate = (0.04, 0.02, 0.02)
    half_beam = 0.012  # m, half width of the bridge between them
    half_tool = (0.055, 0.028)  # m, half width and height of the carriage in pictures
    # Bridge axis for which `_swap` exchanges x and y: a bridge along y is drawn as one along x.
    _swapped_axis = 1

    def __init__(self, workspace: NDArray[np.float64], bridge_axis: int | None = 0) -> None:
        (self.left, self.right), (self.low, self.high) = np.asarray(workspace, float).tolist()
        self.bridge_axis = bridge_axis
        # m, from the workspace to the rails and pulleys, along x and y
        out = [self.clearance, self.clearance]
        if bridge_axis is not None:
            out[bridge_axis] = CLEARANCE + HALF_BRIDGE
        self.x0, self.x1 = self.left - out[0], self.right + out[0]
        self.y0, self.y1 = self.low - out[1], self.high + out[1]
        self.motors: tuple[tuple[int, float], ...] = ()
        self.belts: dict[str, str] = {}

    def _swap(self, point: Point) -> Point:
        """Convert between (x, y) and the coordinates in which a subclass draws a bridge along either axis."""
        return (point[1], point[0]) if self.bridge_axis == self._swapped_axis else point

    def rails(self) -> list[Box]:
        """Compute two opposite corners (x, y), m, of each rail: two rails, or one for a single axis."""
        if self.bridge_axis is None:
            return [(self.x0 - 0.03, -0.03, self.x1 + 0.03, 0.03)]
        if self.bridge_axis == 0:
            return [(self.x0 - 0.03, y - 0.03, self.x1 + 0.03, y + 0.03) for y in (self.y0, self.y1)]
        return [(x - 0.03, self.y0 - 0.03, x + 0.03, self.y1 + 0.03) for x in (self.x0, self.x1)]

    def bridge(self, x: float, y: float) -> list[Box]:
        """Compute two opposite corners (x, y), m, of each of the bridge's parts; none for a single axis.

        Args:
            x: Tool position along x, m.
            y: Tool position along y, m.
        """
        if self.bridge_axis is None:
            return []
        u, (first, last) = (x, (self.y0, self.y1)) if self.bridge_axis == 0 else (y, (self.x0, self.x1))
        half, outward, inward = self.plate
        ends = (first - outward, first + inward), (last - inward, last + outward)
        boxes = [(u - half, low, u + half, high) for low, high in ends]
        boxes.append((u - self.half_beam, first, u + self.half_beam, last))
        return boxes if self.bridge_axis == 0 else [(b, a, d, c) for a, b, c, d in boxes]

    def pulleys(self, x: float, y: float = 0.0) -> list[Point]:
        """Compute the centers (x, y), m, of the pulleys with the tool at `x`, `y`, m; none without belts."""
        del x, y
        return []

    def sections(self, x: float, y: float) -> dict[str, list[Point]]:
        """Compute the belt sections with the tool at `x`, `y`, m; none without belts.

        A section is a piece of belt between two pulleys, or between a pulley and the carriage.

        Returns:
            Vertices (x, y), m, by name of the section.
        """
        del x, y
        return {}


class DialGeometry(StageGeometry):
    """View of a rotary axis along its shaft: an arm of 0.1 m (`ARM`) with the tool at its end."""

    half_tool = (0.012, 0.012)

    def __init__(self) -> None:
        """Create the view; angles count counterclockwise from the right."""
        super().__init__(np.array([(-ARM, ARM), (-ARM, ARM)]), None)
        self.motors = ((0, 1.0),)

    @override
    def rails(self) -> list[Box]:
        """Return no rails: the list is empty."""
        return []

    @override
    def pulleys(self, x: float, y: float = 0.0) -> list[Point]:
        """Return the center of the shaft, (0, 0) m, which is drawn as a pulley."""
        del x, y
        return [(0.0, 0.0)]

    @override
    def sections(self, x: float, y: float) -> dict[str, list[Point]]:
        """Return the arm as the only section, "arm": vertices (x, y), m, from the shaft to the tool.

        Args:
            x: First coordinate of the tool in the drawing, m (a point, not an angle; see `drawn_point`).
            y: Second coordinate of the tool in the drawing, m.
        """
        return {"arm": [(0.0, 0.0), (x, y)]}


def drawn_point(unit: AxisUnit, position: Sequence[float]) -> Point:
    """Return the point (x, y), m, at which a drawing shows a tool position: (x, 0), or the end of an arm.

    Args:
        position: Tool position along one or two axes, m or rad.
    """
    if unit is not RADIANS:
        return position[0], position[1] if len(position) > 1 else 0.0
    if len(position) == 1:
        return ARM * math.cos(position[0]), ARM * math.sin(position[0])
    return ARM * position[0], ARM * position[1]


def position_of_point(unit: AxisUnit, point: Point, near: Sequence[float]) -> tuple[float, ...]:
    """Return the tool position, m or rad, at a point of a drawing, the inverse of `drawn_point`.

    Args:
        point: Point (x, y), m.
        near: Tool position along one or two axes, m or rad. Of the angles of a rotary axis that differ by
            turns, the one nearest to it is returned.
    """
    if unit is not RADIANS:
        return point[: len(near)]
    if len(near) == 1:
        angle = math.atan2(point[1], point[0])
        return (angle + 2.0 * math.pi * round((near[0] - angle) / (2.0 * math.pi)),)
    return point[0] / ARM, point[1] / ARM


class BeltGeometry(StageGeometry):
    """Plan view of an H-frame: where the pulleys are, and the path of the belt around them.

    The path follows the sections of the 20th-order model (eq. 25-34 of Sollmann et al. 2010). From the cart,
    the belt runs down the left side of the bridge, out to the left corner pulley, along the frame to the
    right one (a motor), back to the bridge, and up its right side. The upper half is the mirror image.

    Args:
        workspace: Rows x and y, columns low and high, m, shape (2, 2).
        machine: Machine whose belts are assigned to the drawn sections (attribute `belts`). None: none is
            assigned.
        bridge_axis: Axis along which the bridge moves, 0 (x) or 1 (y).
    """

    plate = (0.092, 0.012, 0.062)  # m; each carries two pulleys
    half_beam = 0.025

    def __init__(
        self, workspace: NDArray[np.float64], machine: Machine | None = None, bridge_axis: int = 0
    ) -> None:
        super().__init__(workspace, bridge_axis)
        # Below, u is along the motion of the bridge and v along the bridge.
        (self._u0, self._v0), (self._u1, self._v1) = (
            self._swap((self.x0, self.y0)),
            self._swap((self.x1, self.y1)),
        )
        # From above, with the belt as drawn, a positive angle turns both motors counterclockwise where u is
        # x.
        turn = 1.0 if bridge_axis == 0 else -1.0
        self.motors = ((1, turn), (3, turn))
        names = {b.name for b in machine.belts} if machine else set()
        for lumped, sections in LUMPED_SECTIONS.items():
            drawn = {section: section if section in names else lumped for section in sections}
            self.belts |= {section: name for section, name in drawn.items() if name in names}

    @override
    def pulleys(self, x: float, y: float = 0.0) -> list[Point]:
        """Return the centers (x, y), m, of phi3, phi1 (motor), phi4, phi2 (motor), phi7, phi5, phi8, phi6."""
        return [self._swap(point) for point in self._pulleys(self._swap((x, y))[0])]

    def _pulleys(self, bridge: float) -> list[Point]:
        """Return the pulleys for a position of the bridge, along its motion and along the bridge, m."""
        d, rise = HALF_BRIDGE + PULLEY_RADIUS, 2 * PULLEY_RADIUS
        corners = [(u, v) for v in (self._v0, self._v1) for u in (self._u0, self._u1)]
        return [
            *corners,
            *((bridge + s * d, v) for v in (self._v0 + rise, self._v1 - rise) for s in (-1.0, 1.0)),
        ]

    @override
    def sections(self, x: float, y: float) -> dict[str, list[Point]]:
        """Return the vertices (x, y), m, of the nine belt sections of an H-frame, by name.

        They are "s1" to "s9" as in the 20th-order model.
        """
        x, y = self._swap((x, y))
        phi3, phi1, phi4, phi2, phi7, phi5, phi8, phi6 = self._pulleys(x)  # centers
        # Each section is a straight line, which touches the pulleys at a distance r from their centers, and
        # the arc around the pulley at its end.
        half, side, r = HALF_PI, HALF_BRIDGE, PULLEY_RADIUS
        lines = {
            "s7": [(x - side, y), (x - side, phi7[1]), *_arc(phi7, 0.0, -half)],
            "s5": [(phi7[0], phi7[1] - r), (phi3[0], phi3[1] + r), *_arc(phi3, half, 3 * half)],
            "s1": [(phi3[0], phi3[1] - r), (phi1[0], phi1[1] - r), *_arc(phi1, -half, half)],
            "s3": [(phi1[0], phi1[1] + r), (phi5[0], phi5[1] - r), *_arc(phi5, -half, -2 * half)],
            "s9": [(x + side, phi5[1]), (x + side, phi6[1]), *_arc(phi6, 2 * half, half)],
            "s4": [(phi6[0], phi6[1] + r), (phi2[0], phi2[1] - r), *_arc(phi2, -half, half)],
            "s2": [(phi2[0], phi2[1] + r), (phi4[0], phi4[1] + r), *_arc(phi4, half, 3 * half)],
            "s6": [(phi4[0], phi4[1] - r), (phi8[0], phi8[1] + r), *_arc(phi8, half, 0.0)],
            "s8": [(x - side, phi8[1]), (x - side, y)],
        }
        return {name: [self._swap(point) for point in line] for name, line in lines.items()}


class CoreXYGeometry(StageGeometry):
    """Plan view of a CoreXY stage: two belts, each on a motor at the front and around the rear of the frame.

    Args:
        workspace: Rows x and y, columns low and high, m, shape (2, 2).
        machine: Machine with the kinematics of a CoreXY stage (a belt for each motor).
        bridge_axis: Axis along which the bridge moves, 0 (x) or 1 (y).
        travel: Belt travel at each drive per travel along x and y, 1 or -1, shape (2, 2).
    """

    radius = SMALL_RADIUS
    clearance = 0.11  # m; the carriage does not cover the pulleys on the bridge
    _swapped_axis = 0  # drawn with a bridge that moves along y, the motors in front

    def __init__(
        self, workspace: NDArray[np.float64], machine: Machine, bridge_axis: int, travel: NDArray[np.float64]
    ) -> None:
        super().__init__(workspace, bridge_axis)
        along, across = 1 - bridge_axis, bridge_axis  # of the carriage on the bridge, and of the bridge
        signs = np.sign(travel)
        # The belt of a motor at the left becomes longer in front of the bridge with both positions.
        self._first = 0 if signs[0, along] == signs[0, across] else 1  # drive whose motor is at the left
        mirrored = 1.0 if bridge_axis == 1 else -1.0  # exchanging x and y reverses rotations
        spins = [mirrored * float(row[along]) for row in signs]
        self.motors = tuple((0 if drive == self._first else 1, spins[drive]) for drive in (0, 1))
        axis = machine.tool_axes[across]
        for drive, label in ((self._first, "1"), (1 - self._first, "2")):
            rows = [b for b in machine.belts if machine.drives[drive].coordinate in b.extension]
            for b in rows:
                side = "front" if b.extension.get(axis, 0.0) > 0 else "rear"
                for section in ("front", "rear") if len(rows) == 1 else (side,):
                    self.belts[section + label] = b.name

    @override
    def pulleys(self, x: float, y: float = 0.0) -> list[Point]:
        """Return the centers (x, y), m, of the ten pulleys of a CoreXY stage, seen with the motors in front.

        Their order is: left and right motor; left and right idler at the rear of the first belt (on the left
        motor), then of the second belt; on the bridge: left and right in front, left and right behind.
        """
        return [self._swap(point) for point in self._pulleys(self._swap((x, y))[1])]

    @override
    def sections(self, x: float, y: float) -> dict[str, list[Point]]:
        """Return the vertices (x, y), m, of the four belt sections, from a motor to the carriage, by name.

        "front1" directly and "rear1" around the rear of the frame, both from the left motor; "front2" and
        "rear2" likewise from the right motor.
        """
        carriage, bridge = self._swap((x, y))  # positions along the bridge, and along its motion
        motor1, motor2, left1, right1, left2, right2, front_l, front_r, rear_l, rear_r = self._pulleys(bridge)
        r, pi = self.radius, math.pi
        front = (carriage, bridge - r)
        rear = (carriage, bridge + r)  # where the belts are fixed to the carriage
        lines = {
            "front1": [*_arc(motor1, 1.5 * pi, 2 * pi, r), *_arc(front_l, pi, HALF_PI, r), front],
            "rear1": [
                *_arc(motor1, 1.5 * pi, pi, r),
                *_arc(left1, pi, HALF_PI, r),
                *_arc(right1, HALF_PI, 0.0, r),
                *_arc(rear_r, 0.0, -HALF_PI, r),
                rear,
            ],
            "front2": [*_arc(motor2, 1.5 * pi, pi, r), *_arc(front_r, 0.0, HALF_PI, r), front],
            "rear2": [
                *_arc(motor2, 1.5 * pi, 2 * pi, r),
                *_arc(right2, 0.0, HALF_PI, r),
                *_arc(left2, HALF_PI, pi, r),
                *_arc(rear_l, pi, 1.5 * pi, r),
                rear,
            ],
        }
        return {name: [self._swap(point) for point in line] for name, line in lines.items()}

    def _pulleys(self, bridge: float) -> list[Point]:
        """Return the pulleys for a position of the bridge, along it (left, right) and its motion, m."""
        (left, front), (right, rear) = self._swap((self.x0, self.y0)), self._swap((self.x1, self.y1))
        gap = 2 * self.radius
        inner = rear - 1.75 * gap  # the second belt runs inside the first one at the rear, where they cross
        fixed = [
            (left, front),
            (right, front),
            (left, rear),
            (right - gap, rear),
            (left + gap, inner),
            (right, inner),
        ]
        return fixed + [(end, bridge + side) for side in (-gap, gap) for end in (left + gap, right - gap)]


def _arc(center: Point, start: float, end: float, radius: float = PULLEY_RADIUS) -> list[Point]:
    """Return points on a pulley from one angle to another, rad."""
    angles = np.linspace(start, end, max(2, int(abs(end - start) / 0.2) + 1)).tolist()
    return [(center[0] + radius * math.cos(a), center[1] + radius * math.sin(a)) for a in angles]


def stage_geometry(machine: Machine) -> StageGeometry:
    """Choose how to draw a machine from above, by its kinematics; names of belts do not matter.

    Returns:
        `BeltGeometry` for an H-frame (one belt around both motors), `CoreXYGeometry` for a CoreXY stage (a
        belt for each motor), a `DialGeometry` for a rotary axis, else a `StageGeometry` without belts. An
        axis without a range is drawn from -0.25 m to 0.25 m.

    Raises:
        ValueError: If the machine has no tool axes.
    """
    axes = [machine.coordinate(name) for name in machine.tool_axes]
    if not axes:
        raise ValueError(f"machine {machine.name!r} has no tool axes")
    if machine.axis_unit is RADIANS:
        ranges = np.array([limits for limits in machine.axis_ranges if limits])
        return DialGeometry() if len(axes) == 1 else StageGeometry(ARM * ranges)
    if len(axes) == 1:
        return StageGeometry(np.array([axes[0].range or DEFAULT_RANGE, (-0.05, 0.05)]), None)
    workspace = np.array([axis.range or DEFAULT_RANGE for axis in axes])
    bridge_axis = 0 if axes[0].mass >= axes[1].mass else 1
    travel = _belt_travel(machine)
    if travel is None:
        return StageGeometry(workspace, bridge_axis)
    if _connected(machine, [d.coordinate for d in machine.drives]):
        return BeltGeometry(workspace, machine, bridge_axis)
    if travel[0].prod() * travel[1].prod() < 0:
        return CoreXYGeometry(workspace, machine, bridge_axis, travel)
    return StageGeometry(workspace, bridge_axis)


def _belt_travel(machine: Machine) -> NDArray[np.float64] | None:
    """Return belt travel at both drives per travel along x and y, (2, 2), or None if it is not 1 or -1."""
    motions = rigid_motions(machine)
    drives, axes = [machine.coordinate(d.coordinate) for d in machine.drives], machine.tool_axes
    if len(drives) != 2 or not set(axes) <= set(motions) or any(d.kind == "linear" for d in drives):
        return None
    columns = [machine.coordinate_names.index(d.name) for d in drives]
    travel = np.array(
        [[motions[axis][c] * d.radius for axis in axes] for c, d in zip(columns, drives, strict=True)]
    )
    return travel if np.allclose(np.abs(travel), 1.0, atol=0.05) else None


def _connected(machine: Machine, coordinates: Sequence[str]) -> bool:
    """Return whether belts connect two pulleys, if need be by way of others."""
    groups = [set(b.extension).intersection(pulley_names(machine)) for b in machine.belts]
    reached = {coordinates[0]}
    for _ in groups:
        reached |= {name for group in groups if group & reached for name in group}
    return coordinates[1] in reached
