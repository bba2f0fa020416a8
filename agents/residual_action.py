"""Mapping from a policy's output to drive actions: an authority that shrinks near the goal, plus a base controller.

    action = base + authority * output
    authority = min(most, least + distance / full_at_m + speed / full_at_m_s)

With the tool at rest at the goal, 0.1 V moves it by 0.1 mm in one control period. A policy explores with the same noise
everywhere; the authority makes that noise small at the goal and large far from it. The previous observation and action
let the policy infer masses and friction, which it cannot observe; an adaptive base adds its estimates of them.
Training and the finished agent use this one implementation.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from ..controllers import CONTROLLERS, AdaptiveController, EpisodeStarts
from ..errors import InputError
from ..machine import Machine

Array = NDArray[np.float64]
Observation = Mapping[str, NDArray[Any]]

# What an adaptive base adds to the observation: attributes of `AdaptiveController` in the order of its `feature_sizes`.
ADAPTIVE_FEATURES = ("expected_friction", "estimates")


@dataclass(frozen=True)
class Authority:
    """Fraction of the rated voltage that a policy output of 1 represents.

    Attributes:
        least: Fraction at rest at the goal.
        most: Upper limit of the fraction.
        full_at_m: Distance to the goal over which the fraction grows by 1, m.
        full_at_m_s: Tool speed over which the fraction grows by 1, m/s.
    """

    least: float = 1.0
    most: float = 1.0
    full_at_m: float = 5e-3
    full_at_m_s: float = 0.2

    def __call__(self, observation: Observation, tool_speeds: slice) -> Array:
        """Return the authority of each environment.

        Args:
            observation: Batched observation with `observation`, shape (batch, entries), and `desired_goal`, m, shape
                (batch, 2).
            tool_speeds: Columns of `observation` that hold the tool's speeds, m/s.

        Returns:
            Fractions of the rated voltage, shape (batch, 1).
        """
        distance = np.linalg.norm(observation["desired_goal"] - observation["observation"][:, :2], axis=1)
        speed = np.linalg.norm(observation["observation"][:, tool_speeds], axis=1)
        unlimited = self.least + distance / self.full_at_m + speed / self.full_at_m_s
        return np.minimum(unlimited, self.most)[:, None]


class ResidualAction:
    """Add what a policy needs to the observations of a batch of environments and turn its outputs into actions.

    In every control period `augment` must be called first, then `action`.

    Args:
        machine: Machine for which the base controller is built.
        period: Control period, s.
        base: Name of a registered controller whose action the policy corrects, or None for a policy that acts alone.
        **authority: Keywords of `Authority`.

    Raises:
        InputError: If no controller is registered under the name of the base. Agents are data: their files cannot name
            a module to import.
    """

    def __init__(self, machine: Machine, period: float, base: str | None = None, **authority: float) -> None:
        self.authority = Authority(**authority)
        if base and base not in CONTROLLERS:
            raise InputError(f"base controller {base!r} is unknown; choose one of {', '.join(CONTROLLERS)}")
        self.base = CONTROLLERS.get(base)(machine, period) if base else None
        self._adaptive_base = self.base if isinstance(self.base, AdaptiveController) else None
        self._drives = len(machine.drives)
        self._tool_speeds = slice(2 + self._drives, 4 + self._drives)
        self._starts = EpisodeStarts()
        self._state: NDArray[Any] = np.zeros((0, 0))  # `observation` of this period, (batch, entries)
        self._last_state: NDArray[Any] = np.zeros((0, 0))  # and of the previous period
        self._last_action = self._base_action = self._authority = np.zeros((0, 0))  # (batch, drives), (batch, 1)

    def observation_space(self, observation_space: spaces.Dict) -> spaces.Dict:
        """Return the space of `augment`.

        Args:
            observation_space: Observation space of one environment.

        Returns:
            That space with the keys that `augment` adds.
        """
        action_box = spaces.Box(-1.0, 1.0, (self._drives,), np.float32)
        added: dict[str, spaces.Space[Any]] = {
            "last_observation": observation_space["observation"],
            "last_action": action_box,
        }
        if self.base:
            added["base_action"] = action_box
        if self._adaptive_base:
            for key, size in zip(ADAPTIVE_FEATURES, self._adaptive_base.feature_sizes.values(), strict=True):
                added[key] = spaces.Box(-np.inf, np.inf, (size,), np.float32)
        return spaces.Dict({**observation_space.spaces, **added})

    def reset(self, mask: NDArray[np.bool_] | None = None) -> None:
        """Forget the history of environments whose episode begins with the next observation.

        Args:
            mask: Environments to reset, shape (batch,). Default: all.
        """
        if self.base:
            self.base.reset(mask)
        self._starts.reset(mask)

    def augment(self, observation: Observation) -> dict[str, NDArray[Any]]:
        """Add the previous observation and action, and the base controller's action and estimates.

        Args:
            observation: Batched observation, each value of shape (batch, entries of the key).

        Returns:
            The observation with the keys of `history`.
        """
        state = observation["observation"]
        if self._starts.resize(len(state)):
            self._state, self._last_action = state, np.zeros((len(state), self._drives))
        starting = self._starts.mask[:, None]  # (batch, 1)
        self._last_state = np.where(starting, state, self._state)
        self._last_action = np.where(starting, 0.0, self._last_action)
        self._starts.clear()
        self._state = state
        self._authority = self.authority(observation, self._tool_speeds)
        if self.base:
            self._base_action = np.clip(self.base.act(observation), -1.0, 1.0)
        return {**observation, **self.history()}

    def history(self) -> dict[str, NDArray[np.float32]]:
        """Return the entries that `augment` added last, with the most recent action as `last_action`.

        Returns:
            `last_observation`, `last_action`, and with a base `base_action` and its estimates, each of shape
            (batch, entries of the key).
        """
        added: dict[str, NDArray[Any]] = {"last_observation": self._last_state, "last_action": self._last_action}
        if self.base:
            added["base_action"] = self._base_action
        if self._adaptive_base:
            added |= {key: getattr(self._adaptive_base, key) for key in ADAPTIVE_FEATURES}
        return {key: values.astype(np.float32) for key, values in added.items()}

    def action(self, output: NDArray[Any]) -> Array:
        """Turn the policy's outputs into actions and record them as applied.

        Args:
            output: Policy outputs, shape (batch, drives).

        Returns:
            Actions in [-1, 1], shape (batch, drives).
        """
        base_action = self._base_action if self.base else 0.0
        self.replace_last_action(np.clip(self._authority * output + base_action, -1.0, 1.0))
        return self._last_action

    def replace_last_action(self, actions: Array) -> None:
        """Record the actions that the drives received, for the next observation and for the base controller.

        Args:
            actions: Actions in [-1, 1], shape (batch, drives).
        """
        self._last_action = actions
        if self.base:
            self.base.replace_last_action(actions)


def residual_action(machine: Machine, settings: Mapping[str, Any], period: float) -> ResidualAction | None:
    """Build the action mapping of a recipe.

    Args:
        machine: Machine for which the base controller is built.
        settings: The recipe's [actuation] table.
        period: Control period, s.

    Returns:
        The mapping, or None if the table is empty: the policy's outputs are then the actions.
    """
    return ResidualAction(machine, period, **settings) if settings else None
