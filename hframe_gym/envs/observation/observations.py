"""Observations of a batch of environments, from the state or from measurements.

Environments are simulated in blocks: environment b is lane b % LANES of block b // LANES. Methods for a range
of blocks can run in several threads at once.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...arrays import EnvironmentCounts, EnvironmentParameters, EpisodeKeys, Index
from ...dynamics import LANES
from ...dynamics.codegen.blocks import write_block
from ...dynamics.codegen.compiled import compiled
from ...dynamics.codegen.lane_program import LaneProgram
from ...dynamics.codegen.native_calls import call_at
from ...machine import Sensor
from ..batched_simulator import BatchedSimulator, block_ranges
from ..randomization.machine_sampler import MachineSampler
from ..rewards import Evaluation, evaluate_rows
from ..workspace import product_in_tool_position, workspace_of
from .measurements import SensorArray
from .sensors import PositionFromSensors
from .spaces import MARGIN, SignalSpec, bounds_of, privileged_signals, sensor_signals, state_signals

Observation = dict[str, NDArray[np.float32]]
_FLOAT32 = np.dtype(np.float32)  # saves its construction in every step


class StateView:
    """Select n positions and velocities of the state for an observation; the first are the tool position.

    Attributes:
        size: Number of entries n of the signals.
        bounds: Lower, then upper bounds of the entries (m, rad, m/s or rad/s), rounded to float32,
            shape (2 n, LANES).
        program: Compiled function `observe`.
    """

    def __init__(self, simulator: BatchedSimulator, signals: Sequence[SignalSpec]) -> None:
        self.size = len(signals)
        box = np.stack(bounds_of(signals)).astype(np.float32) if signals else np.zeros((2, 0))
        self.bounds = np.repeat(box.astype(np.float64).reshape(-1, 1), LANES, axis=1)
        names = simulator.machine.coordinate_names
        lines = []
        for j, signal in enumerate(signals):
            i = names.index(signal.coordinate)
            # All positions come first in the state, then all velocities.
            row = i + len(names) * signal.velocity
            value = f"load(state, {row}) * load(units, {i})"
            first, second = (
                (-1, -1)
                if signal.velocity
                else product_in_tool_position(simulator.machine, signal.coordinate)
            )
            if first >= 0:  # the tool of a bridge that can yaw is at x + yaw * y
                across = f"(load(state, {second}) * load(units, {second}))"
                value += f" + load(state, {first}) * load(units, {first}) * {across}"
            lines += [
                f"value_{j} = {value}",
                f"store(values, {j}, minimum(maximum(value_{j}, load(bounds, "
                f"{j})), load(bounds, {self.size + j})))",
            ]
        residue = " + ".join(
            ["load(state, 0) * 0.0", *(f"(value_{j} - value_{j})" for j in range(self.size))]
        )
        lines.append(f"store(values, {self.size}, {residue})")  # zero if all entries are finite
        text = "\n    ".join(["def observe(state, units, bounds, values):", *lines]) + "\n"
        self.program = LaneProgram(text, ("observe",))


class ObservationBuilder:
    """Compute the observations of `simulator.count` environments, except their goals.

    Args:
        sensors: Observed sensors, or None to observe the true state.
        privileged: Whether observations contain the array `privileged` (true state and randomized
            parameters).

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
        self._tool = StateView(simulator, state_signals(machine, machine.tool_axes)[: len(machine.tool_axes)])
        self._sensors: SensorArray | None = None
        if sensors is None:
            self._state = StateView(simulator, self.entries)
        else:
            self._sensors = SensorArray(machine, sensors, count, sampler.space.names.index)
            # Blocks are measured as a whole: environments that were never reset have the nominal noise and
            # resolution.
            nominal = np.tile(sampler.space.nominal, (count, 1))
            self._sensors.begin(np.arange(count), np.zeros(count, np.uint64), nominal)
            position = PositionFromSensors.of(machine, sensors)
            self._measurement_program = _measurement_program(position, sensors, len(machine.tool_axes))
            goal_box = workspace_of(machine) + np.array([-MARGIN, MARGIN])
            bounds = np.concatenate([np.stack(bounds_of(self.entries)).ravel(), goal_box.T.ravel()])
            self._bounds = np.repeat(bounds[:, None], LANES, axis=1)
        self.privileged = privileged_signals(machine, sampler.normalized_bounds()) if privileged else ()
        self._all_state = StateView(simulator, [s for s in self.privileged if s.coordinate])
        shapes = {"observation": (count, len(self.entries)), "achieved_goal": (count, len(machine.tool_axes))}
        if privileged:
            shapes["privileged"] = count, len(self.privileged)
        self._shapes = tuple(shapes.items())
        self._parameters = np.zeros((count, len(sampler.names) if privileged else 0), np.float32)

    def _observe(
        self, first: int, last: int, view: StateView, out: NDArray[np.float32], tool: NDArray[np.float32]
    ) -> int:
        """Write a view to `out`, the tool position to `tool`; return one with a non-finite state, or -1."""
        simulator, function = self._simulator, view.program.addresses["observe"]
        state, units = simulator.state, simulator.units_per_travel
        broken: int = _observe(function, view.size, state, units, view.bounds, first, last, out, tool)
        return broken

    def begin(
        self,
        index: Index,
        keys: EpisodeKeys,
        values: EnvironmentParameters,
        sampler: MachineSampler,
        elapsed: EnvironmentCounts,
    ) -> None:
        """Begin new episodes of k environments: store randomized parameters and take first measurements.

        Parameters are stored for the array `privileged`, measurements if sensors are observed. The sampler is
        the one that returned keys and values.

        Args:
            elapsed: Control periods since the reset of all environments, not of the k alone; they select the
                random numbers of the noise.
        """
        if self.privileged:
            self._parameters[index] = sampler.normalized(values)
        if self._sensors is not None:
            self._sensors.begin(index, keys, values)
            self._sensors.measure_first(self._simulator.readings, elapsed, index, block_ranges(index))

    def measure(self, first: int, last: int, elapsed: EnvironmentCounts) -> None:
        """Measure with sensors of blocks first to last - 1 at a control period's end, and store the results.

        `write` puts the measurements and their rates of change into observations. Nothing happens if the true
        state is observed. The number of `elapsed` control periods since the reset selects the random numbers.
        """
        if self._sensors is not None:
            self._sensors.measure(self._simulator.readings, elapsed, first, last)

    def add_blank(self, observation: Observation) -> None:
        """Add arrays for all keys but goals to `observation`, not initialized, shape (count, entries)."""
        for key, shape in self._shapes:
            observation[key] = np.empty(shape, _FLOAT32)

    def tool_array(self, observation: Observation) -> NDArray[np.float32]:
        """Return the array into which `write` puts the true tool positions, m or rad, shape (count, axes).

        If the true state is observed, it is `achieved_goal` of the observation; if sensors are observed, it
        is a new array.
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

        All are limited to the bounds of the observation space. With `evaluation`, distances to the goal and
        rewards are written too.

        Args:
            observation: Output; rows of other blocks are not changed.
            tool: Output, true tool positions, m or rad, shape (count, axes); `achieved_goal` itself if the
                state is observed.
            evaluation: The last arguments of `evaluate_rows`, with two output arrays, shape (count,) each:
                distances, m or rad, and rewards. Default: neither is computed.

        Returns:
            Index of an environment whose state is not finite, or -1 if all are finite.
        """
        simulator = self._simulator
        broken: int
        if self._sensors is not None:
            broken = self._observe(first, last, self._tool, tool, tool)
            self._write_measurements(self._sensors, first, last, observation)
            if evaluation is not None:
                end = min(last * LANES, simulator.count)
                achieved, desired = observation["achieved_goal"], observation["desired_goal"]
                evaluate_rows(tool, achieved, True, desired, first * LANES, end, *evaluation)
        elif evaluation is None:
            broken = self._observe(first, last, self._state, observation["observation"], tool)
        else:  # one call for both: calls are most of a step of one environment
            view = self._state
            broken = _observe_and_evaluate(
                view.program.addresses["observe"],
                view.size,
                simulator.state,
                simulator.units_per_travel,
                view.bounds,
                first,
                last,
                observation["observation"],
                tool,
                observation["desired_goal"],
                *evaluation,
            )
        if self.privileged:
            rows = observation["privileged"]
            broken = max(broken, self._observe(first, last, self._all_state, rows, tool))
            block_rows = slice(first * LANES, last * LANES)
            rows[block_rows, self._all_state.size :] = self._parameters[block_rows]
        return broken

    def _write_measurements(
        self, sensors: SensorArray, first: int, last: int, observation: Observation
    ) -> None:
        """Write `observation` and `achieved_goal` of blocks first..last-1 from measurements."""
        _write_measurements(
            self._measurement_program.addresses["observe"],
            sensors.measurements,
            self._simulator.period,
            sensors.low,
            sensors.high,
            self._bounds,
            first,
            last,
            observation["observation"],
            observation["achieved_goal"],
        )

    def write_tool(self, first: int, last: int, tool: NDArray[np.float32]) -> None:
        """Write the true tool positions of blocks `first` to `last` - 1 to `tool`.

        They are in m or rad, of shape (count, axes). They are limited to the bounds of the observation space.
        """
        self._observe(first, last, self._tool, tool, tool)


def _measurement_program(position: PositionFromSensors, sensors: Sequence[Sensor], axes: int) -> LaneProgram:
    """Compile the function that computes an observation from measurements: them, then the rates of positions.

    The position along an axis is the measurement itself where that is strictly inside its range, else what
    the other sensors give on unstretched belts. The rows of `bounds` limit measurements and rates first, then
    the axes.
    """
    n = len(sensors)
    rated = [j for j, sensor in enumerate(sensors) if sensor.of_position]
    size = n + len(rated)
    lines = []

    def limit(row: int, bound: int, count: int, value: str) -> str:
        return (
            f"store(values, {row}, minimum(maximum({value}, load(bounds, "
            f"{bound})), load(bounds, {bound + count})))"
        )

    for j in range(n):
        lines.append(limit(j, j, size, f"load(now, {j})"))
    for k, j in enumerate(rated, start=n):
        change = f"(load(now, {j}) - load(before, {j}))"
        turn = sensors[j].turn
        if turn is not None:  # the shorter way between two angles
            change = f"({change} - {turn!r} * rint({change} / {turn!r}))"
        lines.append(limit(k, k, size, f"{change} / period"))
    for axis in range(axes):
        terms = [f"{float(position.belts[axis, j])!r} * load(now, {j})" for j in range(n)]
        value = " + ".join(["0.0", *terms])
        j = int(position.direct[axis])
        if j >= 0:
            measured = f"{float(position.scale[axis])!r} * load(now, {j})"
            inside = f"(load(low, {j}) < load(now, {j})) & (load(now, {j}) < load(high, {j}))"
            value = f"where({inside}, {measured}, {value})" if position.belts[axis].any() else measured
        lines.append(limit(size + axis, 2 * size + axis, axes, value))
    head = "def observe(now, before, low, high, bounds, period: float, values):"
    return LaneProgram("\n    ".join([head, *lines]) + "\n", ("observe",))


@compiled
def _write_measurements(
    program: int,
    history: Any,
    period: float,
    range_low: Any,
    range_high: Any,
    bounds: Any,
    first: int,
    last: int,
    out: Any,
    achieved: Any,
) -> None:
    """Write observations out (B, size) and positions achieved (B, axes) of blocks first..last-1.

    program: address of the function of `_measurement_program`; history (2, blocks, n, LANES): last
    measurements and those before; range_low, range_high (blocks, n, LANES): ends of the ranges; bounds (2
    size + 2 axes, LANES).
    """
    size, axes = out.shape[1], achieved.shape[1]
    values = np.empty((size + axes, LANES))
    for block in range(first, last):
        now, before = history[0, block], history[1, block]
        call_at(program, now, before, range_low[block], range_high[block], bounds, period, values)
        write_block(values, block * LANES, size, out)
        write_block(values[size:], block * LANES, axes, achieved)


@compiled
def _observe(
    program: int, size: int, state: Any, units: Any, bounds: Any, first: int, last: int, out: Any, tool: Any
) -> int:
    """Write a state view with n = size entries to out (B, n or more), the first also to tool (B, axes).

    program: address of its function; units (blocks, coordinates, LANES): units per meter of travel; bounds (2
    n, LANES). Return the index of an environment whose state is not finite, or -1.
    """
    values = np.empty((size + 1, LANES))
    broken = -1
    for block in range(first, last):
        begin = block * LANES
        call_at(program, state[block], units[block], bounds, values)
        write_block(values, begin, size, out)
        write_block(values, begin, tool.shape[1], tool)
        bad = 0
        for lane in range(LANES):  # without an exit at the first one: the compiler vectorizes the loop
            bad += values[size, lane] != 0.0
        if bad > 0 and broken < 0:
            broken = begin + np.argmax(values[size] != 0.0)
    return broken


@compiled
def _observe_and_evaluate(
    program: int,
    size: int,
    state: Any,
    units: Any,
    bounds: Any,
    first: int,
    last: int,
    out: Any,
    tool: Any,
    desired: Any,
    kind: int,
    band: float,
    meters: float,
    distance: Any,
    reward: Any,
) -> int:
    """Do `_observe`, and `evaluate_rows` for the same environments and their true tool positions."""
    broken: int = _observe(program, size, state, units, bounds, first, last, out, tool)
    end = min(last * LANES, tool.shape[0])
    measured = bool(0)  # of another type than False, for which Numba would compile `evaluate_rows` once more
    evaluate_rows(tool, tool, measured, desired, first * LANES, end, kind, band, meters, distance, reward)
    return broken
