"""The model-based PID that learns the stage as it goes: belts, masses and friction by `MomentumFilter`.

Belts, masses   a PID each for softer, declared and stiffer belts and for light and heavy masses; the force that is
                asked for along x and y lies between theirs by what belts and that axis have shown (gain scheduling,
                Astrom and Wittenmark 1995, chapter 9).
Friction        the voltage that it will take along the path beyond the model's, less what it took lately: that a PID
                has learnt itself, but a force that turns over with the motion takes it by surprise.

Nothing here is trained: the prior is in momentum_filter.py, and all else is the stage's own motion.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..machine import Machine
from .dead_time import DeadTime
from .input_inversion import InputInversion
from .model_pid import ModelBasedController
from .momentum_filter import MomentumFilter
from .motion_model import MotionModel

Array = NDArray[np.float64]
BELTS = np.array([0.7, 1.0, 1.3])  # of the declared EA: about all that `default` draws,
MASSES = np.array([0.9, 1.2])  # and of the declared masses
LATELY = 0.3  # share of the newest in what was taken lately, a period: as fast as the PID learns along a path
SEEN = 3  # periods of the path to come of which it says what they take, the first included


class AdaptivePID:
    """See `Controller`.  period: of control, s.

    What it tells a policy on top of it, by the names of `told` with how many numbers each has: `expected`, shares of
    the rated voltages (B, 2 SEEN + 2), beyond the model's, that this period and the next ones will take along the path,
    and last what was taken lately, zeros for a goal that stays; `learnt` (B, 2 n + 1), the estimates of the filter.

    Raises ValueError as `ModelBasedController` does, for a machine or period that it cannot control.
    """

    def __init__(self, machine: Machine, period: float = 0.01) -> None:
        self._bank = [
            [ModelBasedController(_scaled(machine, b, m), period) for m in MASSES.tolist()] for b in BELTS.tolist()
        ]
        self.model = MotionModel(machine)
        self._late, self._amplifiers = DeadTime(machine, period), InputInversion(machine)
        self._filter = MomentumFilter(self.model, period)
        self.told = {"expected": 2 * (SEEN + 1), "learnt": 2 * len(self.model.mass) + 1}
        self._fresh = np.zeros(0, np.bool_)  # stages whose episode begins with the next observation
        self._elapsed_s = np.zeros(0)
        self._state = self.expected = np.zeros((0, 0))

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
        """The estimates (B, 2 n + 1) of `MomentumFilter`."""
        return self._filter.estimates

    def act(self, observation: Mapping[str, NDArray[Any]]) -> Array:
        """Actions (B, 2) in [-1, 1]; observation as for `ModelBasedController`.

        Raises ValueError as `ModelBasedController.act` does, or for a preview that ends too soon after the dead time.
        """
        model = self.model
        state = model.state(observation)
        if len(self._fresh) != len(state):
            self._fresh = np.ones(len(state), np.bool_)
            self._state, self._elapsed_s = state, np.zeros(len(state))
            self.expected = np.zeros((len(state), 2 * (SEEN + 1)))
        self._learn(state)
        self._expect(observation)
        self._fresh = np.zeros(len(state), np.bool_)
        asked = np.array([[pid.act(observation) for pid in row] for row in self._bank]) * model.rated
        volts = self._amplifiers.given(asked.reshape(-1, 2)).reshape(asked.shape)
        by_belts, by_masses = _shares(self._filter.belts, BELTS), _shares(self._filter.masses, MASSES)
        force = np.einsum("kb,lba,klba->ba", by_belts, by_masses, volts @ model.force_per_volt.T)
        news = (self.expected[:, :2] - self.expected[:, -2:]) * model.rated
        mixed = self._amplifiers.asked(np.clip(model.voltage(force) + news, -model.rated, model.rated)) / model.rated
        self._late.send(mixed * model.rated)
        for pid in self._all():
            pid.applied(mixed)
        return mixed

    def _learn(self, state: Array) -> None:
        """Take in the period that ends with a state (B, 2 n)."""
        self._late.begin(self._fresh)
        self._elapsed_s = np.where(self._fresh, 0.0, self._elapsed_s)
        middle, half_s = 0.5 * (self._state + state), self._elapsed_s - 0.5 * self._late.period
        known = self.model.pushes(middle, half_s) + self.model.effects_friction(middle, half_s)
        self._filter.learn(self._state, state, self._amplifiers.given(self._late.arrived()), known, self._fresh)
        self._state, self._elapsed_s = state, self._elapsed_s + self._late.period

    def _expect(self, observation: Mapping[str, NDArray[Any]]) -> None:
        was = self.expected.reshape(len(self._fresh), SEEN + 1, 2)
        lately = np.where(self._fresh[:, None], 0.0, was[:, -1] + LATELY * (was[:, 0] - was[:, -1]))
        if "preview" in observation:
            path = np.concatenate([observation["desired_goal"], observation["preview"]], axis=1, dtype=np.float64)
            goals = self._late.skip(path.reshape(len(path), -1, 2))[:, : SEEN + 2]
            if goals.shape[1] < SEEN + 2:
                raise ValueError(f"the preview ends {goals.shape[1] - 1} periods after the dead time, not {SEEN + 1}")
            takes = self._filter.friction_ahead(goals) / self.model.rated
            self.expected = np.concatenate([takes, lately[:, None]], axis=1).reshape(len(path), -1)

    def applied(self, actions: Array) -> None:
        """The stages were given actions (B, 2) in [-1, 1], and not what `act` answered last."""
        self._late.correct(actions * self.model.rated)
        for pid in self._all():
            pid.applied(actions)

    def _all(self) -> Iterator[ModelBasedController]:
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
