"""Rewards: functions of the achieved and the desired position, and of nothing else.

A reward is called with achieved and desired positions, float32, m, shape (n, 2) each, and returns (n,) float64. A
replay buffer can therefore compute the rewards again for other goals and gets the same bits. The built-in rewards use
only arithmetic and the square root, which round alike on every machine.

Register a new one under a name with `@REWARDS.register("name")`: a class, or a function that returns a reward, which
is called with the task's tolerance band in m.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..registry import Registry
from .counter_rng import compiled

Array: TypeAlias = NDArray[np.float64]
Positions: TypeAlias = NDArray[np.float32]
Reward: TypeAlias = Callable[[Positions, Positions], Array]
RewardLike: TypeAlias = Literal["dense", "sparse"] | str | Reward

REWARDS: Registry[Callable[[float], Reward]] = Registry("reward")

# m. One scale per decade, so that halving the distance pays about the same from 0.5 m down to 10 um.
SCALES = (2e-1, 2e-2, 2e-3, 2e-4, 2e-5)
_DENSE, _SPARSE = 0, 1


@compiled
def _distance(first: Any, second: Any, b: int) -> float:
    """Return the distance of row b of two arrays of positions (n, 2), m."""
    x = np.float64(first[b, 0]) - np.float64(second[b, 0])
    y = np.float64(first[b, 1]) - np.float64(second[b, 1])
    return np.sqrt(x * x + y * y)


@compiled
def evaluate_rows(
    tool: Any,
    achieved: Any,
    measured: bool,
    desired: Any,
    kind: int,
    band: float,
    first: int,
    last: int,
    distance: Any,
    reward: Any,
) -> None:
    """Compute distances and built-in rewards of rows first to last - 1.

    Args:
        tool: True tool positions, m, shape (n, 2).
        achieved: Achieved positions, m, shape (n, 2).
        measured: Whether `achieved` is measured, so that it can differ from `tool`.
        desired: Desired positions, m, shape (n, 2).
        kind: Built-in reward, `BuiltinReward.kind`.
        band: Tolerance of the sparse reward, m.
        first: First row.
        last: Row after the last one.
        distance: Output, distance from tool to desired position, m, shape (n,).
        reward: Output, rewards, shape (n,).
    """
    # One loop for each operation, which the compiler vectorizes.
    for b in range(first, last):
        distance[b] = _distance(tool, desired, b)
    if measured:
        for b in range(first, last):
            reward[b] = _distance(achieved, desired, b)
    else:
        reward[first:last] = distance[first:last]
    if kind == _SPARSE:
        for b in range(first, last):
            reward[b] = 0.0 if reward[b] <= band else -1.0
    else:
        for b in range(first, last):
            d = reward[b]
            # The sum of d / (d + scale) as one fraction: a division costs as much as ten products.
            numerator, denominator = 0.0, 1.0
            for scale in SCALES:
                numerator = numerator * (d + scale) + denominator * d
                denominator *= d + scale
            reward[b] = -numerator / (len(SCALES) * denominator)


def distances(achieved: Positions, desired: Positions) -> Array:
    """Compute the distances between positions.

    Args:
        achieved: Positions, m, shape (n, 2).
        desired: Positions, m, shape (n, 2).

    Returns:
        Distances, m, shape (n,).
    """
    distance, reward = np.empty(len(achieved)), np.empty(len(achieved))
    evaluate_rows(achieved, achieved, False, desired, _DENSE, 0.0, 0, len(achieved), distance, reward)
    return distance


@dataclass(frozen=True)
class BuiltinReward:
    """Base of the rewards that `step` computes in the same pass as the physics.

    Args:
        band: Tolerance of the task, m.
    """

    band: float
    kind = _DENSE

    def __call__(self, achieved: Positions, desired: Positions) -> Array:
        """Compute rewards, shape (n,), of achieved and desired positions, m, shape (n, 2) each."""
        distance, reward = np.empty(len(achieved)), np.empty(len(achieved))
        evaluate_rows(achieved, achieved, False, desired, self.kind, self.band, 0, len(achieved), distance, reward)
        return reward


@REWARDS.register("dense")
class DenseReward(BuiltinReward):
    """Minus the mean of d / (d + scale) over `SCALES`, d the distance to the goal.

    It is 0 at the goal and approaches -1 far from it. In between it resembles -log d: its slope at 0.1 mm is about a
    hundred times that at 10 mm, so that approaching further still pays where a plain distance is too small to learn
    from.
    """

    kind = _DENSE


@REWARDS.register("sparse")
class SparseReward(BuiltinReward):
    """0 within the task's band around the goal, -1 outside."""

    kind = _SPARSE


@dataclass(frozen=True)
class PenalizedReward:
    """A reward minus a penalty outside the workspace.

    Args:
        reward: The reward.
        workspace: Rows x and y, columns low and high, m, shape (2, 2).
        penalty: What is subtracted where the tool is outside.
    """

    reward: Reward
    workspace: Array
    penalty: float

    def __call__(self, achieved: Positions, desired: Positions) -> Array:
        """Compute rewards, shape (n,), of achieved and desired positions, m, shape (n, 2) each."""
        outside = outside_workspace(achieved, self.workspace)
        return np.asarray(self.reward(achieved, desired), np.float64) - self.penalty * outside


def outside_workspace(positions: Positions, workspace: NDArray[Any]) -> NDArray[np.bool_]:
    """Test which positions lie outside the workspace.

    Args:
        positions: Positions, m, shape (n, 2).
        workspace: Rows x and y, columns low and high, m, shape (2, 2).

    Returns:
        Flags, shape (n,).
    """
    beyond = (positions < workspace[:, 0]) | (positions > workspace[:, 1])
    return np.asarray(beyond.any(axis=1))


def as_reward(reward: RewardLike, band: float) -> Reward:
    """Return the reward of the option `reward`.

    Args:
        reward: Registered name, `package.module:name`, or a function of achieved and desired positions.
        band: Tolerance of the task, m.

    Returns:
        The reward.

    Raises:
        InputError: If the name is unknown, or the reward does not return one finite number per row.
    """
    if isinstance(reward, str):
        function = REWARDS.get(reward)(band)
    elif callable(reward):
        function = reward
    else:
        names = ", ".join(map(repr, REWARDS))
        raise InputError(f"reward is {reward!r}; choose {names} or a function of (achieved, desired)")
    if not isinstance(function, BuiltinReward):
        positions = np.zeros((3, 2), np.float32)
        result = np.asarray(function(positions, positions))
        if result.shape != (3,) or result.dtype.kind not in "fiub" or not np.all(np.isfinite(result)):
            raise InputError(
                f"reward: for positions of shape (3, 2) the function returned shape {result.shape} of {result.dtype}; "
                "it must return one finite number per row, shape (3,)"
            )
    return function
