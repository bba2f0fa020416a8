"""The model-based PID: everything from the machine's tables, nothing tuned by hand.

P and D    state feedback on the carriage and the motors: the first voltage of the fastest transfer to rest that keeps
           within the rated voltage (trajectory.py).  Far from the goal this is the time-optimal-like reference,
           replanned from the measured state every period, so it cannot wind up behind saturated motors; near it, where
           the shortest transfer fits, it is a constant gain that brings the model to rest in the fewest periods.
forward    the voltage that Coulomb friction and the machine's known effects take at the present motion.
I          once the shortest transfer fits, the force that the last period's momentum balance left unexplained:
           friction as it is, whatever its level.  Held by friction, the stage hands back the voltage it has, so the
           feedback adds up until it moves, and stands still where there is no error.
hold       an arrival that takes long has a model that is off; longer transfers, thus lower gains, end its ringing.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..machine import Machine
from .model import MotionModel
from .trajectory import Transfers

Array = NDArray[np.float64]
# Of the nominal friction: what a force may be that counts as friction.  More is the model's error in a hard brake.
MOST_FRICTION = 6.0
ARRIVALS = 4  # shortest transfers one after the other, after which a stage that has not come to rest rings
AROUND = 2
STILL = 3e-5  # m, travel in a period below which a stage is not ringing
HOLD = 2.0  # time to go while holding, of the shortest transfer's


class ModelPID:
    """Model-based PID with full state for B stages of one machine, each perhaps a little off it.

    machine: the model, of which gains and feed-forward are made.  period: of control, s.

    Raises ValueError for a machine that it cannot control (see `MotionModel`) or a period that is not positive.
    """

    def __init__(self, machine: Machine, period: float = 0.01) -> None:
        self.model = MotionModel(machine)
        self.transfers = Transfers(self.model, period)
        self.period = period
        self._most = MOST_FRICTION * np.abs(self.model.rigid.T) @ self.model.coulomb
        self._hold = int(np.ceil(HOLD * self.transfers.shortest))
        self._fresh = np.zeros(0, np.bool_)  # stages whose episode begins with the next observation
        self._state = self._volts = np.zeros((0, 0))
        # Periods since arrival began, those of them in motion, and all of the episode.
        self._near = self._restless = self._elapsed = np.zeros(0, np.intp)

    def reset(self, mask: NDArray[np.bool_] | None = None) -> None:
        """Forget the stages of mask (B,), or all."""
        if mask is None:
            self._fresh = np.zeros(0, np.bool_)
        elif len(self._fresh):
            self._fresh = self._fresh | mask

    def _begin(self, state: Array) -> None:
        if len(self._fresh) != len(state):
            self._fresh = np.ones(len(state), np.bool_)
            self._state, self._volts = state, np.zeros((len(state), len(self.model.rated)))
            self._near, self._restless, self._elapsed = (np.zeros(len(state), np.intp) for _ in range(3))
        self._near, self._restless = (np.where(self._fresh, 0, n) for n in (self._near, self._restless))
        self._elapsed = np.where(self._fresh, 0, self._elapsed)

    def act(self, observation: Mapping[str, NDArray[Any]]) -> Array:
        """Actions (B, 2) in [-1, 1], shares of the rated voltage.

        observation: `observation` (B, 2 n), positions of x, y and the driven coordinates, then their velocities, in m,
        rad, m/s and rad/s; `desired_goal` (B, 2), m.

        Raises ValueError for an observation that is not of this machine.
        """
        model = self.model
        state = model.state(observation)
        goal = np.asarray(observation["desired_goal"], np.float64)
        self._begin(state)
        unexplained = model.disturbance(self._state, state, self._volts, self.period)
        # Stages that begin have no last period, and none of them has arrived: `_near` is 0.
        known = model.resistance(state, self._elapsed * self.period)
        measured = known + np.clip(unexplained - known, -self._most, self._most)
        forward = -model.voltage(np.where(self._near[:, None] > 0, measured, known))
        shortest = self.transfers.shortest
        at_least = np.minimum(shortest + self._restless // (ARRIVALS * shortest), self._hold)
        choice = self.transfers.choose(
            state - model.goal_state(goal),
            goal,
            np.maximum(model.rated - np.abs(forward), 0.0),
            at_least,
        )
        # One period more than the shortest (or than the hold) is still an arrival: corrections may ask for it.
        arriving = choice.periods <= at_least + 1
        volts = np.clip(choice.volts + forward, -model.rated, model.rated)
        self._near = np.where(arriving, self._near + 1, 0)
        moved = np.abs(state - self._state)[:, : len(model.mass)].max(axis=1)
        self._restless = np.where(
            choice.periods > at_least + AROUND * shortest, 0, self._restless + (moved > STILL)
        )
        self._elapsed = self._elapsed + 1
        self._state, self._volts = state, volts
        self._fresh = np.zeros(len(state), np.bool_)
        return volts / model.rated
