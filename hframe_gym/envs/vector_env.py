"""`HFrameVectorEnv`: many stages as a native `gymnasium.vector.VectorEnv`, each step one pass of the batch."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from .config import EnvConfig
from .environment_batch import EnvironmentBatch, Flags, Index, StepResult
from .hframe_env import check_options
from .observations import Observation
from .rendering import TRAIL, Renderer, check_mode, scene
from .spaces import SignalSpec, action_space

Numbers = NDArray[np.float64]


class HFrameVectorEnv(VectorEnv[Observation, NDArray[np.float32], NDArray[Any]]):
    """`num_envs` independent `HFrameEnv`s: the same settings, spaces and bits, env i seeded with seed + i.

    Episodes are cut at max_episode_steps.  autoreset_mode: "NextStep" (default; the step after an episode's end resets
    and ignores its action), "SameStep" (the end's step resets; `final_obs` and `final_info` hold the end) or "Disabled"
    (reset with options={"reset_mask": (num_envs,) bool}).  Returned arrays are fresh.

    Other keywords are those of `EnvConfig`, and render_mode: None or "rgb_array".

    Raises ValueError for settings that do not fit together.
    """

    metadata: ClassVar[dict[str, Any]] = {  # type: ignore[misc]
        "render_modes": ["rgb_array"],
        "render_fps": 100,
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }

    def __init__(
        self,
        num_envs: int = 1,
        *,
        max_episode_steps: int | None = 150,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        render_mode: str | None = None,
        **settings: Any,
    ) -> None:
        if max_episode_steps is not None and max_episode_steps < 1:
            raise ValueError(f"max_episode_steps is {max_episode_steps}, it must be at least 1 or None")
        self.batch = EnvironmentBatch(EnvConfig(**settings), num_envs)
        self.num_envs = num_envs
        self.max_episode_steps = max_episode_steps
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.render_mode = check_mode(render_mode, self.metadata["render_modes"])
        fps = round(1.0 / self.batch.settings.period)
        self.metadata = {**self.metadata, "render_fps": fps, "autoreset_mode": self.autoreset_mode}  # type: ignore[misc]
        self.single_observation_space = self.batch.observation_space
        self.single_action_space = action_space(self.batch.machine)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._over: Flags = np.zeros(num_envs, np.bool_)
        self._renderer: Renderer | None = None
        self._trails: list[deque[tuple[float, float]]] = [
            deque(maxlen=TRAIL) for _ in range(num_envs if render_mode else 0)
        ]

    @property
    def entries(self) -> tuple[SignalSpec, ...]:
        """What each number of `observation` is: name, unit, bounds."""
        return self.batch.observer.entries

    @property
    def privileged_entries(self) -> tuple[SignalSpec, ...]:
        """What each number of `privileged` is; empty without privileged=True."""
        return self.batch.observer.privileged

    # -- reset -----------------------------------------------------------------------------------------------------

    def reset(  # type: ignore[override]
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin episodes in all environments, or in those of options["reset_mask"] (num_envs,) bool.

        seed: of env 0, the others' following, or one each.  options: `start`, `target` as (2,) or one row for each
        environment that is reset, m.

        Raises ValueError or TypeError for seeds and options that do not fit.
        """
        options = dict(options or {})
        index = self._which(options.pop("reset_mask", None))
        for b in index.tolist():
            own = seed[b] if isinstance(seed, Sequence) else None if seed is None else seed + b
            if own is not None:
                self.batch.population.seed(b, seeding.np_random(own)[0])
        self.batch.reset(index, **check_options(options))
        self._over[index] = False
        self._follow(index)
        return self.batch.observe(), self._reset_info(index, {})

    def _which(self, mask: Any) -> Index:
        if mask is None:
            return np.arange(self.num_envs)
        if not isinstance(mask, np.ndarray) or mask.dtype != np.bool_:
            raise TypeError(f"options['reset_mask'] must be a NumPy array of bool, not {type(mask).__name__}")
        if mask.shape != (self.num_envs,) or not mask.any():
            raise ValueError(f"options['reset_mask'] must have shape ({self.num_envs},) and hold at least one True")
        return np.flatnonzero(mask)

    # -- step ------------------------------------------------------------------------------------------------------

    def step(
        self, actions: Any
    ) -> tuple[Observation, NDArray[np.float64], Flags, Flags, dict[str, Any]]:  # fmt: skip
        """One control period of all environments under actions (num_envs, 2).

        Raises ValueError for actions of another shape or not finite, RuntimeError in mode "Disabled" when an episode
        that is over was not reset.
        """
        checked = self.batch.check_actions(actions)
        resetting = np.flatnonzero(self._over)
        if self.autoreset_mode is AutoresetMode.DISABLED and len(resetting):
            raise RuntimeError(
                f"the episode of environment {resetting[0]} is over; reset it with options['reset_mask']"
            )
        outcome = self.batch.step(checked, self.max_episode_steps)
        terminated, truncated = outcome.terminated, outcome.truncated
        info: dict[str, Any] = {}
        if self.autoreset_mode is AutoresetMode.NEXT_STEP:
            if len(resetting):
                self.batch.restart(resetting, outcome)
                outcome.reward[resetting] = 0.0
                terminated[resetting] = truncated[resetting] = False
            self._over = terminated | truncated
        elif self.autoreset_mode is AutoresetMode.SAME_STEP:
            resetting = np.flatnonzero(terminated | truncated)
            if len(resetting):
                info = self._final(resetting, outcome)
                self.batch.restart(resetting, outcome)
        else:
            self._over = terminated | truncated
        self._add(info, None, outcome.distance, outcome.contour)
        if len(resetting):
            self._add_drawn(info, resetting)
        self._follow(resetting)
        return outcome.observation, outcome.reward, terminated, truncated, info

    def compute_reward(self, achieved_goal: Any, desired_goal: Any, info: Any) -> Any:
        """Reward of goals (2,) or (n, 2), m; `info` is not looked at.  Exactly what `step` gave for the same goals."""
        return self.batch.compute_reward(achieved_goal, desired_goal)

    # -- info, each key with its mask _key -------------------------------------------------------------------------

    def _add(self, info: dict[str, Any], mask: Flags | None, distance: Numbers, contour: Numbers | None) -> None:
        """Add what info always has; mask: of the environments it is about, None for all."""
        columns = {"distance_m": distance, "is_success": distance <= self.batch.task.band}
        columns["clipped_actions"] = self.batch.clipped.copy()
        if contour is not None:
            columns["contour_m"] = contour
        for key, values in columns.items():
            info[key] = values if mask is None else np.where(mask, values, np.zeros((), values.dtype))
            info[f"_{key}"] = np.ones(self.num_envs, np.bool_) if mask is None else mask.copy()

    def _add_drawn(self, info: dict[str, Any], index: Index) -> None:
        drawn = self.batch.drawn(index)
        if not drawn:
            return
        mask = self._mask(index)
        parameters: dict[str, Any] = {}
        for name, values in drawn.items():
            column = np.zeros(self.num_envs)
            column[index] = values
            parameters[name], parameters[f"_{name}"] = column, mask
        info["parameters"], info["_parameters"] = parameters, mask

    def _reset_info(self, index: Index, info: dict[str, Any]) -> dict[str, Any]:
        distance = np.zeros(self.num_envs)
        distance[index] = self.batch.distance(index)
        self._add(info, self._mask(index), distance, self.batch.contour(slice(None)))
        self._add_drawn(info, index)
        return info

    def _final(self, index: Index, outcome: StepResult) -> dict[str, Any]:
        mask = self._mask(index)
        final_obs = np.full(self.num_envs, None, dtype=object)
        copies = {key: values[index] for key, values in outcome.observation.items()}
        for i, b in enumerate(index.tolist()):
            final_obs[b] = {key: values[i] for key, values in copies.items()}
        final_info: dict[str, Any] = {}
        self._add(final_info, mask, outcome.distance, outcome.contour)
        return {"final_obs": final_obs, "_final_obs": mask, "final_info": final_info, "_final_info": mask.copy()}

    def _mask(self, index: Index) -> Flags:
        mask = np.zeros(self.num_envs, np.bool_)
        mask[index] = True
        return mask

    # -- rendering -------------------------------------------------------------------------------------------------

    def _follow(self, fresh: Index) -> None:
        if self.render_mode is None:
            return
        for b in fresh.tolist():
            self._trails[b].clear()
        for b, trail in enumerate(self._trails):
            position = self.batch.stages.positions(b)
            trail.append((position["x"], position["y"]))

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:  # type: ignore[override]
        """One picture (height, width, 3) for each environment.

        Raises ImportError naming the extra where pygame is not installed.
        """
        if self.render_mode is None:
            return None
        if self._renderer is None:
            self._renderer = Renderer(self.batch.machine, self.render_mode, self.metadata["render_fps"])
        frames = (self._renderer.draw(scene(self.batch, b, trail)) for b, trail in enumerate(self._trails))
        return tuple(frame for frame in frames if frame is not None)

    def close_extras(self, **kwargs: Any) -> None:
        """Let go of the renderer."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_renderer": None}
