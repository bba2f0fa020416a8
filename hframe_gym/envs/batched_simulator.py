"""A batch of stages: their state, their own parameters, and one control period of them all.  No tasks, no gym.

Stages share a machine's shape and differ in numbers.  State and parameters live in the kernel's blocks of lanes
(blocks, rows, LANES) from one step to the next, positions and velocities as belt travel, m and m/s.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..dynamics import NotFiniteError
from ..dynamics.kernel import in_blocks, kernel_for
from ..dynamics.simd import LANES
from ..dynamics.simulation import in_parallel
from ..machine import Machine, rest_state
from . import simd_layout as blocks
from .actuator_presets import IDEAL, Actuators
from .actuators import ActuatorModel
from .end_stops import with_end_stops
from .parameter_index import column, per_travel

Array = NDArray[np.float64]
Index = NDArray[np.intp]
# Fewer blocks than this finish before a second thread has started.
BLOCKS_FOR_THREADS = 64


class View(NamedTuple):
    """What `BatchedSimulator.observe` reads.  entries (n, 4) as for `blocks.observe`; box (2, n): low, high, own units."""

    entries: Index
    box: Array


class BatchedSimulator:
    """`count` stages of one machine.

    period: of control, s; voltages are held that long.  longest_step: of the integrator, s.  drives: converter and
    current limit (their dead time is an effect of the machine).  end_stops: whether x and y end at buffers where their
    range does.

    Raises ValueError for a period or step that is not positive.
    """

    def __init__(
        self,
        machine: Machine,
        count: int,
        *,
        period: float,
        longest_step: float,
        drives: Actuators = IDEAL,
        end_stops: bool = False,
    ) -> None:
        for name, value in (("period", period), ("longest_step", longest_step)):
            if not (np.isfinite(value) and value > 0.0):
                raise ValueError(f"{name} is {value!r}, it must be a positive number of seconds")
        self.machine = machine
        self.count = count
        self.period = period
        self.steps = max(1, int(np.ceil(period / longest_step - 1e-6)))
        self.h = period / self.steps
        self.blocks = -(-count // LANES)
        self._n = len(machine.coordinates)
        self._tool = [machine.coordinate_names.index(name) for name in ("x", "y")]
        # Travel of every coordinate at rest, unstretched, per metre of x and of y.
        self._rest = np.stack([self._rest_travel(name) for name in ("x", "y")], axis=1)
        # What is stepped: the machine, perhaps with end stops; their numbers come last and never change.
        self._stepped = with_end_stops(machine) if end_stops else machine
        self._kernel = kernel_for(self._stepped)
        self.state = np.zeros((self.blocks, self._kernel.states, LANES))
        nominal = np.array(list(self._stepped.parameters.values()))
        self.parameters = in_blocks(np.tile(nominal, (count, 1)))
        self._units = in_blocks(per_travel(machine, np.tile(nominal, (count, 1))))
        self.derived = np.zeros((self.blocks, len(self._kernel.layout.derived), LANES))
        self._kernel.prepare_blocks(self.parameters, self.h, 0, self.blocks, self.derived)
        self.supply = ActuatorModel(
            machine, drives, count, period=period, steps=self.steps, delayed=self._kernel.delayed
        )  # fmt: skip

    def _rest_travel(self, name: str) -> Array:
        linear = [c.name for c in self.machine.coordinates if c.kind == "linear"]
        unit = rest_state(self.machine, [float(c == name) for c in linear])
        return unit[: self._n] * self.machine.radii

    def __getstate__(self) -> dict[str, Any]:
        return {k: v for k, v in self.__dict__.items() if k != "_kernel"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._kernel = kernel_for(self._stepped)

    # -- setting ---------------------------------------------------------------------------------------------------

    def place(self, index: Index, position: Array, values: Array) -> None:
        """Put stages index (k,), ascending, at rest at position (k, 2), m, with parameters values (k, P).

        Belts are unstretched, the clock and effects' own states are at 0 and no voltage is under way.
        """
        if index[-1] == self.count - 1:
            spare = np.arange(self.count, self.blocks * LANES)
            index = np.concatenate([index, spare])
            position, values = (np.concatenate([a, np.repeat(a[-1:], len(spare), 0)]) for a in (position, values))
        state = np.zeros((len(index), self.state.shape[1]))
        state[:, : self._n] = position[:, :1] * self._rest[:, 0] + position[:, 1:] * self._rest[:, 1]
        units = per_travel(self.machine, values)
        blocks.put(index, state, self.state)
        blocks.put(index, values, self.parameters)
        blocks.put(index, units, self._units)
        self.supply.place(index, values, units)
        for first, last in blocks.runs(index):
            self._kernel.prepare_blocks(self.parameters, self.h, first, last, self.derived)

    # -- stepping --------------------------------------------------------------------------------------------------

    def advance(self, actions: NDArray[Any], clipped: NDArray[np.int64], finish: Callable[[int, int], int]) -> None:
        """One control period under actions (count, inputs), finite shares of the rated voltage, clipped to [-1, 1].

        clipped (count,) grows by what was clipped.  finish(first, last) is called, in any thread, for blocks first to
        last - 1 once they are there; it returns a stage that is not finite, or -1.

        Raises NotFiniteError naming the stage when a motion does not stay finite.
        """
        broken: list[int] = []
        self.supply.begin()

        def run(first: int, last: int) -> None:
            self.supply.command(actions, first, last, clipped)
            self.supply.advance(self._kernel, self.state, self.parameters, self.derived, self.h, first, last)
            b = finish(first, last)
            if b >= 0:
                broken.append(b)

        if self.blocks < BLOCKS_FOR_THREADS:
            run(0, self.blocks)
        else:
            in_parallel(run, self.blocks)
        if broken:
            raise NotFiniteError(
                f"environment {min(broken)}: the motion of machine {self.machine.name!r} is not finite"
            )

    # -- reading ---------------------------------------------------------------------------------------------------

    def view(self, entries: Sequence[tuple[str, bool]], low: NDArray[Any], high: NDArray[Any]) -> View:
        """What `observe` reads: for each entry (coordinate, whether its velocity), clipped to [low, high] (n,).

        The positions of x and y are the tool's; they are the first two entries.
        """
        rows = np.full((len(entries), 4), -1)
        for row, (name, velocity) in zip(rows, entries, strict=True):
            i = self.machine.coordinate_names.index(name)
            row[:2] = i + self._n * velocity, i
            if not velocity:
                row[2:] = self._product(name)
        return View(rows, np.stack([low, high]).astype(np.float64))

    def _product(self, name: str) -> tuple[int, int]:
        """The coordinates whose product a yawing bridge adds to the tool's x, or -1."""
        for sensor in self.machine.sensors:
            for key, factor in sensor.row.items():
                if "*" in key and factor == sensor.row.get(name):
                    first, second = map(self.machine.coordinate_names.index, key.split("*"))
                    return first, second
        return -1, -1

    def observe(self, first: int, last: int, view: View, out: NDArray[np.float32], tool: NDArray[np.float32]) -> int:
        """Write what `view` sees of the stages in blocks first..last-1 into out (count, n or more), x, y into tool too.

        Returns a stage that is not finite, or -1.
        """
        broken: int = blocks.observe(self.state, self._units, *view, first, last, out, tool)
        return broken

    @property
    def tables(self) -> tuple[Array, Array]:
        """State (blocks, rows, LANES) and own unit per metre of travel (blocks, coordinates, LANES)."""
        return self.state, self._units

    def values(self, index: Index, column: int) -> Array:
        """One parameter of stages index (k,), by its place in `Machine.parameters`."""
        block, lane = np.divmod(index, LANES)
        return self.parameters[block, column, lane]

    def tools(self, first: int = 0, last: int | None = None) -> Array:
        """Where the tools of blocks first..last-1 (default: all) are, (k, 2) m, in full precision."""
        last = self.blocks if last is None else last
        own, units = self.state[first:last], self._units[first:last]
        places = own[:, self._tool]
        for axis, name in enumerate(("x", "y")):
            a, b = self._product(name)
            if a >= 0:
                places[:, axis] += own[:, a] * units[:, a] * (own[:, b] * units[:, b])
        return places.transpose(0, 2, 1).reshape(-1, 2)[: self.count - first * LANES]

    def positions(self, b: int) -> dict[str, float]:
        """Positions of one stage's coordinates, m or rad."""
        block, lane = divmod(b, LANES)
        values = self.state[block, : self._n, lane] * self._units[block, :, lane]
        return dict(zip(self.machine.coordinate_names, values.tolist(), strict=True))

    def tensions(self, b: int) -> dict[str, float]:
        """Tension of one stage's belts beyond their pretension by Hooke's law, N."""
        block, lane = divmod(b, LANES)
        travel, own = self.state[block, : self._n, lane], self.parameters[block, :, lane]
        tensions = {}
        for belt in self.machine.belts:
            places = (column(self.machine, f"{belt.name}.{key}") for key in ("EA", "rest_length"))
            EA, rest = (factor * own[place] for place, factor in places)
            length = rest + self.machine.row(belt.length) @ travel
            tensions[belt.name] = float(EA / length * (self.machine.row(belt.extension) @ travel))
        return tensions
