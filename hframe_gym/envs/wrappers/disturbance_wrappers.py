"""Wrappers for random forces on the tool, of a single (`HFrameEnv`) or vector one (`HFrameVectorEnv`)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv, VectorWrapper

from ...effects import EFFECTS
from ...errors import InputError
from ...machine import RADIANS, Machine
from ..environment_batch import batch_of
from .disturbances import DISTURBANCES

# Distinguishes the random numbers of disturbances from those of the environment with the same seed.
_STREAM = 7_919


def machine_for_disturbances(machine: Machine) -> Machine:
    """Return a copy of a machine with an effect `constant_force` of 0 N at every tool axis.

    The environments of a `DisturbanceWrapper` need it. An axis that has the effect keeps it.
    """
    present = {effect.label for effect in machine.effects}
    added = [
        EFFECTS["constant_force"].at(axis, size=0.0)
        for axis in machine.tool_axes
        if f"constant_force@{axis}" not in present
    ]
    return machine.with_effects(*added)


class _Forces:
    """Random forces on the tool of a batch.

    Attributes:
        key: Key of an info with the forces; it ends in their unit.
    """

    def __init__(self, env: Any, name: str, options: Mapping[str, Any]) -> None:
        self.batch = batch_of(env)
        names = list(self.batch.machine.parameters)
        wanted = [f"constant_force@{axis}.size" for axis in self.batch.machine.tool_axes]
        if missing := [name for name in wanted if name not in names]:
            raise InputError(
                f"the machine has no parameter {missing[0]}, through which a disturbance acts; "
                "make the environment with machine=machine_for_disturbances(machine)"
            )
        self.key = "disturbance_Nm" if self.batch.machine.axis_unit is RADIANS else "disturbance_N"
        self._rows = [names.index(name) for name in wanted]
        self._process = DISTURBANCES.get(name)(**options)
        self._generator = np.random.default_rng()
        self.forces = np.zeros((self.batch.count, len(wanted)))

    def seed(self, seed: Any) -> None:
        """Begin the random numbers of a seed: integer, or list of integers and None; with None they go on."""
        if seed is not None:
            numbers = [0 if s is None else int(s) for s in np.atleast_1d(np.asarray(seed, dtype=object))]
            self._generator = np.random.default_rng([_STREAM, *numbers])

    def begin(self, mask: Any = slice(None)) -> None:
        """Draw the first forces of environments in which an episode begins."""
        first = self._process.begin(self.forces.shape, self.batch.config.period, self._generator)
        self.forces[mask] = first[mask]
        self._apply()

    def follow(self) -> None:
        """Draw the forces of the next control period."""
        self.forces = self._process.follow(self.forces, self.batch.config.period, self._generator)
        self._apply()

    def _apply(self) -> None:
        """Write the forces to the parameters of the simulated machines, added to those of the episode."""
        parameters = self.batch.simulator.parameters
        for axis, row in enumerate(self._rows):
            column = np.zeros(parameters.shape[0] * parameters.shape[2])
            column[: self.batch.count] = self.batch.values[:, row] + self.forces[:, axis]
            parameters[:, row] = column.reshape(parameters.shape[0], parameters.shape[2])


class DisturbanceWrapper(gym.Wrapper):
    """Let a random force act on the tool, constant in each control period.

    `info["disturbance_N"]` has the force of the step along each axis, N, shape (axes,); with rotary axes,
    `info["disturbance_Nm"]` has the torque about each. A seed at `reset` also determines the forces. The
    state of `get_state` does not contain them.

    Args:
        process: Name in `DISTURBANCES`.
        **options: Keywords of the process, for example std=2.0.

    Raises:
        InputError: If the machine has no place for the force, or the process is unknown.
    """

    def __init__(self, env: gym.Env, process: str, **options: Any) -> None:
        super().__init__(env)
        self._forces = _Forces(env, process, options)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Begin an episode, as the environment does, and draw the force of its first control period."""
        self._forces.seed(seed)
        result = self.env.reset(seed=seed, options=options)
        self._forces.begin()
        return result

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Make a step under the present force, and draw that of the next control period.

        `info` also has the force of this step, see the class.
        """
        applied = self._forces.forces[0].copy()
        observation, reward, terminated, truncated, info = self.env.step(action)
        self._forces.follow()
        info[self._forces.key] = applied
        return observation, reward, terminated, truncated, info


class VectorDisturbanceWrapper(VectorWrapper):
    """`DisturbanceWrapper` for `HFrameVectorEnv`; the force of an episode that begins is drawn anew.

    Raises:
        InputError: As `DisturbanceWrapper`.
    """

    def __init__(self, env: VectorEnv, process: str, **options: Any) -> None:
        super().__init__(env)
        self._forces = _Forces(env, process, options)
        self._over = np.zeros(self._forces.batch.count, np.bool_)
        self._same_step = env.metadata.get("autoreset_mode") is AutoresetMode.SAME_STEP

    def reset(self, **keywords: Any) -> tuple[Any, dict[str, Any]]:
        """Begin episodes, as the environments do, and draw their first forces.

        Args:
            **keywords: `seed`, which also determines the forces, and `options` of `HFrameVectorEnv.reset`;
                only the environments that its `reset_mask` chooses get new forces.
        """
        self._forces.seed(keywords.get("seed"))
        result = self.env.reset(**keywords)
        mask = (keywords.get("options") or {}).get("reset_mask")
        chosen = slice(None) if mask is None else np.asarray(mask, np.bool_)
        self._forces.begin(chosen)
        self._over[chosen] = False
        return result

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Make a step of all environments under the present forces, and draw those of the next one.

        `info` also has the forces of this step, N or Nm, shape (num_envs, axes), under the key of
        `DisturbanceWrapper`. Environments in which an episode begins get a first force.
        """
        applied, began = self._forces.forces.copy(), self._over
        observation, reward, terminated, truncated, info = self.env.step(actions)
        self._over = np.asarray(terminated) | np.asarray(truncated)
        self._forces.follow()
        fresh = self._over if self._same_step else began
        if fresh.any():
            self._forces.begin(fresh)
        info[self._forces.key] = applied
        return observation, reward, terminated, truncated, info
