"""A batch of stages: their state, their own parameters, and one control period of them all.  No tasks, no gym.

Stages share a machine's shape and differ in numbers.  State and parameters live in the kernel's blocks of lanes
(blocks, rows, LANES) from one step to the next, positions and velocities as belt travel, m and m/s.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..machine import Machine, NotFiniteError, rest_state
from ..machine.kernel import Kernel, in_blocks, kernel_for
from ..machine.lanes import LANES
from ..machine.simulate import in_parallel
from . import blocks
from .drives import IDEAL, Drives
from .ends import EndStops, Tables

Array = NDArray[np.float64]
Index = NDArray[np.intp]
# Fewer blocks than this finish before a second thread has started.
BLOCKS_FOR_THREADS = 64


class Stages:
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
        drives: Drives = IDEAL,
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
        self._inputs = len(machine.drives)
        self._names = list(machine.parameters)
        self._converter = self._ranges(drives)
        self._current_limit = drives.current_limit
        self._motors = self._motor_rows()
        # Travel of every coordinate at rest, unstretched, per metre of x and of y.
        self._rest = np.stack([self._rest_travel(name) for name in ("x", "y")], axis=1)
        self.state = np.zeros((self.blocks, 2 * self._n + 1, LANES))
        nominal = np.array(list(machine.parameters.values()))
        self.parameters = in_blocks(np.tile(nominal, (count, 1)))
        self._with_ends = end_stops
        self._kernel = kernel_for(machine)
        self.derived = np.zeros((self.blocks, len(self._kernel.layout.derived), LANES))
        self._kernel.prepare_blocks(self.parameters, self.h, 0, self.blocks, self.derived)
        rows = self.steps * self._inputs if self._kernel.delayed else self._inputs
        self.inputs = np.zeros((self.blocks, rows, LANES))
        periods = 1 + int(np.ceil(max(self._longest_delays()) / period)) if self._kernel.delayed else 1
        self._history = np.zeros((self.blocks, 1 + periods, self._inputs, LANES))
        self._delays = np.zeros((self.blocks, self._inputs, LANES))
        self._set_delays(0, self.blocks)
        self._compile()

    def _ranges(self, drives: Drives) -> tuple[Array, Array, Array, Array]:
        """Rated voltage, the converter's quantum, lowest and highest voltage of each input, V."""
        rated = np.array([d.rated_voltage for d in self.machine.drives])
        most = rated if drives.range_V is None else np.full(self._inputs, drives.range_V)
        if drives.bits is None:
            return rated, np.zeros(self._inputs), -most, most
        quantum = 2.0 * most / 2.0**drives.bits
        return rated, quantum, -most, most - quantum  # two's complement: one level less above

    def _motor_rows(self) -> tuple[Index, Index]:
        """Rows of the state with the drives' speeds (inputs,), of the parameters Ke, N, R and radius (inputs, 4)."""
        speeds, columns = [], []
        for d in self.machine.drives:
            speeds.append(self._n + self.machine.coordinate_names.index(d.coordinate))
            rows = [self._names.index(f"{d.name}.{key}") for key in ("Ke", "gear_ratio", "resistance")]
            columns.append([*rows, self._radius_row(d.coordinate)])
        return np.array(speeds), np.array(columns)

    def _radius_row(self, coordinate: str) -> int:
        rotary = self.machine.coordinate(coordinate).kind == "rotary"
        return self._names.index(f"{coordinate}.radius") if rotary else -1

    def _rest_travel(self, name: str) -> Array:
        linear = [c.name for c in self.machine.coordinates if c.kind == "linear"]
        unit = rest_state(self.machine, [float(c == name) for c in linear])
        return unit[: self._n] * self.machine.radii

    def _compile(self) -> None:
        self._kernel = kernel_for(self.machine)
        self._ends = EndStops(self.machine, self.period, self._tables) if self._with_ends else None

    @property
    def _tables(self) -> Tables:
        return self.state, self.parameters, self.derived, self.inputs

    def __getstate__(self) -> dict[str, Any]:
        return {k: v for k, v in self.__dict__.items() if k not in ("_kernel", "_ends")}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._compile()

    # -- setting ---------------------------------------------------------------------------------------------------

    def place(self, index: Index, position: Array, values: Array) -> None:
        """Put stages index (k,), ascending, at rest at position (k, 2), m, with parameters values (k, P).

        Belts are unstretched, the clock is at 0 and no voltage is under way.
        """
        if index[-1] == self.count - 1:
            spare = np.arange(self.count, self.blocks * LANES)
            index = np.concatenate([index, spare])
            position, values = (np.concatenate([a, np.repeat(a[-1:], len(spare), 0)]) for a in (position, values))
        state = np.zeros((len(index), self.state.shape[1]))
        state[:, : self._n] = position[:, :1] * self._rest[:, 0] + position[:, 1:] * self._rest[:, 1]
        blocks.put(index, state, self.state)
        blocks.put(index, values, self.parameters)
        if self._kernel.delayed:
            block, lane = np.divmod(index, LANES)
            self._history[block, :, :, lane] = 0.0
        for first, last in runs(index):
            self._kernel.prepare_blocks(self.parameters, self.h, first, last, self.derived)
            self._set_delays(first, last)

    def _effect_delays(self, drive: str) -> list[tuple[Any, list[int]]]:
        """Effects that make a drive late, each with the rows of its parameters."""
        return [
            (e, [self._names.index(f"{e.label}.{key}") for key in e.parameters])
            for e in self.machine.effects
            if e.definition.delay and e.site in (drive, "drives")
        ]

    def _longest_delays(self) -> list[float]:
        """The latest that each drive can ever be, by its effects' bounds, s."""
        longest = []
        for drive in self.machine.drives:
            definitions = [effect.definition for effect, _ in self._effect_delays(drive.name)]
            longest.append(sum(float(d.delay(*(p.upper for p in d.parameters))) for d in definitions if d.delay))
        return longest

    def _set_delays(self, first: int, last: int) -> None:
        if not self._kernel.delayed:
            return
        for k, drive in enumerate(self.machine.drives):
            total = np.zeros((last - first, LANES))
            for effect, rows in self._effect_delays(drive.name):
                total = total + effect.definition.delay(*(self.parameters[first:last, row] for row in rows))
            self._delays[first:last, k] = total

    # -- stepping --------------------------------------------------------------------------------------------------

    def advance(self, actions: Array, clipped: NDArray[np.int64], finish: Callable[[int, int], int]) -> None:
        """One control period under actions (count, inputs), finite shares of the rated voltage, clipped to [-1, 1].

        clipped (count,) grows by what was clipped.  finish(first, last) is called, in any thread, for blocks first to
        last - 1 once they are there; it returns a stage that is not finite, or -1.

        Raises NotFiniteError naming the stage when a motion does not stay finite.
        """
        broken: list[int] = []
        if self._kernel.delayed:
            self._history[:, 1:] = self._history[:, :-1]

        def run(first: int, last: int) -> None:
            volts = self._history[:, 0] if self._kernel.delayed else self.inputs
            blocks.command(actions, *self._converter, first, last, volts, clipped)
            if self._kernel.delayed:
                blocks.late(self._history, self._delays, self.period, self.h, first, last, self.inputs)
            if self._ends:
                self._ends.remember(self.state, first, last)
            self._run(self._kernel, self._tables, first, last)
            if self._ends:
                self._ends.correct(self._run, self._tables, first, last)
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

    def _run(self, kernel: Kernel, tables: Tables, first: int, last: int) -> None:
        """One control period of blocks first..last-1 by a kernel, voltages limited where the current would be."""
        if self._current_limit is None:
            kernel.advance_blocks(*tables, self.h, self.steps, first, last)
            return
        state, parameters, derived, asked = tables
        volts = np.empty((len(state), self._inputs, LANES))
        for step in range(self.steps):
            row = step * self._inputs if kernel.delayed else 0
            blocks.limit_current(state, parameters, *self._motors, self._current_limit, asked, row, first, last, volts)
            kernel.advance_blocks(state, parameters, derived, volts, self.h, 1, first, last)

    def observe(self, first: int, last: int, view: View, out: NDArray[np.float32], tool: NDArray[np.float32]) -> int:
        """Write what `view` sees of the stages in blocks first..last-1 into out (count, n or more), x, y into tool too.

        Returns a stage that is not finite, or -1.
        """
        broken: int = blocks.observe(self.state, self.parameters, *view, first, last, out, tool)
        return broken

    # -- reading ---------------------------------------------------------------------------------------------------

    def values(self, index: Index, column: int) -> Array:
        """One parameter of stages index (k,), by its place in `Machine.parameters`."""
        block, lane = np.divmod(index, LANES)
        return self.parameters[block, column, lane]

    def tools(self) -> Array:
        """Where all tools are, (count, 2) m, in full precision."""
        rows = [self.machine.coordinate_names.index(name) for name in ("x", "y")]
        return self.state[:, rows].transpose(0, 2, 1).reshape(-1, 2)[: self.count]

    def positions(self, b: int) -> dict[str, float]:
        """Positions of one stage's coordinates, m or rad."""
        values = self.state[b // LANES, : self._n, b % LANES] / self._radii(b)
        return dict(zip(self.machine.coordinate_names, values.tolist(), strict=True))

    def tensions(self, b: int) -> dict[str, float]:
        """Tension of one stage's belts beyond their pretension, N."""
        travel = self.state[b // LANES, : self._n, b % LANES]
        own = self.parameters[b // LANES, :, b % LANES]
        tensions = {}
        for belt in self.machine.belts:
            EA, rest = (own[self._names.index(f"{belt.name}.{key}")] for key in ("EA", "rest_length"))
            length = rest + self.machine.row(belt.length) @ travel
            tensions[belt.name] = float(EA / length * (self.machine.row(belt.extension) @ travel))
        return tensions

    def _radii(self, b: int) -> Array:
        own = self.parameters[b // LANES, :, b % LANES]
        return np.array(
            [
                own[self._names.index(f"{c.name}.radius")] if c.kind == "rotary" else 1.0
                for c in self.machine.coordinates
            ]
        )

    def view(self, entries: Sequence[tuple[str, bool]], low: NDArray[Any], high: NDArray[Any]) -> View:
        """What `observe` reads: for each entry (coordinate, whether its velocity), clipped to [low, high] (n,).

        The first two entries are the positions of x and y.
        """
        coordinates = self.machine.coordinate_names
        rows = np.array([coordinates.index(c) + (self._n if velocity else 0) for c, velocity in entries])
        radii = np.array([self._radius_row(c) for c, _ in entries])
        return rows, radii, np.asarray(low, np.float64), np.asarray(high, np.float64)


View = tuple[Index, Index, Array, Array]


def runs(index: Index) -> Iterator[tuple[int, int]]:
    """The blocks that hold environments index (k,), ascending, as ranges first, last."""
    own = np.unique(index // LANES)
    for part in np.split(own, np.flatnonzero(np.diff(own) > 1) + 1):
        yield int(part[0]), int(part[-1]) + 1
