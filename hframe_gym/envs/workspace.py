"""The position of a machine's tool, its workspace, and the end stops at the edges of the workspace.

End stops are rubber buffers at both ends of every axis of the tool, an effect of the simulated machine.

References:
    Hunt and Crossley, "Coefficient of restitution interpreted as damping in vibroimpact" (1975).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..arrays import Array, Workspace
from ..dynamics import LANES
from ..dynamics.codegen.compiled import compiled
from ..dynamics.elementwise import absolute, copysign, maximum
from ..effects.smooth_table import TABLE_FAMILY, tabulated_range
from ..errors import InputError
from ..machine import Effect, EffectParameter, Machine

# Rubber buffers at the ends of x and y.
# N/m: both motors at full voltage compress it by 1.2 mm; the cart oscillates on it below 2 kHz.
BUFFER_STIFFNESS = 2e5
BUFFER_DAMPING = 1.5  # s/m: an impact at 0.5 m/s rebounds with less than half its speed
# The integrator keeps a force constant over a step h, so that a buffer could throw a light carriage of mass m
# back faster than it came. These limits of stiffness * h^2 / m and of the slope of the force by the speed * h
# / m, dimensionless, prevent it; the integrator diverges at 12 and 2. The built-in machines do not reach them
# with the default step.
STIFFNESS_LIMIT, DAMPING_LIMIT = 0.5, 1.5
# The second limit applies to m minus this fraction of h^2 times the stiffness of the belts, but at least to a
# tenth of m. Carriages of which the belts take more oscillate too fast for the step, also without buffers.
BELT_FRACTION, SMALLEST_FRACTION = 0.25, 0.1
# Part of the workspace at either end that recordings may have left out without a warning.
UNMEASURED_FRACTION = 0.1
LARGEST_DEPTH = 1e3  # m, more than any machine's workspace


def effect_and_belt_limits(machine: Machine, smallest_fraction: float) -> dict[str, tuple[float, float]]:
    """Compute the limits (smallest, largest), SI, of the parameters of effects and the lengths of belts.

    Effects declare the bounds of their parameters. The unstretched length of a belt depends on the position;
    its value at position 0 is the parameter `rest_length`. The lower limit of this parameter is so large that
    the unstretched length is at least `smallest_fraction` (dimensionless) times the machine's present
    `rest_length` everywhere in the workspace.

    Returns:
        Limits by the parameter's full name, such as "belt1.rest_length"; belts without an upper limit have
        infinity. Belts whose lengths are tied have one entry, that of the free parameter.
    """
    bounds = {
        f"{e.label}.{p.name}": (p.lower, p.upper) for e in machine.effects for p in e.definition.parameters
    }
    for belt in machine.belts:
        # The unstretched length is rest_length plus the sum of factor * belt travel, smallest at the end of a
        # range.
        coordinates = [(machine.coordinate(name), factor) for name, factor in belt.length.items()]
        changes = [[f * c.travel_per_unit * end for end in c.range or (0.0, 0.0)] for c, f in coordinates]
        smallest = smallest_fraction * belt.rest_length - sum(map(min, changes))
        # A tied rest_length is a factor times that of another belt, which must then be large enough for both.
        name = f"{belt.name}.rest_length"
        free_name, factor = machine.untied(name)
        other_limit, _ = bounds.get(free_name, (0.0, math.inf))
        bounds[free_name] = (max(smallest / factor, other_limit), math.inf)
    return bounds


def workspace_of(machine: Machine) -> Workspace:
    """Return the workspace of the tool: the ranges of its axes (`Machine.axis_ranges`).

    Raises:
        InputError: If the machine has no tool axes, a linear axis has no range, or there are not as many
            drives as axes.
    """
    axes = machine.tool_axes
    if not axes:
        linear = [c.name for c in machine.coordinates if c.kind == "linear"]
        if linear:
            raise InputError(
                f"machine {machine.name!r} has the linear coordinates {', '.join(linear)}; "
                "the environment moves a tool along one or two of them. Name two of several x and y"
            )
        rotary = [c.name for c in machine.coordinates if c.name not in machine.spring_loaded]
        raise InputError(
            f"machine {machine.name!r} has the rotary coordinates {', '.join(rotary)} "
            f"and {len(machine.drives)} drives; the environment turns one or two axes with as many drives. "
            "Describe the axes one at a time"
        )
    for name, limits in zip(axes, machine.axis_ranges, strict=True):
        if limits is None:
            raise InputError(
                f"machine {machine.name!r}: coordinate {name!r} has no range; "
                "the environment needs one as its workspace. "
                'Add "range": [low, high] in m to this coordinate in the machine.json'
            )
    if len(machine.drives) != len(axes):
        raise InputError(
            f"machine {machine.name!r} has {len(machine.drives)} drives; "
            f"to move its tool along {' and '.join(axes)} the environment needs {len(axes)}"
        )
    return np.array(machine.axis_ranges, dtype=np.float64)


def unmeasured_workspace(machine: Machine) -> str | None:
    """Return a warning if the workspace extends beyond the positions at which a table was identified.

    Beyond its ends, a table is constant, whatever the actual force is. Up to `UNMEASURED_FRACTION` of the
    workspace may lie beyond an end without a warning; the result is then None.

    Raises:
        InputError: As `workspace_of`.
    """
    workspace = dict(zip(machine.tool_axes, workspace_of(machine).tolist(), strict=True))
    for effect in machine.effects:
        axis = effect.definition.against.removeprefix("position of ")
        if effect.definition.family != TABLE_FAMILY or axis not in workspace:
            continue
        (low, high), (first, last) = workspace[axis], tabulated_range(effect)
        if max(first - low, high - last) > UNMEASURED_FRACTION * (high - low):
            return (
                f"machine {machine.name!r}: {effect.label} was identified from {first:.3g} to {last:.3g} "
                f"{machine.axis_unit.name}, and the workspace reaches from {low:.3g} to {high:.3g}, "
                "where the force is unknown; "
                f'add "range": [{first:.3g}, {last:.3g}] to {axis!r} in the machine.json, or record more'
            )
    return None


def outside_workspace(positions: NDArray[np.floating[Any]], workspace: NDArray[Any]) -> NDArray[np.bool_]:
    """Test which `positions`, m or rad, shape (n, axes), lie outside the `workspace`; its edge is inside."""
    beyond = (positions < workspace[:, 0]) | (positions > workspace[:, 1])
    return np.asarray(beyond.any(axis=1))


def _buffer_force(q, v, t, low, high, stiffness, damping, damped):  # type: ignore[no-untyped-def]
    """Return f = -k d max(0, 1 + c v sign d min(1, damped/|d|)), N, with depth d beyond [low, high], m."""
    depth = maximum(q - high, 0.0) - maximum(low - q, 0.0)
    slope = damping * (damped / maximum(absolute(depth), damped))
    return -stiffness * depth * maximum(1.0 + slope * copysign(1.0, depth) * v, 0.0)


def _compresses_buffer(q, low, high):  # type: ignore[no-untyped-def]
    """Return whether the coordinate is beyond [low, high]."""
    return (q < low) | (q > high)


END_STOP = Effect(
    name="end_stop",
    family="force",
    site="coordinate",
    formula="f = -k d max(0, 1 + c v sign d min(1, damped/|d|)), d the depth beyond [low, high]",
    source="Hunt and Crossley 1975",
    force=_buffer_force,
    active_region=_compresses_buffer,
    parameters=(
        EffectParameter("low", "position", -1e3, 1e3, scale=1e-3, grid=(0.0,)),
        EffectParameter("high", "position", -1e3, 1e3, scale=1e-3, grid=(0.0,)),
        EffectParameter("stiffness", "stiffness", 0.0, 1e9, scale=1e4, grid=(BUFFER_STIFFNESS,)),
        EffectParameter("damping", "s/position", 0.0, 1e3, scale=0.1, grid=(BUFFER_DAMPING,)),
        EffectParameter("damped", "position", 0.0, LARGEST_DEPTH, scale=1e-3, grid=(LARGEST_DEPTH,)),
    ),
)


class EndStops:
    """Rubber buffers at both ends of every tool axis, for machines of one structure and different masses.

    A buffer touches the tool at the end of the axis' declared range. Beyond it by d, m, at the speed v, m/s
    (positive outward), the tool is pushed back with k d (1 + c v), N, never pulled; stiffness k = 2e5 N/m,
    damping c = 1.5 s/m. The force is larger in compression than in release, so that an impact loses energy
    (Hunt and Crossley 1975 with exponent 1). Buffers of a carriage that is too light for the step are softer:
    k is smaller, and beyond a depth c decreases as 1/d. An arm on a rotary axis has such a buffer 0.1 m
    (`ARM`) from the axis.

    Args:
        step: Step of the integrator with which the machines are simulated, s.

    Attributes:
        machine: Copy of the machine with one more effect `end_stop` per axis, whose parameters follow the
            parameters of the machine.

    Raises:
        InputError: If the machine has no tool axes, a tool axis without range, or not one drive per tool
            axis.
    """

    def __init__(self, machine: Machine, step: float) -> None:
        ranges, parameters = workspace_of(machine).tolist(), list(machine.parameters)
        self._step, self._count = step, len(parameters)
        per_meter = machine.axis_unit.per_meter
        self._stiffness, self._damping = BUFFER_STIFFNESS / per_meter**2, BUFFER_DAMPING / per_meter
        columns, factors = [], []  # masses are factors times parameters
        for axis in machine.tool_axes:
            name, factor = machine.untied(f"{axis}.mass")
            columns.append(parameters.index(name))
            factors.append(factor)
        self._columns, self._factors = np.array(columns), np.array(factors)
        belts = np.array([belt.EA / belt.rest_length for belt in machine.belts])
        axes = [machine.coordinate_names.index(axis) for axis in machine.tool_axes]
        self._belts = (
            np.array(belts @ machine.belt_matrix[:, axes] ** 2) if machine.belts else np.zeros(len(axes))
        )
        self._stops = np.array([(low, high, 0.0, self._damping, 0.0) for low, high in ranges]).ravel()
        names = [parameter.name for parameter in END_STOP.parameters]
        nominal = self.parameters(np.array([list(machine.parameters.values())]))[0, self._count :]
        rows = nominal.reshape(len(axes), -1).tolist()
        stops = [
            END_STOP.at(axis, **dict(zip(names, row, strict=True)))
            for axis, row in zip(machine.tool_axes, rows, strict=True)
        ]
        self.machine = machine.with_effects(*stops)

    def parameters(self, values: Array) -> Array:
        """Append the parameters of the end stops to those of k machines, SI, shape (k, parameters).

        The buffers of a machine whose masses are too small for the step of the integrator are softer than the
        nominal ones, so that their oscillation stays resolved.

        Args:
            values: Parameters of the machines, SI, shape (k, N). The first columns are the parameters of the
                machine without end stops, in their order; further columns are ignored.
        """
        result = np.empty((len(values), self._count + len(self._stops)))
        result[:, : self._count] = values[:, : self._count]
        result[:, self._count :] = self._stops
        buffer = self._stiffness, self._damping
        _soften_buffers(result, self._count, self._columns, self._factors, self._belts, self._step, *buffer)
        return result


@compiled
def _soften_buffers(
    parameters: Any,
    first: int,
    columns: Any,
    factors: Any,
    belts: Any,
    step: float,
    largest: float,
    damping: float,
) -> None:
    """Set stiffness and damped depth of the end stops, with parameters from column first, for a step in s.

    parameters (k, n), changed here; columns of the masses in them and factors by which they are multiplied
    (axes,); belts (axes,): stiffness of the belts, N/m or Nm/rad; largest stiffness and damping of the
    buffers.
    """
    for b in range(parameters.shape[0]):
        for axis in range(columns.shape[0]):
            mass, stop = factors[axis] * parameters[b, columns[axis]], first + 5 * axis
            stiffness = min(largest, STIFFNESS_LIMIT / step**2 * mass)
            remaining = max(mass - BELT_FRACTION * step**2 * belts[axis], SMALLEST_FRACTION * mass)
            parameters[b, stop + 2] = stiffness
            damped = DAMPING_LIMIT / (step * damping) * remaining / stiffness
            parameters[b, stop + 4] = min(damped, LARGEST_DEPTH)


def product_in_tool_position(machine: Machine, name: str) -> tuple[int, int]:
    """Return the indices of two coordinates whose product is in the tool position of an axis, or -1, -1.

    The tool position along x is usually the coordinate x. If the bridge can yaw, it is x + yaw * y: the
    result for "x" is then (index of yaw, index of y).
    """
    for sensor in [sensor for sensor in machine.sensors if sensor.of_position]:
        for key, factor in sensor.row.items():
            if "*" in key and factor == sensor.row.get(name):
                first, second = map(machine.coordinate_names.index, key.split("*"))
                return first, second
    return -1, -1


def tool_terms(machine: Machine) -> NDArray[np.intp]:
    """Find the coordinates from which the tool position along each axis is computed.

    With the coordinates q, the position along an axis is usually q[i]. It is q[i] + q[j] q[k] where a product
    is added: with a bridge that can yaw, the tool is at x + yaw * y along x.

    Returns:
        Indices i, j and k of each axis in `machine.coordinate_names`, shape (axes, 3); j = k = -1 without
        product.
    """
    return np.array(
        [
            (machine.coordinate_names.index(name), *product_in_tool_position(machine, name))
            for name in machine.tool_axes
        ]
    )


@compiled
def write_tool_positions(state: Any, units: Any, terms: Any, first: int, positions: Any) -> None:
    """Write the true tool positions of k simulated machines to an array.

    Args:
        state: Belt travel of all coordinates, m, and further rows, in lanes, shape (blocks, rows, LANES).
        units: Factor from belt travel to the coordinate's unit, shape (blocks, coordinates, LANES).
        terms: Indices of coordinates, as `tool_terms` returns them, shape (axes, 3).
        first: Index of the first block. The k machines are machine first * LANES and those after it.
        positions: Output, tool positions, m or rad, shape (k, axes).
    """
    for axis in range(terms.shape[0]):
        row, a, b = terms[axis]
        for i in range(positions.shape[0]):  # the travel of a linear axis is its position
            block, lane = first + i // LANES, i % LANES
            positions[i, axis] = state[block, row, lane] * units[block, row, lane]
        if a >= 0:
            for i in range(positions.shape[0]):
                block, lane = first + i // LANES, i % LANES
                factor = state[block, a, lane] * units[block, a, lane]
                positions[i, axis] += factor * (state[block, b, lane] * units[block, b, lane])
