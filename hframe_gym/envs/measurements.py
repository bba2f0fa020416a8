"""Simulation of sensors for a batch of environments: delay, noise, quantization and range.

An ideal reading is the output of a sensor in its unit, without noise and quantization, as the compiled simulation
kernel (generated code) computes it. Readings have the kernel's SIMD layout (blocks, sensors, LANES): environment b is
lane b % LANES of block b // LANES. A measurement includes noise, quantization and range.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..dynamics import LANES
from ..machine import SENSOR_KINDS, Machine, Sensor, SensorKind
from .random_numbers import compiled, normal_pair, normal_pairs
from .sensors import sensor_range_names

Array = NDArray[np.float64]
Index = NDArray[np.intp]
# First channel of the random numbers of sensor kinds whose formula is not the default one.
_FIRST_CUSTOM_CHANNEL = 1 << 20


class SensorArray:
    """Turn ideal readings into measurements with noise, quantization and range; keep the last two for differences.

    An ideal reading is the output of a sensor without noise and quantization, as the simulation computes it. Readings
    are stored in blocks of LANES environments: environment b is lane b % LANES (8 or 16) of block b // LANES.

    Args:
        machine: Machine that declares the sensors.
        sensors: The n sensors to measure.
        count: Number of environments.
        column: Function that returns the column of a parameter in the `values` of `begin`, given its full name.

    Attributes:
        measurements: Last measurement (row 0) and the one before (row 1), in the channels' units, shape (2, n, count).
        low: Lower end of each sensor's range, in the channels' units, -inf without a range, shape (n, count).
        high: Upper end of each sensor's range, in the channels' units, inf without a range, shape (n, count).
    """

    def __init__(self, machine: Machine, sensors: tuple[Sensor, ...], count: int, column: Callable[[str], int]) -> None:
        channels = list(machine.output_channels)
        self._rows = np.array([channels.index(s.channel) for s in sensors], np.intp)
        self._device_columns = [[column(f"{s.channel}.{key}") for key in ("noise", "resolution")] for s in sensors]
        names = [sensor_range_names(s) for s in sensors]
        limited = [low in machine.parameters for low, _ in names]
        self._range_columns = [
            [column(name) for name in pair] if has else None for pair, has in zip(names, limited, strict=True)
        ]
        kinds = [SENSOR_KINDS.get(s.kind) for s in sensors]
        self._custom = {j: kind for j, kind in enumerate(kinds) if kind.measure is not SensorKind.measure}
        size = (len(sensors), count)
        self._noise, self._resolution = np.zeros(size), np.zeros(size)
        self.low, self.high = np.full(size, -np.inf), np.full(size, np.inf)
        self._keys = np.zeros(count, np.uint64)
        self.measurements = np.zeros((2, *size))

    def begin(self, index: Index, keys: NDArray[np.uint64], values: Array) -> None:
        """Read noise, resolution and range of the sensors from the parameters of k environments' new episodes.

        Args:
            index: Indices of the environments, shape (k,).
            keys: Keys (seeds) of the episodes, from which their random numbers follow, uint64, shape (k,).
            values: All N parameters of these environments in the order of `ParameterSpace.names`, SI, shape (k, N).
        """
        self._keys[index] = keys
        for j, (noise, resolution) in enumerate(self._device_columns):
            self._noise[j, index], self._resolution[j, index] = values[:, noise], values[:, resolution]
            limits = self._range_columns[j]
            if limits is not None:
                self.low[j, index], self.high[j, index] = values[:, limits[0]], values[:, limits[1]]

    def measure(self, readings: Array, index: Index, elapsed: NDArray[np.int64], *, fresh: bool) -> None:
        """Turn ideal readings of k environments into measurements, with noise, quantization and range.

        They are stored in row 0 of the attribute `measurements`; the previous ones move to row 1.

        Args:
            readings: Ideal (noise-free) readings of all sensors of the machine, delays included, m or rad, shape
                (blocks, sensors, LANES): environment b is lane b % LANES (8 or 16) of block b // LANES.
            index: Indices of the environments, shape (k,).
            elapsed: Control periods since the reset of each of the `count` environments, shape (count,); they select
                the random numbers.
            fresh: Whether this is the first measurement of an episode; it is then stored in both rows.
        """
        # Sensor kinds with a formula of their class replace what the compiled default wrote.
        devices = self._noise, self._resolution, self.low, self.high
        _measure(readings, self._rows, *devices, self._keys, elapsed, index, fresh, self.measurements)
        for j, kind in self._custom.items():
            ideal, normals = np.empty(len(index)), np.empty(len(index))
            channel = _FIRST_CUSTOM_CHANNEL + 2 * j
            _ideal_and_normal(readings, self._rows[j], self._keys, elapsed, index, channel, ideal, normals)
            value = kind.measure(ideal, self._noise[j, index], self._resolution[j, index], normals)
            self.measurements[0, j, index] = np.clip(value, self.low[j, index], self.high[j, index])
            if fresh:
                self.measurements[1, j, index] = self.measurements[0, j, index]


@compiled
def _measure(
    readings: Any,
    rows: Any,
    noise: Any,
    resolution: Any,
    low: Any,
    high: Any,
    keys: Any,
    elapsed: Any,
    index: Any,
    fresh: bool,
    measurements: Any,
) -> None:
    """Write measurements (2, n, B) of environments index (k,) from readings (blocks, sensors, LANES).

    A measurement is the reading plus noise, rounded to the resolution (0: not), each (n, B). A reading at an end of the
    range low, high (n, B) has no noise, and noise does not lead out of the range.
    """
    # A step measures all environments of some blocks, in loops that the compiler vectorizes; a reset any of them.
    begin = 0
    while begin < len(index):
        end = begin + 1
        while end < len(index) and index[end] == index[end - 1] + 1:
            end += 1
        run = slice(index[begin], index[end - 1] + 1)
        count = end - begin
        values, normals, spares, has_spare = (
            np.empty(count),
            np.empty(count),
            np.empty(count),
            np.zeros(count, np.bool_),
        )
        for j in range(rows.shape[0]):
            _read(readings, rows[j], index[begin], values)
            if _next_normals(noise[j, run], keys[run], elapsed[run], j, normals, spares, has_spare):
                _add_noise(noise[j, run], normals, low[j, run], high[j, run], values)
            _round(resolution[j, run], low[j, run], high[j, run], values)
            measurements[1, j, run] = values if fresh else measurements[0, j, run]
            measurements[0, j, run] = values
        begin = end


@compiled
def _read(readings: Any, row: int, first: int, values: Any) -> None:
    """Write the readings (blocks, sensors, LANES) of one sensor, environments from first on, to values (k,)."""
    for i in range(len(values)):
        values[i] = readings[(first + i) // LANES, row, (first + i) % LANES]


@compiled
def _next_normals(noise: Any, keys: Any, elapsed: Any, channel: int, normals: Any, spares: Any, has_spare: Any) -> bool:
    """Write a normal number for each environment to normals (k,) if the sensor has noise (k,); return whether it has.

    Normal numbers come in pairs. The second of a pair, in spares (k,) where has_spare (k,), is for the next sensor with
    noise of the environment.
    """
    noisy = new = 0
    for i in range(len(noise)):
        noisy += noise[i] > 0.0
        new += (noise[i] > 0.0) & (not has_spare[i])
    if new > 0:
        seconds = np.empty(len(noise))
        normal_pairs(keys, elapsed, channel, normals, seconds)
        for i in range(len(noise)):
            normals[i] = spares[i] if has_spare[i] else normals[i]
            spares[i] = spares[i] if has_spare[i] else seconds[i]
    elif noisy > 0:
        normals[:] = spares
    for i in range(len(noise)):
        has_spare[i] = has_spare[i] != (noise[i] > 0.0)
    return noisy > 0


@compiled
def _add_noise(noise: Any, normals: Any, low: Any, high: Any, values: Any) -> None:
    """Add noise (k,) times normals (k,) to values (k,) that are strictly inside low, high (k,)."""
    for i in range(len(values)):
        inside = (low[i] < values[i]) & (values[i] < high[i]) & (noise[i] > 0.0)
        values[i] = values[i] + noise[i] * normals[i] if inside else values[i]


@compiled
def _round(resolution: Any, low: Any, high: Any, values: Any) -> None:
    """Round values (k,) to the resolution (k,), where it is not 0, and limit them to low, high (k,)."""
    for i in range(len(values)):
        rounded = np.rint(values[i] / resolution[i]) * resolution[i]
        values[i] = rounded if resolution[i] > 0.0 else values[i]
    for i in range(len(values)):
        values[i] = min(high[i], max(low[i], values[i]))


@compiled
def _ideal_and_normal(
    readings: Any, row: int, keys: Any, elapsed: Any, index: Any, channel: int, ideal: Any, normals: Any
) -> None:
    """Write the ideal readings (k,) of one sensor and a normal number (k,) for each of environments index (k,)."""
    for i in range(index.shape[0]):
        b = index[i]
        ideal[i] = readings[b // LANES, row, b % LANES]
        normals[i], _ = normal_pair(keys[b], elapsed[b], channel)


class DelayLine:
    """Keep a history of ideal readings, one entry per integration step, for sensors with a delay.

    An ideal reading is the output of a sensor without noise and quantization. Environment b is lane b % LANES of block
    b // LANES of the arrays.

    Args:
        machine: Machine with its sensors and their delays, which are effects.
        blocks: Number of blocks of LANES environments.
        h: Integration step, s.

    Attributes:
        delays: Delay of each sensor, s, shape (blocks, sensors, LANES). The simulator writes them at reset.
    """

    def __init__(self, machine: Machine, blocks: int, h: float) -> None:
        self._h = h
        sensors = len(machine.sensors)
        self._depth = math.ceil(_longest_delay(machine) / h) + 3
        self._history = np.zeros((blocks, self._depth, sensors, LANES))
        self.delays = np.zeros((blocks, sensors, LANES))

    def fill(self, index: Index, readings: Array) -> None:
        """Fill the histories of k environments with their present readings, as if they had always been at rest.

        Args:
            index: Indices of the environments, ascending, shape (k,).
            readings: Ideal (noise-free) readings at the start of the episode, without delay, m or rad, shape
                (blocks, sensors, LANES): environment b is lane b % LANES (8 or 16) of block b // LANES.
        """
        block, lane = np.divmod(index, LANES)
        self._history[block, :, :, lane] = readings[block, :, lane][:, None]

    def record(self, readings: Array, step: int, first: int, last: int) -> None:
        """Store the readings of blocks first to last - 1 after an integration step, in place of the oldest ones.

        Args:
            readings: Ideal (noise-free) readings without delay, m or rad, shape (blocks, sensors, LANES).
            step: Number of the integration step, counted over all episodes and the same for all environments.
            first: Index of the first block of LANES environments.
            last: Index after the last block.
        """
        self._history[first:last, step % self._depth] = readings[first:last]

    def read(self, step: int, first: int, last: int, out: Array) -> None:
        """Write the delayed readings of blocks first to last - 1 to `out`.

        They are interpolated in the history at the present time minus the delay of each sensor. Before the start of
        the episode, readings are those at its start.

        Args:
            step: Number of the integration step that `record` stored last.
            first: Index of the first block of LANES environments.
            last: Index after the last block.
            out: Output, delayed noise-free readings, m or rad, shape (blocks, sensors, LANES).
        """
        _interpolate(self._history, self.delays, self._h, step, first, last, out)


def _longest_delay(machine: Machine) -> float:
    """Return the longest delay that a sensor can have within the bounds of its effects, s."""
    longest = [0.0]
    for sensor in machine.sensors:
        definitions = [e.definition for e in machine.effects if e.site == sensor.channel]
        delays = (d.measurement_delay(*(p.upper for p in d.parameters)) for d in definitions if d.measurement_delay)
        longest.append(sum(map(float, delays)))
    return max(longest)


@compiled
def _interpolate(history: Any, delays: Any, h: float, step: int, first: int, last: int, out: Any) -> None:
    """Write readings at time step * h - delay by a parabola through the three nearest records, to out."""
    depth = history.shape[1]
    for block in range(first, last):
        for j in range(out.shape[1]):
            for lane in range(LANES):
                back = min(delays[block, j, lane] / h, depth - 2.0)
                if back <= 0.0:
                    out[block, j, lane] = history[block, step % depth, j, lane]
                    continue
                middle = max(1, int(back + 0.5))
                u = middle - back  # in steps, towards the present
                newer = history[block, (step - middle + 1) % depth, j, lane]
                here = history[block, (step - middle) % depth, j, lane]
                older = history[block, (step - middle - 1) % depth, j, lane]
                out[block, j, lane] = here + 0.5 * u * (newer - older) + 0.5 * u * u * (newer - 2.0 * here + older)
