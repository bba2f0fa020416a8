"""Actions and actuators: conversion of actions to motor voltages, with D/A converters, dead time and current limit.

The machine declares the D/A converter of each drive (bits, voltage range). Dead time and current limit are effects of
the machine (modeled deviations from the basic model), `input_delay` and `current_limit`. `ActuatorModel` simulates
converters and dead times; the compiled simulation kernel (code generated for a machine) simulates the current limit.
Batches are stored in the kernel's SIMD layout: environment b is lane b % LANES of block b // LANES.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from ..arrays import EnvironmentCounts, EnvironmentParameters, Index
from ..dynamics import LANES
from ..dynamics.codegen.blocks import read_block
from ..dynamics.codegen.compiled import compiled
from ..effects import EFFECTS
from ..errors import InputError, is_integer, is_number, suggestion
from ..machine import Machine
from .delays import longest_delay


@dataclass(frozen=True)
class Actuators:
    """D/A converter, current limit and dead time of all drives. They replace the converters that the machine declares.

    Args:
        bits: Resolution of the D/A converter, an integer from 1 to 32: it has 2**bits levels from -range_V to range_V;
            None: not quantized.
        range_V: Voltage range of the converter, V; None: the rated voltage.
        current_limit: Largest current in either direction, A; None: only the machine's limits. The amplifier lowers
            the voltage V so that |V - Ke N w| / R stays within the limit (back-EMF constant Ke, gear ratio N, pulley
            speed w, resistance R). A smaller limit of the machine remains.
        delay: Dead time between action and voltage, s.

    Raises:
        InputError: If a number is invalid.
    """

    bits: int | None = None
    range_V: float | None = None
    current_limit: float | None = None
    delay: float = 0.0

    def __post_init__(self) -> None:
        if self.bits is not None and not (is_integer(self.bits) and 1 <= self.bits <= 32):
            raise InputError(f"drives: bits is {self.bits!r}, it must be an integer from 1 to 32 or None")
        for name in ("range_V", "current_limit"):
            value = getattr(self, name)
            if value is not None and not (is_number(value) and value > 0.0):
                raise InputError(f"drives: {name} is {value!r}, it must be a positive number or None")
        if not (is_number(self.delay) and 0.0 <= self.delay <= 0.1):
            raise InputError(f"drives: delay is {self.delay!r}, it must be a number from 0 to 0.1 s")

    def apply(self, machine: Machine) -> Machine:
        """Return a copy of a machine whose drives have this D/A converter, current limit and dead time.

        `bits` and `range_V` replace the converter of every drive. `current_limit` becomes the effect of this
        name, unless a drive has a smaller limit already; `delay` becomes the effect `input_delay`.

        Raises:
            InputError: If the machine has an input delay already and `delay` is not 0.
        """
        drives = [
            dataclasses.replace(d, converter_bits=self.bits or 0, voltage_range=self.range_V)
            for d in machine.drives
        ]
        machine = machine.replace(drives=tuple(drives))
        if self.current_limit is not None:
            for drive in machine.drives:
                machine = _with_current_limit(machine, drive.name, self.current_limit)
        if self.delay == 0.0:
            return machine
        present = [e.label for e in machine.effects if e.definition.delay]
        if present:
            raise InputError(
                f"drives: machine {machine.name!r} has a dead time already ({', '.join(present)}); leave delay at 0"
            )
        return machine.with_effects(EFFECTS["input_delay"].at("drives", d=self.delay))


def _with_current_limit(machine: Machine, drive: str, limit: float) -> Machine:
    """Return the machine with a current limit of a drive, A, or the smaller one that it has already."""
    effect = EFFECTS["current_limit"].at(drive, I=limit)
    name = f"{effect.label}.I"
    if name in machine.parameters:
        return machine.replace({name: min(limit, machine.parameters[name])})
    return machine.with_effects(effect)


# Section II of Sollmann et al. (2010): a 12-bit converter and amplifiers of type A12. The paper gives no current limit;
# 12 A is the peak current of amplifiers of this name. At standstill 12 V would drive 17 A.
ACTUATOR_PRESETS: dict[str, Actuators | None] = {
    "ideal": Actuators(),
    "rig": Actuators(bits=12, current_limit=12.0),
    "machine": None,
}
_FLOAT32 = np.dtype(np.float32)
ActuatorsLike: TypeAlias = Literal["ideal", "rig", "machine"] | Actuators


def with_actuators(machine: Machine, drives: ActuatorsLike) -> Machine:
    """Return a copy of a machine with converters, current limits and dead time that an environment adds to it.

    The machine keeps a dead time that it already has, and a current limit that is smaller than that of `drives`.

    Args:
        drives: What to add: `Actuators`, or a name of `ACTUATOR_PRESETS`. With "machine", nothing is added, and the
            machine itself is returned.

    Raises:
        InputError: If `drives` is invalid, or both the machine and `drives` have a dead time.
    """
    if isinstance(drives, Actuators):
        return drives.apply(machine)
    if not isinstance(drives, str) or drives not in ACTUATOR_PRESETS:
        raise InputError(
            f"drives is {drives!r}; choose one of {', '.join(ACTUATOR_PRESETS)}, or give Actuators(...)"
            f"{suggestion(drives, ACTUATOR_PRESETS)}"
        )
    preset = ACTUATOR_PRESETS[drives]
    return machine if preset is None else preset.apply(machine)


def action_space(machine: Machine) -> spaces.Box:
    """Create the action space: the voltage of each drive as a fraction of its rated voltage."""
    return spaces.Box(-1.0, 1.0, (len(machine.drives),), np.float32)


def check_actions(actions: Any, shape: tuple[int, int], machine: Machine) -> NDArray[Any]:
    """Check that actions have the required shape (environments, drives) and are finite; convert them to floats.

    They may exceed [-1, 1]; the actuators limit them. float32 stays float32, all others become float64.

    Raises:
        ValueError: If actions are not numbers, have another shape, or an entry is not finite.
    """
    values = np.ascontiguousarray(actions)
    if values.dtype != _FLOAT32:
        if values.dtype.kind not in "fiub":
            raise ValueError(f"actions have the type {values.dtype}, they must be numbers")
        values = values.astype(np.float64, copy=False)
    if values.shape != shape:
        raise ValueError(f"actions have shape {values.shape}, they must have {shape}")
    if not _all_finite(values):
        b, k = np.argwhere(~np.isfinite(values))[0].tolist()
        raise ValueError(f"action of environment {b}, {machine.drives[k].name}: {values[b, k]} is not finite")
    return values


@compiled
def _all_finite(actions: Any) -> bool:
    """Return whether all entries of actions (B, drives) are finite."""
    values, bad = actions.reshape(-1), 0
    for i in range(len(values)):  # without an exit at the first one, so that the compiler vectorizes the loop
        bad += not abs(values[i]) < math.inf
    return bad == 0


class ActuatorModel:
    """Convert actions to the input voltages of the simulated motors, with D/A converters and dead times.

    Args:
        count: Number of environments.
        column: Function that takes the full name of a parameter ("motor1.converter_bits") and returns its column in the
            argument `values` of `begin`.
        period: Control period, s.
        steps: Integration steps per control period.
        delayed: Whether any drive has a dead time.

    Attributes:
        inputs: Input voltages of the simulation, V, in lanes. Shape (blocks, drives, LANES), constant over a control
            period; if a drive has a dead time, (blocks, steps * drives, LANES), one set of drives per integration step.
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
        """Make room for the voltages of a new control period in the history from which dead times are simulated.

        Call it once per control period, before `command`. Without dead times there is no history: nothing happens.
        """
        if self._commanded is not None:  # without dead time nothing reads the history
            self._history[:, 1:] = self._history[:, :-1]

    def command(self, actions: NDArray[Any], first: int, last: int, clipped: EnvironmentCounts) -> None:
        """Convert actions to the motor voltages of one control period, for blocks first to last - 1, in `inputs`.

        Args:
            actions: Voltages as fractions of the rated voltages, shape (environments, drives); limited to [-1, 1] here.
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
    """Write quantum, lowest and highest voltage of environments index (k,) to converters (blocks, 3 drives, LANES), V.

    values (k, N): parameters; columns (drives, 2): those of the bits and of the voltage range. Return whether any
    converter has levels.
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
    """Write volts (blocks, drives, LANES) of actions (B, drives), and count entries outside [-1, 1] in clipped (B,).

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
    """Write the mean voltage that arrives in each step of a control period to inputs (blocks, steps * drives, LANES).

    history (blocks, periods, drives, LANES): volts of this period (0), the one before (1), ...; delays (blocks, drives,
    LANES) s. A step h is not longer than the period, so that at most two commanded voltages arrive during it.
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
