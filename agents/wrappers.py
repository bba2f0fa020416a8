"""Vector environment wrapper that applies a `ResidualAction` during training. Needs the extra `agents`."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnvWrapper

from ..envs.sb3_vec_env import HFrameVecEnv
from .residual_action import Observation, ResidualAction


class ResidualActionVecEnv(VecEnvWrapper):
    """Vector environment whose actions are policy outputs, which a `ResidualAction` converts to drive actions.

    Observations also contain the arrays that `ResidualAction.augment` adds.

    Args:
        environment: Vector environment to wrap.
        mapping: Conversion of policy outputs to drive actions, for a batch of all environments.
    """

    def __init__(self, environment: HFrameVecEnv, mapping: ResidualAction) -> None:
        inner_space = environment.observation_space
        assert isinstance(inner_space, spaces.Dict)
        super().__init__(environment, observation_space=mapping.observation_space(inner_space))
        self.mapping = mapping

    def reset(self) -> dict[str, NDArray[Any]]:
        """Start a new episode in every environment.

        Returns:
            First observations: arrays by key, each of shape (num_envs, entries of the key).
        """
        self.mapping.reset()
        return self.mapping.augment(_as_dict(self.venv.reset()))

    def step_async(self, actions: NDArray[Any]) -> None:
        """Convert policy outputs to drive actions and send them to the environments; `step_wait` returns the result.

        Args:
            actions: Policy outputs, usually in [-1, 1], shape (num_envs, drives).
        """
        self.venv.step_async(self.mapping.action(actions))

    def step_wait(
        self,
    ) -> tuple[dict[str, NDArray[Any]], NDArray[np.float64], NDArray[np.bool_], list[dict[str, Any]]]:
        """Finish the step that `step_async` started; environments whose episode has ended are reset.

        The base controller must be called once per control period, so an episode's terminal observation contains the
        base action of the period before; the stage is usually at rest by then.

        Returns:
            observations: Arrays by key, each of shape (num_envs, entries of the key); the first ones of a new episode
                where `dones` is True.
            rewards: Rewards of the step, shape (num_envs,).
            dones: True where an episode has ended, shape (num_envs,).
            infos: One dictionary per environment; `terminal_observation` holds an ended episode's last observation.
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
