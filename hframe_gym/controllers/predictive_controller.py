"""Predictive controller: it identifies the machine in an episode's first periods, and plans with the result.

Estimation   `ParameterWindow` compares every measured state with simulations of the period before.
Moves        A plan of voltages within their limits brings the tool to its goal in the fewest periods
             (`ArrivalPlanner`), planned anew from the measured state every period. Simulations correct the
             last periods of the approach and what remains at the goal (`PlanSimulation`).
Paths        A plan over the previewed goals minimizes the distances to them. Every period it is shifted by
             one period, simulated from the measured state, and corrected by the linear model (real-time
             iteration, `_PathPlanner`).
Memory       All simulations go on from what the machine remembers of the episode: states of effects, such as
             a hysteresis, and the swing of slow loads (`SimulatedMotion`).
Disturbance  Where the simulation cannot explain the measured states, because they are inexact or the machine
             has effects that are not declared, the estimator also varies a voltage at each drive.

There is no training. The controller takes 0.1 to 0.4 ms per machine and period in batches, and 1.5 to 6 ms
for one.

References:
    Rawlings, Mayne and Diehl (2017), Model Predictive Control: Theory, Computation, and Design.
    Diehl, Bock and Schloeder (2005), A real-time iteration scheme for nonlinear optimization in optimal
    feedback control.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from ..arrays import Actions, Array, Mask, PreviewedGoals, TravelStates
from ..machine import Machine
from .base import CONTROLLERS, Feedback, FullStateController
from .estimation.parameter_estimators import ParameterWindow
from .models.input_compensation import DeadTime, InputInversion
from .models.linear_motion import LinearMotion
from .models.motion_model import MotionModel, OperatingPointGrid
from .models.simulated_motion import SimulatedMotion
from .planning.finite_horizon_control import HORIZON_S, longest_transfer_s
from .planning.predictive_plans import ArrivalPlanner, PlanSimulation

LONGEST_PERIODS = 60  # until the tool arrives; a longer way is planned again on the way
ARRIVED = 1.2e-4  # m, predicted error of a plan that arrives in time
# Periods by which the arrival may change from one period to the next, in the order tried.
DELAYS = (-1, 0, 1, 2, 3)
# Periods before the arrival in which a plan is corrected by simulations, and simulated periods after the
# arrival.
REFINED_PERIODS, PERIODS_BEYOND = 3, 3
CHANGE_WEIGHT = 1e-5  # m/V, tool error that is as costly as a voltage change of 1 V along a path
ESTIMATES_CHANGED = 2e-3  # change of an estimate after which linear models are computed again


@CONTROLLERS.register("predictive")
class PredictiveController(FullStateController):
    """Model-predictive controller that identifies friction, masses and belts during the episode.

    Attributes:
        feature_sizes: Number of columns of `estimates`, by name; a learned policy on top of this controller
            observes them.
    """

    feedback: ClassVar[Feedback] = "estimated_state"
    knowledge: ClassVar[str] = "plans, estimates parameters"

    def __init__(self, machine: Machine, period: float = 0.01) -> None:
        super().__init__(machine, period)
        self._dead_time, self._inversion = DeadTime(machine, period), InputInversion(machine)
        self._undelayed_model = MotionModel(self._dead_time.machine_without_delay)
        self._motion = SimulatedMotion(self._undelayed_model)
        self.estimator = ParameterWindow(self._undelayed_model, period, self._dead_time.remainder_s)
        self._linear, self._grid = LinearMotion(self._undelayed_model, period), OperatingPointGrid(machine)
        self._longest = min(
            LONGEST_PERIODS, int(np.ceil(longest_transfer_s(self.model, self._grid) / period))
        )
        self._arrival_planner = ArrivalPlanner(self._undelayed_model, period, self._longest)
        self._simulation = PlanSimulation(self._undelayed_model, period, REFINED_PERIODS + PERIODS_BEYOND)
        self._path_planner: _PathPlanner | None = None  # created when the length of the preview is known
        self._follows_path = False  # whether the goal moved in the last period
        self.feature_sizes = {"estimates": self.estimator.size}
        self._resize(0)

    def _resize(self, batch: int) -> None:
        """Allocate the memory of B machines."""
        drives = len(self.model.rated)
        self._state = np.zeros((batch, 2 * len(self.model.mass)))  # at the last observation
        self._arrival = np.zeros(batch, np.intp)  # periods until the arrival; 0 before the first plan
        self._settling = np.zeros(batch, np.bool_)  # whether the tool has arrived
        self._refined = np.full((batch, self._simulation.periods, drives), np.nan)  # plan, V; NaN: none yet
        self._elapsed = np.zeros(batch, np.intp)  # periods

    def _begin_episodes(self, starts: Mask) -> None:
        """Clear the memory of the machines (B,) whose episode starts."""
        self._dead_time.reset(starts)
        self._arrival[starts] = 0
        self._settling[starts] = False
        self._refined[starts] = np.nan
        self._elapsed[starts] = 0

    @override
    def act_on_state(self, state: TravelStates, goals: PreviewedGoals) -> Actions:
        """Update the estimates, plan the motion to the goal or along its preview, and start it.

        The actions are limited to [-1, 1].
        """
        if self._starts.resize(len(state)):
            self._resize(len(state))
        self._begin_episodes(self._starts.mask)
        arrived_actions = self._dead_time.arrived_history()[1][:, :-1] / self.model.rated
        self.estimator.update(self._state, state, arrived_actions, self._starts.mask)
        parameters = self.estimator.parameters(self.estimator.estimates)
        predicted, memory = self._after_dead_time(state, parameters)
        self._follows_path = goals.shape[1] > 1
        plan = self._track if self._follows_path else self._reach
        volts = np.clip(plan(predicted, memory, goals, parameters), -self.model.rated, self.model.rated)
        self._dead_time.send(volts)
        self._state, self._elapsed = state, self._elapsed + 1
        self._starts.clear()
        return volts / self.model.rated

    @override
    def replace_last_action(self, actions: Actions) -> None:
        self._dead_time.replace_last(actions * self.model.rated)

    @property
    def estimates(self) -> Array:
        """Estimated errors of the model's parameters and missing voltages of B machines, dimensionless.

        An array of shape (B, 2 n + 2 b + drives) for n coordinates and b belts. Columns in this order:
        Coulomb friction of every coordinate, mass of every coordinate, stiffness EA of every belt, length of
        every belt, each as ln(estimated / declared value), where 0.1 is about 10 % above; then for each drive
        the voltage that the simulation lacks, as a fraction of the rated voltage.
        """
        return self.estimator.estimates

    def gain(self) -> Array:
        """Compute the derivative of the voltages that `act` returned last, with respect to the state.

        It is the derivative of the plan with the linear model; corrections of the plan by simulations are
        ignored. The analytic policy gradient needs it to train a policy that corrects this controller.

        Returns:
            Gains, V/m and Vs/m, shape (B, drives, 2 n).
        """
        if self._follows_path and self._path_planner is not None:
            return self._path_planner.gain()
        return self._arrival_planner.gain(self._arrival)

    def _after_dead_time(self, state: Array, parameters: Array) -> tuple[Array, Array]:
        """Return the states (B, 2 n) and memories (B, M) at the end of the drives' dead time."""
        if self._dead_time.delay_s == 0.0:
            return state, self.estimator.memory
        times, volts = self._dead_time.pending_history()
        volts = volts + self.estimator.offset[:, None]
        states, memories = self._motion.simulate(state, self.estimator.memory, times, volts, parameters)
        return states[:, -1], memories[:, -1]

    def _reach(self, state: Array, memory: Array, goals: Array, parameters: Array) -> Array:
        """Return commanded voltages (B, drives) for states (B, 2 n), goals (B, 1, axes), parameters."""
        goal = goals[:, 0]
        error = state - self.model.goal_state(goal)
        elapsed_s = self._elapsed.astype(np.float64) * self.period
        force = self._linear.opposing_friction(state, error, parameters) + self.model.effect_force(
            state, elapsed_s
        )
        force += self.estimator.offset @ self.model.drive.T
        self._arrival_planner.predict(self._linear.matrices(parameters, goal), error, force)
        plans = self._plan_arrival()
        commands = self._inversion.command(plans.reshape(-1, plans.shape[2])).reshape(plans.shape)
        volts = commands[:, 0]
        self._settling |= self._arrival <= 1
        chosen = self._settling | (self._arrival <= REFINED_PERIODS)
        if chosen.any():
            rows = np.flatnonzero(chosen)
            volts[rows] = self._refine(rows, state, memory, parameters, goal, commands)
        return volts

    def _plan_arrival(self) -> Array:
        """Return the voltages (B, periods, drives), V, of the plans that arrive first; update its period."""
        new = self._arrival == 0
        if new.any():
            self._arrival[new] = self._earliest_arrival()[new] + 1
        expected = np.maximum(self._arrival - 1, 1)
        volts, accepted = np.zeros(0), np.zeros(len(new), np.bool_)
        for delay in DELAYS:
            arrival = np.clip(expected + delay, 1, self._longest)
            plan = self._arrival_planner.plan(arrival)
            chosen = ~accepted & ((plan.error < ARRIVED) | (delay == DELAYS[-1]))
            volts = np.where(chosen[:, None, None], plan.volts, volts) if len(volts) else plan.volts
            self._arrival = np.where(chosen, arrival, self._arrival)
            accepted |= chosen
            if accepted.all():
                break
        return volts

    def _earliest_arrival(self) -> NDArray[np.intp]:
        """Return the smallest number of periods (B,) in which the tool can arrive, at most the longest."""
        # Bisection, because a later arrival is possible wherever an earlier one is.
        low, high = np.ones(len(self._arrival), np.intp), np.full(len(self._arrival), self._longest)
        while np.any(low < high):
            middle = (low + high) // 2
            arrives = self._arrival_planner.plan(middle).error < ARRIVED
            low, high = np.where(arrives | (low == high), low, middle + 1), np.where(arrives, middle, high)
        return high

    def _refine(
        self,
        rows: NDArray[np.intp],
        state: Array,
        memory: Array,
        parameters: Array,
        goal: Array,
        commands: Array,
    ) -> Array:
        """Return the first commanded voltages (rows, drives) of refined plans, and store the plans."""
        previous, periods = self._refined[rows], self._simulation.periods
        planned = np.zeros(previous.shape)
        planned[:, : commands.shape[1]] = commands[rows, :periods]
        shifted = np.concatenate([previous[:, 1:], np.zeros_like(previous[:, :1])], axis=1)
        offset = self.estimator.offset[rows, None]
        plans = [np.where(np.isnan(shifted), planned, shifted) + offset, planned + offset]
        count = int(self._elapsed.max(initial=0))
        best = self._simulation.improve(
            state[rows], memory[rows], parameters[rows], goal[rows], plans, self._arrival[rows], count
        )
        self._refined[rows] = best - offset
        return best[:, 0] - offset[:, 0]

    def _track(self, state: Array, memory: Array, goals: Array, parameters: Array) -> Array:
        """Return commanded voltages (B, drives) for goals (B, 1 + P, axes), m, now and at periods' ends."""
        goals = self._dead_time.delayed_goals(goals)
        horizon = min(goals.shape[1] - 1, max(1, round(HORIZON_S / self.period)))
        if self._path_planner is None or self._path_planner.horizon != horizon:
            self._path_planner = _PathPlanner(
                self._linear, self._grid, self._undelayed_model, self.period, horizon
            )
        return self._path_planner.command(
            state,
            memory,
            goals[:, : horizon + 1],
            parameters,
            self.estimator.offset,
            self._inversion,
            self._starts.mask,
        )


class _PathPlanner:
    """Planner of the motion along a previewed path for B machines with different parameters."""

    def __init__(
        self, linear: LinearMotion, grid: OperatingPointGrid, model: MotionModel, period: float, horizon: int
    ) -> None:
        self._linear, self._grid, self.horizon = linear, grid, horizon
        self._simulation = PlanSimulation(model, period, horizon)
        self._rated, self._tool = model.rated, model.tool
        entries = horizon * len(self._rated)
        self._difference = np.eye(entries) - np.eye(entries, k=-len(self._rated))
        self._volts = np.zeros((0, horizon, len(self._rated)))  # plan of the last period, V
        self._parameters, self._points = np.zeros((0, 0)), np.zeros(0, np.intp)
        self._response = self._by_state = np.zeros((0, 0, 0))

    def command(
        self,
        state: Array,
        memory: Array,
        goals: Array,
        parameters: Array,
        offset: Array,
        inversion: InputInversion,
        starts: Mask,
    ) -> Array:
        """Return the commanded voltages of the present period, V, shape (B, drives)."""
        if len(self._volts) != len(state):
            self._volts = np.zeros((len(state), self.horizon, len(self._rated)))
        self._volts[starts] = 0.0
        self._update_response(parameters, self._grid.nearest(goals[:, 0]))
        batch, entries = len(state), self._difference.shape[0]
        last = np.zeros((batch, entries))
        last[:, : len(self._rated)] = self._volts[:, 0]
        volts = np.concatenate([self._volts[:, 1:], self._volts[:, -1:]], axis=1)
        R, D = self._response, CHANGE_WEIGHT * self._difference
        normal = R.transpose(0, 2, 1) @ R + D.T @ D
        commands = inversion.command(volts.reshape(-1, len(self._rated))).reshape(volts.shape)
        samples = self._simulation.tool_positions(state, memory, parameters, commands + offset[:, None])
        ends = samples[:, samples.shape[1] // self.horizon - 1 :: samples.shape[1] // self.horizon]
        error = (ends - goals[:, 1:]).reshape(batch, -1)
        change = volts.reshape(batch, -1) @ D.T - CHANGE_WEIGHT * last
        gradient = np.einsum("bij,bi->bj", R, error) + change @ D
        volts = volts - np.linalg.solve(normal, gradient[..., None]).reshape(volts.shape)
        self._volts = np.clip(volts, -self._rated, self._rated)
        return inversion.command(self._volts[:, 0])

    def _update_response(self, parameters: Array, points: NDArray[np.intp]) -> None:
        """Compute the tool's response at the periods' ends to the voltages (B, axes H, drives H) anew."""
        if len(self._parameters) == len(parameters) and np.array_equal(points, self._points):
            change = parameters / np.where(self._parameters, self._parameters, 1.0) - 1.0
            if np.abs(change).max() < ESTIMATES_CHANGED:
                return
        self._parameters, self._points = parameters, points
        A, pulse, _ = self._linear.matrices(parameters, self._grid.points[points])
        H, axes, drives = self.horizon, len(self._tool), len(self._rated)
        response = np.zeros((len(parameters), H, axes, H, drives))
        power, by_state = A, []
        for lag in range(H):
            for period in range(H - lag):
                response[:, period + lag, :, period] = pulse[:, self._tool]
            by_state.append(power[:, self._tool])
            pulse, power = A @ pulse, A @ power
        self._response = response.reshape(len(parameters), axes * H, drives * H)
        self._by_state = np.concatenate(by_state, axis=1)

    def gain(self) -> Array:
        """Return the derivative of the first voltages by the state, V/m and Vs/m, (B, drives, 2 n)."""
        R, D = self._response, CHANGE_WEIGHT * self._difference
        normal = R.transpose(0, 2, 1) @ R + D.T @ D
        gains = -np.linalg.solve(normal, R.transpose(0, 2, 1) @ self._by_state)[:, : len(self._rated)]
        inside = np.abs(self._volts[:, 0]) < self._rated
        return np.asarray(gains * inside[:, :, None])
