"""The model-based PID: everything from the machine's tables, nothing tuned by hand.

P and D    state feedback on the carriage and the motors: the first voltage of the fastest transfer to rest that keeps
           near the rated voltage (trajectory.py).  Far from the goal this is the time-optimal-like reference,
           replanned from the measured state every period, so it cannot wind up behind saturated motors; near it, where
           the shortest transfer fits, it is a constant gain that brings the model to rest in the fewest periods.
forward    the voltage that Coulomb friction and the machine's known effects take at the present motion.
I          once the shortest transfer fits, the force that the last period's momentum balance left unexplained:
           friction as it is, whatever its level.  Held by friction, the stage hands back the voltage it has, so the
           feedback adds up until it moves, and stands still where there is no error.
reference  of the motors: belts stretched by the machine's known forces on the carriage, or not at all; at rest it
           follows the stretch that is there.  Friction too leaves the motors elsewhere, and with the wrong reference
           the feedback would hold the tool off its goal.
hold       an arrival that keeps moving rings because the model is off; longer transfers, thus lower gains, end that.

All this is for a goal that stays.  Where the observation has a preview of one that moves, tracking.py follows it.  A
dead time in the machine's effects is bridged by running the model ahead (delay.py); what they do to a drive's voltage
is undone (amplifiers.py).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..machine import Machine
from .dead_time import DeadTime
from .input_inversion import InputInversion
from .minimum_energy import MinimumEnergyTransfers
from .motion_model import MotionModel
from .preview_control import PreviewTracker

Array = NDArray[np.float64]
# Of the nominal friction: how far what is unexplained may be from what is known.  More is the error of a hard brake.
MOST_UNEXPLAINED = 6.0
# Periods in motion around the goal, over those of the shortest transfer, after which a stage rings.  An arrival from
# full speed takes three or four; every as many again lengthen the transfers by a period.
ARRIVALS = 6
AROUND = 2  # shortest transfers more to go than wanted, beyond which a stage is on its way and not around its goal
# Of the rated voltage: what a transfer may ask for.  It is cut to the rated one and planned again a period later, which
# comes closer to full voltage until the brake, and then full brake, than a least-effort transfer that keeps within it.
EAGER = 1.6
STILL = 3e-5  # m, travel in a period below which a stage is at rest and does not ring
HOLD = 2.0  # longest time to go while holding, of the shortest transfer's
FOLLOW = 0.2  # of the belts' stretch at rest not yet in the motors' reference, a period


class ModelBasedController:
    """Model-based PID with full state for B stages of one machine, each perhaps a little off it.

    machine: the model, of which gains and feed-forward are made.  period: of control, s.

    Raises ValueError for a machine that it cannot control (see `MotionModel`) or a period that is not positive.
    """

    def __init__(self, machine: Machine, period: float = 0.01) -> None:
        self.model = MotionModel(machine)
        self.transfers = MinimumEnergyTransfers(self.model, period)
        self.period = period
        self._late = DeadTime(machine, period)
        self._amplifiers = InputInversion(machine)
        self._tracker: PreviewTracker | None = None  # made when it is known how far the goals are seen
        self._most = MOST_UNEXPLAINED * np.abs(self.model.rigid.T) @ self.model.coulomb
        self._hold = int(np.ceil(HOLD * self.transfers.shortest))
        self._fresh = np.zeros(0, np.bool_)  # stages whose episode begins with the next observation
        self._state = np.zeros((0, 0))
        self._stretch = np.zeros((0, 0))  # motors' positions at rest beyond those of unstretched belts, m
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
            self._state = state
            self._stretch = np.zeros((len(state), len(self.model.mass)))
            self._near, self._restless, self._elapsed = (np.zeros(len(state), np.intp) for _ in range(3))
        self._late.begin(self._fresh)
        self._near, self._restless = (np.where(self._fresh, 0, n) for n in (self._near, self._restless))
        self._elapsed = np.where(self._fresh, 0, self._elapsed)

    def act(self, observation: Mapping[str, NDArray[Any]]) -> Array:
        """Actions (B, 2) in [-1, 1], shares of the rated voltage.

        observation: `observation` (B, 2 n), positions of x, y and the driven coordinates, then their velocities, in m,
        rad, m/s and rad/s; `desired_goal` (B, 2), m; for a goal that moves also `preview` (B, 2 P), m, where it is at
        the end of this period, of the next, ...

        Raises ValueError for an observation that is not of this machine, or a preview that ends within the dead time.
        """
        state = self.model.state(observation)
        goal = np.asarray(observation["desired_goal"], np.float64)
        self._begin(state)
        if "preview" in observation:
            later = np.asarray(observation["preview"], np.float64).reshape(len(state), -1, 2)
            volts = self._follow(state, np.concatenate([goal[:, None], later], axis=1))
        else:
            volts = self._reach(state, goal)
        volts = self._amplifiers.asked(volts)
        self._late.send(volts)
        self._elapsed = self._elapsed + 1
        self._state = state
        self._fresh = np.zeros(len(state), np.bool_)
        return volts / self.model.rated

    def applied(self, actions: Array) -> None:
        """The stages were given actions (B, 2) in [-1, 1], and not what `act` answered last."""
        self._late.correct(actions * self.model.rated)

    def _follow(self, state: Array, goals: Array) -> Array:
        """Voltages (B, 2) for states (B, 2 n) with goals (B, 1 + P, 2), m, now and at the end of each period."""
        goals = self._late.skip(goals)
        if self._tracker is None or self._tracker.goals > goals.shape[1] - 1:
            self._tracker = PreviewTracker(self.model, self.transfers.places, self.period, goals.shape[1] - 1)
        self._tracker.learn(self._state, state, self._amplifiers.given(self._late.arrived()), self._fresh)
        elapsed_s = self._elapsed.astype(np.float64) * self.period + self._late.seconds
        last = self._amplifiers.given(self._late.last)
        return self._tracker.volts(self._late.ahead(state), goals, last, elapsed_s)

    def _reach(self, seen: Array, goal: Array) -> Array:
        """Voltages (B, 2) for states (B, 2 n) with goals (B, 2), m, that stay where they are."""
        model = self.model
        state = self._late.ahead(seen)
        # Stages that begin have no last period, and none of them has arrived: `_near` is 0.
        elapsed_s = self._elapsed.astype(np.float64) * self.period
        pushes = model.pushes(state, elapsed_s)
        known = (pushes + model.friction(state, elapsed_s)) @ model.rigid
        arrived = self._amplifiers.given(self._late.arrived())
        unexplained = model.disturbance(self._state, seen, arrived, self.period) - known
        measured = known + np.clip(unexplained, -self._most, self._most)
        forward = -model.voltage(np.where(self._near[:, None] > 0, measured, known))
        error = state - model.goal_state(goal)
        stretch = model.stretch(error)
        still = np.abs(seen - self._state)[:, : len(model.mass)].max(axis=1) <= STILL
        self._stretch = np.where(
            self._near[:, None] > 0,
            self._stretch + FOLLOW * still[:, None] * (stretch - self._stretch),
            model.held_stretch(pushes, goal),
        )
        error[:, : len(model.mass)] -= self._stretch
        shortest = self.transfers.shortest
        at_least = np.minimum(shortest + self._restless // (ARRIVALS * shortest), self._hold)
        # What forward takes of the voltage one way, it gives the other way: a brake gains by friction.
        limit = EAGER * model.rated
        choice = self.transfers.choose(error, goal, (-limit - forward, limit - forward), at_least)
        # One period more than the shortest (or than the hold) is still an arrival: corrections may ask for it.
        arriving = choice.periods <= at_least + 1
        self._near = np.where(arriving, self._near + 1, 0)
        self._restless = np.where(choice.periods > at_least + AROUND * shortest, 0, self._restless + ~still)
        return np.clip(choice.volts + forward, -model.rated, model.rated)
