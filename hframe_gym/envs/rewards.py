"""Rewards: functions of where the tool is and where it should be, and of nothing else.

Each takes achieved and desired, (n, 2) float32 m, and gives (n,) float64; so a replay buffer may compute them again for
other goals and gets the same bits.  They use only arithmetic and the square root, which round alike everywhere.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from .counter_rng import compiled

Goals: TypeAlias = NDArray[np.float32]
Reward: TypeAlias = Callable[[Goals, Goals], NDArray[np.float64]]
RewardLike: TypeAlias = Literal["dense", "sparse"] | Reward

# m.  One scale a decade, so that halving the distance pays about the same from 0.5 m down to 10 um.
SCALES = (2e-1, 2e-2, 2e-3, 2e-4, 2e-5)
DENSE, SPARSE = 0, 1


@compiled
def _distance(achieved: Any, desired: Any, b: int) -> float:
    x = np.float64(achieved[b, 0]) - np.float64(desired[b, 0])
    y = np.float64(achieved[b, 1]) - np.float64(desired[b, 1])
    return np.sqrt(x * x + y * y)


@compiled
def judge(
    tool: Any,
    achieved: Any,
    sensed: bool,
    desired: Any,
    kind: int,
    band: float,
    first: int,
    last: int,
    distance: Any,
    reward: Any,
) -> None:
    """Distance of the tool (n,), m, and reward of achieved (n,), both in rows first to last - 1 of the goals (n, 2).

    sensed: whether what is achieved may be another place than the tool's.
    """
    # Loops of one thing each, which the compiler turns into vector code.
    for b in range(first, last):
        distance[b] = _distance(tool, desired, b)
    if sensed:
        for b in range(first, last):
            reward[b] = _distance(achieved, desired, b)
    else:
        reward[first:last] = distance[first:last]
    if kind == SPARSE:
        for b in range(first, last):
            reward[b] = 0.0 if reward[b] <= band else -1.0
    else:
        for b in range(first, last):
            d = reward[b]
            # The sum of d / (d + scale) as one fraction: a division costs as much as ten products.
            above, below = 0.0, 1.0
            for scale in SCALES:
                above = above * (d + scale) + below * d
                below *= d + scale
            reward[b] = -above / (len(SCALES) * below)


def distances(achieved: Goals, desired: Goals) -> NDArray[np.float64]:
    """Distance between the goals, (n,) m."""
    return Builtin(DENSE, 0.0).judge(achieved, desired)[0]


@dataclass(frozen=True)
class Builtin:
    """The rewards that step computes beside the physics.

    DENSE: minus the mean of d / (d + scale) over `SCALES`: 0 at the target, towards -1 far from it.  Smooth for d > 0
    and like -log d in between; its slope at 0.1 mm is about a hundred times that at 10 mm, so that it keeps paying to
    come closer where a plain distance has become too small to learn from.
    SPARSE: 0 within `band` (m) around the target, -1 outside.
    """

    kind: int
    band: float

    def __call__(self, achieved: Goals, desired: Goals) -> NDArray[np.float64]:
        return self.judge(achieved, desired)[1]

    def judge(self, achieved: Goals, desired: Goals) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Distances (n,), m, and rewards (n,)."""
        distance, reward = np.empty(len(achieved)), np.empty(len(achieved))
        judge(achieved, achieved, False, desired, self.kind, self.band, 0, len(achieved), distance, reward)
        return distance, reward


@dataclass(frozen=True)
class WithPenalty:
    """A reward less `penalty` wherever the tool is outside the workspace (2, 2): rows x and y, columns low and high."""

    reward: Reward
    workspace: NDArray[np.float64]
    penalty: float

    def __call__(self, achieved: Goals, desired: Goals) -> NDArray[np.float64]:
        outside = outside_of(achieved, self.workspace)
        return np.asarray(self.reward(achieved, desired), np.float64) - self.penalty * outside


def outside_of(achieved: Goals, workspace: NDArray[Any]) -> NDArray[np.bool_]:
    """Where the tool is beyond the workspace (2, 2), (n,)."""
    beyond = (achieved < workspace[:, 0]) | (achieved > workspace[:, 1])
    return np.asarray(beyond.any(axis=1))


def as_reward(reward: RewardLike, band: float) -> Reward:
    """The reward by its name, or a user's function after one trial.

    Raises ValueError for an unknown name, or where a function does not give one finite number a row.
    """
    if isinstance(reward, str) and reward in ("dense", "sparse"):
        return Builtin(SPARSE if reward == "sparse" else DENSE, band)
    if not callable(reward):
        raise ValueError(f"reward is {reward!r}, choose 'dense', 'sparse' or a function of (achieved, desired)")
    trial = np.zeros((3, 2), np.float32)
    answer = np.asarray(reward(trial, trial))
    if answer.shape != (3,) or answer.dtype.kind not in "fiub" or not np.all(np.isfinite(answer)):
        raise ValueError(
            f"reward: for goals of shape (3, 2) the function gave shape {answer.shape} of {answer.dtype}, "
            "it must give one finite number a row, (3,)"
        )
    return reward
