"""What environments of a batch observe of their stages: the full state or sensors' readings, and what is privileged."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from ..dynamics.simd import LANES
from .batched_simulator import BatchedSimulator, View
from .machine_sampler import MachineSampler
from .sensor_readings import read, report
from .sensors import Sensors, channels, sensed_entries
from .spaces import BEYOND, SignalSpec, privileged_entries, workspace

Array = NDArray[np.float64]
Index = NDArray[np.intp]
Observation = dict[str, NDArray[np.float32]]


class ObservationBuilder:
    """Looks at all stages of a batch.

    sensors: None for the full state.  drawn: for privileged observations, the bounds of each drawn parameter by name,
    as shares of its nominal value (or as it is where that is zero); None for none.

    entries, privileged: what each number of `observation` and of `privileged` is.
    """

    def __init__(
        self,
        stages: BatchedSimulator,
        sensors: Sensors | None,
        drawn: Mapping[str, tuple[float, float]] | None,
    ) -> None:
        self._stages = stages
        self.sensors = sensors
        machine, count = stages.machine, stages.count
        self.entries = sensed_entries(machine, sensors)
        goals = workspace(machine) + np.array([-BEYOND, BEYOND])
        self._tool = stages.view([("x", False), ("y", False)], goals[:, 0], goals[:, 1])
        wanted = [e for e in self.entries if sensors is None or not e.velocity]
        self._view = self._view_of(wanted)
        self._readings = np.zeros((count, 2, len(wanted)))
        self._keys = np.zeros(count, np.uint64)  # of each environment's episode, for its noise
        if sensors is not None:
            self._channels = channels(machine, sensors)
            low, high = (np.array([getattr(e, edge) for e in self.entries]) for edge in ("low", "high"))
            self._report = (stages.period, *self._channels[2:], low, high, goals)
        self.privileged = () if drawn is None else privileged_entries(machine, drawn)
        self._all_state = self._view_of([e for e in self.privileged if e.coordinate])
        self._shares = np.zeros((count, len(drawn or {})), np.float32)

    def _view_of(self, wanted: Sequence[SignalSpec]) -> View:
        # The box is float32; its edges may lie inside those of the entries.
        low, high = (np.array([getattr(e, edge) for e in wanted], np.float32) for edge in ("low", "high"))
        return self._stages.view([(e.coordinate, e.velocity) for e in wanted], low, high)

    def begin(
        self,
        index: Index,
        keys: NDArray[np.uint64],
        values: Array,
        population: MachineSampler,
        elapsed: NDArray[np.int64],
    ) -> None:
        """Episodes of environments index (k,) begin, with keys (k,) and parameters values (k, P)."""
        self._keys[index] = keys
        if self.privileged:
            self._shares[index] = population.shares(values)
        if self.sensors is not None:
            self._read(index, elapsed, fresh=True)

    def read(self, first: int, last: int, elapsed: NDArray[np.int64]) -> None:
        """Take the sensors' readings of blocks first..last-1 after elapsed (count,) periods of their episodes."""
        if self.sensors is not None:
            self._read(self._rows(first, last), elapsed, fresh=False)

    def _rows(self, first: int, last: int) -> Index:
        return np.arange(first * LANES, min(last * LANES, self._stages.count))

    def _read(self, index: Index, elapsed: NDArray[np.int64], *, fresh: bool) -> None:
        own = self._view.entries, *self._channels[:4]
        read(*self._stages.tables, *own, self._keys, elapsed, index, fresh, self._readings)

    def blank(self) -> tuple[Observation, NDArray[np.float32]]:
        """Arrays for the observations of all environments, without goals, and for where the tools are (count, 2)."""
        count = self._stages.count
        achieved = np.empty((count, 2), np.float32)
        observation = {
            "observation": np.empty((count, len(self.entries)), np.float32),
            "achieved_goal": achieved,
        }
        if self.privileged:
            observation["privileged"] = np.empty((count, len(self.privileged)), np.float32)
        return observation, self.tool(observation)

    def tool(self, observation: Observation) -> NDArray[np.float32]:
        """An array (count, 2) for where the tools are: with the full state, that is what is achieved."""
        achieved = observation["achieved_goal"]
        return achieved if self.sensors is None else np.empty_like(achieved)

    def see(self, first: int, last: int, observation: Observation, tool: NDArray[np.float32]) -> int:
        """Write what environments of blocks first..last-1 observe; returns one that is not finite, or -1."""
        look = self._stages.observe
        if self.sensors is None:
            broken = look(first, last, self._view, observation["observation"], tool)
        else:
            broken = look(first, last, self._tool, tool, tool)
            index = self._rows(first, last)
            out = observation["observation"], observation["achieved_goal"]
            report(self._readings, *self._report, index, *out)
        if self.privileged:
            rows = observation["privileged"]
            broken = max(broken, look(first, last, self._all_state, rows, tool))
            own = slice(first * LANES, last * LANES)
            rows[own, len(self._all_state.entries) :] = self._shares[own]
        return broken

    def see_tools(self, first: int, last: int, tool: NDArray[np.float32]) -> None:
        """Write where the tools of blocks first..last-1 are into tool (count, 2)."""
        self._stages.observe(first, last, self._tool, tool, tool)
