"""A batch of environments without gymnasium's interface: the one code behind `HFrameEnv` and its vector twin.

An episode of environment b: `reset` draws its machine, start and plan from its own generator and puts the stage
at rest; each `step` advances all stages by one control period.  Ending episodes is left to the caller.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from gymnasium.utils import seeding
from numpy.typing import ArrayLike, NDArray

from ..machine.lanes import LANES
from . import blocks
from .draws import reset_uniforms
from .drives import as_drives
from .observing import Observation, Observer
from .randomisation import Sampler, as_rules
from .rewards import Builtin, Reward, WithPenalty, as_reward, distances, judge, outside_of
from .sensors import as_sensors
from .settings import MachineLike as MachineLike
from .settings import Settings, as_machine
from .spaces import observation_space, workspace
from .stage import Stages, runs
from .tasks import as_task, check_point

Array = NDArray[np.float64]
Index = NDArray[np.intp]
Flags = NDArray[np.bool_]


class Outcome(NamedTuple):
    """One control period of all environments, first axis B, fresh arrays.

    distance, contour: of the tools themselves to their goals and to their paths (None: no path), m.
    """

    observation: Observation
    reward: Array
    terminated: Flags
    truncated: Flags
    distance: Array
    contour: Array | None


class Batch:
    """`count` environments.

    Raises ValueError for settings that do not fit together.
    """

    def __init__(self, settings: Settings, count: int) -> None:
        s = settings
        if count < 1:
            raise ValueError(f"num_envs is {count}, it must be at least 1")
        self.settings = settings
        self.count = count
        drives = as_drives(s.drives)
        self.machine = drives.on(as_machine(s.machine))
        self.workspace = workspace(self.machine)
        self.task = as_task(s.task)
        self.task.check(self.workspace)
        reward = as_reward(s.reward, self.task.band)
        self.reward: Reward = WithPenalty(reward, self.workspace, s.penalty) if s.ends == "terminate" else reward
        self._randomise()
        self.stages = Stages(
            self.machine,
            self.count,
            period=s.period,
            longest_step=s.longest_step,
            drives=drives,
            end_stops=s.ends == "stops",
        )
        self.observer = Observer(self.stages, as_sensors(s.sensors), self._shares() if s.privileged else None)
        self.observation_space = observation_space(
            self.machine,
            len(self.task.ahead_s),
            observed=self.observer.entries,
            privileged=self.observer.privileged,
        )
        self._edges = self.workspace.astype(np.float32)
        self._plan = np.zeros((self.count, self.task.plan_size))
        self._goals = np.zeros((self.count, 2), np.float32)  # as they are at reset, for a task whose goals stay
        self.rngs: list[np.random.Generator | None] = [None] * self.count
        self.elapsed = np.zeros(self.count, np.int64)
        self.clipped = np.zeros(self.count, np.int64)

    def _randomise(self) -> None:
        rules = as_rules(self.settings.randomize, self.machine)
        self._startup = Sampler(self.machine, rules, "startup")
        self._at_reset = Sampler(self.machine, rules, "reset", before=(self._startup.low, self._startup.high))
        self._drawn = sorted({*self._startup.names, *self._at_reset.names})
        self._drawn_columns = [list(self.machine.parameters).index(name) for name in self._drawn]
        nominal = np.array(list(self.machine.parameters.values()))
        self._base = np.tile(nominal, (self.count if self._startup.names else 1, 1))
        self._to_start = np.ones(self.count, np.bool_)  # startup draws not made yet

    def _nominal(self) -> Array:
        """What drawn parameters are shares of: their nominal values, or 1 where those are zero."""
        nominal = np.array([self.machine.parameters[name] for name in self._drawn])
        return np.where(nominal == 0.0, 1.0, nominal)

    def _shares(self) -> dict[str, tuple[float, float]]:
        edges = np.stack([self._at_reset.low, self._at_reset.high], axis=1)[self._drawn_columns]
        shares = np.sort(edges / self._nominal()[:, None], axis=1)
        return {name: (low, high) for name, (low, high) in zip(self._drawn, shares.tolist(), strict=True)}

    # -- reset -----------------------------------------------------------------------------------------------------

    def seed(self, b: int, generator: np.random.Generator) -> None:
        """Give environment b its generator; its startup draws are made anew at the next reset."""
        self.rngs[b] = generator
        self._to_start[b] = True

    def _new_keys(self, index: Index) -> NDArray[np.uint64]:
        """One 64-bit number from the generator of each environment of index (k,)."""
        own = index.tolist()
        for b in own:
            if self.rngs[b] is None:
                self.rngs[b] = seeding.np_random()[0]
        return np.array([self.rngs[b].bit_generator.random_raw() for b in own], np.uint64)  # type: ignore[union-attr]

    def reset(self, index: Index, start: ArrayLike | None = None, target: ArrayLike | None = None) -> None:
        """Begin new episodes in environments index (k,), ascending.

        start, target: (2,) or (k, 2) m in place of what the task draws.

        Raises ValueError for a start or target outside the workspace.
        """
        given = [self._points(name, points, len(index)) for name, points in (("start", start), ("target", target))]
        if self._startup.names:
            fresh = index[self._to_start[index]]
            nominal = np.tile(np.array(list(self.machine.parameters.values())), (len(fresh), 1))
            uniforms = reset_uniforms(self._new_keys(fresh), self._startup.draws)
            self._base[fresh] = self._startup.draw(nominal, uniforms)
            self._to_start[fresh] = False
        keys = self._new_keys(index)
        uniforms = reset_uniforms(keys, self.task.draws + self._at_reset.draws)
        position, plan = self.task.begin(self.workspace, uniforms[:, : self.task.draws])
        base = self._base[index] if self._startup.names else np.repeat(self._base, len(index), axis=0)
        values = self._at_reset.draw(base, uniforms[:, self.task.draws :])
        self._plan[index] = plan if given[1] is None else self.task.aim(given[1])
        self.elapsed[index] = 0
        self.clipped[index] = 0
        self._goals[index] = self.task.goal(self._plan[index], np.zeros(len(index)))
        self.stages.place(index, position if given[0] is None else given[0], values)
        self.observer.begin(index, keys, values[:, self._drawn_columns] / self._nominal(), self.elapsed)

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
            for name, column in zip(self._drawn, self._drawn_columns, strict=True)
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
        bad = blocks.first_not_finite(values)
        if bad >= 0:
            b, k = divmod(bad, wanted[1])
            drive = self.machine.drives[k].name
            raise ValueError(f"action of environment {b}, {drive}: {values[b, k]} is not finite")
        return values

    def step(self, actions: NDArray[Any], limit: int | None = None) -> Outcome:
        """One control period under checked actions (count, drives); truncated after limit periods of an episode.

        Raises NotFiniteError when a motion does not stay finite.
        """
        self.elapsed += 1
        observation, tool = self._blank()
        achieved, desired = observation["achieved_goal"], observation["desired_goal"]
        sensed = self.observer.sensors is not None
        reward, distance = np.empty(self.count), np.empty(self.count)
        builtin = self.reward if isinstance(self.reward, Builtin) else None

        def finish(first: int, last: int) -> int:
            begin, end = first * LANES, min(last * LANES, self.count)
            self.observer.read(first, last, self.elapsed)
            broken = self.observer.see(first, last, observation, tool)
            if builtin is not None:
                judge(tool, achieved, sensed, desired, builtin.kind, builtin.band, begin, end, distance, reward)
            return broken

        self.stages.advance(actions, self.clipped, finish)
        if builtin is None:
            distance, reward = distances(tool, desired), np.asarray(self.reward(achieved, desired), np.float64)
        ends = self.settings.ends == "terminate"
        terminated = outside_of(tool, self._edges) if ends else np.zeros(self.count, np.bool_)
        truncated = np.zeros(self.count, np.bool_) if limit is None else self.elapsed >= limit
        return Outcome(observation, reward, terminated, truncated, distance, self.contour(slice(None)))

    def restart(self, index: Index, outcome: Outcome) -> None:
        """Begin new episodes in environments index (k,), ascending, and write how they look into their rows."""
        self.reset(index)
        observation = outcome.observation
        tool = self.observer.tool(observation)
        observation["desired_goal"][index] = self.goals(index)
        if "preview" in observation:
            observation["preview"][index] = self.previews(index)
        for first, last in runs(index):
            self.observer.see(first, last, observation, tool)
        outcome.distance[index] = distances(tool[index], observation["desired_goal"][index])
        if outcome.contour is not None:
            outcome.contour[index] = self.contour(index)

    def observe(self) -> Observation:
        """The observation of all environments as they are, fresh arrays."""
        observation, tool = self._blank()
        self.observer.see(0, self.stages.blocks, observation, tool)
        return observation

    # -- what is seen ----------------------------------------------------------------------------------------------

    def _blank(self) -> tuple[Observation, NDArray[np.float32]]:
        """Arrays for an observation of all environments, goals written, and for where the tools are (count, 2)."""
        observation, tool = self.observer.blank()
        everyone = slice(None)
        observation["desired_goal"] = self.goals(everyone)
        if self.task.ahead_s:
            observation["preview"] = self.previews(everyone)
        return observation, tool

    def goals(self, index: Index | slice) -> NDArray[np.float32]:
        """Where environments index (k,) should be now, (k, 2) m, fresh."""
        if not self.task.ahead_s:
            return np.array(self._goals[index])
        return self.task.goal(self._plan[index], self._elapsed_s(index)).astype(np.float32)

    def previews(self, index: Index | slice) -> NDArray[np.float32]:
        """Where they should be later, (k, 2 P) m: x and y of the nearest future goal, of the next, ..."""
        times = self._elapsed_s(index)[:, None] + np.array(self.task.ahead_s)
        plans = np.repeat(self._plan[index], times.shape[1], axis=0)
        return self.task.goal(plans, times.ravel()).reshape(len(times), -1).astype(np.float32)

    def path(self, b: int, elapsed_s: Array) -> NDArray[np.float32]:
        """Where environment b should be elapsed_s (n,) after its reset, (n, 2) m; nothing for a goal that stays."""
        times = elapsed_s if self.task.ahead_s else elapsed_s[:0]
        return self.task.goal(np.repeat(self._plan[b : b + 1], len(times), axis=0), times).astype(np.float32)

    def contour(self, index: Index | slice) -> Array | None:
        """Distance (k,) of the tools themselves to their paths, m; None for a task without a path."""
        if not self.task.ahead_s:
            return None
        return self.task.contour(self._plan[index], self.stages.tools()[index], self._elapsed_s(index))

    def distance(self, index: Index) -> Array:
        """Distance (k,) of the tools themselves to their goals, m."""
        tool = np.empty((self.count, 2), np.float32)
        for first, last in runs(index):
            self.observer.see_tools(first, last, tool)
        return distances(tool[index], self.goals(index))

    def _elapsed_s(self, index: Index | slice) -> Array:
        return np.asarray(self.elapsed[index].astype(np.float64) * self.settings.period)

    # -- rewards again ---------------------------------------------------------------------------------------------

    def compute_reward(self, achieved: ArrayLike, desired: ArrayLike) -> Any:
        """Rewards of goals (2,) as a float, or of (n, 2) as (n,), exactly those that `step` gives."""
        a, d = np.asarray(achieved, np.float32), np.asarray(desired, np.float32)
        if a.ndim == 1:
            return float(self.reward(a[None], d[None])[0])
        return np.asarray(self.reward(a, d), np.float64)
