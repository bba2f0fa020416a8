"""How a policy's output becomes voltages: authority that shrinks near the goal, and a controller underneath.

    action = base + authority * output
    authority = min(most, least + distance / full_at_m + speed / full_at_m_s)

At rest at the goal a tenth of a volt moves the tool by a tenth of a millimetre in a period.  A policy explores with one
level of noise everywhere; with this its noise there is fine, and full far away.  What the stage did in the period
before tells a policy about masses and friction that it is not told; an adaptive base says what it has learnt of them.
Training and the finished agent share this code.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from ..controllers import CONTROLLERS, AdaptivePID
from ..machine import Machine

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Authority:
    """Share of the rated voltage that an output of 1 stands for.

    least: at rest at the goal.  most: anywhere.  full_at_m, full_at_m_s: how far from the goal, and how fast, it would
    have grown by 1.
    """

    least: float = 1.0
    most: float = 1.0
    full_at_m: float = 5e-3
    full_at_m_s: float = 0.2

    def __call__(self, observation: Mapping[str, NDArray[Any]], speeds: slice) -> Array:
        """(B, 1) from an observation whose columns `speeds` are the tool's speeds."""
        distance = np.linalg.norm(observation["desired_goal"] - observation["observation"][:, :2], axis=1)
        speed = np.linalg.norm(observation["observation"][:, speeds], axis=1)
        grown = self.least + distance / self.full_at_m + speed / self.full_at_m_s
        return np.minimum(grown, self.most)[:, None]


class ResidualAction:
    """Between what B stages say and take and what a policy sees and gives.

    base: the name of a controller underneath, or nothing.  authority: keywords of `Authority`.

    `see` comes first in every period, then `apply`.
    """

    def __init__(self, machine: Machine, period: float, base: str | None = None, **authority: float) -> None:
        self.authority = Authority(**authority)
        self.base = CONTROLLERS[base](machine, period) if base else None
        self._adaptive = self.base if isinstance(self.base, AdaptivePID) else None
        self._drives = len(machine.drives)
        self._speeds = slice(2 + self._drives, 4 + self._drives)
        self._fresh = np.zeros(0, np.bool_)  # stages whose episode begins with the next observation
        self._before = self._state = self._last = self._base = self._scale = np.zeros((0, 0))

    @property
    def own(self) -> tuple[str, ...]:
        """The keys that `see` adds and that are actions: of the period before, and the base's of this one."""
        return ("last_action", "base_action") if self.base else ("last_action",)

    def space(self, observation_space: spaces.Dict) -> spaces.Dict:
        """What the policy sees."""
        box = spaces.Box(-1.0, 1.0, (self._drives,), np.float32)
        before = {"last_observation": observation_space["observation"]}
        own = {**before, **dict.fromkeys(self.own, box)}
        if self._adaptive:
            for key, size in self._adaptive.told.items():
                own[key] = spaces.Box(-np.inf, np.inf, (size,), np.float32)
        return spaces.Dict({**observation_space.spaces, **own})

    def reset(self, mask: NDArray[np.bool_] | None = None) -> None:
        """Forget the stages of mask (B,), or all."""
        if self.base:
            self.base.reset(mask)
        if mask is None:
            self._fresh = np.zeros(0, np.bool_)
        elif len(self._fresh):
            self._fresh = self._fresh | mask

    def see(self, observation: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
        """The observation (B rows), what it was a period before, and the actions of `own`."""
        state = observation["observation"]
        if len(self._fresh) != len(state):
            self._fresh = np.ones(len(state), np.bool_)
            self._state, self._last = state, np.zeros((len(state), self._drives))
        fresh = self._fresh[:, None]
        self._before = np.where(fresh, state, self._state)
        self._last = np.where(fresh, 0.0, self._last)
        self._fresh = np.zeros(len(state), np.bool_)
        self._state = state
        self._scale = self.authority(observation, self._speeds)
        if self.base:
            self._base = np.clip(self.base.act(observation), -1.0, 1.0)
        return {**observation, **self.remembered()}

    def remembered(self) -> dict[str, NDArray[np.float32]]:
        """What `see` added last, but the action now the newest one."""
        own = {"last_observation": self._before, "last_action": self._last}
        if self.base:
            own["base_action"] = self._base
        if self._adaptive:
            own |= {key: getattr(self._adaptive, key) for key in self._adaptive.told}
        return {key: values.astype(np.float32) for key, values in own.items()}

    def apply(self, output: NDArray[Any]) -> Array:
        """Actions (B, drives) in [-1, 1] from the policy's output (B, drives)."""
        self.applied(np.clip(self._scale * output + (self._base if self.base else 0.0), -1.0, 1.0))
        return self._last

    def applied(self, actions: Array) -> None:
        """The stages are given actions (B, drives): what the policy sees as its last, and the base as its own."""
        self._last = actions
        if self.base:
            self.base.applied(actions)
