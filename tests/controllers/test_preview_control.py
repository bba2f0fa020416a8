from __future__ import annotations

import numpy as np
import pytest
from closed_loop import PERIOD, PREVIEW, circles, closed_loop, random_stages
from scipy.optimize import lsq_linear

from hframe_gym.controllers import ModelBasedController, MotionModel, TextbookPID
from hframe_gym.controllers.operating_points import OperatingPointGrid
from hframe_gym.controllers.preview_control import CHANGE, PreviewGains
from hframe_gym.dynamics import rollout
from hframe_gym.machine import BUILTIN_MACHINES, Machine


def test_follows_a_circle_of_its_own_machine_to_ten_micrometres(hframe: Machine, pid: ModelBasedController) -> None:
    goals = circles(16, 1)
    run = closed_loop(pid, hframe, goals[:, 0], goals)
    assert np.sqrt(np.mean(run.error[:, 40:] ** 2)) < 1.5e-5
    assert np.abs(run.actions).max() <= 1.0


def test_follows_circles_on_random_machines(hframe: Machine, pid: ModelBasedController) -> None:
    goals = circles(64, 2)
    run = closed_loop(pid, hframe, goals[:, 0], goals, changes=random_stages(hframe, 64, 3))
    assert np.sqrt(np.mean(run.error**2)) < 1e-4
    textbook = closed_loop(
        TextbookPID(hframe, PERIOD), hframe, goals[:, 0], goals, changes=random_stages(hframe, 64, 3)
    )
    assert np.mean(textbook.error**2) > 100.0 * np.mean(run.error**2)


def test_the_plan_is_the_least_squares_solution(hframe: Machine) -> None:
    """Against SciPy's solver, with the tool's responses taken from the simulation of the linear machine."""
    machine = BUILTIN_MACHINES["hframe-linear"]()
    model = MotionModel(machine)
    places = OperatingPointGrid(machine)
    middle = int(places.nearest(np.zeros((1, 2)))[0])
    H = 6
    plans = PreviewGains(model, places, PERIOD, H, CHANGE)
    time = PERIOD * np.arange(H + 1)

    def tool(start: np.ndarray, volts: np.ndarray) -> np.ndarray:
        held = np.vstack([volts, np.zeros((1, 2))])
        return rollout(machine, time, held, start=start, longest_step=2e-5)[0, 1:, :2].ravel()

    start = np.array([1e-3, -2e-3, 0.05, -0.1, 0.1, 0.05, -8.0, 3.0])
    free = tool(start, np.zeros((H, 2)))
    columns = []
    for k in range(2 * H):
        volts = np.zeros(2 * H)
        volts[k] = 1.0
        columns.append(tool(start, volts.reshape(H, 2)) - free)
    response = np.array(columns).T
    goals = np.random.default_rng(0).normal(0.0, 5e-3, 2 * H)
    last = np.array([2.0, -1.0])
    steps = np.eye(2 * H) - np.eye(2 * H, k=-2)
    before = np.concatenate([last, np.zeros(2 * H - 2)])
    A = np.vstack([response, CHANGE * steps])
    b = np.concatenate([goals - free, CHANGE * before])
    expected = lsq_linear(A, b).x[:2]
    state = start * np.tile(machine.radii, 2)
    found = plans.state[middle] @ state + plans.goal[middle] @ goals + plans.last[middle] @ last
    np.testing.assert_allclose(found, expected, rtol=2e-3)


def test_a_batch_equals_batches_of_one(hframe: Machine, pid: ModelBasedController) -> None:
    goals = circles(3, 4, periods=40)
    changes = random_stages(hframe, 3, 5)
    whole = closed_loop(pid, hframe, goals[:, 0], goals, changes=changes, periods=40)
    for b in range(3):
        own = {name: values[b : b + 1] for name, values in changes.items()}
        one = closed_loop(pid, hframe, goals[b : b + 1, 0], goals[b : b + 1], changes=own, periods=40)
        np.testing.assert_allclose(one.actions[0], whole.actions[b], rtol=0.0, atol=1e-9)


def test_a_goal_that_stands_still_is_kept(hframe: Machine, pid: ModelBasedController) -> None:
    goals = np.tile(np.array([[[0.05, -0.02]]]), (2, 41 + PREVIEW, 1))
    run = closed_loop(pid, hframe, goals[:, 0], goals, periods=40)
    assert run.error.max() < 1e-9


@pytest.mark.parametrize("period", [0.002, 0.005])
def test_gains_of_other_periods_bring_the_model_to_the_goals(hframe: Machine, period: float) -> None:
    """Frictionless and rigidly placed, the closed loop of gains and model settles on a goal a millimetre away."""
    model = MotionModel(hframe)
    places = OperatingPointGrid(hframe)
    middle = int(places.nearest(np.zeros((1, 2)))[0])
    H = round(0.1 / period)
    plans = PreviewGains(model, places, period, H, CHANGE)
    A, B, _ = model.discretize(places.points[middle], period)
    goal = np.array([1e-3, 0.0])
    state, last = np.zeros(8), np.zeros(2)
    for _ in range(round(0.5 / period)):
        last = plans.state[middle] @ state + plans.goal[middle] @ np.tile(goal, H) + plans.last[middle] @ last
        state = A @ state + B @ last
    np.testing.assert_allclose(model.tool(state[None])[0], goal, atol=1e-9)
