"""Rewards of steps, and the reward "progress", which compares the positions before and after a step.

Goals *as observed* are in m or, with the option `normalize`, normalized. `achieved_goal` is the tool position
and `desired_goal` the position where it should be.

References:
    Ng, Harada and Russell, "Policy invariance under reward transformations" (1999), for the reward
    "progress".
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..arrays import Array, Index, KeyedObservation
from ..dynamics.codegen.compiled import compiled
from ..errors import InputError
from .observation.spaces import ObservationFormat
from .rewards import (
    PROGRESS,
    REWARDS,
    BuiltinReward,
    Evaluation,
    PenalizedReward,
    Positions,
    Reward,
    distances,
    evaluate_rows,
    row_distance,
)

# Per step at the goal, and the distance at which it is halved, m. Without it nothing but the discount makes
# an agent prefer to stay close, and exploration hides that: PPO was then still at 2 mm after 100 000 steps.
PRECISION_BONUS, BONUS_SCALE = 1.0, 2e-3


@REWARDS.register("progress")
class ProgressReward(BuiltinReward):
    """Reward for coming closer to the goal in a step and for being there.

    It is ln((d0 + d before) / (d0 + d after)) + 1 / (1 + d after / d1) with d0 = 1 mm and d1 = 2 mm. Each
    halving of the distance d earns 0.69, at 100 mm as at 10 mm, and each doubling costs as much. A critic has
    little to learn before the policy can improve, so that PPO with its default hyperparameters learns several
    times as fast as with "dense". The first term is the potential-based shaping of Ng, Harada and Russell
    (1999): it changes the best policy only as far as the future is discounted. The second term pays for
    precision.

    Calling the object gives the potential -ln(1 + d / d0), whose increase in a step is the first term;
    `StepRewards` keeps the potential before the step and adds the second term.
    """

    kind = PROGRESS

    def bonus(self, achieved: Positions, desired: Positions) -> Array:
        """Compute the second term of the reward, 1 / (1 + d / 2 mm), dimensionless, shape (n,).

        The distance d to the goal is in m; an angle is multiplied by `meters`, the length of the arm.

        Args:
            achieved: Tool positions, m or rad, shape (n, axes).
            desired: Goals, m or rad, shape (n, axes).
        """
        return PRECISION_BONUS / (1.0 + distances(achieved, desired) * self.meters / BONUS_SCALE)


@compiled
def _evaluate_step(
    tool: Any,
    achieved: Any,
    desired: Any,
    normalization: Any,
    kind: int,
    band: float,
    meters: float,
    first: int,
    last: int,
    before: Any,
    distance: Any,
    reward: Any,
) -> None:
    """Write distances from tool to desired and built-in rewards of rows first..last-1, as `evaluate_rows`.

    normalization (2, axes): center and scale by which achieved and desired are normalized and restored, as an
    agent sees them; scale 0: not at all. before (n,): potentials of "progress" before the step, replaced by
    those after it.
    """
    count, axes = last - first, desired.shape[1]
    goals = np.empty((2, count, axes), np.float32)
    for i in range(count):
        distance[first + i] = row_distance(tool, desired, first + i)
        for axis in range(axes):
            center, scale = normalization[0, axis], normalization[1, axis]
            goals[0, i, axis], goals[1, i, axis] = achieved[first + i, axis], desired[first + i, axis]
            if scale > 0.0:
                for j in range(2):
                    goals[j, i, axis] = (goals[j, i, axis] - center) / scale * scale + center
    seen, values = np.empty(count), np.empty(count)
    evaluate_rows(goals[0], goals[0], False, goals[1], 0, count, kind, band, meters, seen, values)
    for i in range(count):
        if kind == PROGRESS:
            reward[first + i] = (
                values[i] - before[first + i] + PRECISION_BONUS / (1.0 + seen[i] * meters / BONUS_SCALE)
            )
            before[first + i] = values[i]
        else:
            reward[first + i] = values[i]


class StepRewards:
    """Compute the rewards of steps, and of relabeled goals, by a reward function.

    Of an observation, they need `achieved_goal` and `desired_goal`.

    Args:
        observation_format: Converts between positions and goals as observed.
        moving: Whether goals move, so that the desired goal before a step differs from that after it.

    Attributes:
        compares_steps: Whether the reward needs the goals of the step before.
        compiled: Whether `write` computes the rewards; if not, `of_step` does.
        depends_on_distance: Whether the reward of a step is a built-in function of the distance alone, for
            which `evaluation` gives the arguments of `evaluate_rows`.
    """

    def __init__(
        self, reward: Reward, observation_format: ObservationFormat, *, count: int, moving: bool
    ) -> None:
        self.reward, self._format = reward, observation_format
        self._builtin = reward if isinstance(reward, BuiltinReward) else None
        self.compiled = self._builtin is not None
        self._kind, self._constants = 0, (0, 0.0, 1.0)
        if self._builtin is not None:
            self._kind = self._builtin.kind
            self._constants = self._kind, self._builtin.band, self._builtin.meters
        self._normalization = observation_format.goal_normalization()
        self.depends_on_distance = (
            self.compiled and self._kind != PROGRESS and not observation_format.normalize
        )
        self._potential = np.zeros(count)
        inside = reward.reward if isinstance(reward, PenalizedReward) else reward
        self._progress = inside if isinstance(inside, ProgressReward) else None
        # Of the goals before and after the last step, m, these are kept; none unless the reward compares two
        # steps.
        self._keys: tuple[str, ...] = ()
        if self._progress is not None:
            self._keys = ("achieved_goal", "desired_goal") if moving else ("achieved_goal",)
        self.compares_steps = bool(self._keys)
        self._before: dict[str, Positions] = {}
        self._after: dict[str, Positions] = {}

    def begin(self, index: Index, observation: KeyedObservation) -> None:
        """Store the goals of an observation in the rows `index`, where episodes start.

        Only the reward "progress" needs them; for others this method does nothing.
        """
        for key in self._keys:
            for goals in (self._before, self._after):
                goals.setdefault(key, np.zeros_like(observation[key]))[index] = observation[key][index]
        if self._kind == PROGRESS:
            goals_seen = (
                self._format.goal_as_observed(observation[f"{k}_goal"][index])
                for k in ("achieved", "desired")
            )
            self._potential[index] = self._evaluate(self.reward, *goals_seen)

    def evaluation(self, distance: Array, reward: Array) -> Evaluation:
        """Return the last five arguments of `evaluate_rows`, which then computes distances and rewards.

        Use them only if the attribute `depends_on_distance` is True.

        Args:
            distance: Array that `evaluate_rows` fills with distances to the goals, m or rad, shape (count,).
            reward: Array that it fills with rewards, dimensionless, shape (count,).
        """
        return *self._constants, distance, reward

    def write(
        self,
        rows: slice,
        observation: KeyedObservation,
        tool: Positions,
        distance: Array,
        reward: Array,
    ) -> None:
        """Compute distances and rewards of the last step for some environments, in compiled code.

        Call it only if the attribute `compiled` is True, and once per step and environment: the reward
        "progress" compares the distances after this step with those that the previous call stored. Calls for
        different rows may run in several threads at once.

        Args:
            rows: The environments, a slice with start and stop.
            tool: True tool positions, m or rad, shape (count, axes).
            distance: Output, distances from `tool` to the goals, m or rad, shape (count,); other rows are not
                changed.
            reward: Output, rewards, dimensionless, shape (count,); other rows are not changed.
        """
        achieved, desired = observation["achieved_goal"], observation["desired_goal"]
        constants = self._normalization, *self._constants, rows.start, rows.stop
        _evaluate_step(tool, achieved, desired, *constants, self._potential, distance, reward)

    def keep_goals(self, observation: KeyedObservation) -> None:
        """Store the goals after a step for the `info` of the next one.

        Call it once per step if the attribute `compares_steps` is True (reward "progress").
        """
        self._before, self._after = self._after, {key: observation[key].copy() for key in self._keys}

    def of_step(self, observation: KeyedObservation) -> Array:
        """Compute the rewards of the last step, shape (count,), if the attribute `compiled` is False.

        Call `keep_goals` before if `compares_steps` is True.
        """
        achieved, desired = (
            self._format.goal_as_observed(observation[f"{key}_goal"]) for key in ("achieved", "desired")
        )
        rewards: Array = self.compute(achieved, desired, self.info())
        return rewards

    def info(self) -> dict[str, Positions]:
        """Return the goals before the last step by key, as observed, shape (count, axes), for the info.

        `compute` needs them to compute the reward "progress" again, for example for relabeled goals. Right
        after a reset they are the present goals. The dict is empty for rewards other than "progress".
        """
        return {f"previous_{key}": self._format.goal_as_observed(g) for key, g in self._before.items()}

    def compute(self, achieved_goal: Any, desired_goal: Any, info: Any = None) -> Any:
        """Compute rewards from achieved and desired goals, for example after hindsight relabeling.

        For the goals that `step` returned, the result equals the rewards of `step` bit by bit. It is a float
        if both goals have the shape (axes,), else an array of shape (n,).

        Args:
            achieved_goal: Achieved goals as observed (m, rad or normalized), shape (axes,) or (n, axes).
            desired_goal: Desired goals, likewise. A single goal is combined with each of n goals of the other
                argument.
            info: Info of the step, or one info per row. Only the reward "progress" uses it:
                `previous_achieved_goal` and, if goals move, `previous_desired_goal`.

        Raises:
            InputError: If the shapes of the goals do not fit together. For the reward "progress" also if an
                info lacks the goals before the step, or there is not one info per row.
        """
        achieved, desired = self._same_shape(achieved_goal, desired_goal)
        rewards = self._evaluate(self.reward, achieved, desired)
        if self._progress is not None:
            rewards = rewards - self._evaluate(self.reward, *_previous_goals(info, desired))
            rewards = rewards + self._evaluate(self._progress.bonus, achieved, desired)
        return rewards if achieved.ndim > 1 else float(rewards[0])

    def _same_shape(self, achieved_goal: Any, desired_goal: Any) -> tuple[NDArray[Any], NDArray[Any]]:
        """Return goals as arrays of one shape, (axes,) or (n, axes); raise InputError if they do not fit."""
        achieved, desired = np.asarray(achieved_goal), np.asarray(desired_goal)
        axes = self._normalization.shape[1]
        fits = all(goal.ndim in (1, 2) and goal.shape[-1] == axes for goal in (achieved, desired))
        if fits and achieved.shape == desired.shape:
            return achieved, desired
        counts = {len(np.atleast_2d(goal)) for goal in (achieved, desired)} - {1}
        if not fits or len(counts) > 1:
            raise InputError(
                f"compute_reward: achieved_goal has shape {achieved.shape} and desired_goal {desired.shape}; "
                f"both must be ({axes},) or (n, {axes}), with the same n"
            )
        shape = np.broadcast_shapes(achieved.shape, desired.shape)
        return np.array(np.broadcast_to(achieved, shape)), np.array(np.broadcast_to(desired, shape))

    def _evaluate(self, function: Reward, achieved: NDArray[Any], desired: NDArray[Any]) -> Array:
        """Return the values (n,) of a function of positions for goals as observed (n, axes) or (axes,)."""
        goals = (np.atleast_2d(self._format.goal_in_axis_unit(goal)) for goal in (achieved, desired))
        return np.asarray(function(*goals), np.float64)


def _previous_goals(info: Any, desired: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return achieved and desired goals before a step, of the shape of `desired`, from one or many infos."""
    infos = [info] if isinstance(info, Mapping) else list(info if info is not None else ())
    if not infos or any("previous_achieved_goal" not in each for each in infos):
        raise InputError(
            "reward 'progress' compares two steps and needs info['previous_achieved_goal'], which "
            "HerReplayBuffer(copy_info_dict=True) keeps; or choose reward='sparse' or 'dense'"
        )
    keys = "previous_achieved_goal", "previous_desired_goal"
    goals = [np.array([each[key] for each in infos]) if key in infos[0] else desired for key in keys]
    if any(values.size != desired.size for values in goals):
        raise InputError(
            f"compute_reward: {len(infos)} infos for goals of shape {desired.shape}; "
            "'progress' needs one per row"
        )
    achieved_before, desired_before = (np.reshape(values, desired.shape) for values in goals)
    return achieved_before, desired_before
