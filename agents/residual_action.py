"""Residual action: base controller plus policy output, scaled by an authority that shrinks near the goal.

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
    """Authority of a policy: the fraction of the rated voltage that an output of 1 represents, by distance and speed.

    Attributes:
        least: Fraction for a tool at rest at its goal, 0 to 1.
        most: Upper limit of the fraction, 0 to 1.
        full_at_m: Distance to the goal that increases the fraction by 1, m.
        full_at_m_s: Tool speed that increases the fraction by 1, m/s.
    """

    least: float = 1.0
    most: float = 1.0
    full_at_m: float = 5e-3
    full_at_m_s: float = 0.2

    def __call__(self, observation: Observation, tool_speeds: slice) -> Array:
        """Compute the fraction of the rated voltage that a policy output of 1 represents, for each environment.

        It is min(most, least + distance / full_at_m + speed / full_at_m_s), with distance to the goal and tool speed.

        Args:
            observation: Arrays by key. `observation`: full state, the tool position in its first columns, m, shape
                (batch, entries) for a batch of environments. `desired_goal`: tool goal, m, shape (batch, axes).
            tool_speeds: Slice of the columns of `observation` that hold the tool velocity along its axes, m/s.

        Returns:
            Fractions of the rated voltage, shape (batch, 1).
        """
        goal = observation["desired_goal"]
        distance = np.linalg.norm(goal - observation["observation"][:, : goal.shape[1]], axis=1)
        speed = np.linalg.norm(observation["observation"][:, tool_speeds], axis=1)
        unlimited = self.least + distance / self.full_at_m + speed / self.full_at_m_s
        return np.minimum(unlimited, self.most)[:, None]


class ResidualAction:
    """Conversion of policy outputs to actions, action = base + authority * output, for a batch of environments.

    The base is the action of another controller; the authority is a fraction of the rated voltage (see `Authority`).
    The class also adds the previous observation, the previous action and the base controller's action to the
    observations. In every control period, call `augment` first, then `action`.

    Args:
        machine: Machine for which the base controller is designed.
        period: Control period, s.
        base: Name of a registered controller whose action the policy corrects; None: the policy acts alone.
        **authority: Keyword arguments of `Authority`, which limits the policy's part of the action.

    Attributes:
        authority: Fraction of the rated voltage that an output of 1 represents, by distance and speed.
        base: Controller whose action the policy corrects, or None.

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
        axes = machine.tool_axes
        first = len({*axes, *(drive.coordinate for drive in machine.drives)})  # after all positions
        self._tool_speeds = slice(first, first + len(axes))
        self._starts = EpisodeStarts()
        self._state: NDArray[Any] = np.zeros((0, 0))  # `observation` of this period, (batch, entries)
        self._last_state: NDArray[Any] = np.zeros((0, 0))  # and of the previous period
        self._last_action = self._base_action = self._authority = np.zeros((0, 0))  # (batch, drives), (batch, 1)

    def observation_space(self, observation_space: spaces.Dict) -> spaces.Dict:
        """Extend the observation space of an environment by the keys that `augment` adds.

        Args:
            observation_space: Observation space of one environment.

        Returns:
            Observation space of the policy: the given keys and `last_observation`, `last_action`; with a base
            controller also `base_action`; with an `AdaptiveController` as base also `expected_friction` and
            `estimates`.
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
        """Clear the history of environments whose next observation starts a new episode.

        Args:
            mask: True for the environments to reset, shape (batch,) for a batch of environments. Default: all; the
                number of environments may then change.
        """
        if self.base:
            self.base.reset(mask)
        self._starts.reset(mask)

    def augment(self, observation: Observation) -> dict[str, NDArray[Any]]:
        """Run the base controller; add its action, the previous observation and the previous action to an observation.

        Call it once per control period: the base controller advances by one period.

        Args:
            observation: Arrays by key as the environment returns them, m, rad, m/s and rad/s, each of shape (batch,
                entries of the key) for a batch of environments.

        Returns:
            Arrays by key, each of shape (batch, entries of the key), in SI: the given ones and those that `history`
            returns.

        Raises:
            InputError: If the base controller does not accept the observation.
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
        """Return the arrays that a policy receives beside the observation, with the most recent action.

        Returns:
            last_observation: `observation` of the previous period, m, rad, m/s and rad/s, shape (batch, entries) for a
                batch of environments.
            last_action: Voltages divided by the rated voltages, shape (batch, drives).
            base_action: Action of the base controller, which the policy corrects, likewise; only with a base.
            expected_friction: Attribute of this name of an `AdaptiveController`, and likewise `estimates`; only if it
                is the base.
        """
        added: dict[str, NDArray[Any]] = {"last_observation": self._last_state, "last_action": self._last_action}
        if self.base:
            added["base_action"] = self._base_action
        if self._adaptive_base:
            added |= {key: getattr(self._adaptive_base, key) for key in ADAPTIVE_FEATURES}
        return {key: values.astype(np.float32) for key, values in added.items()}

    def action(self, output: NDArray[Any]) -> Array:
        """Convert policy outputs to actions, and record the actions as applied.

        action = base action + authority * output, where the base action is that of another controller and the authority
        is the fraction of the rated voltage that an output of 1 represents.

        Args:
            output: Policy outputs, usually in [-1, 1], shape (batch, drives) for a batch of environments.

        Returns:
            Voltages divided by the rated voltages, limited to [-1, 1], shape (batch, drives).
        """
        base_action = self._base_action if self.base else 0.0
        self.replace_last_action(np.clip(self._authority * output + base_action, -1.0, 1.0))
        return self._last_action

    def replace_last_action(self, actions: Array) -> None:
        """Record the actions that were applied, for the next observation and for the base controller.

        Args:
            actions: Applied voltages divided by the rated voltages, in [-1, 1], shape (batch, drives) for a batch of
                environments.
        """
        self._last_action = actions
        if self.base:
            self.base.replace_last_action(actions)


def residual_action(machine: Machine, settings: Mapping[str, Any], period: float) -> ResidualAction | None:
    """Build the conversion of policy outputs to actions (base controller plus correction) from a recipe's settings.

    Args:
        machine: Machine for which the base controller is designed.
        settings: Keyword arguments of `ResidualAction` except machine and period: the recipe's table [actuation].
        period: Control period, s.

    Returns:
        The conversion, or None if `settings` is empty: the policy's outputs are then the actions.

    Raises:
        InputError: If no controller is registered under the name of the base.
    """
    return ResidualAction(machine, period, **settings) if settings else None
