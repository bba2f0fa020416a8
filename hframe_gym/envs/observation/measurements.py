"""Simulation of sensors for a batch of environments: noise, quantization and range; `delays` has their delay.

An ideal reading is the output of a sensor in its unit, without noise and quantization, as the compiled
simulation kernel (generated code) computes it. Readings have the kernel's SIMD layout (blocks, sensors,
LANES): environment b is lane b % LANES of block b // LANES. A measurement includes noise, quantization and
range.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...arrays import Array, EnvironmentCounts, EnvironmentParameters, EpisodeKeys, Index, LaneReadings
from ...dynamics import LANES
from ...dynamics.codegen.compiled import compiled
from ...dynamics.codegen.lane_program import LaneProgram
from ...dynamics.codegen.native_calls import call_at
from ...machine import SENSOR_KINDS, Machine, Sensor, SensorKind
from ..randomization.random_numbers import normal_pair, normal_pairs
from .sensors import sensor_range_names

# First channel of the random numbers of sensor kinds whose formula is not the default one.
_FIRST_CUSTOM_CHANNEL = 1 << 20


class SensorArray:
    """Turn ideal readings into measurements with noise, quantization and range; store the last two.

    Args:
        sensors: The n sensors to measure.
        count: Number of environments.
        column: Function that takes the full name of a parameter ("x_m.noise") and returns its column in the
            argument `values` of `begin`.

    Attributes:
        measurements: Last measurements (row 0) and those before (row 1), m or rad,
            shape (2, blocks, n, LANES).
        low: Lower end of each sensor's range, in the channels' units, -inf without a range,
            shape (blocks, n, LANES).
        high: Upper end, inf without a range, shape (blocks, n, LANES).
    """

    def __init__(
        self, machine: Machine, sensors: tuple[Sensor, ...], count: int, column: Callable[[str], int]
    ) -> None:
        channels = list(machine.output_channels)
        self._rows = np.array([channels.index(s.channel) for s in sensors], np.intp)
        self._program = _measurement_program(self._rows.tolist())
        self._device_columns = [
            [column(f"{s.channel}.{key}") for key in ("noise", "resolution")] for s in sensors
        ]
        names = [sensor_range_names(s) for s in sensors]
        limited = [low in machine.parameters for low, _ in names]
        self._range_columns = [
            [column(name) for name in pair] if has else None for pair, has in zip(names, limited, strict=True)
        ]
        kinds = [SENSOR_KINDS.get(s.kind) for s in sensors]
        self._custom = {j: kind for j, kind in enumerate(kinds) if kind.measure is not SensorKind.measure}
        size = (-(-count // LANES), len(sensors), LANES)
        self._noise, self._resolution = np.zeros(size), np.zeros(size)
        self.low, self.high = np.full(size, -np.inf), np.full(size, np.inf)
        self._keys = np.zeros(count, np.uint64)
        self.measurements = np.zeros((2, *size))

    def begin(self, index: Index, keys: EpisodeKeys, values: EnvironmentParameters) -> None:
        """Begin new episodes of k environments: set the sensors' noise, resolution, range and random keys."""
        self._keys[index] = keys
        block, lane = np.divmod(index, LANES)
        for j, (noise, resolution) in enumerate(self._device_columns):
            self._noise[block, j, lane] = values[:, noise]
            self._resolution[block, j, lane] = values[:, resolution]
            limits = self._range_columns[j]
            if limits is not None:
                self.low[block, j, lane] = values[:, limits[0]]
                self.high[block, j, lane] = values[:, limits[1]]

    def measure(self, readings: LaneReadings, elapsed: EnvironmentCounts, first: int, last: int) -> None:
        """Turn ideal readings, delays included, of environments in blocks first..last-1 into measurements.

        They are stored in row 0 of the attribute `measurements`; the previous ones move to row 1. The number
        of `elapsed` control periods since the reset selects the random numbers.
        """
        self._measure(readings, elapsed, first, last, *self.measurements)

    def measure_first(
        self,
        readings: LaneReadings,
        elapsed: EnvironmentCounts,
        index: Index,
        block_ranges: Iterable[tuple[int, int]],
    ) -> None:
        """Take the first measurements in new episodes of k environments.

        They are put in both rows of `measurements`, so that rates are zero; other environments keep theirs.

        Args:
            readings: Ideal readings at the start, delays included.
            elapsed: Number of control periods since the reset; it selects the random numbers.
            index: The k environments.
            block_ranges: Their blocks, as `batched_simulator.block_ranges` returns them.
        """
        measured, unused = np.empty_like(self.measurements)
        for first, last in block_ranges:
            self._measure(readings, elapsed, first, last, measured, unused)
        block, lane = np.divmod(index, LANES)
        self.measurements[:, block, :, lane] = measured[block, :, lane][:, None]

    def _measure(
        self, readings: Array, elapsed: NDArray[np.int64], first: int, last: int, out: Array, before: Array
    ) -> None:
        """Write measurements of blocks first..last-1 to out (blocks, n, LANES), what was there to before."""
        devices = self._noise, self._resolution, self.low, self.high
        _measure(
            self._program.addresses["measure"],
            readings,
            devices,
            self._keys,
            elapsed,
            first,
            last,
            out,
            before,
        )
        if not self._custom:
            return
        # Sensor kinds with a formula of their class replace what the compiled default wrote.
        index = np.arange(first * LANES, min(last * LANES, len(elapsed)))
        block, lane = np.divmod(index, LANES)
        for j, kind in self._custom.items():
            ideal, normals = np.empty(len(index)), np.empty(len(index))
            channel = _FIRST_CUSTOM_CHANNEL + 2 * j
            _ideal_and_normal(readings, self._rows[j], self._keys, elapsed, index, channel, ideal, normals)
            noise, resolution, low, high = (values[block, j, lane] for values in devices)
            out[block, j, lane] = np.clip(kind.measure(ideal, noise, resolution, normals), low, high)


def _measurement_program(rows: Sequence[int]) -> LaneProgram:
    """Compile the function that turns the readings in some rows into measurements.

    A measurement is the reading plus noise, rounded to the resolution (0: not rounded). A reading at an end
    of the range has no noise, and noise does not lead out of the range.
    """
    lines = []
    for j, row in enumerate(rows):
        lines += [
            f"reading_{j} = load(readings, {row})",
            f"size_{j} = load(noise, {j})",
            f"inside_{j} = (load(low, {j}) < reading_{j}) "
            f"& (reading_{j} < load(high, {j})) & (size_{j} > 0.0)",
            f"noisy_{j} = where(inside_{j}, reading_{j} + size_{j} * load(normals, {j}), reading_{j})",
            f"quantum_{j} = load(resolution, {j})",
            f"rounded_{j} = where(quantum_{j} > 0.0, rint(noisy_{j} / quantum_{j}) * quantum_{j}, noisy_{j})",
            f"store(before, {j}, load(now, {j}))",
            f"store(now, {j}, minimum(maximum(rounded_{j}, load(low, {j})), load(high, {j})))",
        ]
    head = "def measure(readings, normals, noise, resolution, low, high, now, before):"
    return LaneProgram("\n    ".join([head, *lines]) + "\n", ("measure",))


@compiled
def _measure(
    program: int,
    readings: Any,
    devices: Any,
    keys: Any,
    elapsed: Any,
    first: int,
    last: int,
    out: Any,
    before: Any,
) -> None:
    """Write measurements of blocks first..last-1 to out (blocks, n, LANES), the former ones to before.

    program: address of the function of `_measurement_program`; readings (blocks, sensors, LANES); devices:
    noise, resolution, low and high end of the range, (blocks, n, LANES) each.
    """
    noise, resolution, low, high = devices
    normals = _normals(noise, keys, elapsed, first, last)
    for b in range(first, last):
        devices_b = noise[b], resolution[b], low[b], high[b]
        call_at(program, readings[b], normals[b - first], *devices_b, out[b], before[b])


@compiled
def _normals(noise: Any, keys: Any, elapsed: Any, first: int, last: int) -> Any:
    """Return normal numbers (last - first, n, LANES) for sensors with noise (blocks, n, LANES), else zero."""
    begin, count = first * LANES, min(last * LANES, len(elapsed)) - first * LANES
    run = slice(begin, begin + count)
    out = np.zeros((last - first, noise.shape[1], LANES))
    sizes = np.empty(count)
    normals = np.empty(count)
    spares = np.empty(count)
    has_spare = np.zeros(count, np.bool_)
    for j in range(noise.shape[1]):
        for i in range(count):
            sizes[i] = noise[first + i // LANES, j, i % LANES]
        if _next_normals(sizes, keys[run], elapsed[run], j, normals, spares, has_spare):
            for i in range(count):
                out[i // LANES, j, i % LANES] = normals[i]
    return out


@compiled
def _next_normals(
    noise: Any, keys: Any, elapsed: Any, channel: int, normals: Any, spares: Any, has_spare: Any
) -> bool:
    """Write a normal number per environment to normals (k,); return False if no sensor has noise (k,).

    Normal numbers come in pairs. The second of a pair, in spares (k,) where has_spare (k,), is for the next
    sensor with noise of the environment.
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
        for i in range(len(noise)):
            normals[i] = spares[i]
    for i in range(len(noise)):
        has_spare[i] = has_spare[i] != (noise[i] > 0.0)
    return noisy > 0


@compiled
def _ideal_and_normal(
    readings: Any, row: int, keys: Any, elapsed: Any, index: Any, channel: int, ideal: Any, normals: Any
) -> None:
    """Write ideal readings (k,) of one sensor and a normal number (k,) for environments index (k,)."""
    for i in range(index.shape[0]):
        b = index[i]
        ideal[i] = readings[b // LANES, row, b % LANES]
        normals[i], _ = normal_pair(keys[b], elapsed[b], channel)
