"""`HFrameEnv`: one stage as a `gymnasium.Env`, a batch of one through the batch's own code."""

from __future__ import annotations

from collections import deque
from typing import Any, ClassVar

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from .config import EnvConfig
from .environment_batch import EnvironmentBatch
from .observations import Observation
from .rendering import TRAIL, Renderer, check_mode, scene
from .spaces import SignalSpec, action_space

_ONLY = np.zeros(1, np.intp)


class HFrameEnv(gym.Env[Observation, NDArray[np.float32]]):
    """An H-frame belt stage that is to bring its tool to a goal.

    Action: (2,) in [-1, 1], share of each motor's rated voltage, held for one control period.  Observation: a dict of
    float32 arrays in SI units: `observation` (see `entries`), `achieved_goal`, `desired_goal` (x, y of tool and goal).
    Episodes do not end by themselves unless ends="terminate"; `gym.make` cuts them at 150 steps (1.5 s).

    Info: `distance_m` and `is_success` (distance within the task's band now), both of the tool itself and not of what
    sensors say, `clipped_actions` (entries beyond [-1, 1] in this episode), for a task with a path `contour_m` (the
    tool's distance to it, whatever the time), and after a reset `parameters`, the machine's randomised numbers by name.

    Keywords are those of `EnvConfig`, and render_mode: None, "rgb_array" or "human".

    Raises ValueError for settings that do not fit together.
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": ["human", "rgb_array"], "render_fps": 100}  # type: ignore[misc]

    def __init__(self, *, render_mode: str | None = None, **settings: Any) -> None:
        self.batch = EnvironmentBatch(EnvConfig(**settings), 1)
        self.render_mode = check_mode(render_mode, self.metadata["render_modes"])
        self.metadata = {**self.metadata, "render_fps": round(1.0 / self.batch.settings.period)}  # type: ignore[misc]
        self.observation_space = self.batch.observation_space  # type: ignore[assignment]
        self.action_space = action_space(self.batch.machine)  # type: ignore[assignment]
        self._generator: np.random.Generator | None = None  # the one that the batch was seeded by
        self._renderer: Renderer | None = None
        self._trail: deque[tuple[float, float]] = deque(maxlen=TRAIL)

    @property
    def entries(self) -> tuple[SignalSpec, ...]:
        """What each number of `observation` is: name, unit, bounds."""
        return self.batch.observer.entries

    @property
    def privileged_entries(self) -> tuple[SignalSpec, ...]:
        """What each number of `privileged` is; empty without privileged=True."""
        return self.batch.observer.privileged

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin an episode at rest.

        options: `start`, `target`, each (x, y) m, in place of what the task draws.

        Raises ValueError for options it does not know or that are outside the workspace.
        """
        super().reset(seed=seed)
        if self._generator is not self.np_random or seed is not None:
            self._generator = self.np_random
            self.batch.population.seed(0, self.np_random)
        self.batch.reset(_ONLY, **check_options(options))
        observation = {k: v[0] for k, v in self.batch.observe().items()}
        info = self._info(self.batch.distance(_ONLY).item(), self.batch.contour(_ONLY))
        drawn = self.batch.drawn(_ONLY)
        if drawn:
            info["parameters"] = {name: float(value[0]) for name, value in drawn.items()}
        self._trail.clear()
        self._show()
        return observation, info

    def step(self, action: Any) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """One control period.

        Raises ValueError for an action of another shape or with a number that is not finite.
        """
        outcome = self.batch.step(self.batch.check_actions(np.asarray(action)[None]))
        observation = {k: v[0] for k, v in outcome.observation.items()}
        self._show()
        return (
            observation,
            outcome.reward.item(),
            outcome.terminated.item(),
            False,
            self._info(outcome.distance.item(), outcome.contour),
        )

    def compute_reward(self, achieved_goal: Any, desired_goal: Any, info: Any) -> Any:
        """Reward of goals (2,) or (n, 2), m; `info` is not looked at.  Exactly what `step` gave for the same goals."""
        return self.batch.compute_reward(achieved_goal, desired_goal)

    def _info(self, distance: float, contour: NDArray[np.float64] | None) -> dict[str, Any]:
        info: dict[str, Any] = {
            "distance_m": distance,
            "is_success": distance <= self.batch.task.band,
            "clipped_actions": self.batch.clipped.item(),
        }
        return info if contour is None else info | {"contour_m": contour.item()}

    # -- rendering -------------------------------------------------------------------------------------------------

    def _show(self) -> None:
        if self.render_mode is not None:
            position = self.batch.stages.positions(0)
            self._trail.append((position["x"], position["y"]))
        if self.render_mode == "human":
            self.render()

    def render(self) -> NDArray[np.uint8] | None:  # type: ignore[override]
        """The picture (height, width, 3) in mode rgb_array; draws the window in mode human.

        Raises ImportError naming the extra where pygame is not installed.
        """
        if self.render_mode is None:
            gym.logger.warn(
                "render() without render_mode: make the environment with render_mode='rgb_array' or 'human'"
            )
            return None
        if self._renderer is None:
            self._renderer = Renderer(self.batch.machine, self.render_mode, self.metadata["render_fps"])
        return self._renderer.draw(scene(self.batch, 0, self._trail))

    def close(self) -> None:
        """Close the window, if there is one."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None

    def __getstate__(self) -> dict[str, Any]:
        # A window belongs to its process; a copy opens its own.
        return {**self.__dict__, "_renderer": None}


def check_options(options: dict[str, Any] | None) -> dict[str, Any]:
    """Options of a reset as keywords of `EnvironmentBatch.reset`.

    Raises ValueError for a name that is none of them.
    """
    options = options or {}
    unknown = sorted(set(options) - {"start", "target"})
    if unknown:
        raise ValueError(f"reset does not know the option {', '.join(map(repr, unknown))}; it takes 'start', 'target'")
    return options
