"""`HFrameVecEnv`: the native vector environment as a stable-baselines3 `VecEnv`, without a process an environment.

Needs stable-baselines3, the extra `agents`; nothing else of `hframe_gym.envs` does.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from .vector_env import HFrameVectorEnv

try:
    from stable_baselines3.common.vec_env import VecEnv
except ImportError as error:
    raise ImportError("this adapter needs stable-baselines3: pip install 'hframe-gym[agents]'") from error

Indices = None | int | Iterable[int]


class HFrameVecEnv(VecEnv):  # type: ignore[misc]
    """`num_envs` stages for stable-baselines3.  Keywords are those of `HFrameVectorEnv` but the autoreset mode.

    Observations are fresh dicts of arrays, already reset where an episode ended; that episode's info holds
    `terminal_observation`, `TimeLimit.truncated` (cut, not ended), `is_success` and `distance_m` at its end.  The
    info of an environment whose episode goes on is empty.  `reset_infos` holds the last reset's draws.
    """

    def __init__(self, num_envs: int, **keywords: Any) -> None:
        self.envs = HFrameVectorEnv(num_envs, autoreset_mode=AutoresetMode.SAME_STEP, **keywords)
        self._actions: NDArray[Any] | None = None
        super().__init__(num_envs, self.envs.single_observation_space, self.envs.single_action_space)

    def reset(self) -> dict[str, NDArray[np.float32]]:
        """Begin episodes everywhere, with the seeds and options that `seed` and `set_options` left."""
        options = self._stacked_options()
        observation, info = self.envs.reset(seed=self._seeds, options=options)
        self._keep_reset_infos(info, range(self.num_envs))
        self._reset_seeds()
        self._reset_options()
        return observation

    def _stacked_options(self) -> dict[str, Any]:
        """One row an environment from the dicts of all.

        Raises ValueError when only some environments have an option.
        """
        names = set().union(*self._options)
        if any(set(own) != names for own in self._options):
            raise ValueError("set_options: give every environment the same options")
        return {name: np.array([own[name] for own in self._options]) for name in names}

    def step_async(self, actions: NDArray[Any]) -> None:
        """Keep the actions (num_envs, 2) for `step_wait`."""
        self._actions = actions

    def step_wait(
        self,
    ) -> tuple[dict[str, NDArray[np.float32]], NDArray[np.float64], NDArray[np.bool_], list[dict[str, Any]]]:
        """Observations, rewards (num_envs,), dones (num_envs,) and infos of the actions given last."""
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
        drawn = {name: column for name, column in info.get("parameters", {}).items() if not name.startswith("_")}
        for b in index:
            self.reset_infos[b] = (
                {"parameters": {name: float(column[b]) for name, column in drawn.items()}} if drawn else {}
            )

    def close(self) -> None:
        """Close the environment."""
        self.envs.close()

    def get_images(self) -> Sequence[NDArray[np.uint8] | None]:
        """One picture an environment, in mode rgb_array."""
        return self.envs.render() or [None] * self.num_envs

    # -- what stable-baselines3 asks of single environments; here all share one ------------------------------------

    def get_attr(self, attr_name: str, indices: Indices = None) -> list[Any]:
        """An attribute of the vector environment, once for each index."""
        return [getattr(self.envs, attr_name)] * len(list(self._get_indices(indices)))

    def set_attr(self, attr_name: str, value: Any, indices: Indices = None) -> None:
        """Set an attribute of the vector environment, that is, of all."""
        setattr(self.envs, attr_name, value)

    def env_method(self, method_name: str, *args: Any, indices: Indices = None, **kwargs: Any) -> list[Any]:
        """Call a method of the vector environment once and give its answer for each index."""
        answer = getattr(self.envs, method_name)(*args, **kwargs)
        return [answer] * len(list(self._get_indices(indices)))

    def env_is_wrapped(self, wrapper_class: Any, indices: Indices = None) -> list[bool]:
        """No environment is wrapped."""
        return [False] * len(list(self._get_indices(indices)))
