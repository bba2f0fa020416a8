"""`HFrameVectorEnv` and `HFrameTrackVectorEnv`: many machines as one `gymnasium.vector.VectorEnv`."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Unpack

import numpy as np
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray
from typing_extensions import override

from ..arrays import Array, Index
from ..errors import InputError, is_integer
from ..machine import Machine
from .actuation.actuators import action_space
from .batch_properties import BatchProperties
from .config import EnvConfig, EnvOptions, check_keywords, check_render_mode
from .environment_batch import EnvironmentBatch, Flags, StepResult
from .hframe_env import require_path
from .observation.observations import Observation
from .rendering import TRAIL_LENGTH, Renderer, Scene, tool_point
from .reset_options import reset_keywords

_KEYWORDS = ("num_envs", "max_episode_steps", "autoreset_mode", "render_mode")


class HFrameVectorEnv(BatchProperties, VectorEnv[Observation, NDArray[np.float32], NDArray[Any]]):
    """Many independent `HFrameEnv`s with the same options, stepped in one pass.

    Environment i of a vector seeded with s is the single environment seeded with s + i, to the bit.

    ## Action Space, Observation Space, Rewards, Starting State

    Those of `HFrameEnv` with a first axis of num_envs. Every step returns new arrays.

    ## Episode End

    As for `HFrameEnv`, with truncation after `max_episode_steps`. The autoreset modes are Gymnasium's:
    "NextStep" (the step after an episode's end resets and ignores its action), "SameStep" (the last step
    resets; `final_obs` and `final_info` in the info describe the end of the episode) and "Disabled" (the
    caller resets, with options={"reset_mask": mask}, where mask is a bool array of shape (num_envs,)). The
    arrays of `parameters` in an info are read-only.

    ## Arguments

    | keyword | default | meaning |
    |---|---|---|
    | `num_envs` | 1 | number of environments |
    | `max_episode_steps` | 150 | control periods until truncation, or `None` |
    | `autoreset_mode` | `"NextStep"` | see Episode End |
    | `render_mode` | `None` | `None` or `"rgb_array"` |
    | others | | as for `HFrameEnv` |

    Raises:
        InputError: If an option is invalid or options do not fit together.
        TypeError: If a keyword is unknown; the message lists the keywords.
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
        **options: Unpack[EnvOptions],
    ) -> None:
        check_keywords(type(self).__name__, dict(options), _KEYWORDS)
        if max_episode_steps is not None and not (is_integer(max_episode_steps) and max_episode_steps >= 1):
            raise InputError(
                f"max_episode_steps is {max_episode_steps!r}, it must be an integer, at least 1, or None"
            )
        modes = [mode.value for mode in AutoresetMode]
        if not (isinstance(autoreset_mode, AutoresetMode) or autoreset_mode in modes):
            raise InputError(f"autoreset_mode is {autoreset_mode!r}; choose one of {', '.join(modes)}")
        self.batch = EnvironmentBatch(EnvConfig(**options), num_envs)
        self.num_envs = num_envs
        self.max_episode_steps = max_episode_steps
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.render_mode = check_render_mode(render_mode, self.metadata["render_modes"])
        fps = max(1, round(1.0 / self.batch.config.period))
        self.metadata = {**self.metadata, "render_fps": fps, "autoreset_mode": self.autoreset_mode}  # type: ignore[misc]
        self.single_observation_space = self.batch.format.space  # type: ignore[assignment]
        self.single_action_space = action_space(self.batch.machine)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._over: Flags = np.zeros(num_envs, np.bool_)
        self._parameters: dict[str, Any] = {}  # of the running episodes, as info has them
        self._renderer: Renderer | None = None
        self._trails: list[deque[tuple[float, float]]] = [
            deque(maxlen=TRAIL_LENGTH) for _ in range(num_envs if render_mode else 0)
        ]

    @property
    def machine(self) -> Machine:
        """Machine without randomization, with the chosen sensors and actuators."""
        return self.batch.machine

    @property
    def parameters(self) -> Array:
        """Values of the n `machine.parameters`, in order, in running episodes, SI, shape (num_envs, n)."""
        return self.batch.values[:, : len(self.machine.parameters)].copy()

    @property
    def travel(self) -> Array:
        """True positions of all coordinates as belt travel, m, float64, shape (num_envs, coordinates).

        The belt travel of a rotary coordinate is its radius * angle, that of a linear one its position.
        """
        count = len(self.machine.coordinates)
        return (
            self.batch.simulator.state[:, :count]
            .transpose(0, 2, 1)
            .reshape(-1, count)[: self.num_envs]
            .copy()
        )

    @override
    def reset(  # type: ignore[override]
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin episodes in all environments, or in those that the option `reset_mask` selects.

        Args:
            seed: Seed s, which gives environment i the seed s + i, or one seed per environment. None: the
                present sequences of random numbers continue.
            options: The keys of `HFrameEnv.reset`, with one value for all or one row for each environment
                that is reset; `reset_mask`, the environments to reset, bool, shape (num_envs,).

        Raises:
            InputError: As `HFrameEnv.reset`.
            TypeError: If the mask is not an array of bool.
            ValueError: If the mask has another shape or selects nothing, or the number of seeds is wrong.
        """
        mask = options.get("reset_mask") if isinstance(options, Mapping) else None
        index = self._selected(mask)
        # Errors change no random numbers.
        keywords = reset_keywords(options, self.batch, len(index), ("reset_mask",))
        for b, generator in self._generators(seed, index).items():
            self.batch.sampler.seed(b, generator)
        self.batch.reset(index, **keywords)
        self._over[index] = False
        self._collect_parameters()
        self._update_trails(index)
        distance = np.zeros(self.num_envs)
        distance[index] = self.batch.distance(index)
        info: dict[str, Any] = {}
        self._describe(info, self._mask(index), distance, self.batch.contour(slice(None)))
        return self.batch.format.apply(self.batch.observe()), info

    def _generators(
        self, seed: int | Sequence[int | None] | None, index: Index
    ) -> dict[int, np.random.Generator]:
        """Return the random generators of seeded environments (k,); raise an error for a bad seed."""
        if seed is None:
            return {}
        seeds = list(seed) if isinstance(seed, Sequence) else [seed + b for b in range(self.num_envs)]
        if len(seeds) != self.num_envs:
            raise ValueError(f"seed has {len(seeds)} entries, but there are {self.num_envs} environments")
        return {b: seeding.np_random(seeds[b])[0] for b in index.tolist() if seeds[b] is not None}

    def _selected(self, mask: Any) -> Index:
        """Return the environments of a mask, or all if it is None; an invalid mask raises an error."""
        if mask is None:
            return np.arange(self.num_envs)
        if not isinstance(mask, np.ndarray) or mask.dtype != np.bool_:
            raise TypeError(f"options['reset_mask'] must be a NumPy array of bool, not {type(mask).__name__}")
        if mask.shape != (self.num_envs,) or not mask.any():
            raise ValueError(
                f"options['reset_mask'] must have shape ({self.num_envs},) and hold at least one True"
            )
        return np.flatnonzero(mask)

    @override
    def step(self, actions: Any) -> tuple[Observation, Array, Flags, Flags, dict[str, Any]]:
        """Advance all environments by a period as `HFrameEnv.step`; begin new episodes where they are due.

        With `autoreset_mode` "NextStep" a new episode begins in the step after its predecessor's end, which
        ignores the action and has reward 0; with "SameStep" in the last step; with "Disabled" only by
        `reset`.

        Raises:
            ValueError: If the actions have another shape or an entry is not finite.
            RuntimeError: In mode "Disabled", if an episode is over and was not reset.
            InputError: If an episode begins and an unbounded distribution yields an impossible parameter.
            gymnasium.error.ResetNeeded: If `reset` was not called.
            NotFiniteError: If a position or velocity is not finite (simulation diverged).
        """
        checked = self.batch.check_actions(actions)
        resetting = self._over.nonzero()[0]
        if self.autoreset_mode is AutoresetMode.DISABLED and len(resetting):
            raise RuntimeError(
                f"the episode of environment {resetting[0]} is over; reset it with options['reset_mask']"
            )
        observation, result = self.batch.blank(), self.batch.result()
        self.batch.step(checked, observation, result)
        limit = np.inf if self.max_episode_steps is None else self.max_episode_steps
        terminated, truncated = result.terminated, self.batch.elapsed >= limit
        info: dict[str, Any] = {}
        if self.autoreset_mode is AutoresetMode.NEXT_STEP:
            if len(resetting):
                self._restart(resetting, observation, result)
                result.reward[resetting] = 0.0
                terminated[resetting] = truncated[resetting] = False
            self._over = terminated | truncated
        elif self.autoreset_mode is AutoresetMode.SAME_STEP:
            resetting = np.flatnonzero(terminated | truncated)
            if len(resetting):
                info = self._final_info(resetting, observation, result)
                self._restart(resetting, observation, result)
        else:
            self._over = terminated | truncated
        self._describe(info, None, result.distance, result.contour)
        self._update_trails(resetting)
        return self.batch.format.apply(observation), result.reward, terminated, truncated, info

    def _restart(self, index: Index, observation: Observation, result: StepResult) -> None:
        """Begin new episodes of environments index (k,) within a step."""
        self.batch.restart(index, observation, result)
        self._collect_parameters()

    # -- info: each key with its mask "_key" -----------------------------------------------------------------

    def _describe(
        self, info: dict[str, Any], mask: Flags | None, distance: Array, contour: Array | None
    ) -> None:
        """Add what every info has; mask: the environments that it describes, None for all."""
        columns = {self.batch.distance_key: distance, "is_success": distance <= self.batch.task.band}
        columns |= {"clipped_actions": self.batch.clipped.copy(), **self.batch.rewards.info()}
        if contour is not None:
            columns[self.batch.contour_key] = contour
        _add_columns(info, columns, mask, self.num_envs)
        if self._parameters and mask is None:
            info["parameters"] = dict(self._parameters)
            info["_parameters"] = np.ones(self.num_envs, np.bool_)
        elif self._parameters:
            info["parameters"] = {}
            values = {name: column for name, column in self._parameters.items() if not name.startswith("_")}
            _add_columns(info["parameters"], values, mask, self.num_envs)
            info["_parameters"] = np.array(mask)

    def _collect_parameters(self) -> None:
        """Collect the randomized parameters of all environments after a reset; the arrays are read-only."""
        self._parameters = {}
        _add_columns(self._parameters, self.batch.randomized(np.arange(self.num_envs)), None, self.num_envs)
        for column in self._parameters.values():
            column.setflags(write=False)

    def _final_info(self, index: Index, observation: Observation, result: StepResult) -> dict[str, Any]:
        """Return `final_obs` and `final_info` of environments index (k,), whose episodes end in this step."""
        mask = self._mask(index)
        final_obs = np.full(self.num_envs, None, dtype=object)
        copies = self.batch.format.apply({key: values[index] for key, values in observation.items()})
        for i, b in enumerate(index.tolist()):
            final_obs[b] = {k: v[i] for k, v in copies.items()} if isinstance(copies, dict) else copies[i]
        final_info: dict[str, Any] = {}
        self._describe(final_info, mask, result.distance, result.contour)
        return {
            "final_obs": final_obs,
            "_final_obs": mask,
            "final_info": final_info,
            "_final_info": mask.copy(),
        }

    def _mask(self, index: Index) -> Flags:
        """Return the mask (num_envs,) of environments index (k,)."""
        mask = np.zeros(self.num_envs, np.bool_)
        mask[index] = True
        return mask

    def _update_trails(self, fresh: Index) -> None:
        """Extend the trails of the pictures; those of environments fresh (k,) begin anew."""
        if self.render_mode is None:
            return
        for b in fresh.tolist():
            self._trails[b].clear()
        for b, trail in enumerate(self._trails):
            trail.append(tool_point(self.batch, b))

    @override
    def render(self) -> tuple[NDArray[np.uint8], ...] | None:  # type: ignore[override]
        """Draw the machine of every environment from above, uint8, shape (height, width, 3) each.

        None without render mode.
        """
        if self.render_mode is None:
            return None
        if self._renderer is None:
            self._renderer = Renderer(self.batch.machine, self.render_mode, self.metadata["render_fps"])
        frames = (self._renderer.draw(Scene.of(self.batch, b, trail)) for b, trail in enumerate(self._trails))
        return tuple(frame for frame in frames if frame is not None)

    def get_state(self) -> dict[str, Any]:
        """Copy the complete state for `set_state`; simulations that continue from it are equal to the bit.

        It includes the counters of the random numbers, so that later episodes are the same too.

        Returns:
            State for `set_state`, which can be pickled.

        Raises:
            gymnasium.error.ResetNeeded: If `reset` was not called.
        """
        trails = [list(trail) for trail in self._trails]
        return {**self._shared_state("vector"), "over": self._over.copy(), "trails": trails}

    def set_state(self, state: dict[str, Any]) -> None:
        """Restore a state of `get_state`.

        A state of other environments raises an InputError and changes nothing.
        """
        self._restore_shared(state, "vector")
        self._over = state["over"].copy()
        self._collect_parameters()
        for trail, points in zip(self._trails, state["trails"], strict=False):
            trail.clear()
            trail.extend(points)

    # -- Gymnasium's access to single environments; all are rows of this one
    # ---------------------------------------

    def call(self, name: str, *args: Any, **kwargs: Any) -> tuple[Any, ...]:
        """Call a method, or read an attribute, that all environments share.

        Return the result once per environment.
        """
        value = self._shared(name)
        return (value(*args, **kwargs) if callable(value) else value,) * self.num_envs

    def get_attr(self, name: str) -> tuple[Any, ...]:
        """Read an attribute that all environments share; return it once per environment."""
        return (self._shared(name),) * self.num_envs

    def set_attr(self, name: str, values: Any) -> None:
        """Set an attribute that all environments share.

        A list or tuple must repeat the value per environment.

        Raises:
            AttributeError: If there is no such attribute: nothing would read it. Options are fixed when the
                environment is made, and `reset(options=...)` sets parameters, starts and goals.
            ValueError: If a list or tuple has another length.
            InputError: If the values of a list or tuple differ, because the attribute exists only once.
        """
        self._shared(name)
        if isinstance(values, list | tuple):
            if len(values) != self.num_envs:
                raise ValueError(f"set_attr: {len(values)} values for {self.num_envs} environments")
            if any(value is not values[0] and value != values[0] for value in values):
                raise InputError(
                    f"set_attr: {name} exists once for all environments, so that its values must be equal"
                )
            values = values[0]
        setattr(self, name, values)

    def _shared(self, name: str) -> Any:
        """Return an attribute of one environment; the AttributeError of an unknown one names both classes."""
        if not hasattr(self, name):
            raise AttributeError(f"{type(self).__name__} and its environments have no attribute {name!r}")
        return getattr(self, f"single_{name}" if name in ("action_space", "observation_space") else name)

    @override
    def close_extras(self, **kwargs: Any) -> None:
        """Release the renderer; Gymnasium's `close` calls this method."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_renderer": None}


def _add_columns(info: dict[str, Any], columns: dict[str, Any], mask: Flags | None, count: int) -> None:
    """Add columns (count,) and their masks to an info, zero where the mask is False; mask None: all True."""
    present = np.ones(count, np.bool_) if mask is None else mask
    for key, values in columns.items():
        info[key] = (
            values
            if mask is None
            else np.where(mask.reshape(-1, *[1] * (values.ndim - 1)), values, values.dtype.type(0))
        )
        info[f"_{key}"] = present.copy()


class HFrameTrackVectorEnv(HFrameVectorEnv):
    """`HFrameVectorEnv` with goals that move along paths (`HFrameTrack-v0`).

    Args:
        num_envs: Number of environments.
        **options: Keywords of `HFrameVectorEnv`. `task` is "track" by default; another must have `metrics`
            "track".

    Raises:
        InputError: If the task has no path, or an option is invalid.
        TypeError: If a keyword is unknown; the message lists the keywords.
    """

    def __init__(self, num_envs: int = 1, **options: Any) -> None:
        super().__init__(num_envs, **{"task": "track", **options})
        require_path(self.batch)
