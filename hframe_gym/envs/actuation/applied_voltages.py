"""Simulation of actuators for a batch of environments: from actions to motor voltages, through converters.

Batches are stored in the kernel's SIMD layout: environment b is lane b % LANES of block b // LANES.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...arrays import EnvironmentCounts, EnvironmentParameters, Index
from ...dynamics import LANES
from ...dynamics.codegen.blocks import read_block
from ...dynamics.codegen.compiled import compiled
from ...machine import Machine
from ..delays import longest_delay


class ActuatorModel:
    """Convert actions to the input voltages of the simulated motors, with D/A converters and dead times.

    Args:
        count: Number of environments.
        column: Function that takes the full name of a parameter ("motor1.converter_bits") and returns its
            column in the argument `values` of `begin`.
        period: Control period, s.
        steps: Integration steps per control period.
        delayed: Whether any drive has a dead time.

    Attributes:
        inputs: Input voltages of the simulation, V, in lanes. Shape (blocks, drives, LANES), constant over a
            control period; if a drive has a dead time, (blocks, steps * drives, LANES), one set of drives per
            integration step.
        delays: Dead times, s, shape (blocks, drives, LANES). The simulator writes them at reset.
    """

    def __init__(
        self,
        machine: Machine,
        count: int,
        column: Callable[[str], int],
        *,
        period: float,
        steps: int,
        delayed: bool,
    ) -> None:
        self._period, self._steps = period, steps
        drives, blocks = len(machine.drives), -(-count // LANES)
        self._rated = np.array([d.rated_voltage for d in machine.drives])
        self._columns = np.array(
            [
                [column(f"{d.name}.{key}") for key in ("converter_bits", "voltage_range")]
                for d in machine.drives
            ]
        )
        # Quantum (0: continuous), lowest and highest voltage of the converters, V.
        self._converters = np.zeros((blocks, 3 * drives, LANES))
        self._quantized = False
        self.inputs = np.zeros((blocks, (steps if delayed else 1) * drives, LANES))
        self.delays = np.zeros((blocks, drives, LANES))
        # Voltages commanded in this period (0) and in those before, V.
        dead_time = longest_delay(machine, (d.name for d in machine.drives), "delay")
        periods = 2 + math.ceil(dead_time / period) if delayed else 0
        self._history = np.zeros((blocks, periods, drives, LANES))
        self._commanded = np.zeros((blocks, drives, LANES)) if delayed else None

    def begin(self, index: Index, values: EnvironmentParameters) -> None:
        """Begin new episodes of k environments: set their D/A converters, and all earlier voltages to 0 V.

        A drive with a dead time therefore applies 0 V until this time has passed.
        """
        self._quantized |= _set_converters(index, values, self._columns, self._converters)
        if self._commanded is not None:  # without dead time there is no history
            block, lane = np.divmod(index, LANES)
            self._history[block, :, :, lane] = 0.0

    def begin_period(self) -> None:
        """Make room for the voltages of a new period in the history, from which dead times are simulated.

        Call it once per control period, before `command`. Without dead times, there is no history and nothing
        happens.
        """
        if self._commanded is not None:  # without dead time nothing reads the history
            self._history[:, 1:] = self._history[:, :-1]

    def command(self, actions: NDArray[Any], first: int, last: int, clipped: EnvironmentCounts) -> None:
        """Compute the motor voltages of a control period for blocks first to last - 1, into `inputs`.

        An action is multiplied by the drive's rated voltage and rounded and limited by its D/A converter. A
        drive with a dead time gets the result exactly that much later, as the mean of each integration step
        if it arrives within one.

        Args:
            actions: Voltages as fractions of the rated voltages, shape (environments, drives); limited to
                [-1, 1] here.
            clipped: Number of action entries outside [-1, 1] since the reset; increased here.
        """
        commanded = self.inputs if self._commanded is None else self._commanded
        _convert(actions, self._rated, self._converters, self._quantized, first, last, commanded, clipped)
        if self._commanded is None:
            return
        self._history[first:last, 0] = self._commanded[first:last]
        _delay(self._history, self.delays, self._period, self._period / self._steps, first, last, self.inputs)


@compiled
def _set_converters(index: Any, values: Any, columns: Any, converters: Any) -> bool:
    """Write quantum, lowest, highest voltage of environments (k,) to converters (blocks, 3 drives, LANES), V.

    values (k, N): parameters; columns (drives, 2): those of the bits and of the voltage range. Return whether
    any converter has levels.
    """
    quantized = False
    for i in range(index.shape[0]):
        block, lane = index[i] // LANES, index[i] % LANES
        for k in range(columns.shape[0]):
            bits, largest = values[i, columns[k, 0]], values[i, columns[k, 1]]
            quantum = 2.0 * largest / math.ldexp(1.0, int(bits)) if bits > 0.0 else 0.0
            quantized = quantized or bits > 0.0
            converters[block, 3 * k, lane] = quantum
            # Two's complement: there is one level less above zero.
            converters[block, 3 * k + 1, lane] = -largest
            converters[block, 3 * k + 2, lane] = largest - quantum
    return quantized


@compiled
def _convert(
    actions: Any,
    rated: Any,
    converters: Any,
    quantized: bool,
    first: int,
    last: int,
    volts: Any,
    clipped: Any,
) -> None:
    """Write volts (blocks, drives, LANES) of actions (B, drives), and the entries outside [-1, 1] in clipped.

    rated (drives,) V; converters (blocks, 3 drives, LANES): quantum, lowest and highest voltage, V.
    """
    fractions = np.empty((actions.shape[1], LANES))
    for block in range(first, last):
        read_block(actions, block * LANES, fractions)
        for k in range(actions.shape[1]):
            for lane in range(LANES):
                value = min(1.0, max(-1.0, fractions[k, lane])) * rated[k]
                if quantized:
                    quantum = converters[block, 3 * k, lane]
                    value = np.rint(value / quantum) * quantum if quantum > 0.0 else value
                value = max(converters[block, 3 * k + 1, lane], value)
                volts[block, k, lane] = min(converters[block, 3 * k + 2, lane], value)
            for lane in range(min(LANES, len(clipped) - block * LANES)):
                clipped[block * LANES + lane] += abs(fractions[k, lane]) > 1.0


@compiled
def _delay(history: Any, delays: Any, period: float, h: float, first: int, last: int, inputs: Any) -> None:
    """Write the mean voltage of each step of a control period to inputs (blocks, steps * drives, LANES).

    history (blocks, periods, drives, LANES): volts of this period (0), the one before (1), ...; delays
    (blocks, drives, LANES) s. A step h is not longer than the period, so that at most two commanded voltages
    arrive during it.
    """
    drives = history.shape[2]
    oldest = history.shape[1] - 1
    for block in range(first, last):
        for row in range(inputs.shape[1]):
            k = row % drives
            for lane in range(LANES):
                begin = (row // drives) * h - delays[block, k, lane]
                older = min(oldest, max(0, math.ceil(-begin / period)))
                newer = min(oldest, max(0, math.ceil(-(begin + h) / period)))
                value = history[block, older, k, lane]
                if newer != older:
                    fraction = min(1.0, max(0.0, (begin + h + newer * period) / h))
                    value = (1.0 - fraction) * value + fraction * history[block, newer, k, lane]
                inputs[block, row, lane] = value
