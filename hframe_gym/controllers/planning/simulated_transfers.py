"""Transfers to rest of machines as estimated, planned anew in every period and corrected by simulations.

`MinimumEnergyTransfers` are designed once, for the declared machine, and leave Coulomb friction out. Here
each of B machines has parameters of its own, which an estimator changes from period to period, and friction
is part of the plan:

Linear plan   The voltages with the least sum of squares that bring the linear model to rest at the goal in N
              periods, against a constant friction force that opposes the motion.
Simulation    Friction reverses within a motion, and static friction decides where a tool stops that is a
              tenth of a millimeter from its goal. Plans that end soon are simulated with the estimated
              parameters; the linear model corrects them by the error of the state at their end (shooting, a
              few iterations).

The derivative of the voltages with respect to the state is that of the linear plan.

References:
    Stoer and Bulirsch (2002), Introduction to Numerical Analysis, section 7.3 (shooting methods).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ...arrays import Array, ParameterRows, ToolPositions, TravelStates, Volts
from ...dynamics import Equations
from ...errors import InputError
from ..models.linear_motion import LinearMotion, reachability, state_scale
from ..models.motion_model import MotionModel
from ..models.simulated_motion import SimulatedMotion

SIMULATED_PERIODS, CORRECTIONS = 6, 5  # longest plan that is simulated, and how often it is corrected
SHORTER = 0.5  # factor of a correction after one that did not help
CORRECTION_STEP_S = 1e-3  # s, integration step; the corrections need no higher accuracy
SWITCHING_S = 1e-9  # s, length of the interval in which the last voltage is applied, for a dead time
# m/V: final error (velocities in units of 0.1 m/s per mm) that is as costly as 1 V. It matters for plans of
# so few periods that they cannot bring every state to rest.
FINAL_ERROR = 1e-6


class PlannedTransfers(NamedTuple):
    """First voltages of K transfers (motions to rest at the goal) of each machine.

    Attributes:
        volts: Voltages of the first period, V, not limited, shape (B, K, drives).
        gains: Derivatives of `volts` with respect to the state, V/m and Vs/m, shape (B, K, drives, 2 n).
    """

    volts: Array
    gains: Array


class SimulatedTransfers:
    """Planner of motions to rest at the goal, in given numbers of periods, for B different machines.

    Args:
        model: Model of the machine with its declared parameters, n coordinates; the simulations contain its
            effects.
        period: Control period, s.
        durations: Numbers of periods of the K transfers, positive, ascending.

    Raises:
        InputError: If the durations are not positive and ascending.
    """

    def __init__(self, model: MotionModel, period: float, durations: Sequence[int]) -> None:
        if not durations or durations[0] < 1 or list(durations) != sorted(set(durations)):
            raise InputError(
                f"durations of transfers are {list(durations)}; they must be positive and ascending"
            )
        self._model, self._linear, self._motion = model, LinearMotion(model, period), SimulatedMotion(model)
        self._durations = np.array(durations)
        self._scale = state_scale(2 * len(model.mass))
        self._simulated = self._durations[self._durations <= SIMULATED_PERIODS]
        longest = self._simulated.max(initial=1)
        self._time_s = period * np.arange(longest + 1)
        self._delayed = any(float(delay) > 0.0 for delay in Equations(model.machine).voltage_delays())
        if self._delayed:  # the simulation delays what is applied from the first sample on
            self._time_s = np.insert(self._time_s, 1, SWITCHING_S)

    def plan(
        self,
        state: TravelStates,
        goal: ToolPositions,
        parameters: ParameterRows,
        last_volts: Volts,
        memory: Array | None = None,
    ) -> PlannedTransfers:
        """Plan motions from the present states to rest at the goals, one for each of the K `durations`.

        Plans of up to SIMULATED_PERIODS = 6 periods are corrected by simulations of the machines with their
        effects. The last voltages still act during the dead time of the drives.

        Args:
            memory: Memories of the machines (`SimulatedMotion`), shape (B, M). Default: those at rest.

        Returns:
            Voltages of the first period of each motion, V, not limited, shape (B, K, drives), and their
            derivatives with respect to the state, V/m and Vs/m, shape (B, K, drives, 2 n).
        """
        if memory is None:
            memory = np.zeros((len(state), self._motion.memory_size))
        scale = self._scale
        error = state - self._model.goal_state(goal)
        force = self._linear.opposing_friction(state, error, parameters)
        pulse, gramian, costates = self._costates(self._linear.matrices(parameters, goal), force)
        first = pulse[:, self._durations - 1].transpose(0, 1, 3, 2)
        gains = first @ costates[..., :-1] / scale
        planned = np.einsum("bkij,bj->bki", costates[..., :-1], error / scale) + costates[..., -1]
        count = len(self._simulated)
        best, smallest = planned[:, :count], np.full((len(state), count), np.inf)
        correction, step_length = np.zeros_like(best), np.ones_like(smallest)
        for _ in range(CORRECTIONS + 1 if count else 0):  # the last correction is simulated as well
            final = self._final_states(pulse, planned[:, :count], state, memory, parameters, last_volts)
            final_error = (final - self._model.goal_state(goal)[:, None]) / scale
            # A simulation that diverges counts as an error of 1 m or 100 m/s.
            final_error = np.nan_to_num(final_error, nan=1.0, posinf=1.0, neginf=-1.0)
            distance = np.linalg.norm(final_error, axis=2)
            # A plan that ends farther away than the one before is not used; the next correction is then
            # shorter.
            closer = distance < smallest
            best = np.where(closer[..., None], planned[:, :count], best)
            smallest = np.minimum(distance, smallest)
            full_correction = np.linalg.solve(gramian[:, :count], final_error[..., None])[..., 0]
            correction = np.where(closer[..., None], full_correction, correction)
            step_length = np.where(closer, 1.0, SHORTER * step_length)
            planned[:, :count] = best - step_length[..., None] * correction
        planned[:, :count] = best
        return PlannedTransfers(np.einsum("bkij,bkj->bki", first, planned), gains)

    def _costates(self, matrices: tuple[Array, Array, Array], force: Array) -> tuple[Array, Array, Array]:
        """Compute the costates of all transfers, against a constant force on each coordinate (B, n), N.

        A plan with the costate c applies (A^(j-1) B)' c in the j-th period before its end.
        """
        A, B, E = matrices
        force_response = np.einsum("bij,bj->bi", E, force) / self._scale  # to the force in one period
        # Responses by number of periods: A^N to the initial state, and the accumulated one to the force.
        powers, accumulated = [np.broadcast_to(np.eye(A.shape[1]), A.shape)], [np.zeros_like(force_response)]
        pulses, gramians = [], []
        for pulse, gramian, power in reachability(A, B, int(self._durations[-1])):
            pulses.append(pulse)
            gramians.append(gramian + FINAL_ERROR**2 * np.eye(A.shape[1]))
            accumulated.append(accumulated[-1] + np.einsum("bij,bj->bi", powers[-1], force_response))
            powers.append(power)
        chosen = np.stack(gramians, axis=1)[:, self._durations - 1]
        final = np.concatenate([np.stack(powers, axis=1), np.stack(accumulated, axis=1)[..., None]], axis=3)
        return np.stack(pulses, axis=1), chosen, -np.linalg.solve(chosen, final[:, self._durations])

    def _final_states(
        self, pulse: Array, costates: Array, state: Array, memory: Array, parameters: Array, last_volts: Array
    ) -> Array:
        """Simulate the plans that end soon, within the voltage limits; return the last states (B, k, 2 n)."""
        periods, rated = int(self._simulated[-1]), self._model.rated
        remaining = self._simulated[:, None] - 1 - np.arange(periods)
        by_period = np.where((remaining >= 0)[..., None, None], pulse[:, np.maximum(remaining, 0)], 0.0)
        volts = (
            np.einsum("bkjis,bki->bkjs", by_period, costates)
            .clip(-rated, rated)
            .reshape(-1, periods, len(rated))
        )
        volts = np.concatenate([volts, volts[:, -1:]], axis=1)
        count = len(self._simulated)
        if self._delayed:
            volts = np.concatenate([np.repeat(last_volts, count, axis=0)[:, None], volts], axis=1)
        states, _ = self._motion.simulate(
            np.repeat(state, count, axis=0),
            np.repeat(memory, count, axis=0),
            self._time_s,
            volts,
            np.repeat(parameters, count, axis=0),
            longest_step=CORRECTION_STEP_S,
            parallel=False,
        )
        by_plan = states[:, -periods:].reshape(len(state), count, periods, -1)
        return by_plan[:, np.arange(count), self._simulated - 1]
