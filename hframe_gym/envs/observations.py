"""Observations of a batch of environments, from the state or from measurements.

Environments are simulated in blocks: environment b is lane b % LANES of block b // LANES. Methods for a range of blocks
can run in several threads at once.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..dynamics import LANES
from ..dynamics.simd import any_of, inlined, load, store, where
from ..dynamics.simd_math import maximum, minimum, write_block
from ..machine import Sensor
from .batched_simulator import BatchedSimulator, block_ranges
from .machine_sampler import MachineSampler
from .measurements import SensorArray
from .random_numbers import compiled
from .rewards import Evaluation, evaluate_rows
from .sensors import PositionFromSensors
from .spaces import MARGIN, SignalSpec, bounds_of, privileged_signals, sensor_signals, state_signals
from .workspace import tool_product, workspace_of

Array = NDArray[np.float64]
Index = NDArray[np.intp]
Observation = dict[str, NDArray[np.float32]]
_FLOAT32 = np.dtype(np.float32)  # saves its construction in every step


class StateView(NamedTuple):
    """Select n positions and velocities of the simulated state for an observation; the first are the tool position.

    Attributes:
        rows: Four indices per entry, shape (n, 4): row of the state array; coordinate; two coordinates whose product
            is added, or -1 and -1. Example: if the bridge can yaw, the tool is at x + yaw * y; the entry x then has the
            indices of x, x, yaw and y.
        box: Lower and upper bounds of the entries (m, rad, m/s or rad/s), shape (2, n).
    """

    rows: Index
    box: Array

    @classmethod
    def of(cls, simulator: BatchedSimulator, signals: Sequence[SignalSpec]) -> StateView:
        """Find the rows of the simulator's state array from which n observation entries are read.

        Args:
            simulator: Simulator of the machines.
            signals: Specifications of the entries, positions and velocities; the tool's axes come first.

        Returns:
            `rows`, shape (n, 4): for each entry the row of the state array, the index of the coordinate, and the
            indices of two coordinates whose product is added (yaw * y for a bridge that can yaw), or -1 and -1.
            `box`, shape (2, n): lower and upper bounds in the entries' units, rounded to float32.
        """
        names = simulator.machine.coordinate_names
        rows = np.full((len(signals), 4), -1)
        for row, signal in zip(rows, signals, strict=True):
            i = names.index(signal.coordinate)
            row[:2] = i + len(names) * signal.velocity, i  # all positions come first in the state, then all velocities
            if not signal.velocity:
                row[2:] = tool_product(simulator.machine, signal.coordinate)
        box = np.stack(bounds_of(signals)).astype(np.float32)
        return cls(rows, box.astype(np.float64))


class ObservationBuilder:
    """Compute the observations of `simulator.count` environments, except their goals.

    Args:
        simulator: Simulator of the machines.
        sensors: Observed sensors, or None to observe the true state.
        sampler: Sampler of the parameters.
        privileged: Whether observations contain the array `privileged` (true state and randomized parameters).

    Attributes:
        entries: Name, unit and bounds of every entry of `observation`.
        privileged: Name, unit and bounds of every entry of `privileged`; empty without this array.
        measured: Whether sensors are observed instead of the state.
    """

    def __init__(
        self,
        simulator: BatchedSimulator,
        sensors: tuple[Sensor, ...] | None,
        sampler: MachineSampler,
        *,
        privileged: bool,
    ) -> None:
        self._simulator = simulator
        machine, count = simulator.machine, simulator.count
        self.measured = sensors is not None
        self.entries = state_signals(machine) if sensors is None else sensor_signals(machine, sensors)
        self._tool = StateView.of(simulator, state_signals(machine, machine.tool_axes)[: len(machine.tool_axes)])
        self._sensors: SensorArray | None = None
        if sensors is None:
            self._state = StateView.of(simulator, self.entries)
        else:
            self._sensors = SensorArray(machine, sensors, count, sampler.space.names.index)
            # Blocks are measured as a whole: environments that were never reset have the nominal noise and resolution.
            nominal = np.tile(sampler.space.nominal, (count, 1))
            self._sensors.begin(np.arange(count), np.zeros(count, np.uint64), nominal)
            self._position = PositionFromSensors.of(machine, sensors)
            self._box = np.stack(bounds_of(self.entries))
            self._goal_box = workspace_of(machine) + np.array([-MARGIN, MARGIN])
        self.privileged = privileged_signals(machine, sampler.normalized_bounds()) if privileged else ()
        self._all_state = StateView.of(simulator, [s for s in self.privileged if s.coordinate])
        shapes = {"observation": (count, len(self.entries)), "achieved_goal": (count, len(machine.tool_axes))}
        if privileged:
            shapes["privileged"] = count, len(self.privileged)
        self._shapes = tuple(shapes.items())
        self._parameters = np.zeros((count, len(sampler.names) if privileged else 0), np.float32)

    def _observe(
        self, first: int, last: int, view: StateView, out: NDArray[np.float32], tool: NDArray[np.float32]
    ) -> int:
        """Write a view to `out`, the tool position to `tool`; return an environment with a non-finite state, or -1."""
        simulator = self._simulator
        broken: int = _observe(simulator.state, simulator.units_per_travel, *view, first, last, out, tool)
        return broken

    def begin(
        self,
        index: Index,
        keys: NDArray[np.uint64],
        values: Array,
        sampler: MachineSampler,
        elapsed: NDArray[np.int64],
    ) -> None:
        """Begin new episodes of k environments: store the randomized parameters and take the first measurements.

        Parameters are stored for the array `privileged`, measurements if sensors are observed.

        Args:
            index: Indices of the environments, shape (k,).
            keys: Keys (seeds) of the episodes, from which their random numbers follow, uint64, shape (k,).
            values: All N parameters, SI, in the order of `sampler.space.names`, shape (k, N).
            sampler: Sampler that returned `keys` and `values`.
            elapsed: Control periods since the reset of each of the `count` environments, shape (count,).
        """
        if self.privileged:
            self._parameters[index] = sampler.normalized(values)
        if self._sensors is not None:
            self._sensors.begin(index, keys, values)
            self._sensors.measure_first(self._simulator.readings, elapsed, index, block_ranges(index))

    def measure(self, first: int, last: int, elapsed: NDArray[np.int64]) -> None:
        """Measure with the sensors of blocks first to last - 1 at the end of a control period, and store the results.

        Measurements are positions and angles with noise, quantization and limited range. `write` puts them and their
        rates of change into observations. Nothing happens if the true state is observed.

        Args:
            first: Index of the first block. Block i has environments i * LANES to (i + 1) * LANES - 1 (LANES: 8 or 16).
            last: Index after the last block.
            elapsed: Control periods since the reset of each environment, shape (count,); it selects random numbers.
        """
        if self._sensors is not None:
            self._sensors.measure(self._simulator.readings, elapsed, first, last)

    def blank(self) -> Observation:
        """Allocate the arrays of an observation, which `write` fills; they are not initialized.

        Returns:
            Arrays by key, float32, shape (count, entries of the key) for `count` environments: `observation`,
            `achieved_goal` and, for a builder with the option `privileged`, `privileged`.
        """
        observation: Observation = {}
        for key, shape in self._shapes:  # quicker than a comprehension, and every step does it
            observation[key] = np.empty(shape, _FLOAT32)
        return observation

    def tool_array(self, observation: Observation) -> NDArray[np.float32]:
        """Return the array into which `write` is to put the true tool positions.

        Args:
            observation: Arrays by key, among them `achieved_goal`, m, shape (count, axes).

        Returns:
            Array for positions, m, float32, shape (count, axes). If the true state is observed, it is the array
            `achieved_goal`, which then holds the true positions; if sensors are observed, it is a new array.
        """
        achieved = observation["achieved_goal"]
        return np.empty_like(achieved) if self.measured else achieved

    def write(
        self,
        first: int,
        last: int,
        observation: Observation,
        tool: NDArray[np.float32],
        evaluation: Evaluation | None = None,
    ) -> int:
        """Write observations and true tool positions of the environments in blocks first to last - 1.

        All are limited to the bounds of the observation space. With `evaluation`, distances to the goal and rewards are
        written too.

        Args:
            first: Index of the first block. Block i has environments i * LANES to (i + 1) * LANES - 1 (LANES: 8 or 16).
            last: Index after the last block.
            observation: Output, arrays by key, shape (count, entries of the key); rows of other blocks are not changed.
            tool: Output, true tool positions, m, shape (count, axes); `achieved_goal` itself if the state is observed.
            evaluation: Kind of built-in reward (0 dense, 1 sparse), distance that counts as a success, m, and two
                output arrays, shape (count,) each: distances, m, and rewards. Default: neither is computed.

        Returns:
            Index of an environment whose state is not finite, or -1 if all are finite.
        """
        simulator = self._simulator
        broken: int
        if self._sensors is not None:
            broken = self._observe(first, last, self._tool, tool, tool)
            self._write_measurements(self._sensors, first, last, observation)
            if evaluation is not None:
                goals = tool, observation["achieved_goal"], True, observation["desired_goal"]
                evaluate_rows(*goals, first * LANES, min(last * LANES, simulator.count), *evaluation)
        elif evaluation is None:
            broken = self._observe(first, last, self._state, observation["observation"], tool)
        else:  # one call for both: calls are most of a step of one environment
            state, units, (entries, box) = simulator.state, simulator.units_per_travel, self._state
            out, desired = observation["observation"], observation["desired_goal"]
            kind, band, distance, reward = evaluation
            broken = _observe_and_evaluate(
                state, units, entries, box, first, last, out, tool, desired, kind, band, distance, reward
            )
        if self.privileged:
            rows = observation["privileged"]
            broken = max(broken, self._observe(first, last, self._all_state, rows, tool))
            block_rows = slice(first * LANES, last * LANES)
            rows[block_rows, len(self._all_state.rows) :] = self._parameters[block_rows]
        return broken

    def _write_measurements(self, sensors: SensorArray, first: int, last: int, observation: Observation) -> None:
        """Write `observation` and `achieved_goal` of blocks first..last-1 from measurements."""
        position = self._position.belts, self._position.direct, self._position.scale
        limits, boxes = (sensors.low, sensors.high), (self._box, self._goal_box)
        out = observation["observation"], observation["achieved_goal"]
        _write_measurements(sensors.measurements, self._simulator.period, limits, position, boxes, first, last, *out)

    def write_tool(self, first: int, last: int, tool: NDArray[np.float32]) -> None:
        """Write the true tool positions, limited to their bounds, of the environments in blocks first to last - 1.

        Args:
            first: Index of the first block. Block i has environments i * LANES to (i + 1) * LANES - 1 (LANES: 8 or 16).
            last: Index after the last block.
            tool: Output, positions, m, shape (count, axes); other rows are not changed.
        """
        self._observe(first, last, self._tool, tool, tool)


@compiled
def _write_measurements(
    history: Any, period: float, limits: Any, position: Any, boxes: Any, first: int, last: int, out: Any, achieved: Any
) -> None:
    """Write observations out (B, 2 n) and positions achieved (B, axes) of blocks first..last-1 from measurements.

    history (2, blocks, n, LANES): last measurements and those before; limits: lower and upper end of the ranges,
    (blocks, n, LANES) each; position: `PositionFromSensors`. The position along an axis is the measurement itself where
    that is strictly inside its range, else what the other sensors give on unstretched belts. All are clipped to boxes:
    (2, 2 n) for out, (axes, 2) for achieved.
    """
    (range_low, range_high), (belts, direct, scale), (box, goal_box) = limits, position, boxes
    n, axes = history.shape[2], achieved.shape[1]
    values, positions = np.empty((2 * n, LANES), np.float32), np.empty((axes, LANES), np.float32)
    undetermined = np.array([not belts[axis].any() for axis in range(axes)])
    for block in range(first, last):
        now, before, low, high = history[0, block], history[1, block], range_low[block], range_high[block]
        for j in range(n):
            rate = (load(now, j) - load(before, j)) / period
            store(values, j, _clip(load(now, j), box[0, j], box[1, j]))
            store(values, n + j, _clip(rate, box[0, n + j], box[1, n + j]))
        write_block(values, block * LANES, 2 * n, out)
        for axis in range(axes):
            value = 0.0 + belts[axis, 0] * load(now, 0)
            for j in range(1, n):
                value = value + belts[axis, j] * load(now, j)
            j = direct[axis]
            if j >= 0:
                inside = (load(low, j) < load(now, j)) & (load(now, j) < load(high, j))
                measured = scale[axis] * load(now, j)
                value = measured if undetermined[axis] else where(inside, measured, value)
            store(positions, axis, _clip(value, goal_box[axis, 0], goal_box[axis, 1]))
        write_block(positions, block * LANES, axes, achieved)


@inlined
def _clip(value: Any, low: float, high: float) -> Any:
    """Return a SIMD register, limited to [low, high]."""
    return minimum(maximum(value, low), high)


@compiled
def _observe(state: Any, units: Any, entries: Any, box: Any, first: int, last: int, out: Any, tool: Any) -> int:
    """Write `StateView.rows` (n, 4) of the state as float32 to out (B, n or more), the first also to tool (B, axes).

    units (blocks, coordinates, LANES): units per meter of travel; box (2, n): bounds. Return the index of an
    environment whose state is not finite, or -1.
    """
    count = entries.shape[0]
    values, residues = np.empty((count, LANES), np.float32), np.empty((1, LANES))
    broken = -1
    for block in range(first, last):
        begin = block * LANES
        block_state, block_units = state[block], units[block]
        residue = load(block_state, 0) * 0.0  # stays zero until a value is not finite
        for j in range(count):
            value = load(block_state, entries[j, 0]) * load(block_units, entries[j, 1])
            factor, other = entries[j, 2], entries[j, 3]
            if factor >= 0:
                across = load(block_state, other) * load(block_units, other)
                value = value + load(block_state, factor) * load(block_units, factor) * across
            residue = residue + (value - value)
            store(values, j, minimum(maximum(value, box[0, j]), box[1, j]))
        write_block(values, begin, count, out)
        write_block(values, begin, tool.shape[1], tool)
        if any_of(where(residue == 0.0, 0.0, 1.0) > 0.0):
            store(residues, 0, residue)
            for lane in range(LANES):
                if broken < 0 and not math.isfinite(residues[0, lane]):
                    broken = begin + lane
    return broken


@compiled
def _observe_and_evaluate(
    state: Any,
    units: Any,
    entries: Any,
    box: Any,
    first: int,
    last: int,
    out: Any,
    tool: Any,
    desired: Any,
    kind: int,
    band: float,
    distance: Any,
    reward: Any,
) -> int:
    """Do `_observe`, and `evaluate_rows` for the same environments and their true tool positions."""
    broken: int = _observe(state, units, entries, box, first, last, out, tool)
    end = min(last * LANES, tool.shape[0])
    evaluate_rows(tool, tool, False, desired, first * LANES, end, kind, band, distance, reward)
    return broken
