"""Differentiable parts of an episode: the motion of a control period, the limits of actions, and the cost.

The derivatives of the machine are those of `DifferentiableMotion`. Importing this module needs the extra
`agents`; `AnalyticPolicyGradient` uses it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

from ..arrays import Array
from ..dynamics import DifferentiableMotion, Equations, Friction, Motions
from ..envs.batched_simulator import steps_of_period
from ..envs.config import LONGEST_STEP
from ..envs.rewards import ARRIVAL_WEIGHTS, SCALES
from ..envs.tasks.base import ReferenceTrajectories
from ..envs.workspace import EndStops
from ..errors import InputError
from ..machine import Machine

SAMPLES = 2  # samples of the tool position per control period that enter the cost
COARSENING = 2  # steps of the environment in one step of the gradient, which needs no higher accuracy
# Static friction can hold the tool up to 0.7 V. A derivative of zero there would hide from the policy that a
# higher voltage moves it.
FRICTION: Friction = "smoothed"
# Units of travel, m, and rate, m/s, in which the derivative with respect to the state is limited: typical
# changes in one period.
TRAVEL_UNIT, RATE_UNIT = 1e-3, 0.05
SMALLEST_DISTANCE = 1e-6  # m, below which the cost is smooth
# Cost along a path: per CONTOUR_UNIT of rms contour error, and per TRACKING_UNIT of rms distance to the
# moving goal.
CONTOUR_UNIT, TRACKING_UNIT = 1e-4, 2e-4  # m; with less weight on the goal, agents learn to stay at the start
CONTOUR_STEP = 1e-6  # m, of the finite differences of the contour error


class SimulatedPeriod:
    """One control period of B machines with n coordinates and d drives, and its derivatives.

    Args:
        machine: Machine that is simulated, with end stops.
        period: Control period, s.

    Attributes:
        delayed: Whether a drive has a dead time, so that the voltages of the period before act at first.

    Raises:
        InputError: If a dead time exceeds the period.
    """

    def __init__(self, machine: Machine, period: float) -> None:
        part = period / SAMPLES
        step = part / -(-steps_of_period(machine, part, LONGEST_STEP) // COARSENING)
        self._end_stops = EndStops(machine, step)
        self._coordinates = len(machine.coordinates)
        self._tool = [machine.coordinate_names.index(name) for name in machine.tool_axes]
        longest_s = max((float(delay) for delay in Equations(machine).voltage_delays()), default=0.0)
        if longest_s > period:
            raise InputError(
                f"machine {machine.name!r} has a dead time of {longest_s:g} s; "
                f"analytic gradients support one of at most a control period, {period:g} s"
            )
        self._motion = DifferentiableMotion(
            self._end_stops.machine, part, longest_step=step, friction=FRICTION
        )
        self.delayed = self._motion.delayed

    def simulate(self, state: Array, volts: Array, last_volts: Array, parameters: Array) -> Motions:
        """Simulate one control period in SAMPLES = 2 equal parts.

        Args:
            state: Belt travel (radius * angle if rotary) of n coordinates and its rate, m and m/s,
                shape (B, 2 n).
            volts: Voltages of the drives, V, shape (B, d).
            last_volts: Voltages of the period before, V, shape (B, d); they still act until a dead time has
                passed, and have no influence without one.
            parameters: Parameters of the machines in the order of `Machine.parameters`, SI, shape (B, P).

        Returns:
            The motions, with states (positions, velocities and states of effects) at the beginning and at the
            end of each part; `outputs` and `gradients` take them.
        """
        values = self._end_stops.parameters(parameters)
        # The states of effects begin at zero in every period.
        start = np.zeros((len(state), self._motion.state_size))
        start[:, : state.shape[1]] = state / self._units(values)
        held, before = (np.repeat(values[:, None], SAMPLES, axis=1) for values in (volts, last_volts))
        return self._motion.simulate(
            start, held, values, earlier=before if self.delayed else None, parallel=False
        )

    def outputs(self, motions: Motions) -> Array:
        """Read the results of a period from its motions.

        Returns:
            State at the end of the period, m and m/s, followed by the tool positions, m, at SAMPLES = 2
            equally spaced times, the last of which is the end (all axes of a time before those of the next);
            shape (B, 2 n + axes * SAMPLES).
        """
        moving = 2 * self._coordinates
        end = motions.states[:, -1, :moving] * self._units(motions.parameters)
        tool = motions.states[:, 1:, self._tool]
        return np.hstack([end, tool.reshape(len(end), -1)])

    def gradients(self, motions: Motions, by_outputs: Array) -> tuple[Array, Array, Array]:
        """Compute the gradients of a number by the chain rule, from its derivatives by a period's outputs.

        Args:
            motions: Motions that `simulate` returned.
            by_outputs: Derivatives by the result of `outputs`, per SI unit, shape (B, 2 n + axes * SAMPLES).

        Returns:
            state: Derivatives by belt travel and rate at the beginning, 1/m and s/m, shape (B, 2 n).
            volts: Derivatives by the voltages, 1/V, shape (B, d).
            last_volts: Derivatives by the voltages of the period before, 1/V, shape (B, d); zero without a
            dead time.
        """
        moving, units = 2 * self._coordinates, self._units(motions.parameters)
        by_states = np.zeros(motions.states.shape)
        by_states[:, -1, :moving] = by_outputs[:, :moving] * units
        by_states[:, 1:, self._tool] += by_outputs[:, moving:].reshape(len(units), SAMPLES, -1)
        found = self._motion.gradients(motions, by_states, by_parameters=False, parallel=False)
        by_last = found.inputs[:, :-SAMPLES].sum(axis=1)
        return found.start[:, :moving] / units, found.inputs[:, -SAMPLES:].sum(axis=1), by_last

    def _units(self, parameters: Array) -> Array:
        """Return the belt travel per position, and per velocity, of each coordinate, (B, 2 n)."""
        return np.tile(self._motion.travel_per_unit(parameters), 2)


class _Period(torch.autograd.Function):
    """Outputs of `SimulatedPeriod` as a differentiable function of state, voltages and last voltages."""

    @staticmethod
    def forward(
        ctx: Any,
        state: Any,
        volts: Any,
        last_volts: Any,
        parameters: Array,
        period: SimulatedPeriod,
        limit: float,
        discount: float,
    ) -> Any:
        arrays = [values.detach().numpy() for values in (state, volts, last_volts)]
        ctx.motions = period.simulate(arrays[0], arrays[1], arrays[2], parameters)
        ctx.period, ctx.limit, ctx.discount = period, limit, discount
        return torch.from_numpy(period.outputs(ctx.motions))

    @staticmethod
    def backward(ctx: Any, gradient: Any) -> Any:  # type: ignore[override]
        parts = ctx.period.gradients(ctx.motions, gradient.numpy())
        by_state, by_volts, by_last = map(np.nan_to_num, parts)
        norm = np.linalg.norm(by_state * np.repeat([TRAVEL_UNIT, RATE_UNIT], by_state.shape[1] // 2), axis=1)
        factor = np.minimum(1.0, ctx.limit / np.maximum(norm, 1e-12))[:, None]
        by_state, by_volts, by_last = (
            torch.from_numpy(factor * part) for part in (by_state, by_volts, by_last)
        )
        return ctx.discount * by_state, by_volts, ctx.discount * by_last, None, None, None, None


class _Limit(torch.autograd.Function):
    """Limit to [-1, 1] whose gradient is zero only where a descent step would lead farther outside."""

    @staticmethod
    def forward(ctx: Any, values: Any) -> Any:
        ctx.save_for_backward(values)
        return values.clamp(-1.0, 1.0)

    @staticmethod
    def backward(ctx: Any, gradient: Any) -> Any:  # type: ignore[override]
        (values,) = ctx.saved_tensors
        return gradient * ((values.abs() <= 1.0) | (values * gradient > 0.0))


class _SquaredContour(torch.autograd.Function):
    """Squared distances (B,), m^2, of points (B, axes) to the paths of their goals."""

    @staticmethod
    def forward(ctx: Any, points: Any, references: ReferenceTrajectories) -> Any:
        def squares(moved: Array) -> Array:
            distance = references.contour(slice(None), moved)
            assert distance is not None
            return distance**2

        position = points.detach().numpy()
        steps = CONTOUR_STEP * np.eye(position.shape[1])
        ctx.slopes = np.stack(
            [(squares(position + step) - squares(position - step)) / (2.0 * CONTOUR_STEP) for step in steps],
            axis=1,
        )
        return torch.from_numpy(squares(position))

    @staticmethod
    def backward(ctx: Any, gradient: Any) -> Any:  # type: ignore[override]
        return gradient[:, None] * torch.from_numpy(ctx.slopes), None


_squared_contour: Any = _SquaredContour.apply
differentiable_period: Any = _Period.apply
limited: Any = _Limit.apply


def distance_cost(distance: Any) -> Any:
    """Compute the costs of distances to the goal: 0 at the goal, towards 1 far from it.

    A cost is the negative of the reward `ArrivalReward` at this distance.

    Args:
        distance: Tensor of distances, m, of any shape.

    Returns:
        Tensor of costs, dimensionless, of the same shape.
    """
    scales, weights = (torch.tensor(values, dtype=distance.dtype) for values in (SCALES, ARRIVAL_WEIGHTS))
    return (weights * distance[..., None] / (distance[..., None] + scales)).sum(-1)


def reach_cost(tool: Any, goal: Any) -> Any:
    """Compute the cost of one period of a motion to a fixed goal; it increases with the distance to the goal.

    Args:
        tool: Tool positions of B environments in the middle and at the end of the period (SAMPLES = 2), m,
            shape (B, SAMPLES, axes).
        goal: Goals, m, shape (B, axes).

    Returns:
        Costs, dimensionless, shape (B,): mean over both times of a function of the distance (`distance_cost`)
        that increases from 0 at the goal towards 1 far from it.
    """
    squares = ((tool - goal.double()[:, None]) ** 2).sum(2)
    return distance_cost(torch.sqrt(squares + SMALLEST_DISTANCE**2)).mean(1)


def path_errors(tool: Any, references: ReferenceTrajectories) -> Any:
    """Compute the squared contour and tracking errors of one control period of a motion along a path.

    Args:
        tool: Tool positions at SAMPLES = 2 times of the period, m, shape (B, SAMPLES, axes); the last is at
            its end.
        references: Paths and goals of the B environments; their present time must be the end of the period.

    Returns:
        Two columns: mean squared distance to the path over the samples of the period, and squared distance to
        the goal at its end, m^2, shape (B, 2).
    """
    contour = torch.stack([_squared_contour(points, references) for points in tool.unbind(1)]).mean(0)
    goal = torch.from_numpy(references.goals(slice(None)).astype(np.float64))
    return torch.stack([contour, ((tool[:, -1] - goal) ** 2).sum(1)], dim=1)


def path_cost(squares: Any) -> Any:
    """Compute the cost of episodes along a path from the errors in each control period.

    Args:
        squares: Squared distance to the path (contour error), then to the goal, in each period of B episodes,
            m^2, shape (B, periods, 2).

    Returns:
        Rms contour error / 0.1 mm + rms distance to the goal / 0.2 mm, dimensionless, shape (B,).
    """
    units = torch.tensor([CONTOUR_UNIT, TRACKING_UNIT], dtype=squares.dtype)
    return (torch.sqrt(squares.mean(1) + SMALLEST_DISTANCE**2) / units).sum(1)
