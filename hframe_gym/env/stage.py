"""A batch of stages: their state, their own parameters, and one control period of them all.  No tasks, no gym.

Stages share a machine's shape and differ in numbers.  State and parameters live in the kernel's blocks of lanes
(blocks, rows, LANES) from one step to the next, positions and velocities as belt travel, m and m/s.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..machine import Machine, NotFiniteError, rest_state
from ..machine.kernel import in_blocks, kernel_for
from ..machine.lanes import LANES
from ..machine.simulate import in_parallel
from . import blocks
from .ends import EndStops

Array = NDArray[np.float64]
Index = NDArray[np.intp]
# Fewer blocks than this finish before a second thread has started.
BLOCKS_FOR_THREADS = 64
_NONE = np.zeros(0, np.int64)


class Stages:
    """`count` stages of one machine.

    period: of control, s; voltages are held that long.  longest_step: of the integrator, s.  end_stops: whether x and
    y end at buffers where their range does.

    Raises ValueError for a period or step that is not positive.
    """

    def __init__(
        self, machine: Machine, count: int, *, period: float, longest_step: float, end_stops: bool = False
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
        self._rated = np.array([d.rated_voltage for d in machine.drives])
        self._names = list(machine.parameters)
        # Travel of every coordinate at rest, unstretched, per metre of x and of y.
        self._rest = np.stack([self._rest_travel(name) for name in ("x", "y")], axis=1)
        self.state = np.zeros((self.blocks, 2 * self._n + 1, LANES))
        nominal = np.array(list(machine.parameters.values()))
        self.parameters = in_blocks(np.tile(nominal, (count, 1)))
        self._with_ends = end_stops
        self._compile()
        self.derived = np.zeros((self.blocks, len(self._kernel.layout.derived), LANES))
        self._kernel.prepare_blocks(self.parameters, self.h, 0, self.blocks, self.derived)
        rows = self.steps * self._inputs if self._kernel.delayed else self._inputs
        self.inputs = np.zeros((self.blocks, rows, LANES))
        periods = 1 + int(np.ceil(max(self._longest_delays()) / period)) if self._kernel.delayed else 1
        self._history = np.zeros((self.blocks, 1 + periods, self._inputs, LANES))
        self._delays = np.zeros((self.blocks, self._inputs, LANES))
        self._set_delays(np.arange(self.blocks))

    def _rest_travel(self, name: str) -> Array:
        linear = [c.name for c in self.machine.coordinates if c.kind == "linear"]
        unit = rest_state(self.machine, [float(c == name) for c in linear])
        return unit[: self._n] * self.machine.radii

    def _compile(self) -> None:
        self._kernel = kernel_for(self.machine)
        self._ends = EndStops(self.machine) if self._with_ends else None

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
        block, lane = np.divmod(index, LANES)
        travel = position[:, :1] * self._rest[:, 0] + position[:, 1:] * self._rest[:, 1]
        self.state[block, :, lane] = 0.0
        self.state[block, : self._n, lane] = travel
        self.parameters[block, :, lane] = values
        self._history[block, :, :, lane] = 0.0
        own = np.unique(block)
        derived = np.empty((len(own), *self.derived.shape[1:]))
        self._kernel.prepare_blocks(self.parameters[own], self.h, 0, len(own), derived)
        self.derived[own] = derived
        self._set_delays(own)

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

    def _set_delays(self, own: Index) -> None:
        if not self._kernel.delayed:
            return
        for k, drive in enumerate(self.machine.drives):
            total = np.zeros((len(own), LANES))
            for effect, rows in self._effect_delays(drive.name):
                total = total + effect.definition.delay(*(self.parameters[own, row] for row in rows))
            self._delays[own, k] = total

    # -- stepping --------------------------------------------------------------------------------------------------

    def advance(self, actions: Array, clipped: NDArray[np.int64], view: View, out: NDArray[np.float32]) -> None:
        """One control period under actions (count, inputs), finite shares of the rated voltage, clipped to [-1, 1].

        clipped (count,) grows by what was clipped; out (count, n) gets the observation by `view`.

        Raises NotFiniteError naming the stage when a motion does not stay finite.
        """
        broken: list[int] = []
        if self._kernel.delayed:
            self._history[:, 1:] = self._history[:, :-1]

        def run(first: int, last: int) -> None:
            volts = self._history[:, 0] if self._kernel.delayed else self.inputs
            blocks.command(actions, self._rated, first, last, volts, clipped)
            if self._kernel.delayed:
                blocks.late(self._history, self._delays, self.period, self.h, first, last, self.inputs)
            tables = (self.state, self.parameters, self.derived, self.inputs)
            near = self._ends.find(self.state, self.period, first, last) if self._ends else _NONE
            stopped = self._ends.advance(tables, near, self.h, self.steps) if self._ends and len(near) else None
            self._kernel.advance_blocks(*tables, self.h, self.steps, first, last)
            if stopped is not None:
                blocks.scatter(stopped, near, self.state)
            b = blocks.observe(self.state, self.parameters, *view, first, last, out)
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

    def observe(self, index: Index, view: View, out: NDArray[np.float32]) -> None:
        """Write the observation of stages index (k,) into their rows of out (count, n)."""
        blocks.observe_some(self.state, self.parameters, *view, index, out)

    # -- reading ---------------------------------------------------------------------------------------------------

    def values(self, index: Index, column: int) -> Array:
        """One parameter of stages index (k,), by its place in `Machine.parameters`."""
        block, lane = np.divmod(index, LANES)
        return self.parameters[block, column, lane]

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

    def view(self, entries: Sequence[tuple[str, bool]], low: Array, high: Array) -> View:
        """What `observe` reads: for each entry (coordinate, whether its velocity), clipped to [low, high] (n,)."""
        coordinates = self.machine.coordinate_names
        rows = np.array([coordinates.index(c) + (self._n if velocity else 0) for c, velocity in entries])
        radii = np.array(
            [
                self._names.index(f"{c}.radius") if self.machine.coordinate(c).kind == "rotary" else -1
                for c, _ in entries
            ]
        )
        return rows, radii, np.asarray(low, np.float64), np.asarray(high, np.float64)


View = tuple[Index, Index, Array, Array]
