"""Differentiable parts of an episode: the motion of a control period, the limits of actions, and the cost.

The derivatives of the machine are finite differences of the compiled simulator. Importing this module needs the extra
`agents`; `AnalyticPolicyGradient` uses it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

from hframe_gym.arrays import Array, ParameterRows, TravelStates, Volts

from ..dynamics import Equations, rollout
from ..envs.tasks.base import ReferenceTrajectories
from ..envs.workspace import EndStops
from ..errors import InputError
from ..machine import Machine

SAMPLES = 2  # samples of the tool position per control period that enter the cost
INTEGRATION_STEP = 1e-3  # s, twice that of the environment; the gradient needs no higher accuracy
SWITCHING_S = 1e-9  # s, length of the interval in which the voltage before the period is applied, for a dead time
# Steps of the finite differences: belt travel, m, its rate, m/s, and the range of the voltages, V. Static friction can
# hold the tool up to 0.7 V. Much smaller steps would not move it, so that a derivative of zero would hide from the
# policy that a higher voltage does.
TRAVEL_STEP, RATE_STEP, VOLTAGE_STEPS = 2e-5, 5e-3, (0.05, 0.3)
# Units of travel, m, and rate, m/s, in which the derivative with respect to the state is limited: typical changes in
# one period.
TRAVEL_UNIT, RATE_UNIT = 1e-3, 0.05
# Lengths s, m, and weights w of `distance_cost`. It resembles the reward "dense", which has equal weights; here a few
# tenths of a millimeter count most.
COST_SCALES, COST_WEIGHTS = (2e-1, 2e-2, 2e-3, 2e-4, 2e-5), (0.05, 0.05, 0.3, 0.5, 0.1)
SMALLEST_DISTANCE = 1e-6  # m, below which the cost is smooth
# Cost along a path: per CONTOUR_UNIT of rms contour error, and per TRACKING_UNIT of rms distance to the moving goal.
CONTOUR_UNIT, TRACKING_UNIT = 1e-4, 2e-4  # m; with less weight on the goal, agents learn to stay at the start
CONTOUR_STEP = 1e-6  # m, of the finite differences of the contour error


class SimulatedPeriod:
    """One control period of B machines with n coordinates and d drives, and its derivatives by finite differences.

    Args:
        machine: Machine that is simulated, with end stops.
        period: Control period, s.
        seed: Seed of the random steps of the differences.

    Attributes:
        delayed: Whether a drive has a dead time, so that the voltages of the period before act at first.

    Raises:
        InputError: If a dead time exceeds the period.
    """

    def __init__(self, machine: Machine, period: float, seed: int) -> None:
        self._end_stops = EndStops(machine, INTEGRATION_STEP)
        self._coordinates, self._drives = len(machine.coordinates), len(machine.drives)
        self._tool = [machine.coordinate_names.index(name) for name in machine.tool_axes]
        self._units = np.tile(machine.travel_per_unit, 2)
        self._time_s = np.linspace(0.0, period, SAMPLES + 1)
        longest_s = max((float(delay) for delay in Equations(machine).voltage_delays()), default=0.0)
        if longest_s > period:
            raise InputError(
                f"machine {machine.name!r} has a dead time of {longest_s:g} s; analytic gradients support one of at "
                f"most a control period, {period:g} s"
            )
        self.delayed = longest_s > 0.0
        if self.delayed:  # the simulation delays what is applied from the first sample on
            self._time_s = np.insert(self._time_s, 1, SWITCHING_S)
        self.generator = np.random.default_rng(seed)

    def outputs(self, state: TravelStates, volts: Volts, last_volts: Volts, parameters: ParameterRows) -> Array:
        """Simulate one control period.

        Args:
            state: State at its start.
            volts: Voltages of the drives.
            last_volts: Voltages of the period before; they still act until a dead time has passed.
            parameters: Parameters of the machines.

        Returns:
            State at the end of the period, m and m/s, followed by the tool positions, m, at SAMPLES = 2 equally spaced
            times, the last of which is the end (all axes of a time before those of the next); shape (B, 2 n + axes *
            SAMPLES).
        """
        applied = np.repeat(volts[:, None], len(self._time_s), axis=1)
        if self.delayed:
            applied[:, 0] = last_volts
        states = rollout(
            self._end_stops.machine,
            self._time_s,
            applied,
            velocities=True,
            parameters=self._end_stops.parameters(parameters),
            start=state / self._units,
            longest_step=INTEGRATION_STEP,
            parallel=False,
        )
        tool = states[:, -SAMPLES:, self._tool]
        return np.hstack([states[:, -1] * self._units, tool.reshape(len(state), -1)])

    def differences(
        self, state: TravelStates, volts: Volts, last_volts: Volts, parameters: ParameterRows
    ) -> tuple[Array, Array]:
        """Simulate one control period and estimate the derivatives of its result by finite differences.

        For each derivative the simulation is repeated with one entry of state or voltages changed by a random step. The
        arguments are those of `outputs`.

        Returns:
            outputs: Result of the method `outputs`, shape (B, o).
            derivatives: Derivatives of the o outputs with respect to the entries of `state`, then of `volts` and, if
                the drives have a dead time, of `last_volts`, SI, shape (2 n + d or 2 n + 2 d, B, o).
        """
        inputs = np.hstack([state, volts, last_volts] if self.delayed else [state, volts])
        batch, entries = inputs.shape
        split = state.shape[1]
        counts = [self._coordinates] * 2 + [entries - split]
        steps = np.tile(np.repeat([TRAVEL_STEP, RATE_STEP, 1.0], counts), (batch, 1))
        lowest, highest = np.log(VOLTAGE_STEPS)
        steps[:, split:] = np.exp(self.generator.uniform(lowest, highest, (batch, entries - split)))
        steps *= np.where(self.generator.random(steps.shape) < 0.5, -1.0, 1.0)
        changed = np.tile(inputs, (1 + entries, 1, 1))
        for i in range(entries):
            changed[1 + i, :, i] += steps[:, i]
        rows = changed.reshape(-1, entries)
        by_drive = rows[:, split : split + self._drives], rows[:, -self._drives :]
        results = self.outputs(rows[:, :split], *by_drive, np.tile(parameters, (1 + entries, 1)))
        results = results.reshape(1 + entries, batch, -1)
        return results[0], (results[1:] - results[0]) / steps.T[:, :, None]


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
        outputs, ctx.derivatives = period.differences(arrays[0], arrays[1], arrays[2], parameters)
        ctx.limit, ctx.discount, ctx.states, ctx.drives = limit, discount, state.shape[1], volts.shape[1]
        return torch.from_numpy(outputs)

    @staticmethod
    def backward(ctx: Any, gradient: Any) -> Any:  # type: ignore[override]
        change = np.nan_to_num(np.einsum("bo,ibo->bi", gradient.numpy(), ctx.derivatives))
        by_state = change[:, : ctx.states] * np.repeat([TRAVEL_UNIT, RATE_UNIT], ctx.states // 2)
        norm = np.linalg.norm(by_state, axis=1, keepdims=True)
        change *= np.minimum(1.0, ctx.limit / np.maximum(norm, 1e-12))
        by_state, by_volts, by_last = np.split(change, [ctx.states, ctx.states + ctx.drives], axis=1)
        earlier = [torch.from_numpy(ctx.discount * part) if part.size else None for part in (by_state, by_last)]
        return earlier[0], torch.from_numpy(by_volts), earlier[1], None, None, None, None


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
            [(squares(position + step) - squares(position - step)) / (2.0 * CONTOUR_STEP) for step in steps], axis=1
        )
        return torch.from_numpy(squares(position))

    @staticmethod
    def backward(ctx: Any, gradient: Any) -> Any:  # type: ignore[override]
        return gradient[:, None] * torch.from_numpy(ctx.slopes), None


_squared_contour: Any = _SquaredContour.apply
differentiable_period: Any = _Period.apply
limited: Any = _Limit.apply


def distance_cost(distance: Any) -> Any:
    """Compute a cost, dimensionless, that increases with the distance d to the goal, m, from 0 at the goal towards 1.

    The cost is the sum over k of w[k] * d / (d + s[k]), with the lengths s = 200, 20, 2, 0.2 and 0.02 mm and the
    weights w = 0.05, 0.05, 0.3, 0.5 and 0.1. Halving the distance thus reduces the cost noticeably, from 0.2 m down to
    20 um. The argument is a tensor of any shape.
    """
    scales, weights = (torch.tensor(values, dtype=distance.dtype) for values in (COST_SCALES, COST_WEIGHTS))
    return (weights * distance[..., None] / (distance[..., None] + scales)).sum(-1)


def reach_cost(tool: Any, goal: Any) -> Any:
    """Compute the cost of one control period of a motion to a fixed goal, shape (B,): the mean of `distance_cost`.

    Args:
        tool: Tool positions of B environments in the middle and at the end of the period (SAMPLES = 2), m, shape (B,
            SAMPLES, axes).
        goal: Goals, m, shape (B, axes).
    """
    squares = ((tool - goal.double()[:, None]) ** 2).sum(2)
    return distance_cost(torch.sqrt(squares + SMALLEST_DISTANCE**2)).mean(1)


def path_errors(tool: Any, references: ReferenceTrajectories) -> Any:
    """Compute the squared contour and tracking errors of one control period of a motion along a path.

    Args:
        tool: Tool positions at SAMPLES = 2 times of the period, m, shape (B, SAMPLES, axes); the last is at its end.
        references: Paths and goals of the B environments; their present time must be the end of the period.

    Returns:
        Two columns: mean squared distance to the path over the samples of the period, and squared distance to the goal
        at its end, m^2, shape (B, 2).
    """
    contour = torch.stack([_squared_contour(points, references) for points in tool.unbind(1)]).mean(0)
    goal = torch.from_numpy(references.goals(slice(None)).astype(np.float64))
    return torch.stack([contour, ((tool[:, -1] - goal) ** 2).sum(1)], dim=1)


def path_cost(squares: Any) -> Any:
    """Compute the cost of episodes along a path, rms contour error / 0.1 mm + rms distance to the goal / 0.2 mm.

    Args:
        squares: Squared distance to the path (contour error), then to the goal, in each period of B episodes, m^2,
            shape (B, periods, 2).

    Returns:
        Costs, dimensionless, shape (B,).
    """
    units = torch.tensor([CONTOUR_UNIT, TRACKING_UNIT], dtype=squares.dtype)
    return (torch.sqrt(squares.mean(1) + SMALLEST_DISTANCE**2) / units).sum(1)
