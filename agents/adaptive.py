"""The model-based PID that learns the stage as it goes: belts, masses and friction from `Memory`.

Belts, masses   a PID each for softer, declared and stiffer belts and for light and heavy masses; the force that is
                asked for along x and y lies between theirs by what belts and that axis have shown (gain scheduling,
                Astrom and Wittenmark 1995, chapter 9).
Friction        the voltage that it will take along the path beyond the model's, less what it took lately: that a PID
                has learnt itself, but a force that turns over with the motion takes it by surprise.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hframe_gym.control import ModelPID
from hframe_gym.control.delay import DeadTime
from hframe_gym.control.model import MotionModel
from hframe_gym.machine import Machine

from .memory import Memory

Array = NDArray[np.float64]
BELTS = np.array([0.7, 1.0, 1.3])  # of the declared EA: about all that `default` draws,
MASSES = np.array([0.9, 1.2])  # and of the declared masses
LATELY = 0.3  # share of the newest in what was taken lately, a period: as fast as the PID learns along a path
SEEN = 3  # periods of the path to come of which it says what they take, the first included


class AdaptivePID:
    """See `hframe_gym.control.Controller`.  period: of control, s.

    What it tells a policy, by the names of `told` with how many numbers each has: `expected`, shares of the rated
    voltages (B, 2 SEEN + 2), beyond the model's, that this period and the next ones will take along the path, and last
    what was taken lately, zeros for a goal that stays; `learnt` (B, 2 n + 1), the estimates of `Memory`.

    Raises ValueError as `ModelPID` does, or for a machine with a dead time: what it learnt would be of other voltages.
    """

    def __init__(self, machine: Machine, period: float) -> None:
        if DeadTime(machine, period).seconds > 0.0:
            raise ValueError(f"machine {machine.name!r}: the PID that adapts is not made for drives with a dead time")
        self._bank = [[ModelPID(_scaled(machine, b, m), period) for m in MASSES.tolist()] for b in BELTS.tolist()]
        self.model = MotionModel(machine)
        self._memory = Memory(self.model, period)
        self.told = {"expected": 2 * (SEEN + 1), "learnt": 2 * len(self.model.mass) + 1}
        self._fresh = np.zeros(0, np.bool_)  # stages whose episode begins with the next observation
        self._state = self._last = self.expected = np.zeros((0, 0))

    def reset(self, mask: NDArray[np.bool_] | None = None) -> None:
        """Forget the stages of mask (B,), or all."""
        for pid in self._all():
            pid.reset(mask)
        if mask is None:
            self._fresh = np.zeros(0, np.bool_)
        elif len(self._fresh):
            self._fresh = self._fresh | mask

    @property
    def learnt(self) -> Array:
        """The estimates (B, 2 n + 1) of `Memory`."""
        return self._memory.estimates

    def act(self, observation: Mapping[str, NDArray[Any]]) -> Array:
        """Actions (B, 2) in [-1, 1]; observation as for `ModelPID`."""
        state = self.model.state(observation)
        if len(self._fresh) != len(state):
            self._fresh = np.ones(len(state), np.bool_)
            self._state, self._last = state, np.zeros((len(state), 2))
            self.expected = np.zeros((len(state), 2 * (SEEN + 1)))
        self._memory.learn(self._state, state, self._last * self.model.rated, self._fresh)
        self._state = state
        self._expect(observation)
        self._fresh = np.zeros(len(state), np.bool_)
        volts = np.array([[pid.act(observation) for pid in row] for row in self._bank]) * self.model.rated
        by_belts, by_masses = _shares(self._memory.belts, BELTS), _shares(self._memory.masses, MASSES)
        force = np.einsum("kb,lba,klba->ba", by_belts, by_masses, volts @ self.model.force_per_volt.T)
        mixed = self.model.voltage(force) / self.model.rated + self.expected[:, :2] - self.expected[:, -2:]
        self.applied(np.clip(mixed, -1.0, 1.0))
        return self._last

    def _expect(self, observation: Mapping[str, NDArray[Any]]) -> None:
        was = self.expected.reshape(len(self._fresh), SEEN + 1, 2)
        lately = np.where(self._fresh[:, None], 0.0, was[:, -1] + LATELY * (was[:, 0] - was[:, -1]))
        if "preview" in observation:
            path = np.concatenate([observation["desired_goal"], observation["preview"]], axis=1, dtype=np.float64)
            goals = path.reshape(len(path), -1, 2)[:, : SEEN + 2]
            takes = self._memory.expects(goals) / self.model.rated
            self.expected = np.concatenate([takes, lately[:, None]], axis=1).reshape(len(path), -1)

    def applied(self, actions: Array) -> None:
        """The stages were given actions (B, 2) in [-1, 1], and not what `act` answered last."""
        self._last = actions
        for pid in self._all():
            pid.applied(actions)

    def _all(self) -> Iterator[ModelPID]:
        return (pid for row in self._bank for pid in row)


def _scaled(machine: Machine, belts: float, masses: float) -> Machine:
    factors = {".EA": belts, ".mass": masses}
    scaled = {
        name: factors[end] * value
        for name, value in machine.parameters.items()
        for end in factors
        if name.endswith(end)
    }
    return machine.replace(scaled)


def _shares(values: Array, grid: Array) -> Array:
    """Weights (len(grid), ...) with which a grid's points make up values (...)."""
    return np.stack([np.interp(values, grid, row) for row in np.eye(len(grid))])
