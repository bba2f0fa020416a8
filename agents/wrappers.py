"""`ResidualActionVecEnv`: the environment as a policy meets it, with the actuation inside."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnvWrapper

from ..envs.sb3_vec_env import HFrameVecEnv
from .residual_action import ResidualAction


class ResidualActionVecEnv(VecEnvWrapper):
    """An `HFrameVecEnv` whose observations hold what the actuation adds and whose actions are a policy's output."""

    def __init__(self, environment: HFrameVecEnv, actuation: ResidualAction) -> None:
        super().__init__(environment, observation_space=actuation.space(environment.observation_space))
        self.actuation = actuation

    def reset(self) -> dict[str, NDArray[Any]]:
        """Begin episodes everywhere."""
        self.actuation.reset()
        return self.actuation.see(self.venv.reset())

    def step_async(self, actions: NDArray[Any]) -> None:
        """Outputs (num_envs, drives) of the policy."""
        self.venv.step_async(self.actuation.apply(actions))

    def step_wait(
        self,
    ) -> tuple[dict[str, NDArray[Any]], NDArray[np.float64], NDArray[np.bool_], list[dict[str, Any]]]:
        """As the environment's.

        An episode's last observation gets what was remembered a period before, for the base counts its calls; by then
        the stage rests.
        """
        observation, reward, done, infos = self.venv.step_wait()
        last = self.actuation.remembered()
        for b in np.flatnonzero(done).tolist():
            infos[b]["terminal_observation"].update({key: values[b] for key, values in last.items()})
        if done.any():
            self.actuation.reset(done)
        return self.actuation.see(observation), reward, done, infos
