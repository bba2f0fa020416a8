"""Simulation of machines with the same equations and different parameters, one control period at a time.

State and parameters stay in the SIMD layout of the compiled simulation kernel (code generated for a machine),
arrays (blocks, rows, LANES): machine b is lane b % LANES of block b // LANES. Unused lanes of the last block
repeat the last machine, without voltage. Positions and velocities are belt travel, m and m/s: the coordinate
if linear, radius * angle if rotary. Compiled functions work on blocks first to last - 1, run without the
interpreter lock and use only arithmetic that rounds alike everywhere. A machine therefore gets the same bits
in any batch, lane or thread.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..arrays import Array, EnvironmentCounts, EnvironmentParameters, Index
from ..dynamics import LANES, Equations, MotionPoint, in_blocks, kernel_for, resolved_step
from ..dynamics.codegen.compiled import compiled
from ..errors import InputError
from ..machine import Machine, rest_positions_per_axis
from .actuation.applied_voltages import ActuatorModel
from .delays import DelayLine
from .randomization.machine_sampler import ParameterSpace
from .workspace import EndStops, tool_terms, write_tool_positions


def block_ranges(index: Index) -> Iterator[tuple[int, int]]:
    """Find the blocks of given machines, as ranges (first, index after the last) of consecutive blocks.

    Example: with LANES = 8, machines 0, 9 and 30 are in blocks 0, 1 and 3, which gives the ranges (0, 2) and
    (3, 4).
    """
    if len(index) == (index[-1] - index[0] + 1):  # consecutive machines
        yield int(index[0]) // LANES, int(index[-1]) // LANES + 1
        return
    blocks = np.unique(index // LANES)
    for part in np.split(blocks, np.flatnonzero(np.diff(blocks) > 1) + 1):
        yield int(part[0]), int(part[-1]) + 1


def steps_of_period(machine: Machine, period: float, longest_step: float) -> int:
    """Return into how many equal integration steps a control period is divided.

    They resolve the machine's fastest vibration and drives (`dynamics.resolved_step`), but not its delays.

    Args:
        period: Control period, s.
        longest_step: Largest step of a machine that needs no shorter one, s.

    Raises:
        InputError: If the period or the step is not positive.
    """
    for name, value in (("period", period), ("longest_step", longest_step)):
        if not (np.isfinite(value) and value > 0.0):
            raise InputError(f"{name} is {value!r}, it must be a positive number of seconds")
    return max(1, int(np.ceil(period / resolved_step(machine, longest_step, delays=False) - 1e-6)))


class BatchedSimulator:
    """Simulate many machines with the same equations and different parameters, one control period at a time.

    Machines are stored in blocks of LANES for the SIMD instructions of the processor: machine b is lane b %
    LANES of block b // LANES.

    Args:
        count: Number of machines.
        space: Names of the parameters in the columns of `reset`'s argument `values`; those of the machine
            come first.
        period: Control period, s; voltages are constant for this time.
        longest_step: Largest integration step, s (`steps_of_period`).
        end_stops: Whether rubber buffers limit x and y.
        sensors: Whether to compute the machine's sensor outputs.

    Attributes:
        state: Belt travel of all coordinates (m), their rates (m/s), time (s) and internal states of effects
            such as friction; shape (blocks, rows, LANES).
        parameters: Parameters of the machines, SI, shape (blocks, parameters, LANES).
        units_per_travel: Factor from belt travel to the coordinate's unit,
            shape (blocks, coordinates, LANES).
        readings: Sensor outputs with effects and delay, before noise and rounding,
            shape (blocks, sensors, LANES).

    Raises:
        InputError: If the period or the step is not positive.
    """

    def __init__(
        self,
        machine: Machine,
        count: int,
        space: ParameterSpace,
        *,
        period: float,
        longest_step: float,
        end_stops: bool = False,
        sensors: bool = False,
    ) -> None:
        self.machine, self.count, self.period = machine, count, period
        self.steps = steps_of_period(machine, period, longest_step)
        self.h = period / self.steps
        self.blocks = -(-count // LANES)
        self._unused = self.blocks * LANES - count  # lanes of the last block without a machine
        self._n = len(machine.coordinates)
        self._tool_terms = tool_terms(machine)
        # Travel of every coordinate at rest with unstretched belts per meter of each axis, (n, axes).
        self._rest = rest_positions_per_axis(machine) * machine.travel_per_unit[:, None]
        # The stepped machine may have end stops; their parameters come last and depend on the masses.
        self._end_stops = EndStops(machine, self.h) if end_stops else None
        self._stepped = machine if self._end_stops is None else self._end_stops.machine
        self._kernel = kernel_for(self._stepped)
        self.state = np.zeros((self.blocks, self._kernel.states, LANES))
        nominal = np.array(list(self._stepped.parameters.values()))
        self.parameters = in_blocks(np.tile(nominal, (count, 1)))
        self.units_per_travel = in_blocks(1.0 / machine.travel_per_unit_of(np.tile(nominal, (count, 1))))
        self._derived = np.zeros((self.blocks, len(self._kernel.layout.derived), LANES))
        self._kernel.prepare_blocks(self.parameters, self.h, 0, self.blocks, self._derived)
        delayed = self._kernel.drives_delayed
        self.actuators = ActuatorModel(
            machine, count, space.names.index, period=period, steps=self.steps, delayed=delayed
        )
        self._sensors = sensors
        self.readings = np.zeros((self.blocks, len(machine.sensors), LANES))
        self._undelayed = np.zeros_like(self.readings)
        self._delay_line: DelayLine | None = None
        if sensors and self._kernel.sensors_delayed:
            self._delay_line = DelayLine(machine, self.blocks, self.h)
        self._steps_done = 0  # at the end of the present control period

    def __getstate__(self) -> dict[str, Any]:
        return {k: v for k, v in self.__dict__.items() if k != "_kernel"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._kernel = kernel_for(self._stepped)

    def reset(
        self, index: Index, position: Array, values: EnvironmentParameters, motion: Array | None = None
    ) -> None:
        """Put k machines at rest with unstretched belts, or into a given motion, with new parameters.

        Their time, the internal states of effects and the delayed voltages become zero.

        Args:
            position: Tool positions, m or rad, shape (k, axes); ignored if `motion` is given.
            motion: Positions of the n coordinates, then their velocities, in their units, shape (k, 2 n), in
                place of `position`. Default: at rest.
        """
        # At rest, the travel of every coordinate is a linear function of the tool position; the rest of the
        # state is 0.
        state = np.zeros((len(index), self.state.shape[1]))
        for axis, travel in enumerate(self._rest.T):
            state[:, : self._n] += position[:, axis, None] * travel
        units = 1.0 / self.machine.travel_per_unit_of(values)
        if motion is not None:
            state[:, : 2 * self._n] = motion / np.tile(units, 2)
        # The unused lanes of the last block repeat the last machine, with voltages of zero.
        repeats = self._unused if index[-1] == self.count - 1 else 0
        _put(index, state, repeats, self.state)
        parameters = np.ascontiguousarray(values[:, : len(self.machine.parameters)])
        if self._end_stops is not None:
            parameters = self._end_stops.parameters(values)
        _put(index, parameters, repeats, self.parameters)
        _put(index, units, repeats, self.units_per_travel)
        self.actuators.begin(index, values)
        kernel, delay_line = self._kernel, self._delay_line
        for first, last in block_ranges(index):
            kernel.prepare_blocks(self.parameters, self.h, first, last, self._derived)
            if kernel.drives_delayed:
                kernel.drive_delay_blocks(self.parameters, first, last, self.actuators.delays)
            if self._sensors:
                kernel.read_blocks(self.state, self.parameters, first, last, self._undelayed)
            if delay_line is not None:
                kernel.sensor_delay_blocks(self.parameters, first, last, delay_line.delays)
        if self._sensors:
            block, lane = np.divmod(index, LANES)
            self.readings[block, :, lane] = self._undelayed[block, :, lane]
        if delay_line is not None:
            delay_line.fill(index, self._undelayed)

    def begin_period(self) -> None:
        """Begin a control period of all machines: advance voltage history (dead times) and step counter.

        Call it once per period, before `advance`.
        """
        self.actuators.begin_period()
        self._steps_done += self.steps

    def advance(self, actions: NDArray[Any], clipped: EnvironmentCounts, first: int, last: int) -> None:
        """Advance the machines in blocks first to last - 1 by the control period that `begin_period` began.

        Calls for different blocks may run in several threads at once.

        Args:
            actions: Voltages as fractions of the rated ones, shape (count, drives), limited to [-1, 1] here.
            clipped: Number of entries outside [-1, 1] since the reset of each machine; increased here.
            first: First block.
            last: Block after the last one.
        """
        self.actuators.command(actions, first, last, clipped)
        if self._delay_line is not None:
            self._advance_with_delay_line(self._delay_line, first, last)
            return
        inputs, kernel = self.actuators.inputs, self._kernel
        kernel.advance_blocks(
            self.state, self.parameters, self._derived, inputs, self.h, self.steps, first, last
        )
        if self._sensors:
            kernel.read_blocks(self.state, self.parameters, first, last, self.readings)

    def _advance_with_delay_line(self, delay_line: DelayLine, first: int, last: int) -> None:
        """Advance blocks first..last-1 by one control period and record their readings after every step."""
        inputs = self.actuators.inputs
        drives, begin = len(self.machine.drives), self._steps_done - self.steps
        for step in range(self.steps):
            row = step * drives if self._kernel.drives_delayed else 0
            voltages = np.ascontiguousarray(inputs[:, row : row + drives])
            self._kernel.advance_blocks(
                self.state, self.parameters, self._derived, voltages, self.h, 1, first, last
            )
            self._kernel.read_blocks(self.state, self.parameters, first, last, self._undelayed)
            delay_line.record(self._undelayed, begin + step + 1, first, last)
        delay_line.read(self._steps_done, first, last, self.readings)

    # -- reading ---------------------------------------------------------------------------------------------

    def tool_positions(self, first: int = 0, last: int | None = None) -> Array:
        """Compute the true tool positions of the machines in some blocks, m or rad, shape (k, axes).

        Args:
            first: First block.
            last: Block after the last one. Default: all blocks from the first one on.
        """
        last = self.blocks if last is None else last
        positions = np.empty((min(last * LANES, self.count) - first * LANES, len(self._tool_terms)))
        write_tool_positions(self.state, self.units_per_travel, self._tool_terms, first, positions)
        return positions

    def positions(self, b: int) -> dict[str, float]:
        """Compute the present positions of all coordinates of machine b, m or rad, by name."""
        block, lane = divmod(b, LANES)
        values = self.state[block, : self._n, lane] * self.units_per_travel[block, :, lane]
        return dict(zip(self.machine.coordinate_names, values.tolist(), strict=True))

    def tensions(self, b: int) -> dict[str, float]:
        """Compute the present belt tensions of machine b minus the pretension, N, by name of the belt."""
        block, lane = divmod(b, LANES)
        state, parameters = self.state[block, :, lane], self.parameters[block, :, lane]
        equations = Equations(
            self.machine, dict(zip(self.machine.parameters, parameters.tolist(), strict=False))
        )
        point = MotionPoint(state[: self._n].tolist(), state[self._n : 2 * self._n].tolist())
        belts = zip(self.machine.belts, equations.belt_states(point), strict=True)
        return {belt.name: float(belt_state.tension) for belt, belt_state in belts}


@compiled
def _put(index: Any, rows: Any, repeats: int, table: Any) -> None:
    """Write rows (k, n) into the lanes of machines index (k,) of table (blocks, n or more, LANES).

    The last row goes to as many further lanes as `repeats` says.
    """
    for i in range(index.shape[0] + repeats):
        row = min(i, index.shape[0] - 1)
        b = index[row] + i - row
        for j in range(rows.shape[1]):
            table[b // LANES, j, b % LANES] = rows[row, j]
