"""A batch of environments without gymnasium's interface: the one code behind `HFrameEnv` and its vector twin.

An episode of environment b: `reset` draws its machine, start and plan from its own generator and puts the stage
at rest; each `step` advances all stages by one control period.  Ending episodes is left to the caller.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, NamedTuple, TypeAlias

import numpy as np
from gymnasium.utils import seeding
from numpy.typing import ArrayLike, NDArray

from ..machine import Machine
from ..machine.simulate import LONGEST_STEP
from . import blocks
from .randomisation import Randomise, Sampler, as_rules
from .rewards import Reward, RewardLike, WithPenalty, as_reward, distances, outside_of
from .spaces import entries, observation_space, workspace
from .stage import Stages
from .tasks import TaskLike, as_task, check_point

Array = NDArray[np.float64]
Index = NDArray[np.intp]
Observation = dict[str, NDArray[np.float32]]
MachineLike: TypeAlias = Machine | str | Path
Ends = Literal["stops", "terminate"]

# Taken from the reward when an episode ends at the workspace's edge: as much as a hundred steps can lose, so that
# leaving does not pay.
PENALTY = 100.0


@dataclass(frozen=True)
class Settings:
    """What an environment is made of; every keyword of `gym.make("HFrame-v0", ...)` but the rendering.

    machine: a `Machine`, a built-in name or the path of a machine.json.
    task: "reach" or a `Task`.
    reward: "dense", "sparse" (0 within the task's band, else -1) or a function of (achieved, desired), (n, 2) -> (n,).
    randomize: "none" (the machine as it is), "default", "wide", "identified" or a list of rules.
    ends: what the edge of the workspace is: "stops", rubber buffers, or "terminate", the end of the episode with
        `penalty`.  Buffers learn better: with an episode's end, giving up becomes a choice that has to be priced out.
    period: of control, s.  longest_step: of the integrator, s.
    """

    machine: MachineLike = "hframe"
    task: TaskLike = "reach"
    reward: RewardLike = "dense"
    randomize: Randomise = "none"
    ends: Ends = "stops"
    penalty: float = PENALTY
    period: float = 0.01
    longest_step: float = LONGEST_STEP


class Outcome(NamedTuple):
    """One control period of all environments, first axis B."""

    observation: Observation
    reward: Array
    terminated: NDArray[np.bool_]
    distance: Array


class Batch:
    """`count` environments.

    Raises ValueError for settings that do not fit together.
    """

    def __init__(self, settings: Settings, count: int) -> None:
        s = settings
        if count < 1:
            raise ValueError(f"num_envs is {count}, it must be at least 1")
        if s.ends not in ("stops", "terminate"):
            raise ValueError(f"ends is {s.ends!r}, choose 'stops' or 'terminate'")
        if not (np.isfinite(s.penalty) and s.penalty >= 0.0):
            raise ValueError(f"penalty is {s.penalty!r}, it must be a number that is not negative")
        self.settings = settings
        self.count = count
        self.machine = as_machine(s.machine)
        self.workspace = workspace(self.machine)
        self.task = as_task(s.task)
        self.task.check(self.workspace)
        reward = as_reward(s.reward, self.task.band)
        self.reward: Reward = WithPenalty(reward, self.workspace, s.penalty) if s.ends == "terminate" else reward
        rules = as_rules(s.randomize, self.machine)
        self._startup = Sampler(self.machine, rules, "startup")
        self._at_reset = Sampler(self.machine, rules, "reset")
        self._drawn = sorted({*self._startup.names, *self._at_reset.names})
        self._drawn_columns = [list(self.machine.parameters).index(name) for name in self._drawn]
        self.stages = Stages(
            self.machine, self.count, period=s.period, longest_step=s.longest_step, end_stops=s.ends == "stops"
        )
        self.observation_space = observation_space(self.machine)
        box = self.observation_space["observation"]
        wanted = [(e.coordinate, e.velocity) for e in entries(self.machine)]
        self._view = self.stages.view(wanted, box.low, box.high)  # type: ignore[attr-defined]
        self._edges = self.workspace.astype(np.float32)
        nominal = np.array(list(self.machine.parameters.values()))
        self._base = np.tile(nominal, (self.count if self._startup.names else 1, 1))
        self._plan = np.zeros((self.count, self.task.plan_size))
        self._to_start = np.ones(self.count, np.bool_)  # startup draws not made yet
        self.rngs: list[np.random.Generator | None] = [None] * self.count
        self.elapsed = np.zeros(self.count, np.int64)
        self.clipped = np.zeros(self.count, np.int64)

    # -- reset -----------------------------------------------------------------------------------------------------

    def seed(self, b: int, generator: np.random.Generator) -> None:
        """Give environment b its generator; its startup draws are made anew at the next reset."""
        self.rngs[b] = generator
        self._to_start[b] = True

    def _random(self, index: Index, uniforms: int, normals: int) -> tuple[Array, Array]:
        u, z = np.empty((len(index), uniforms)), np.empty((len(index), normals))
        for i, b in enumerate(index.tolist()):
            generator = self.rngs[b]
            if generator is None:
                generator = self.rngs[b] = seeding.np_random()[0]
            generator.random(out=u[i])
            if normals:
                generator.standard_normal(out=z[i])
        return u, z

    def reset(self, index: Index, start: ArrayLike | None = None, target: ArrayLike | None = None) -> None:
        """Begin new episodes in environments index (k,), ascending.

        start, target: (2,) or (k, 2) m in place of what the task draws.

        Raises ValueError for a start or target outside the workspace.
        """
        given = [self._points(name, points, len(index)) for name, points in (("start", start), ("target", target))]
        if self._startup.names:
            fresh = index[self._to_start[index]]
            u, z = self._random(fresh, self._startup.uniforms, self._startup.normals)
            nominal = np.tile(np.array(list(self.machine.parameters.values())), (len(fresh), 1))
            self._base[fresh] = self._startup.draw(nominal, u, z)
            self._to_start[fresh] = False
        sampler = self._at_reset
        u, z = self._random(index, self.task.draws + sampler.uniforms, sampler.normals)
        position, plan = self.task.begin(self.workspace, u[:, : self.task.draws])
        base = self._base[index] if self._startup.names else np.repeat(self._base, len(index), axis=0)
        values = sampler.draw(base, u[:, self.task.draws :], z)
        self._plan[index] = plan if given[1] is None else given[1]
        self.elapsed[index] = 0
        self.clipped[index] = 0
        self.stages.place(index, position if given[0] is None else given[0], values)

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

    def check_actions(self, actions: Any) -> Array:
        """Actions as (count, drives) float64.

        Raises ValueError for another shape, and for a number that is not finite, naming environment and motor.
        """
        values = np.ascontiguousarray(actions, np.float64)
        wanted = (self.count, len(self.machine.drives))
        if values.shape != wanted:
            raise ValueError(f"actions have shape {values.shape}, they must have {wanted}")
        bad = int(blocks.first_not_finite(values))
        if bad >= 0:
            b, k = divmod(bad, wanted[1])
            drive = self.machine.drives[k].name
            raise ValueError(f"action of environment {b}, {drive}: {values[b, k]} is not finite")
        return values

    def step(self, actions: Array) -> Outcome:
        """One control period under checked actions (count, drives).

        Raises NotFinite when a motion does not stay finite.
        """
        state = np.empty((self.count, len(self._view[0])), np.float32)
        self.stages.advance(actions, self.clipped, self._view, state)
        self.elapsed += 1
        observation = self._with_goals(state)
        achieved, desired = observation["achieved_goal"], observation["desired_goal"]
        reward = np.asarray(self.reward(achieved, desired), np.float64)
        if self.settings.ends == "terminate":
            terminated = outside_of(achieved, self._edges)
        else:
            terminated = np.zeros(self.count, np.bool_)
        return Outcome(observation, reward, terminated, distances(achieved, desired))

    def observe(self) -> Observation:
        """The observation of all environments as they are, fresh arrays."""
        state = np.empty((self.count, len(self._view[0])), np.float32)
        self.stages.observe(np.arange(self.count), self._view, state)
        return self._with_goals(state)

    def refresh(self, index: Index, observation: Observation) -> None:
        """Write what environments index (k,) see after a reset into their rows of an observation."""
        self.stages.observe(index, self._view, observation["observation"])
        observation["achieved_goal"][index] = observation["observation"][index, :2]
        observation["desired_goal"][index] = self.goals(index)

    def goals(self, index: Index | slice) -> NDArray[np.float32]:
        """Where environments index (k,) should be now, (k, 2) m."""
        elapsed_s = self.elapsed[index].astype(np.float64) * self.settings.period
        return self.task.goal(self._plan[index], elapsed_s)

    def _with_goals(self, state: NDArray[np.float32]) -> Observation:
        return {
            "observation": state,
            "achieved_goal": state[:, :2].copy(),
            "desired_goal": self.goals(slice(None)),
        }

    def distance(self, index: Index) -> Array:
        """Distance of environments index (k,) to their goals, (k,) m, as their observations say."""
        state = np.empty((self.count, len(self._view[0])), np.float32)
        self.stages.observe(index, self._view, state)
        return np.asarray(distances(state[index, :2], self.goals(index)))

    # -- rewards again ---------------------------------------------------------------------------------------------

    def compute_reward(self, achieved: ArrayLike, desired: ArrayLike) -> Any:
        """Rewards of goals (2,) as a float, or of (n, 2) as (n,), exactly those that `step` gives."""
        a, d = np.asarray(achieved, np.float32), np.asarray(desired, np.float32)
        if a.ndim == 1:
            return float(self.reward(a[None], d[None])[0])
        return np.asarray(self.reward(a, d), np.float64)


def as_machine(machine: MachineLike) -> Machine:
    """The machine itself, or the one of a built-in name or file."""
    if isinstance(machine, Machine):
        return machine
    from ..files import load_machine

    return load_machine(machine)
