"""`HFrameVecEnv`: the native vector environment as a stable-baselines3 `VecEnv`, in one process.

It needs stable-baselines3, the extra `agents`; nothing else of `hframe_gym.envs` does.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, Unpack

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from .config import EnvOptions
from .vector_env import HFrameVectorEnv

try:
    from stable_baselines3.common.vec_env import VecEnv
except ImportError as error:
    raise ImportError("this adapter needs stable-baselines3: pip install 'hframe_gym[agents]'") from error

Indices = None | int | Iterable[int]


class HFrameVecEnv(VecEnv):  # type: ignore[misc]
    """Many machines for stable-baselines3.

    Observations are new dicts of arrays, those after the reset where an episode ended. The info of an episode that
    ended holds `terminal_observation`, `TimeLimit.truncated` (the limit, not the workspace's edge, ended it),
    `is_success` and `distance_m` at its end; the info of an episode that continues is empty.

    Args:
        num_envs: Number of environments.
        max_episode_steps: Control periods until truncation, or None.
        render_mode: None or "rgb_array".
        **options: As for `HFrameEnv`.

    Attributes:
        envs: The native vector environment.
        reset_infos: The randomized parameters of the running episodes.
    """

    def __init__(
        self,
        num_envs: int,
        *,
        max_episode_steps: int | None = 150,
        render_mode: str | None = None,
        **options: Unpack[EnvOptions],
    ) -> None:
        self.envs = HFrameVectorEnv(
            num_envs,
            max_episode_steps=max_episode_steps,
            autoreset_mode=AutoresetMode.SAME_STEP,
            render_mode=render_mode,
            **options,
        )
        self._actions: NDArray[Any] | None = None
        super().__init__(num_envs, self.envs.single_observation_space, self.envs.single_action_space)

    def reset(self) -> dict[str, NDArray[np.float32]]:
        """Begin episodes everywhere, with the seeds and options of `seed` and `set_options`.

        Returns:
            Observations, first axis num_envs.
        """
        options = self._stacked_options()
        observation, info = self.envs.reset(seed=self._seeds, options=options)
        self._keep_reset_infos(info, range(self.num_envs))
        self._reset_seeds()
        self._reset_options()
        return observation

    def _stacked_options(self) -> dict[str, Any]:
        """Return the options of all environments, one row each; raises ValueError if only some have an option."""
        names = set().union(*self._options)
        if any(set(options) != names for options in self._options):
            raise ValueError("set_options: give every environment the same options")
        return {name: np.array([options[name] for options in self._options]) for name in names}

    def step_async(self, actions: NDArray[Any]) -> None:
        """Keep actions for `step_wait`.

        Args:
            actions: Fractions of the rated voltages, shape (num_envs, 2).
        """
        self._actions = actions

    def step_wait(
        self,
    ) -> tuple[dict[str, NDArray[np.float32]], NDArray[np.float64], NDArray[np.bool_], list[dict[str, Any]]]:
        """Advance by one control period with the actions of `step_async`.

        Returns:
            Observations, rewards, dones, first axis num_envs each, and one info per environment.
        """
        observation, reward, terminated, truncated, info = self.envs.step(self._actions)
        done = terminated | truncated
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        if "final_obs" in info:
            over = np.flatnonzero(done).tolist()
            final = info["final_info"]
            for b in over:
                infos[b] = {
                    "terminal_observation": info["final_obs"][b],
                    "TimeLimit.truncated": bool(truncated[b] and not terminated[b]),
                    "is_success": bool(final["is_success"][b]),
                    "distance_m": float(final["distance_m"][b]),
                }
            self._keep_reset_infos(info, over)
        return observation, reward, done, infos

    def _keep_reset_infos(self, info: dict[str, Any], index: Iterable[int]) -> None:
        """Keep the randomized parameters of environments whose episodes begin."""
        columns = {name: column for name, column in info.get("parameters", {}).items() if not name.startswith("_")}
        for b in index:
            parameters = {name: float(column[b]) for name, column in columns.items()}
            self.reset_infos[b] = {"parameters": parameters} if parameters else {}

    def close(self) -> None:
        """Close the environment."""
        self.envs.close()

    def get_images(self) -> Sequence[NDArray[np.uint8] | None]:
        """Draw all stages.

        Returns:
            One picture per environment in mode "rgb_array", else None for each.
        """
        return self.envs.render() or [None] * self.num_envs

    # -- stable-baselines3's access to single environments; all are part of one vector environment -------------------

    def get_attr(self, attr_name: str, indices: Indices = None) -> list[Any]:
        """Return an attribute of the vector environment.

        Args:
            attr_name: Name of the attribute.
            indices: Environments, None for all.

        Returns:
            The attribute, once for each index.
        """
        return [getattr(self.envs, attr_name)] * len(list(self._get_indices(indices)))

    def set_attr(self, attr_name: str, value: Any, indices: Indices = None) -> None:
        """Set an attribute of the vector environment, and thereby of all environments.

        Args:
            attr_name: Name of the attribute.
            value: Its value.
            indices: Not used.
        """
        setattr(self.envs, attr_name, value)

    def env_method(self, method_name: str, *args: Any, indices: Indices = None, **kwargs: Any) -> list[Any]:
        """Call a method of the vector environment once.

        Args:
            method_name: Name of the method.
            *args: Its positional arguments.
            indices: Environments, None for all.
            **kwargs: Its keywords.

        Returns:
            The result, once for each index.
        """
        result = getattr(self.envs, method_name)(*args, **kwargs)
        return [result] * len(list(self._get_indices(indices)))

    def env_is_wrapped(self, wrapper_class: Any, indices: Indices = None) -> list[bool]:
        """Return that no environment is wrapped.

        Args:
            wrapper_class: Not used.
            indices: Environments, None for all.

        Returns:
            False for each index.
        """
        return [False] * len(list(self._get_indices(indices)))
