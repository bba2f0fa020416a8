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

from .blocks import compiled

Goals: TypeAlias = NDArray[np.float32]
Reward: TypeAlias = Callable[[Goals, Goals], NDArray[np.float64]]
RewardLike: TypeAlias = Literal["dense", "sparse"] | Reward

# m.  One scale a decade, so that halving the distance pays about the same from 0.5 m down to 10 um.
SCALES = (2e-1, 2e-2, 2e-3, 2e-4, 2e-5)


@compiled
def distances(achieved: Any, desired: Any) -> Any:
    """Distance between the goals, (n,) m."""
    out = np.empty(achieved.shape[0])
    for b in range(achieved.shape[0]):
        x = np.float64(achieved[b, 0]) - np.float64(desired[b, 0])
        y = np.float64(achieved[b, 1]) - np.float64(desired[b, 1])
        out[b] = np.sqrt(x * x + y * y)
    return out


@compiled
def dense(achieved: Any, desired: Any) -> Any:
    """Minus the mean of d / (d + scale) over `SCALES`: 0 at the target, towards -1 far from it.

    Smooth for d > 0 and like -log d in between; its slope at 0.1 mm is about a hundred times that at 10 mm, so that it
    keeps paying to come closer where a plain distance has become too small to learn from.
    """
    out = distances(achieved, desired)
    for b in range(out.shape[0]):
        total = 0.0
        for scale in SCALES:
            total += out[b] / (out[b] + scale)
        out[b] = -total / len(SCALES)
    return out


@dataclass(frozen=True)
class Sparse:
    """0 within a band around the target, -1 outside.  band: m."""

    band: float

    def __call__(self, achieved: Goals, desired: Goals) -> NDArray[np.float64]:
        return np.where(distances(achieved, desired) <= self.band, 0.0, -1.0)


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
    if reward == "dense":
        return dense
    if reward == "sparse":
        return Sparse(band)
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
