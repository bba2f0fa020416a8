"""`HFrameEnv` and `HFrameTrackEnv`: one machine as a `gymnasium.Env`."""

from __future__ import annotations

from collections import deque
from typing import Any, ClassVar, Unpack

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from ..errors import InputError
from .actuation.actuators import action_space
from .batch_properties import BatchProperties
from .config import EnvConfig, EnvOptions, check_keywords, check_render_mode
from .environment_batch import EnvironmentBatch
from .observation.observations import Observation
from .rendering import TRAIL_LENGTH, Renderer, Scene, tool_point
from .reset_options import reset_keywords
from .saved_state import generator_state

_ONLY = np.zeros(1, np.intp)


class HFrameEnv(BatchProperties, gym.Env[Observation, NDArray[np.float32]]):
    """An H-frame belt stage that moves a tool in the plane.

    Two fixed motors move a carriage in x and y by one belt. The belt stretches, every moving part has
    friction, and the motors are controlled by their voltages.

    ## Action Space

    `Box(-1, 1, (2,), float32)`, constant for one control period (10 ms). Entries outside this range are
    clipped.

    | index | action | unit | range |
    |---|---|---|---|
    | 0 | voltage of motor 1 | fraction of the rated voltage (12 V) | -1 to 1 |
    | 1 | voltage of motor 2 | fraction of the rated voltage (12 V) | -1 to 1 |

    With equal fractions the tool moves along y, with opposite ones along x.

    ## Observation Space

    A `Dict` of bounded float32 arrays. `env.unwrapped.entries` describes `observation` with its bounds for
    any machine; the table is that of `hframe`.

    | key | index | name | unit | range |
    |---|---|---|---|---|
    | `observation` | 0 | x of the tool | m | -0.33 to 0.33 |
    | | 1 | y of the tool | m | -0.24 to 0.24 |
    | | 2, 3 | angles phi1, phi2 of the motor pulleys | rad | -36.3 to 36.3 |
    | | 4, 5 | velocities of x and y | m/s | -5.15 to 5.15 |
    | | 6, 7 | velocities of phi1 and phi2 | rad/s | -265.3 to 265.3 |
    | `achieved_goal` | 0, 1 | x, y of the tool | m | -0.33 to 0.33, -0.24 to 0.24 |
    | `desired_goal` | 0, 1 | x, y of the goal | m | -0.33 to 0.33, -0.24 to 0.24 |
    | `preview` | 2 i, 2 i + 1 | x, y of future goal i (with a path) | m | -0.33 to 0.33, -0.24 to 0.24 |
    | `privileged` | | state of all coordinates, randomized parameters (only with `privileged=True`) | | |
    | `error` | 0, 1 | log of the distance to the goal along x and y (only with `error=True`) | 1 | -1 to 1 |

    With `sensors="rig"` or `"machine"`, positions are measurements and velocities their differences over the
    control period, unfiltered. `achieved_goal` is then the measured tool position: that of a sensor of x or y
    inside its range, else the position that the encoders' angles give on unstretched belts.

    ## Rewards

    With d the distance from `achieved_goal` to `desired_goal`:

    - `"dense"`: minus the mean of d / (d + scale) over scales from 0.2 m to 20 um; 0 at the goal, near -1 far
      from it.
    - `"arrival"`: likewise with the weights 0.05, 0.05, 0.3, 0.5 and 0.1, so that the last millimeters count
      most.
    - `"progress"`: ln((1 mm + d before the step) / (1 mm + d)) + 1 / (1 + d / 2 mm); what `normalize=True`
      chooses.
    - `"sparse"`: 0 within the task's band (1 mm), else -1.
    - a function of (achieved, desired), or a registered name.

    With `ends="terminate"`, `penalty` is subtracted if `achieved_goal` is outside the workspace.
    `compute_reward` returns exactly the rewards of `step`.

    ## Starting State

    At rest with unstretched belts. Task `reach` starts at a uniform random position at least 20 mm inside the
    workspace, with a target of the same distribution; task `track` starts at the beginning of its path.
    `randomize` changes the machine's parameters. `reset(options={"start": (x, y), "target": (x, y)})` sets
    both positions.

    ## Episode End

    - Termination: only with `ends="terminate"`, when `achieved_goal` (with sensors: the measured position) is
      outside the workspace. By default rubber buffers stop the tool.
    - Truncation: by `gym.make` after 150 steps, whatever `period` is (1.5 s with the default); its keyword
      `max_episode_steps` changes the limit.

    `info` describes the true tool position, even where measurements are observed: `distance_m` to the goal,
    `is_success` (within the task's band now) and `contour_m` (distance to the path, for tasks with one). It
    also has `clipped_actions` (number of entries outside [-1, 1] in this episode) and, with randomization,
    `parameters`: the values of the randomized parameters by full name. With the reward "progress" it has
    `previous_achieved_goal` and, if goals move, `previous_desired_goal`: the goals before the step, as
    observed.

    ## Arguments

    | keyword | default | choices |
    |---|---|---|
    | `machine` | `"hframe"` | preset name, path of a machine.json, `Machine` |
    | `task` | `"reach"` | `"reach"`, `"track"`, `Reach(...)`, `Track(...)`, another registered task, `Task` |
    | `reward` | `None` | `"dense"` (default), `"progress"` (that with `normalize`), `"sparse"`, a function |
    | `randomize` | `"none"` | `"none"`, `"default"`, `"wide"`, `"identified"`, a list of rules |
    | `sensors` | `"state"` | `"state"`, `"rig"`, `"machine"`, `Sensors(...)` |
    | `drives` | `"ideal"` | `"ideal"`, `"rig"`, `"machine"`, `Actuators(...)` |
    | `privileged` | `False` | whether the observation has `privileged` |
    | `normalize` | `False` | whether observations and goals are (value - center) / scale, as in `entries` |
    | `flat` | `False` | whether the observation is one array |
    | `error` | `False` | whether the observation has `error` |
    | `ends` | `"stops"` | `"stops"`, `"terminate"` |
    | `penalty` | 100 | see Rewards |
    | `period` | 0.01 | control period, s |
    | `longest_step` | 0.0005 | longest step of the integrator, s; stiff machines have shorter ones |
    | `render_mode` | `None` | `None`, `"rgb_array"`, `"human"` |

    Raises:
        InputError: If an option is invalid or options do not fit together.
        TypeError: If a keyword is unknown; the message lists the keywords.
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": ["human", "rgb_array"], "render_fps": 100}  # type: ignore[misc]

    def __init__(self, *, render_mode: str | None = None, **options: Unpack[EnvOptions]) -> None:
        check_keywords(type(self).__name__, dict(options))
        self.batch = EnvironmentBatch(EnvConfig(**options), 1)
        self.render_mode = check_render_mode(render_mode, self.metadata["render_modes"])
        self.metadata = {**self.metadata, "render_fps": max(1, round(1.0 / self.batch.config.period))}  # type: ignore[misc]
        self.observation_space = self.batch.format.space  # type: ignore[assignment]
        self.action_space = action_space(self.batch.machine)  # type: ignore[assignment]
        # All steps write to the same arrays, and observations are copies of their rows.
        self._arrays, self._result = self.batch.blank(), self.batch.result()
        self._rows = _only_rows(self._arrays)
        self._parameters: dict[str, float] = {}  # those that are randomized, in this episode
        self._seeded_by: np.random.Generator | None = None
        self._formats = self.batch.format.active  # a step looks nothing up that it does not need
        self._renderer: Renderer | None = None
        self._trail: deque[tuple[float, float]] = deque(maxlen=TRAIL_LENGTH)

    @override
    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin an episode: sample parameters, put the tool at rest at its start and choose the goal.

        Args:
            seed: Seed of the environment's random generator; None continues the present sequence.
            options: Optional keys `start` and `target`: tool and goal positions, m or rad, shape (axes,), in
                place of those that the task chooses; `parameters`: values by full name ("x.mass"), SI, in
                place of the sampled ones, for this episode; `state`: positions of the machine's n
                coordinates, then their velocities, in their units, shape (2 n,), in place of `start` and
                rest.

        Raises:
            InputError: If an option or a parameter is unknown or impossible, a position is outside the
                workspace, or `target` is given for a task without one, such as "track".
        """
        keywords = reset_keywords(options, self.batch, 1)  # an error changes no random numbers
        super().reset(seed=seed)
        if self._seeded_by is not self.np_random or seed is not None:
            self._seeded_by = self.np_random
            self.batch.sampler.seed(0, self.np_random)
        self.batch.reset(_ONLY, **keywords)
        self._parameters = {name: value.item() for name, value in self.batch.randomized(_ONLY).items()}
        self.batch.observe(self._arrays)
        observation = self._observation()
        info = self._info(self.batch.distance(_ONLY).item(), self.batch.contour(_ONLY))
        self._trail.clear()
        if self.render_mode is not None:
            self._update_picture()
        return observation, info

    @override
    def step(self, action: Any) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Apply voltages, fractions of rated ones limited to [-1, 1], shape (drives,), for one period.

        Returns:
            Observation, reward (dimensionless), `terminated`, `truncated` and `info`, whose keys the class
            describes. `terminated` is False unless `ends` is "terminate" and `achieved_goal` is outside the
            workspace; `truncated` is always False, because `gym.make` adds the limit of 150 steps.

        Raises:
            ValueError: If the action has another shape or an entry is not finite.
            gymnasium.error.ResetNeeded: If `reset` was not called.
            NotFiniteError: If a position or velocity is not finite (simulation diverged).
        """
        batch, result = self.batch, self._result
        checked = batch.check_actions(np.asarray(action)[None], single=True)
        batch.step(checked, self._arrays, result)
        observation = self._observation()
        if self.render_mode is not None:
            self._update_picture()
        info = self._info(result.distance.item(), result.contour)
        return observation, result.reward.item(), result.terminated.item(), False, info

    def get_state(self) -> dict[str, Any]:
        """Copy the complete state for `set_state`; a simulation that continues from it is equal to the bit.

        The state can be pickled. It includes the random generator, so that later episodes are the same too.
        The step counter of `gym.make`'s time limit is in a wrapper and is not included.
        """
        return {
            **self._shared_state("single"),
            "generator": generator_state(self._np_random),
            "seeded": self._seeded_by is not None and self._seeded_by is self._np_random,
            "trail": list(self._trail),
        }

    def set_state(self, state: dict[str, Any]) -> None:
        """Restore a state of `get_state`, from an environment with the same options.

        Another state raises an InputError and changes nothing.
        """
        self._restore_shared(state, "single")
        if state["generator"] is None:
            self._np_random = None
        else:
            self.np_random.bit_generator.state = state["generator"]
        self._seeded_by = self._np_random if state["seeded"] else None
        self.batch.observe(self._arrays)
        self._parameters = {name: value.item() for name, value in self.batch.randomized(_ONLY).items()}
        self._trail = deque(state["trail"], maxlen=TRAIL_LENGTH)

    def _observation(self) -> Any:
        """Copy the present observation, in the form of `normalize`, `flat` and `error`."""
        rows = self._rows
        if self._formats:
            formatted = self.batch.format.apply(self._arrays)
            if not isinstance(formatted, dict):
                return formatted[0]
            rows = _only_rows(formatted)
        observation = {}
        for key, row in rows.items():  # faster than a comprehension
            observation[key] = row.copy()
        return observation

    def _info(self, distance: float, contour: NDArray[np.float64] | None) -> dict[str, Any]:
        """Return the info of a step or reset."""
        info: dict[str, Any] = {
            self.batch.distance_key: distance,
            "is_success": distance <= self.batch.task.band,
            "clipped_actions": self.batch.clipped.item(),
        }
        if contour is not None:
            info[self.batch.contour_key] = contour.item()
        if self.batch.rewards.compares_steps:
            info |= {key: goals[0] for key, goals in self.batch.rewards.info().items()}
        if self._parameters:
            info["parameters"] = self._parameters.copy()
        return info

    # -- rendering -------------------------------------------------------------------------------------------

    def _update_picture(self) -> None:
        """Extend the trail of the picture, and update the window in mode "human"."""
        self._trail.append(tool_point(self.batch, 0))
        if self.render_mode == "human":
            self.render()

    @override
    def render(self) -> NDArray[np.uint8] | None:  # type: ignore[override]
        """Draw the machine from above, with belts, goal and the past path of the tool.

        Returns:
            Picture, uint8, shape (660, 880, 3), in mode "rgb_array"; None in mode "human", which updates the
            window, and without render mode, after a warning.

        Raises:
            ImportError: If pygame is missing; the message names the extra.
            InputError: In mode "human", if there is no display.
        """
        if self.render_mode is None:
            gym.logger.warn(
                "render() without render_mode: make the environment with render_mode='rgb_array' or 'human'"
            )
            return None
        if self._renderer is None:
            self._renderer = Renderer(self.batch.machine, self.render_mode, self.metadata["render_fps"])
        return self._renderer.draw(Scene.of(self.batch, 0, self._trail))

    def close(self) -> None:
        """Close the window of render mode "human" if it is open; the environment remains usable."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None

    def __getstate__(self) -> dict[str, Any]:
        # A window belongs to its process. A copy opens another one.
        return {**self.__dict__, "_renderer": None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._rows = _only_rows(self._arrays)  # a copied row is no part of the copied array


def _only_rows(observation: Observation) -> Observation:
    """Return the observation, shape (entries,), of the only environment, as views of arrays (1, entries)."""
    return {key: values[0] for key, values in observation.items()}


class HFrameTrackEnv(HFrameEnv):
    """`HFrameEnv` with a goal that moves along a path (`HFrameTrack-v0`).

    The action space, observation space, rewards and arguments are those of `HFrameEnv`; the observation has
    `preview` and the info `contour_m`.

    Args:
        render_mode: None, "rgb_array" or "human".
        **options: Keywords of `EnvConfig`. `task` is "track" by default; another task must have `metrics`
            "track".

    Raises:
        InputError: If the task has no path, or an option is invalid.
        TypeError: If a keyword is unknown; the message lists the keywords.
    """

    def __init__(self, *, render_mode: str | None = None, **options: Unpack[EnvOptions]) -> None:
        options.setdefault("task", "track")
        super().__init__(render_mode=render_mode, **options)
        require_path(self.batch)


def require_path(batch: EnvironmentBatch) -> None:
    """Raise an InputError if the task has no path (`metrics` "track"), as `HFrameTrack-v0` requires."""
    if batch.task.metrics != "track":
        raise InputError(
            f"HFrameTrack-v0 needs a task with a path, not {batch.task.name!r}; use HFrame-v0 for it"
        )
