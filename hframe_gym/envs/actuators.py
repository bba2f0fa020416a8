"""From actions to the voltage of each integration step: converter, dead time, current limit, for a batch of stages."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..dynamics.kernel import Kernel
from ..dynamics.simd import LANES
from ..machine import Machine
from ..machine.effect import AppliedEffect
from . import simd_layout as blocks
from .actuator_presets import Actuators
from .counter_rng import compiled
from .parameter_index import column, numbers

Array = NDArray[np.float64]
Index = NDArray[np.intp]


class ActuatorModel:
    """The drives of a batch.

    count, period, steps: of stages, of control (s), of the integrator in a period.  delayed: whether the machine's
    effects make drives late.

    inputs: volts (blocks, inputs, LANES) of this period, or one such set a step where a drive is late.
    """

    def __init__(
        self, machine: Machine, drives: Actuators, count: int, *, period: float, steps: int, delayed: bool
    ) -> None:
        self._machine, self._drives = machine, drives
        self._period, self._steps, self._delayed = period, steps, delayed
        self._width = len(machine.drives)
        size = -(-count // LANES)
        self._ranges = self._converter()
        self.inputs = np.zeros((size, (steps if delayed else 1) * self._width, LANES))
        periods = 2 + int(np.ceil(max(self._longest_delays()) / period)) if delayed else 1
        # Commanded voltages of past periods. Without delays `inputs` is all there is; no view of it is kept, because a
        # copied environment would have two unrelated arrays.
        self._history = np.zeros((size, periods, self._width, LANES)) if delayed else None
        self.delays = np.zeros((size, self._width, LANES))
        n = len(machine.coordinates)
        self._speeds = np.array([n + machine.coordinate_names.index(d.coordinate) for d in machine.drives])
        self._motors = np.zeros((size, 2 * self._width, LANES))  # back e.m.f., Vs/m; voltage of the most current, V

    def _converter(self) -> Array:
        """Rated voltage, the converter's quantum, lowest and highest voltage (4, inputs), V."""
        rated = np.array([d.rated_voltage for d in self._machine.drives])
        range_V, bits = self._drives.range_V, self._drives.bits
        most = rated if range_V is None else np.full(self._width, range_V)
        quantum = np.zeros(self._width) if bits is None else 2.0 * most / 2.0**bits
        return np.stack([rated, quantum, -most, most - quantum])  # two's complement: one level less above

    def _late(self, drive: str) -> list[tuple[AppliedEffect, list[int]]]:
        """Effects that make a drive late, each with the columns of its parameters."""
        return [
            (e, [column(self._machine, f"{e.label}.{key}")[0] for key in e.parameters])
            for e in self._machine.effects
            if e.definition.delay and e.site in (drive, "drives")
        ]

    def _longest_delays(self) -> list[float]:
        """The latest that each drive can ever be, by its effects' bounds, s."""
        longest = []
        for drive in self._machine.drives:
            definitions = [effect.definition for effect, _ in self._late(drive.name)]
            longest.append(sum(float(d.delay(*(p.upper for p in d.parameters))) for d in definitions if d.delay))
        return longest

    def place(self, index: Index, values: Array, units: Array) -> None:
        """Stages index (k,) begin with parameters values (k, P); no voltage is under way.

        units (k, coordinates): own unit per metre of travel.
        """
        if self._drives.current_limit is not None:
            motors = np.empty((len(index), 2 * self._width))
            for k, d in enumerate(self._machine.drives):
                Ke, gear, R = (
                    numbers(self._machine, f"{d.name}.{key}", values) for key in ("Ke", "gear_ratio", "resistance")
                )
                motors[:, k] = Ke * gear * units[:, self._machine.coordinate_names.index(d.coordinate)]
                motors[:, self._width + k] = self._drives.current_limit * R
            blocks.put(index, motors, self._motors)
        if self._history is not None:
            block, lane = np.divmod(index, LANES)
            self._history[block, :, :, lane] = 0.0
            for k, drive in enumerate(self._machine.drives):
                late = [e.definition.delay(*values[:, columns].T) for e, columns in self._late(drive.name)]  # type: ignore[misc]
                self.delays[block, k, lane] = sum(late)

    def begin(self) -> None:
        """A control period begins."""
        if self._history is not None:
            self._history[:, 1:] = self._history[:, :-1]

    def command(self, actions: NDArray[Any], first: int, last: int, clipped: NDArray[np.int64]) -> None:
        """Set the inputs of blocks first..last-1 for a period from actions (count, inputs); clipped (count,) grows."""
        history = self.inputs[:, None] if self._history is None else self._history
        command(actions, self._ranges, first, last, history, clipped)
        if self._history is not None:
            late(self._history, self.delays, self._period, self._period / self._steps, first, last, self.inputs)

    def advance(
        self, kernel: Kernel, state: Array, parameters: Array, derived: Array, h: float, first: int, last: int
    ) -> None:
        """One control period of blocks first..last-1 by the kernel, voltages limited where the current would be."""
        if self._drives.current_limit is None:
            kernel.advance_blocks(state, parameters, derived, self.inputs, h, self._steps, first, last)
            return
        volts = np.empty((len(state), self._width, LANES))
        for step in range(self._steps):
            row = step * self._width if self._delayed else 0
            limit_current(state, self._speeds, self._motors, self.inputs, row, first, last, volts)
            kernel.advance_blocks(state, parameters, derived, volts, h, 1, first, last)


@compiled
def command(actions: Any, ranges: Any, first: int, last: int, history: Any, clipped: Any) -> None:
    """Volts history[:, 0] (blocks, inputs, LANES) from actions (B, inputs), shares of the rated voltage.

    Actions end at -1 and 1; clipped (B,) grows by the number of entries that were out of range.  ranges (4, inputs):
    rated voltage, quantum of the D/A converter (0: none), and where it ends, V.
    """
    count = actions.shape[0]
    for k in range(actions.shape[1]):
        rated, quantum, lowest, highest = ranges[0, k], ranges[1, k], ranges[2, k], ranges[3, k]
        for block in range(first, last):
            for lane in range(LANES):
                share = np.float64(actions[min(block * LANES + lane, count - 1), k])
                value = min(1.0, max(-1.0, share)) * rated
                if quantum > 0.0:
                    value = np.rint(value / quantum) * quantum
                history[block, 0, k, lane] = min(highest, max(lowest, value))
        for b in range(first * LANES, min(last * LANES, count)):
            clipped[b] += abs(actions[b, k]) > 1.0


@compiled
def limit_current(state: Any, speeds: Any, motors: Any, asked: Any, row: int, first: int, last: int, out: Any) -> None:
    """Volts out (blocks, inputs, LANES) nearest to those asked for with which the current stays within its limit.

    speeds (inputs,): rows of the state; motors (blocks, 2 inputs, LANES): back e.m.f. per speed, Vs/m, then the voltage
    of the most current, V; asked (blocks, rows, LANES) V from row on.
    """
    width = speeds.shape[0]
    for block in range(first, last):
        for k in range(width):
            for lane in range(LANES):
                back = motors[block, k, lane] * state[block, speeds[k], lane]
                room = motors[block, width + k, lane]
                out[block, k, lane] = min(back + room, max(back - room, asked[block, row + k, lane]))


@compiled
def late(history: Any, delays: Any, period: float, h: float, first: int, last: int, inputs: Any) -> None:
    """Mean voltage that arrives in each step of one control period, where drives are late.

    history (blocks, periods, inputs, LANES): volts held in this period (0), the one before (1), ...; delays
    (blocks, inputs, LANES) s; inputs (blocks, steps * inputs, LANES) is written.  h is not longer than the period, so
    a step's window touches two held values at most.
    """
    width = history.shape[2]
    oldest = history.shape[1] - 1
    for block in range(first, last):
        for row in range(inputs.shape[1]):
            k = row % width
            for lane in range(LANES):
                begin = (row // width) * h - delays[block, k, lane]
                older = min(oldest, max(0, math.ceil(-begin / period)))
                newer = min(oldest, max(0, math.ceil(-(begin + h) / period)))
                value = history[block, older, k, lane]
                if newer != older:
                    share = min(1.0, max(0.0, (begin + h + newer * period) / h))
                    value = (1.0 - share) * value + share * history[block, newer, k, lane]
                inputs[block, row, lane] = value
