"""Rewards: functions of the achieved and the desired position, and of nothing else.

A reward is called with achieved and desired positions, float32, m, shape (n, axes) each, and returns (n,)
float64. A replay buffer can therefore compute the rewards again for other goals and gets the same bits. The
built-in rewards use only arithmetic and the square root, which round alike on every machine; "progress" has a
logarithm.

Register a new one under a name with `@REWARDS.register("name")`: a class, or a function that returns a
reward, which is called with the task's tolerance band in m.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..arrays import Array
from ..dynamics.codegen.compiled import compiled
from ..errors import InputError
from ..machine import METERS, AxisUnit
from ..registry import Registry
from .workspace import outside_workspace

Positions: TypeAlias = NDArray[np.float32]
Reward: TypeAlias = Callable[[Positions, Positions], Array]
# The last arguments of `evaluate_rows`: kind, band and length of a unit of a built-in reward, and the arrays
# for distances and rewards.
Evaluation: TypeAlias = tuple[int, float, float, Array, Array]
RewardLike: TypeAlias = Literal["dense", "sparse"] | str | Reward

REWARDS: Registry[Callable[[float], Reward]] = Registry("reward")

# m. One scale per decade, so that halving the distance pays about the same from 0.5 m down to 10 um.
SCALES = (2e-1, 2e-2, 2e-3, 2e-4, 2e-5)
# Weights of the scales in the reward "arrival": the time until 0.2 mm depends on the last millimeters before
# the goal.
ARRIVAL_WEIGHTS = (0.05, 0.05, 0.3, 0.5, 0.1)
PROGRESS_SCALE = 1e-3  # m; below this distance, coming closer pays less and less in the reward "progress"
_DENSE, _SPARSE, PROGRESS, _ARRIVAL = 0, 1, 2, 3


@compiled
def row_distance(first: Any, second: Any, b: int) -> float:
    """Compute the distance of rows b of two arrays of positions, m or rad, shape (n, 1) or (n, 2) each."""
    last = first.shape[1] - 1
    x = np.float64(first[b, 0]) - np.float64(second[b, 0])
    y = np.float64(first[b, last]) - np.float64(second[b, last])
    # The factor is 1 with two axes and 0 with one; a branch would keep the compiler from vectorizing the
    # loops.
    return np.sqrt(x * x + np.float64(last) * (y * y))


@compiled
def evaluate_rows(
    tool: Any,
    achieved: Any,
    measured: bool,
    desired: Any,
    first: int,
    last: int,
    kind: int,
    band: float,
    meters: float,
    distance: Any,
    reward: Any,
) -> None:
    """Compute distances to the goal and built-in rewards of rows first to last - 1 (one row per environment).

    Args:
        tool: True tool positions, m or rad, shape (n, axes).
        achieved: Tool positions that the reward uses, true or measured, m or rad, shape (n, axes).
        measured: Whether `achieved` is measured and can differ from `tool`; if not, only `tool` is used.
        desired: Goal positions, m or rad, shape (n, axes).
        kind: Number of the built-in reward for the distance d. 0, dense: minus the mean of d / (d + scale)
            over `SCALES`, from -1 (far) to 0 (at the goal). 1, sparse: 0 within `band` and -1 outside. 2: the
            potential of "progress", -ln(1 + d / 1 mm). 3, arrival: dense with the weights `ARRIVAL_WEIGHTS`.
        band: Distance to the goal within which the sparse reward is 0, m or rad.
        meters: Length, m, that one unit of position corresponds to in the other rewards: 1 for m, `ARM` for
            rad.
        distance: Output, distances from `tool` to `desired`, m or rad, shape (n,).
        reward: Output, rewards for the distances from `achieved` to `desired`, dimensionless, shape (n,).
    """
    # One loop for each operation, which the compiler vectorizes.
    for b in range(first, last):
        distance[b] = row_distance(tool, desired, b)
    seen = reward if measured else distance
    if measured:
        for b in range(first, last):
            seen[b] = row_distance(achieved, desired, b)
    if kind == _SPARSE:
        for b in range(first, last):
            reward[b] = 0.0 if seen[b] <= band else -1.0
    elif kind == PROGRESS:
        for b in range(first, last):
            reward[b] = -math.log1p(seen[b] * meters / PROGRESS_SCALE)
    elif kind == _ARRIVAL:
        for b in range(first, last):
            d = seen[b] * meters
            numerator, denominator = 0.0, 1.0
            for scale, weight in zip(SCALES, ARRIVAL_WEIGHTS):  # noqa: B905 (compiled)
                numerator = numerator * (d + scale) + weight * denominator * d
                denominator *= d + scale
            reward[b] = -numerator / denominator
    else:
        for b in range(first, last):
            d = seen[b] * meters
            # The sum of d / (d + scale) as one fraction: a division costs as much as ten products.
            numerator, denominator = 0.0, 1.0
            for scale in SCALES:
                numerator = numerator * (d + scale) + denominator * d
                denominator *= d + scale
            reward[b] = -numerator / (len(SCALES) * denominator)


def _check_same_shape(achieved: Positions, desired: Positions) -> None:
    """Raise InputError unless two arrays have one shape (n, axes), which compiled code does not check."""
    if achieved.shape != desired.shape or achieved.ndim != 2:
        raise InputError(
            f"reward: positions of shapes {achieved.shape} and {desired.shape}; both must be (n, axes)"
        )


def distances(achieved: Positions, desired: Positions) -> Array:
    """Compute the distances from achieved to desired positions, m or rad, shape (n,).

    Args:
        achieved: Tool positions, m or rad, shape (n, axes).
        desired: Goals, m or rad, shape (n, axes).

    Raises:
        InputError: If the two differ in shape.
    """
    _check_same_shape(achieved, desired)
    distance, reward = np.empty(len(achieved)), np.empty(len(achieved))
    evaluate_rows(achieved, achieved, False, desired, 0, len(achieved), _DENSE, 0.0, 1.0, distance, reward)
    return distance


@dataclass(frozen=True)
class BuiltinReward:
    """Base class of the rewards that `step` computes in compiled code, in the same pass as the simulation.

    Args:
        band: Distance to the goal that counts as a success, m or rad.
        meters: Length, m, that one unit of position corresponds to: 1 for m, `ARM` for rad.

    Attributes:
        kind: Number of the reward in `evaluate_rows`: 0 dense, 1 sparse, 2 progress, 3 arrival.
    """

    band: float
    meters: float = 1.0
    kind = _DENSE

    def __call__(self, achieved: Positions, desired: Positions) -> Array:
        """Compute rewards, shape (n,), of achieved tool and goal positions, m or rad, (n, axes) each."""
        _check_same_shape(achieved, desired)
        distance, reward = np.empty(len(achieved)), np.empty(len(achieved))
        constants = self.kind, self.band, self.meters
        evaluate_rows(achieved, achieved, False, desired, 0, len(achieved), *constants, distance, reward)
        return reward


@REWARDS.register("dense")
class DenseReward(BuiltinReward):
    """Reward -mean(d / (d + scale)) over lengths 0.2 m, 20 mm, ..., 20 um (`SCALES`), with the distance d.

    It is 0 at the goal and approaches -1 far from it. In between it resembles -log d: its slope at 0.1 mm is
    about a hundred times that at 10 mm, so that the last tenths of a millimeter still change the reward
    measurably. The lengths of rotary axes are ways at the end of an arm of 0.1 m (`ARM`): d is 0.1 m times
    the angle.
    """

    kind = _DENSE


@REWARDS.register("sparse")
class SparseReward(BuiltinReward):
    """Reward 0 within a distance `band` of the goal, -1 outside."""

    kind = _SPARSE


@REWARDS.register("arrival")
class ArrivalReward(BuiltinReward):
    """Reward like `DenseReward` with the weights 0.05, 0.05, 0.3, 0.5 and 0.1 of lengths 0.2 m to 20 um.

    The approach from 1 to 0.2 mm earns 1.8 times as much as with "dense", that from 0.2 m to 10 mm less than
    half.
    """

    kind = _ARRIVAL


@dataclass(frozen=True)
class PenalizedReward:
    """Reward from which a penalty is subtracted outside the workspace.

    Args:
        reward: Reward inside the workspace, a function of achieved and desired positions.
        workspace: One row per axis of the tool, columns low and high, m, float32 as positions,
            shape (axes, 2).
        penalty: Amount subtracted where the achieved position is outside the workspace, not negative.
    """

    reward: Reward
    workspace: Positions
    penalty: float

    def __call__(self, achieved: Positions, desired: Positions) -> Array:
        """Compute rewards, and subtract the penalty where `achieved` is outside the workspace.

        The positions have the shape (n, axes), the rewards (n,).
        """
        outside = outside_workspace(achieved, self.workspace)
        return np.asarray(self.reward(achieved, desired), np.float64) - self.penalty * outside


def as_reward(reward: RewardLike, band: float, axes: int = 2, unit: AxisUnit = METERS) -> Reward:
    """Convert the environment option `reward` to a reward function.

    Args:
        reward: Registered name ("dense", "sparse", ...), `package.module:name`, or a reward function as it is
            returned.
        band: Distance to the goal that counts as a success, m or rad. What is registered under a name is
            called with it and returns the reward function; a function that is given directly does not receive
            it.
        axes: Number of axes of the tool, for a test call of the function.
        unit: Unit of positions and of the band; the lengths of built-in rewards hold for angles at the end of
            an arm.

    Returns:
        Function of achieved and desired positions, m or rad, shape (n, axes) each, that returns rewards,
        dimensionless, shape (n,). The function for "progress" returns a potential instead, from whose
        increase in a step `StepRewards` computes the reward.

    Raises:
        InputError: If the name is unknown, the function cannot be called with two arrays, or it does not
            return one finite number per row.
    """
    if isinstance(reward, str):
        function = REWARDS.get(reward)(band)
        if isinstance(function, BuiltinReward):
            function = dataclasses.replace(function, meters=1.0 / unit.per_meter)
    elif callable(reward):
        function = reward
    else:
        names = ", ".join(map(repr, REWARDS))
        raise InputError(f"reward is {reward!r}; choose {names} or a function of (achieved, desired)")
    if not isinstance(function, BuiltinReward):
        positions = np.zeros((3, axes), np.float32)
        try:
            result = np.asarray(function(positions, positions))
        except TypeError as error:  # for example another number of arguments
            raise InputError(f"reward: a test call with (achieved, desired) failed: {error}") from error
        if result.shape != (3,) or result.dtype.kind not in "fiub" or not np.all(np.isfinite(result)):
            raise InputError(
                f"reward: for positions of shape (3, {axes}) the function returned shape {result.shape} of "
                f"{result.dtype}; it must return one finite number per row, shape (3,)"
            )
    return function
