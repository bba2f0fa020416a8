"""Tests of the tracking of previewed goals."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from hframe_gym.controllers import ModelBasedController, MotionModel, OperatingPointGrid, PreviewGains, TextbookPID
from hframe_gym.controllers.preview_control import VOLTAGE_CHANGE_WEIGHT
from hframe_gym.dynamics import rollout
from hframe_gym.machine import BUILTIN_MACHINES, Machine
from tests.controllers.closed_loop import PERIOD, PREVIEW, circles, closed_loop, random_stages


def test_tracks_a_circle_on_the_nominal_machine(hframe: Machine, model_based: ModelBasedController) -> None:
    goals = circles(16, 1)
    loop = closed_loop(model_based, hframe, goals[:, 0], goals)
    assert np.sqrt(np.mean(loop.error[:, 40:] ** 2)) < 1.5e-5
    assert np.abs(loop.actions).max() <= 1.0


def test_tracks_circles_on_randomized_machines(hframe: Machine, model_based: ModelBasedController) -> None:
    goals, changes = circles(64, 2), random_stages(hframe, 64, 3)
    loop = closed_loop(model_based, hframe, goals[:, 0], goals, changes=changes)
    assert np.sqrt(np.mean(loop.error**2)) < 1e-4
    textbook = closed_loop(TextbookPID(hframe, PERIOD), hframe, goals[:, 0], goals, changes=changes)
    assert np.mean(textbook.error**2) > 100.0 * np.mean(loop.error**2)


@pytest.mark.oracle
def test_the_plan_is_the_least_squares_solution() -> None:
    """The reference is SciPy's solver, with the tool's responses from simulations of the linear machine."""
    machine = BUILTIN_MACHINES["hframe-linear"]()
    grid = OperatingPointGrid(machine)
    middle = int(grid.nearest(np.zeros((1, 2)))[0])
    horizon = 6
    gains = PreviewGains(MotionModel(machine), grid, PERIOD, horizon, VOLTAGE_CHANGE_WEIGHT)
    time = PERIOD * np.arange(horizon + 1)

    def tool_path(start: np.ndarray, volts: np.ndarray) -> np.ndarray:
        held = np.vstack([volts, np.zeros((1, 2))])
        return rollout(machine, time, held, start=start, longest_step=2e-5)[0, 1:, :2].ravel()

    start = np.array([1e-3, -2e-3, 0.05, -0.1, 0.1, 0.05, -8.0, 3.0])
    free = tool_path(start, np.zeros((horizon, 2)))
    unit_volts = np.eye(2 * horizon).reshape(-1, horizon, 2)
    response = np.array([tool_path(start, volts) - free for volts in unit_volts]).T
    goals = np.random.default_rng(0).normal(0.0, 5e-3, 2 * horizon)
    last = np.array([2.0, -1.0])
    difference = np.eye(2 * horizon) - np.eye(2 * horizon, k=-2)
    before = np.concatenate([last, np.zeros(2 * horizon - 2)])
    A = np.vstack([response, VOLTAGE_CHANGE_WEIGHT * difference])
    b = np.concatenate([goals - free, VOLTAGE_CHANGE_WEIGHT * before])
    expected = lsq_linear(A, b).x[:2]
    state = start * np.tile(machine.travel_per_unit, 2)
    volts = gains.state[middle] @ state + gains.goal[middle] @ goals + gains.last[middle] @ last
    np.testing.assert_allclose(volts, expected, rtol=2e-3)


def test_a_batch_equals_batches_of_one(hframe: Machine, model_based: ModelBasedController) -> None:
    goals, changes = circles(3, 4, periods=40), random_stages(hframe, 3, 5)
    batch = closed_loop(model_based, hframe, goals[:, 0], goals, changes=changes, periods=40)
    for b in range(3):
        parameters = {name: values[b : b + 1] for name, values in changes.items()}
        single = closed_loop(model_based, hframe, goals[b : b + 1, 0], goals[b : b + 1], changes=parameters, periods=40)
        np.testing.assert_allclose(single.actions[0], batch.actions[b], rtol=0.0, atol=1e-9)


def test_a_previewed_goal_that_does_not_move_is_held(hframe: Machine, model_based: ModelBasedController) -> None:
    goals = np.tile(np.array([[[0.05, -0.02]]]), (2, 41 + PREVIEW, 1))
    loop = closed_loop(model_based, hframe, goals[:, 0], goals, periods=40)
    assert loop.error.max() < 1e-9


@pytest.mark.parametrize("period", [0.002, 0.005])
def test_gains_of_other_periods_bring_the_model_to_the_goal(hframe: Machine, period: float) -> None:
    """The closed loop of the gains and the linear model settles on a goal that is a millimeter away."""
    model, grid = MotionModel(hframe), OperatingPointGrid(hframe)
    middle = int(grid.nearest(np.zeros((1, 2)))[0])
    horizon = round(0.1 / period)
    gains = PreviewGains(model, grid, period, horizon, VOLTAGE_CHANGE_WEIGHT)
    A, B, _ = model.discretize(grid.points[middle], period)
    goal = np.array([1e-3, 0.0])
    state, volts = np.zeros(8), np.zeros(2)
    for _ in range(round(0.5 / period)):
        feedforward = gains.goal[middle] @ np.tile(goal, horizon)
        volts = gains.state[middle] @ state + feedforward + gains.last[middle] @ volts
        state = A @ state + B @ volts
    np.testing.assert_allclose(model.tool_position(state[None])[0], goal, atol=1e-9)
