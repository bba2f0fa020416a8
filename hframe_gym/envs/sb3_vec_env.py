"""`HFrameVecEnv`: the native vector environment as a stable-baselines3 `VecEnv`, in one process.

It needs stable-baselines3, the extra `agents`; nothing else of `hframe_gym.envs` does.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Unpack

import gymnasium as gym
import numpy as np
from gymnasium.envs.registration import load_env_creator
from gymnasium.vector import AutoresetMode, VectorEnv
from numpy.typing import NDArray
from typing_extensions import override

from ..errors import InputError, is_integer, naming_extra
from .config import EnvOptions, check_keywords
from .vector_env import HFrameVectorEnv

with naming_extra("agents", "this adapter needs stable-baselines3"):
    from stable_baselines3.common.vec_env import VecEnv

Indices = None | int | Iterable[int]


def _vector_entry_point(env_id: str) -> tuple[type[HFrameVectorEnv], dict[str, Any]]:
    """Return the vector environment of an id and its registered keywords; an InputError for another id."""
    spec = gym.registry.get(env_id) if isinstance(env_id, str) else None
    make = (
        load_env_creator(spec.vector_entry_point)
        if spec and isinstance(spec.vector_entry_point, str)
        else None
    )
    if not (isinstance(make, type) and issubclass(make, HFrameVectorEnv)):
        names = [name for name in gym.registry if name.startswith("HFrame")]
        raise InputError(f"env_id is {env_id!r}; choose one of {', '.join(names)}")
    return make, dict(spec.kwargs) if spec else {}


def _row(observation: Any, b: int) -> Any:
    """Return the observation of one environment: a dict of arrays, or an array."""
    if isinstance(observation, dict):
        return {key: values[b].copy() for key, values in observation.items()}
    return observation[b].copy()


def _with_rows(observation: Any, other: Any, rows: NDArray[np.bool_]) -> Any:
    """Return observations with the rows (num_envs,) of other ones."""
    if isinstance(observation, dict):
        return {key: _with_rows(values, other[key], rows) for key, values in observation.items()}
    return np.where(rows[:, None], other, observation)


class HFrameVecEnv(VecEnv):  # type: ignore[misc]
    """Simulate many independent environments behind the `VecEnv` interface of stable-baselines3.

    Observations are new dicts of arrays. Where an episode ended, they are those after the reset, and the info
    holds `terminal_observation`, `TimeLimit.truncated` (the limit, not the workspace's edge, ended the
    episode), `is_success` and `distance_m` (or `distance_rad`) at its end. The info of an episode that
    continues is empty, except that with the reward "progress" every info holds `previous_achieved_goal` (and
    `previous_desired_goal` if goals move), which `compute_reward` needs, and that every info holds what
    wrappers add.

    Args:
        num_envs: Number of environments.
        env_id: Id of the environment, for example "HFrameTrack-v0" or "HFrameFlat-v0".
        max_episode_steps: Control periods until truncation, or None.
        render_mode: None or "rgb_array".
        wrappers: Functions that wrap the vector environment, the innermost first, such as
            `lambda envs: VectorPenaltyWrapper(envs, {"energy": 0.1})`; their `step` must return five values.
        **options: Keywords of `EnvConfig`, as for `HFrameEnv`.

    Attributes:
        envs: The Gymnasium vector environment `HFrameVectorEnv`, without wrappers.
        reset_infos: One dict per environment; `parameters` holds the randomized parameters, SI, by full name.

    Raises:
        InputError: If an option is invalid, options do not fit together, or the id is not one of this
            package.
        TypeError: If a keyword is unknown; the message lists the keywords.
    """

    def __init__(
        self,
        num_envs: int = 1,
        *,
        env_id: str = "HFrame-v0",
        max_episode_steps: int | None = 150,
        render_mode: str | None = None,
        wrappers: Sequence[Callable[[VectorEnv], VectorEnv]] = (),
        **options: Unpack[EnvOptions],
    ) -> None:
        own = ("num_envs", "env_id", "max_episode_steps", "render_mode", "wrappers")
        check_keywords(type(self).__name__, dict(options), own)
        if isinstance(num_envs, str):
            raise InputError(
                f"num_envs is {num_envs!r}, it must be a number; HFrameVecEnv(8, env_id='HFrameTrack-v0')"
            )
        make, keywords = _vector_entry_point(env_id)
        self.envs = make(
            num_envs,
            max_episode_steps=max_episode_steps,
            autoreset_mode=AutoresetMode.DISABLED,
            render_mode=render_mode,
            **{**keywords, **options},
        )
        self._wrapped: VectorEnv = self.envs
        for wrap in wrappers:
            self._wrapped = wrap(self._wrapped)
        self._actions: NDArray[Any] | None = None
        self._described: frozenset[str] = frozenset()  # keys of the infos of a reset
        # Those from which `compute_reward` takes goals.
        self._previous_goals: tuple[str, ...] = ()
        super().__init__(num_envs, self._wrapped.single_observation_space, self._wrapped.single_action_space)

    @override
    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Store seeds for the next reset, `seed` + i for environment i; None draws a random `seed`.

        Raises:
            InputError: If the seed is negative or not an integer.
        """
        if seed is not None and not (is_integer(seed) and seed >= 0):
            raise InputError(f"seed is {seed!r}, it must be an integer that is not negative, or None")
        seeds: Sequence[int | None] = super().seed(None if seed is None else int(seed))
        return seeds

    @override
    def reset(self) -> Any:
        """Begin episodes and return their first observations.

        The seeds and options are those that `seed` and `set_options` stored; they hold for this reset only.
        The seeds remain if the reset raises an error: the next reset then uses them.

        Raises:
            InputError: If an option is unknown, a position is outside the workspace, or `set_options` gave an
                option to some environments only.
        """
        options = self._options
        self._reset_options()
        seeds: Any = self._seeds  # one each, which Gymnasium's annotation lacks
        observation, info = self._wrapped.reset(seed=seeds, options=self._stacked(options))
        self._keep_reset_infos(info, range(self.num_envs))
        self._described = frozenset(info)
        self._previous_goals = tuple(key for key in info if key.startswith("previous_"))
        self._reset_seeds()
        return observation

    def _stacked(self, options: Any) -> dict[str, Any]:
        """Return options of all environments, one row each; raises InputError unless all have the same."""
        if not isinstance(options, Sequence) or not all(isinstance(entry, dict) for entry in options):
            raise InputError(
                f"set_options: {options!r} must be a dict, or a list of one dict per environment"
            )
        if len(options) != self.num_envs or any(set(entry) != set(options[0]) for entry in options):
            raise InputError(f"set_options: give each of the {self.num_envs} environments the same options")
        stacked: dict[str, Any] = {name: [entry[name] for entry in options] for name in options[0]}
        if isinstance(options[0].get("parameters"), Mapping):
            dicts = stacked["parameters"]
            if any(not isinstance(values, Mapping) or set(values) != set(dicts[0]) for values in dicts):
                raise InputError(
                    f"set_options: give each of the {self.num_envs} environments the same parameters"
                )
            stacked["parameters"] = {name: [values[name] for values in dicts] for name in dicts[0]}
        return stacked

    @override
    def step_async(self, actions: NDArray[Any]) -> None:
        """Store actions, fractions of rated voltages, shape (num_envs, drives); `step_wait` applies them."""
        self._actions = actions

    @override
    def step_wait(self) -> tuple[Any, NDArray[np.float64], NDArray[np.bool_], list[dict[str, Any]]]:
        """Advance by one control period with the actions that `step_async` has received.

        Returns:
            observation: Observations after the period; where an episode ended, the first one of the next
            episode.
            reward: Rewards, dimensionless, shape (num_envs,).
            done: Whether the episode ended, shape (num_envs,).
            infos: A dict for each environment. Where an episode ended, it has its last observation
            (`terminal_observation`), `TimeLimit.truncated`, `is_success` (tool within the task's band around
            the goal) and the distance to the goal, `distance_m` or `distance_rad`, at its end. With the
            reward "progress", it has the goals before the step: `previous_achieved_goal` and, if goals move,
            `previous_desired_goal`.

        Raises:
            ValueError: If the actions have another shape or an entry is not finite.
            gymnasium.error.ResetNeeded: If `reset` was not called.
            NotFiniteError: If a position or velocity is not finite (simulation diverged).
        """
        observation, reward, terminated, truncated, info = self._wrapped.step(self._actions)
        done = terminated | truncated
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        distance_key = self.envs.batch.distance_key
        for key in (*self._previous_goals, *(info.keys() - self._described)):  # the latter from wrappers
            for description, value in zip(infos, info[key], strict=True):
                description[key] = value
        over = np.flatnonzero(done).tolist()
        for b in over:
            infos[b] |= {
                "terminal_observation": _row(observation, b),
                "TimeLimit.truncated": bool(truncated[b] and not terminated[b]),
                "is_success": bool(info["is_success"][b]),
                distance_key: float(info[distance_key][b]),
            }
        if over:
            begun, info = self._wrapped.reset(options={"reset_mask": done})
            observation = _with_rows(observation, begun, done)
            self._keep_reset_infos(info, over)
        return observation, reward, done, infos

    def _keep_reset_infos(self, info: dict[str, Any], index: Iterable[int]) -> None:
        """Keep the randomized parameters of environments whose episodes begin."""
        columns = {
            name: column for name, column in info.get("parameters", {}).items() if not name.startswith("_")
        }
        for b in index:
            parameters = {name: float(column[b]) for name, column in columns.items()}
            self.reset_infos[b] = {"parameters": parameters} if parameters else {}

    def close(self) -> None:
        """Release the vector environment and its renderer."""
        self.envs.close()

    @override
    def get_images(self) -> Sequence[NDArray[np.uint8] | None]:
        """Draw the machine of every environment from above, uint8, shape (height, width, 3) each.

        An entry is None without render mode.
        """
        return self.envs.render() or [None] * self.num_envs

    # -- stable-baselines3's access to single environments; all are part of one vector environment
    # -------------------

    @override
    def get_attr(self, attr_name: str, indices: Indices = None) -> list[Any]:
        """Return an attribute of the vector environment, the same for all environments, once per index."""
        return [self.envs.get_attr(attr_name)[0]] * len(list(self._get_indices(indices)))

    @override
    def set_attr(self, attr_name: str, value: Any, indices: Indices = None) -> None:
        """Set an attribute of the vector environment for all environments, whatever the indices are."""
        self.envs.set_attr(attr_name, (value,) * self.num_envs)

    @override
    def env_method(self, method_name: str, *args: Any, indices: Indices = None, **kwargs: Any) -> list[Any]:
        """Call a method of the vector environment once, and return the result once per index.

        `get_wrapper_attr` and `has_wrapper_attr`, which Gymnasium's single environments have, work as there.
        """
        if method_name in ("get_wrapper_attr", "has_wrapper_attr"):
            look_up = getattr if method_name == "get_wrapper_attr" else hasattr
            result = look_up(self.envs, *args, **kwargs)
        else:
            result = getattr(self.envs, method_name)(*args, **kwargs)
        return [result] * len(list(self._get_indices(indices)))

    @override
    def env_is_wrapped(self, wrapper_class: Any, indices: Indices = None) -> list[bool]:
        """Return False for each index: the environments are rows of one vector environment."""
        return [False] * len(list(self._get_indices(indices)))
