"""The environment as a policy in training sees it. Needs the extra `agents`."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnvWrapper

from ..envs.sb3_vec_env import HFrameVecEnv
from .residual_action import Observation, ResidualAction


class ResidualActionVecEnv(VecEnvWrapper):
    """Apply a `ResidualAction` inside a vector environment.

    Observations contain the entries that the mapping adds; actions are policy outputs.

    Args:
        environment: Vector environment to wrap.
        mapping: Mapping between policy outputs and actions.
    """

    def __init__(self, environment: HFrameVecEnv, mapping: ResidualAction) -> None:
        inner_space = environment.observation_space
        assert isinstance(inner_space, spaces.Dict)
        super().__init__(environment, observation_space=mapping.observation_space(inner_space))
        self.mapping = mapping

    def reset(self) -> dict[str, NDArray[Any]]:
        """Begin an episode in every environment.

        Returns:
            First observations, each value of shape (num_envs, entries of the key).
        """
        self.mapping.reset()
        return self.mapping.augment(_as_dict(self.venv.reset()))

    def step_async(self, actions: NDArray[Any]) -> None:
        """Start a step.

        Args:
            actions: Policy outputs, shape (num_envs, drives).
        """
        self.venv.step_async(self.mapping.action(actions))

    def step_wait(
        self,
    ) -> tuple[dict[str, NDArray[Any]], NDArray[np.float64], NDArray[np.bool_], list[dict[str, Any]]]:
        """Finish a step.

        The base controller must be called once per control period, so an episode's terminal observation gets the base
        action of the period before; the stage is at rest by then.

        Returns:
            Observations, rewards (num_envs,), end-of-episode flags (num_envs,) and one info per environment.
        """
        observation, reward, done, infos = self.venv.step_wait()
        history = self.mapping.history()
        for b in np.flatnonzero(done).tolist():
            infos[b]["terminal_observation"].update({key: values[b] for key, values in history.items()})
        if done.any():
            self.mapping.reset(done)
        return self.mapping.augment(_as_dict(observation)), reward, done, infos


def _as_dict(observation: Any) -> Observation:
    """Narrow the observation type of stable-baselines3 to a dict, which `HFrameVecEnv` always returns."""
    assert isinstance(observation, dict)
    return observation
