"""A batch of environments without gymnasium's interface: the one code behind `HFrameEnv` and its vector twin.

An episode of environment b: `reset` draws its machine, start and plan from its own generator and puts the stage
at rest; each `step` advances all stages by one control period.  Ending episodes is left to the caller.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..dynamics.simd import LANES
from . import simd_layout as blocks
from .actuator_presets import as_actuators
from .batched_simulator import BatchedSimulator
from .config import EnvConfig, as_machine
from .config import MachineLike as MachineLike
from .machine_sampler import MachineSampler
from .observations import Observation, ObservationBuilder
from .reference_trajectories import ReferenceTrajectories
from .rewards import Builtin, Reward, WithPenalty, as_reward, distances, judge, outside_of
from .sensors import as_sensors
from .spaces import observation_space, workspace
from .tasks import as_task, check_point

Array = NDArray[np.float64]
Index = NDArray[np.intp]
Flags = NDArray[np.bool_]


class StepResult(NamedTuple):
    """One control period of all environments, first axis B, fresh arrays.

    distance, contour: of the tools themselves to their goals and to their paths (None: no path), m.
    """

    observation: Observation
    reward: Array
    terminated: Flags
    truncated: Flags
    distance: Array
    contour: Array | None


class EnvironmentBatch:
    """`count` environments.

    Raises ValueError for settings that do not fit together.
    """

    def __init__(self, settings: EnvConfig, count: int) -> None:
        s = settings
        if count < 1:
            raise ValueError(f"num_envs is {count}, it must be at least 1")
        self.settings = settings
        self.count = count
        drives = as_actuators(s.drives)
        self.machine = drives.on(as_machine(s.machine))
        self.workspace = workspace(self.machine)
        self.task = as_task(s.task)
        self.task.check(self.workspace)
        reward = as_reward(s.reward, self.task.band)
        self.reward: Reward = WithPenalty(reward, self.workspace, s.penalty) if s.ends == "terminate" else reward
        self.population = MachineSampler(self.machine, s.randomize, count)
        self.stages = BatchedSimulator(
            self.machine,
            count,
            period=s.period,
            longest_step=s.longest_step,
            drives=drives,
            end_stops=s.ends == "stops",
        )
        drawn = self.population.bounds() if s.privileged else None
        self.observer = ObservationBuilder(self.stages, as_sensors(s.sensors), drawn)
        self.observation_space = observation_space(
            self.machine,
            len(self.task.ahead_s),
            observed=self.observer.entries,
            privileged=self.observer.privileged,
        )
        self._edges = self.workspace.astype(np.float32)
        self.goals = ReferenceTrajectories(self.task, count, s.period)
        self.clipped = np.zeros(count, np.int64)

    @property
    def elapsed(self) -> NDArray[np.int64]:
        """Control periods (count,) since each episode began."""
        return self.goals.elapsed

    # -- reset -----------------------------------------------------------------------------------------------------

    def reset(self, index: Index, start: ArrayLike | None = None, target: ArrayLike | None = None) -> None:
        """Begin new episodes in environments index (k,), ascending.

        start, target: (2,) or (k, 2) m in place of what the task draws.

        Raises ValueError for a start or target outside the workspace.
        """
        given = [self._points(name, points, len(index)) for name, points in (("start", start), ("target", target))]
        keys, uniforms, values = self.population.draw(index, self.task.draws)
        position, plan = self.task.begin(self.workspace, uniforms)
        self.clipped[index] = 0
        self.goals.begin(index, plan if given[1] is None else self.task.aim(given[1]))
        self.stages.place(index, position if given[0] is None else given[0], values)
        self.observer.begin(index, keys, values, self.population, self.elapsed)

    def _points(self, name: str, points: ArrayLike | None, k: int) -> Array | None:
        if points is None:
            return None
        values = np.asarray(points, np.float64)
        check_point(f"options[{name!r}]", values, self.workspace)
        return np.array(np.broadcast_to(values, (k, 2)))

    def drawn(self, index: Index) -> dict[str, Array]:
        """The randomised parameters of environments index (k,), each (k,), by full name."""
        return {
            name: self.stages.values(index, column)
            for name, column in zip(self.population.drawn, self.population.columns, strict=True)
        }

    # -- step ------------------------------------------------------------------------------------------------------

    def check_actions(self, actions: Any) -> NDArray[Any]:
        """Actions as (count, drives), float32 or float64.

        Raises ValueError for another shape, and for a number that is not finite, naming environment and motor.
        """
        values = np.ascontiguousarray(actions)
        if values.dtype != np.float32:
            values = values.astype(np.float64, copy=False)
        wanted = (self.count, len(self.machine.drives))
        if values.shape != wanted:
            raise ValueError(f"actions have shape {values.shape}, they must have {wanted}")
        if not blocks.all_finite(values):
            b, k = np.argwhere(~np.isfinite(values))[0].tolist()
            drive = self.machine.drives[k].name
            raise ValueError(f"action of environment {b}, {drive}: {values[b, k]} is not finite")
        return values

    def step(self, actions: NDArray[Any], limit: int | None = None) -> StepResult:
        """One control period under checked actions (count, drives); truncated after limit periods of an episode.

        Raises NotFiniteError when a motion does not stay finite.
        """
        self.goals.elapsed += 1
        observation, tool = self._blank()
        achieved, desired = observation["achieved_goal"], observation["desired_goal"]
        sensed = self.observer.sensors is not None
        reward, distance = np.empty(self.count), np.empty(self.count)
        contour = np.empty(self.count) if self.goals.moving else None
        builtin = self.reward if isinstance(self.reward, Builtin) else None

        def finish(first: int, last: int) -> int:
            begin, end = first * LANES, min(last * LANES, self.count)
            self.observer.read(first, last, self.goals.elapsed)
            broken = self.observer.see(first, last, observation, tool)
            if contour is not None:
                rows = slice(begin, end)
                self.goals.show(rows, observation)
                if broken < 0:
                    contour[rows] = self.goals.contour(rows, self.stages.tools(first, last))
            if builtin is not None:
                judge(tool, achieved, sensed, desired, builtin.kind, builtin.band, begin, end, distance, reward)
            return broken

        self.stages.advance(actions, self.clipped, finish)
        if builtin is None:
            distance, reward = distances(tool, desired), np.asarray(self.reward(achieved, desired), np.float64)
        ends = self.settings.ends == "terminate"
        terminated = outside_of(tool, self._edges) if ends else np.zeros(self.count, np.bool_)
        truncated = np.zeros(self.count, np.bool_) if limit is None else self.goals.elapsed >= limit
        return StepResult(observation, reward, terminated, truncated, distance, contour)

    def restart(self, index: Index, outcome: StepResult) -> None:
        """Begin new episodes in environments index (k,), ascending, and write how they look into their rows."""
        self.reset(index)
        observation = outcome.observation
        tool = self.observer.tool(observation)
        self.goals.show(index, observation)
        for first, last in blocks.runs(index):
            self.observer.see(first, last, observation, tool)
        outcome.distance[index] = distances(tool[index], observation["desired_goal"][index])
        if outcome.contour is not None:
            outcome.contour[index] = self.contour(index)

    def observe(self) -> Observation:
        """The observation of all environments as they are, fresh arrays."""
        observation, tool = self._blank()
        self.goals.show(slice(None), observation)
        self.observer.see(0, self.stages.blocks, observation, tool)
        return observation

    def _blank(self) -> tuple[Observation, NDArray[np.float32]]:
        """Arrays for an observation of all environments, and for where their tools are (count, 2)."""
        observation, tool = self.observer.blank()
        observation |= self.goals.blank()
        return observation, tool

    def contour(self, index: Index | slice) -> Array | None:
        """Distance (k,) of the tools themselves to their paths, m; None for a task without a path."""
        return self.goals.contour(index, self.stages.tools()[index]) if self.goals.moving else None

    def distance(self, index: Index) -> Array:
        """Distance (k,) of the tools themselves to their goals, m."""
        tool = np.empty((self.count, 2), np.float32)
        for first, last in blocks.runs(index):
            self.observer.see_tools(first, last, tool)
        return distances(tool[index], self.goals.now(index))

    # -- rewards again ---------------------------------------------------------------------------------------------

    def compute_reward(self, achieved: ArrayLike, desired: ArrayLike) -> Any:
        """Rewards of goals (2,) as a float, or of (n, 2) as (n,), exactly those that `step` gives."""
        a, d = np.asarray(achieved, np.float32), np.asarray(desired, np.float32)
        if a.ndim == 1:
            return float(self.reward(a[None], d[None])[0])
        return np.asarray(self.reward(a, d), np.float64)
