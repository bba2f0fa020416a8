"""Plans of a predictive controller for batches of different machines: voltages that arrive in time.

`ArrivalPlanner`   Voltages within their limits that bring the tool to its goal in K periods and keep it there
                   (the solution of a quadratic program for each machine); the belts come to rest after the
                   tool.
`PlanSimulation`   Simulation of plans, and correction of the last periods of a plan by simulations. They
                   contain static friction, which decides where a tool stops that approaches its goal by a
                   tenth of a millimeter.

References:
    Boyd and Vandenberghe (2004), Convex Optimization, section 5.5 (the dual problem).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...arrays import Array, CoordinateForces, ParameterRows, ToolPositions, TravelStates
from ...dynamics import belt_modes
from ..base import SIMULATION_STEP_S
from ..models.linear_motion import scaled_matrices, state_scale
from ..models.motion_model import MotionModel
from ..models.simulated_motion import SimulatedMotion

Indices = NDArray[np.intp]
# Arrival: unit of the tool's errors, m, weight of the belts' motion at the end of the plan, and of the
# voltages as fractions of their limits. The tool's error counts most.
TOOL_UNIT, REST_WEIGHT, EFFORT_WEIGHT = 1e-4, 0.1, 1e-2
# Time in which the tool is held at its goal in the plan, in periods of the slowest belt mode.
REST_MODE_PERIODS = 1.2
# Newton's method on the dual problem: maximum number of steps, step lengths that are tried, largest slope at
# the end.
NEWTON_STEPS, STEP_LENGTHS, CONVERGED = 10, (1.0, 0.4, 0.1), 1e-7
# Refinement: steps of the differences, V, which reach across static friction; error per sample that costs
# about as much as a larger one, in SAMPLE_UNIT; damping of the tried corrections with their lengths.
VOLTAGE_STEPS = (0.1, 0.2, 0.4)
SAMPLE_UNIT, ROBUST_UNITS, LARGE_WEIGHT = 2e-5, 10.0, 0.02
CORRECTIONS = ((1e-2, 1.0), (1e-2, 0.5), (1.0, 1.0), (30.0, 1.0))
REFINEMENTS, SAMPLES = 2, 4  # iterations per period, and samples of the tool per period


class ArrivalPlan(NamedTuple):
    """Planned motions of B machines.

    Attributes:
        volts: Motor voltages of the control periods from now on, V, shape (B, periods, drives), where periods
            is the length of the longest plan that the planner can make; zero after the end of a shorter plan.
        error: Largest predicted distance of the tool to its goal from its arrival on, m, shape (B,). A large
            distance means that the tool cannot arrive so early.
    """

    volts: Array
    error: Array


class ArrivalPlanner:
    """Planner of motions to a goal at rest, for B machines with different parameters.

    Args:
        model: Model with the coordinates, drives and axes of the machines.
        period: Control period, s.
        longest: Largest number of periods until the tool arrives.
    """

    def __init__(self, model: MotionModel, period: float, longest: int) -> None:
        self._model, self._longest = model, longest
        modes = belt_modes(model.machine)
        rest_s = REST_MODE_PERIODS / min(modes) if modes else 0.0
        self._hold = max(3, int(np.ceil(rest_s / period - 0.3)))  # planned periods after the arrival
        self._scale = state_scale(2 * len(model.mass))

    def predict(
        self, matrices: tuple[Array, Array, Array], error: TravelStates, force: CoordinateForces
    ) -> None:
        """Predict the motion at 0 V and the response to voltages, and store both for `plan` and `gain`.

        Call it in every control period before `plan` and `gain`. The prediction covers the longest plan.

        Args:
            matrices: A, G and E of the model, next error = A error + G voltages + E force, in m, s, V and N,
                for B machines with n coordinates, of the shapes (B, 2 n, 2 n), (B, 2 n, drives) and
                (B, 2 n, n); `LinearMotion.matrices` computes them.
            error: State minus the state at rest at the goal.
            force: Force on each coordinate until the tool arrives, for example friction.
        """
        A, pulse, force_response = scaled_matrices(*matrices)
        push, state = np.einsum("bij,bj->bi", force_response, force), error / self._scale
        pulses, states, pushes = [pulse], [state], [np.zeros_like(push), push]
        for _ in range(self._longest + self._hold):
            pulses.append(A @ pulses[-1])
            states.append(np.einsum("bij,bj->bi", A, states[-1]))
            pushes.append(np.einsum("bij,bj->bi", A, pushes[-1]))
        self._A = A
        self._pulses = np.stack(pulses, axis=1)  # A^j B, (B, periods, 2 n, drives)
        self._free = np.stack(states, axis=1)  # A^j e, (B, periods, 2 n)
        self._pushed = np.cumsum(np.stack(pushes, axis=1), axis=1)  # sum of A^i E f for i < j

    def plan(self, arrival: Indices) -> ArrivalPlan:
        """Compute voltages that bring B tools to their goals in K control periods and keep them there.

        The motion starts from the state that was passed to `predict`. The plan has K + H control periods: it
        ends H periods after the arrival. H covers 1.2 periods of the slowest vibration of the belts, and is
        at least 3.

        Args:
            arrival: Number K of control periods until the tool arrives, 1 or more, shape (B,).

        Returns:
            Motor voltages of the periods of the longest possible plan, V, zero after the end of a shorter
            one, and the largest predicted distance of each tool to its goal from its arrival on, m.
        """
        rated, axes, batch = self._model.rated, len(self._model.tool), len(arrival)
        # Residuals are R a + c for actions a within [-1, 1].
        R, c = self._residuals(arrival)
        actions = _least_squares_within_limits(R, c)
        residual = (np.einsum("bij,bj->bi", R, actions) + c)[:, : self._hold * axes] * TOOL_UNIT
        distance = np.linalg.norm(residual.reshape(batch, self._hold, axes), axis=2).max(axis=1)
        volts = np.zeros((batch, self._longest + self._hold, len(rated)))
        periods = actions.shape[1] // len(rated)
        volts[:, :periods] = actions.reshape(batch, periods, len(rated)) * rated
        return ArrivalPlan(volts, distance)

    def gain(self, arrival: Indices) -> Array:
        """Compute the derivative of the first period's voltages of `plan(arrival)` with respect to the state.

        Args:
            arrival: Number K of control periods until the tool arrives, 1 or more, shape (B,).

        Returns:
            Gains, V/m and Vs/m, shape (B, drives, 2 n); 0 for a voltage at its limit.
        """
        R, c = self._residuals(arrival)
        free = np.abs(_least_squares_within_limits(R, c)) < 1.0  # voltages that are not at their limits
        R = R / np.sqrt(EFFORT_WEIGHT)
        powers = [np.broadcast_to(np.eye(self._A.shape[1]), self._A.shape)]
        for _ in range(int(arrival.max()) + self._hold):
            powers.append(self._A @ powers[-1])
        power, each = np.stack(powers, axis=1), np.arange(len(arrival))
        rows = [power[each, arrival + after][:, self._model.tool] for after in range(self._hold)]
        by_state = (
            np.concatenate([*rows, REST_WEIGHT * power[each, arrival + self._hold]], axis=1) / TOOL_UNIT
        )
        normal = (R * free[:, None]) @ R.transpose(0, 2, 1) + np.eye(R.shape[1])
        drives = len(self._model.rated)
        first = (R * free[:, None])[:, :, :drives].transpose(0, 2, 1)
        actions = -first @ np.linalg.solve(normal, by_state) / np.sqrt(EFFORT_WEIGHT)
        return actions * self._model.rated[:, None] / self._scale

    def _residuals(self, arrival: Indices) -> tuple[Array, Array]:
        """Return R (B, rows, actions) and c (B, rows) of the residuals R a + c of plans with arrivals."""
        end, tool = arrival + self._hold, self._model.tool
        rows, constants = [], []
        for after in range(self._hold):
            response, free = self._response(arrival + after, end.max(), arrival)
            rows.append(response[:, tool] / TOOL_UNIT)
            constants.append(free[:, tool] / TOOL_UNIT)
        response, free = self._response(end, end.max(), arrival)
        rows.append(response * (REST_WEIGHT / TOOL_UNIT))
        constants.append(free * (REST_WEIGHT / TOOL_UNIT))
        return np.concatenate(rows, axis=1) * np.tile(self._model.rated, end.max()), np.concatenate(
            constants, axis=1
        )

    def _response(self, time: Indices, periods: int, arrival: Indices) -> tuple[Array, Array]:
        """Return responses (B, 2 n, periods * drives) of states at times (B,), in periods, and states at 0 V.

        The force acts until the arrival (B,).
        """
        each = np.arange(len(time))
        lag = time[:, None] - 1 - np.arange(periods)
        pulses = np.where((lag >= 0)[..., None, None], self._pulses[each[:, None], np.maximum(lag, 0)], 0.0)
        response = pulses.transpose(0, 2, 1, 3).reshape(len(time), pulses.shape[2], -1)
        free = (
            self._free[each, time]
            + self._pushed[each, time]
            - self._pushed[each, np.maximum(time - arrival, 0)]
        )
        return response, free


def _least_squares_within_limits(R: Array, c: Array) -> Array:
    """Return a in [-1, 1] that minimizes |R a + c|^2 + EFFORT_WEIGHT |a|^2 per machine, shape (B, columns).

    Newton's method on the dual problem, which has as many unknowns as R has rows and no limits.
    """
    limit = np.sqrt(EFFORT_WEIGHT)  # of the scaled unknowns v = limit * a
    R = R / limit
    transposed, identity = R.transpose(0, 2, 1), np.eye(R.shape[1])

    def dual(multipliers: Array) -> Array:
        value = np.abs(np.einsum("bij,bi->bj", R, multipliers))
        inner = np.where(value < limit, 0.5 * value**2, limit * value - 0.5 * limit**2).sum(axis=1)
        return np.asarray(inner - (c * multipliers).sum(axis=1) + 0.5 * (multipliers**2).sum(axis=1))

    multipliers = np.asarray(np.linalg.solve(R @ transposed + identity, c[..., None])[..., 0], np.float64)
    best = dual(multipliers)
    for _ in range(NEWTON_STEPS):
        value = np.einsum("bij,bi->bj", R, multipliers)
        slope = np.einsum("bij,bj->bi", R, np.clip(value, -limit, limit)) - c + multipliers
        if np.abs(slope).max() < CONVERGED:
            break
        inside = (np.abs(value) < limit)[:, None]
        step = -np.linalg.solve((R * inside) @ transposed + identity, slope[..., None])[..., 0]
        start = multipliers
        for length in STEP_LENGTHS:
            trial = np.asarray(start + length * step, np.float64)
            cost = dual(trial)
            multipliers = np.asarray(np.where((cost < best)[:, None], trial, multipliers), np.float64)
            best = np.minimum(cost, best)
    return np.asarray(-np.clip(np.einsum("bij,bi->bj", R, multipliers), -limit, limit) / limit)


class PlanSimulation:
    """Simulation of plans of voltages for B machines, and improvement of plans by simulations.

    Args:
        model: Model of the machines with n coordinates.
        period: Control period, s.
        periods: Largest number of periods of a plan.
    """

    def __init__(self, model: MotionModel, period: float, periods: int) -> None:
        self._model, self.periods, self._motion = model, periods, SimulatedMotion(model)
        self._time_s = np.linspace(0.0, period * periods, periods * SAMPLES + 1)

    def tool_positions(
        self, state: TravelStates, memory: Array, parameters: ParameterRows, volts: Array
    ) -> Array:
        """Simulate; return tool positions at 4 equidistant times per period, m, shape (B, 4 * periods, axes).

        Args:
            memory: Memories of the machines (`SimulatedMotion`), shape (B, M).
            volts: Commanded voltages of each period, V, shape (B, periods, drives).
        """
        inputs = np.repeat(volts, SAMPLES, axis=1)
        states, _ = self._motion.simulate(
            state,
            memory,
            self._time_s[: inputs.shape[1] + 1],
            np.concatenate([inputs, inputs[:, -1:]], axis=1),
            parameters,
            longest_step=SIMULATION_STEP_S,
            parallel=False,
        )
        return states[:, 1:, self._model.tool]

    def improve(
        self,
        state: TravelStates,
        memory: Array,
        parameters: ParameterRows,
        goal: ToolPositions,
        plans: list[Array],
        arrival: Indices,
        count: int,
    ) -> Array:
        """Choose the best of several plans by simulation, and improve it.

        The cost of a plan is a sum over the simulated times from the end of period K on. Each term grows with
        the distance e of the tool from its goal, more slowly for large distances: it is e / (1 + e / 0.2 mm)
        + 0.02 e. Two Gauss-Newton iterations, with derivatives by finite differences, reduce the cost; each
        tries four corrections and keeps the best plan so far.

        Args:
            memory: Memories of the machines (`SimulatedMotion`), shape (B, M).
            plans: One array per plan, at least one: commanded voltages of each period, V, shape (B, periods,
                drives).
            arrival: Number K of periods until the tool should have arrived, shape (B,).
            count: Number of periods since the start of the episode. It selects the finite-difference steps,
                whose size and sign change from period to period so that some of them overcome static
                friction.

        Returns:
            Commanded voltages of the improved plan, V, shape (B, periods, drives).
        """
        batch, rated, entries = len(state), self._model.rated, self.periods * len(self._model.rated)
        counted = np.arange(1, self.periods * SAMPLES + 1) >= arrival[:, None] * SAMPLES  # (B, samples)

        def residuals(volts: Array, repeats: int = 1) -> Array:
            """Return the errors of the tool in SAMPLE_UNIT, (B * repeats, samples, axes)."""
            start, remembered, values, end = (
                np.repeat(array, repeats, axis=0) for array in (state, memory, parameters, goal)
            )
            error = (self.tool_positions(start, remembered, values, volts) - end[:, None]) / SAMPLE_UNIT
            return np.asarray(error * np.repeat(counted, repeats, axis=0)[..., None])

        def tried(volts: Array) -> _TriedPlan:
            residual = residuals(volts)
            distance = np.linalg.norm(residual, axis=2)
            cost = distance / (1.0 + distance / ROBUST_UNITS) + LARGE_WEIGHT * distance
            return _TriedPlan(volts, residual, cost.sum(axis=1))

        best = tried(plans[0])
        for plan in plans[1:]:
            best = best.or_better(tried(plan))
        for iteration in range(REFINEMENTS):
            turn = count * REFINEMENTS + iteration + np.arange(entries)
            steps = np.take(VOLTAGE_STEPS, turn % len(VOLTAGE_STEPS)) * np.where(turn % 2, 1.0, -1.0)
            changed = np.repeat(best.volts.reshape(batch, 1, entries), entries, axis=1) + np.diag(steps)
            shifted = residuals(changed.reshape(-1, *best.volts.shape[1:]), entries).reshape(
                batch, entries, -1
            )
            J = (shifted - best.residual.reshape(batch, 1, -1)) / steps[:, None]
            robust = (1.0 + np.linalg.norm(best.residual, axis=2, keepdims=True) / ROBUST_UNITS) ** -2.0
            weighted = J * np.broadcast_to(robust, best.residual.shape).reshape(batch, 1, -1)
            H, gradient = weighted @ J.transpose(0, 2, 1), weighted @ best.residual.reshape(batch, -1, 1)
            start = best.volts
            for damping, length in CORRECTIONS:
                change = np.linalg.solve(H + damping * np.eye(entries), gradient)[..., 0].reshape(start.shape)
                best = best.or_better(tried(np.clip(start - length * change, -rated, rated)))
        return best.volts


class _TriedPlan(NamedTuple):
    """Plans (B, periods, drives), V, their residuals (B, samples, axes) in SAMPLE_UNIT and costs (B,)."""

    volts: Array
    residual: Array
    cost: Array

    def or_better(self, other: _TriedPlan) -> _TriedPlan:
        """Return for each machine this plan or, if its cost is lower, the other one."""
        better = (other.cost < self.cost)[:, None, None]
        volts = np.where(better, other.volts, self.volts)
        residual = np.where(better, other.residual, self.residual)
        return _TriedPlan(volts, residual, np.minimum(self.cost, other.cost))
