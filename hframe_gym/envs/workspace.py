"""The position of a machine's tool, its workspace, and the end stops at the edges of the workspace.

End stops are rubber buffers at both ends of every axis of the tool, an effect of the simulated machine.

References:
    Hunt and Crossley, "Coefficient of restitution interpreted as damping in vibroimpact" (1975).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..dynamics import LANES
from ..dynamics.elementwise import copysign, maximum
from ..errors import InputError
from ..machine import Effect, EffectParameter, Machine
from .random_numbers import compiled

Array = NDArray[np.float64]
# Rubber buffers at the ends of x and y.
BUFFER_STIFFNESS = 2e5  # N/m: both motors at full voltage compress it by 1.2 mm; the cart oscillates on it below 2 kHz
BUFFER_DAMPING = 1.5  # s/m: an impact at 0.5 m/s rebounds with less than half its speed


def workspace_of(machine: Machine) -> Array:
    """Return the workspace of the tool: the declared ranges of its axes.

    Args:
        machine: Machine whose `tool_axes` names one or two linear coordinates.

    Returns:
        One row per axis, columns low and high, m, shape (axes, 2).

    Raises:
        InputError: If the machine has no tool axes, an axis has no range, or there are not as many drives as axes.
    """
    axes = machine.tool_axes
    if not axes:
        linear = [c.name for c in machine.coordinates if c.kind == "linear"]
        raise InputError(
            f"machine {machine.name!r} has the linear coordinates {', '.join(linear) or 'none'}; the environment moves "
            "a tool along one or two of them. Declare one or two, or name two of several x and y"
        )
    for name in axes:
        if machine.coordinate(name).range is None:
            raise InputError(
                f"machine {machine.name!r}: coordinate {name!r} has no range; the environment needs one as its "
                f'workspace. Add "range": [low, high] in m to this coordinate in the machine.json'
            )
    if len(machine.drives) != len(axes):
        raise InputError(
            f"machine {machine.name!r} has {len(machine.drives)} drives; to move its tool along {' and '.join(axes)} "
            f"the environment needs {len(axes)}"
        )
    return np.array([machine.coordinate(name).range for name in axes], dtype=np.float64)


def outside_workspace(positions: NDArray[np.floating[Any]], workspace: NDArray[Any]) -> NDArray[np.bool_]:
    """Test which positions lie outside the workspace; its edge counts as inside.

    Args:
        positions: Tool positions, m, shape (n, axes).
        workspace: One row per axis of the tool, columns low and high, m, shape (axes, 2).

    Returns:
        True for each position outside, shape (n,).
    """
    beyond = (positions < workspace[:, 0]) | (positions > workspace[:, 1])
    return np.asarray(beyond.any(axis=1))


def _buffer_force(q, v, t, low, high, stiffness, damping):  # type: ignore[no-untyped-def]
    """Return f = -k d max(0, 1 + c v sign d), N, with the depth d beyond [low, high], m."""
    depth = maximum(q - high, 0.0) - maximum(low - q, 0.0)
    return -stiffness * depth * maximum(1.0 + damping * copysign(1.0, depth) * v, 0.0)


def _compresses_buffer(q, low, high):  # type: ignore[no-untyped-def]
    """Return whether the coordinate is beyond [low, high]."""
    return (q < low) | (q > high)


END_STOP = Effect(
    name="end_stop",
    family="force",
    site="coordinate",
    formula="f = -k d max(0, 1 + c v sign d), d the depth beyond [low, high]",
    source="Hunt and Crossley 1975",
    force=_buffer_force,
    active_region=_compresses_buffer,
    parameters=(
        EffectParameter("low", "position", -1e3, 1e3, scale=1e-3, grid=(0.0,)),
        EffectParameter("high", "position", -1e3, 1e3, scale=1e-3, grid=(0.0,)),
        EffectParameter("stiffness", "stiffness", 0.0, 1e9, scale=1e4, grid=(BUFFER_STIFFNESS,)),
        EffectParameter("damping", "s/m", 0.0, 1e3, scale=0.1, grid=(BUFFER_DAMPING,)),
    ),
)


def with_end_stops(machine: Machine) -> Machine:
    """Return a copy of a machine with rubber buffers at both ends of every tool axis.

    A buffer touches the tool at the end of the axis' declared range. Beyond it by d, m, at the speed v, m/s (positive
    outward), the tool is pushed back with k d (1 + c v), N, never pulled; stiffness k = 2e5 N/m, damping c = 1.5 s/m.
    The force is larger in compression than in release, so that an impact loses energy (Hunt and Crossley 1975 with
    exponent 1).

    Args:
        machine: Machine with a range for each tool axis.

    Returns:
        Copy with one more effect `end_stop` per axis, whose parameters follow the parameters of the machine.

    Raises:
        InputError: If the machine has no tool axes, a tool axis without range, or not one drive per tool axis.
    """
    stops = [
        END_STOP.at(name, low=low, high=high, stiffness=BUFFER_STIFFNESS, damping=BUFFER_DAMPING)
        for name, (low, high) in zip(machine.tool_axes, workspace_of(machine).tolist(), strict=True)
    ]
    return machine.with_effects(*stops)


def tool_product(machine: Machine, name: str) -> tuple[int, int]:
    """Find the two coordinates whose product is a part of the tool position along an axis, if there is one.

    The tool position along x is usually the coordinate x. If the bridge can yaw, it is x + yaw * y; the result for "x"
    is then the indices of yaw and y.

    Args:
        machine: Machine with its coordinates and sensors.
        name: Axis of the tool position, "x" or "y".

    Returns:
        first: Index of one coordinate in `machine.coordinate_names`; -1 if the position has no product.
        second: Index of the other coordinate; -1 if the position has no product.
    """
    for sensor in machine.sensors:
        for key, factor in sensor.row.items():
            if "*" in key and factor == sensor.row.get(name):
                first, second = map(machine.coordinate_names.index, key.split("*"))
                return first, second
    return -1, -1


def tool_terms(machine: Machine) -> NDArray[np.intp]:
    """Find the coordinates from which the tool position along each axis is computed.

    Args:
        machine: Machine with one or two tool axes.

    Returns:
        For each axis the index of its coordinate, and of two coordinates whose product is added to it (-1: none), shape
        (axes, 3).
    """
    return np.array(
        [(machine.coordinate_names.index(name), *tool_product(machine, name)) for name in machine.tool_axes]
    )


@compiled
def write_tool_positions(state: Any, units: Any, terms: Any, first: int, positions: Any) -> None:
    """Write the true tool positions of k simulated machines to an array.

    Args:
        state: Belt travel of all coordinates, m, and further rows, shape (blocks, rows, LANES): machine b is lane b %
            LANES (8 or 16) of block b // LANES.
        units: Factor from belt travel to the coordinate's unit, shape (blocks, coordinates, LANES).
        terms: Indices of coordinates, as `tool_terms` returns them, shape (axes, 3).
        first: Index of the block whose first machine is the first of the k machines.
        positions: Output, tool positions, m, shape (k, axes).
    """
    for axis in range(terms.shape[0]):
        row, a, b = terms[axis]
        for i in range(positions.shape[0]):  # the axes are linear: their travel is the position
            positions[i, axis] = state[first + i // LANES, row, i % LANES]
        if a >= 0:
            for i in range(positions.shape[0]):
                block, lane = first + i // LANES, i % LANES
                factor = state[block, a, lane] * units[block, a, lane]
                positions[i, axis] += factor * (state[block, b, lane] * units[block, b, lane])
