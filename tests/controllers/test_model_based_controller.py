"""Tests of the model-based controller on goals that stay."""

from __future__ import annotations

import numpy as np
import pytest

from hframe_gym.controllers import ModelBasedController, MotionModel
from hframe_gym.effects import EFFECTS
from hframe_gym.evaluation import evaluate
from hframe_gym.machine import Machine
from tests.controllers.closed_loop import PERIOD, closed_loop, random_points, random_stages

pytestmark = pytest.mark.integration


def test_reaches_a_grid_of_the_workspace_and_stays(
    hframe: Machine, model_based: ModelBasedController
) -> None:
    grid = np.array([[x, y] for x in np.linspace(-0.25, 0.25, 5) for y in np.linspace(-0.16, 0.16, 5)])
    loop = closed_loop(model_based, hframe, grid[::-1].copy(), grid)
    assert loop.error[:, 100:].max() < 5e-5


def test_reaches_goals_on_randomized_machines(hframe: Machine, model_based: ModelBasedController) -> None:
    start, goal = random_points(64, 1), random_points(64, 2)
    loop = closed_loop(model_based, hframe, start, goal, changes=random_stages(hframe, 64, 3))
    assert loop.error[:, 100:].max() < 2e-4
    periods_after_settling = np.argmax(loop.error[:, ::-1] > 2e-4, axis=1)
    assert PERIOD * np.mean(loop.error.shape[1] - periods_after_settling) < 0.33


def test_uses_the_rated_voltage_and_never_more(hframe: Machine, model_based: ModelBasedController) -> None:
    start, goal = random_points(16, 4), random_points(16, 5)
    loop = closed_loop(model_based, hframe, start, goal, changes=random_stages(hframe, 16, 6))
    assert 0.9 < np.abs(loop.actions).max() <= 1.0


def test_a_batch_equals_batches_of_one(hframe: Machine, model_based: ModelBasedController) -> None:
    start, goal = random_points(5, 7), random_points(5, 8)
    changes = random_stages(hframe, 5, 9)
    batch = closed_loop(model_based, hframe, start, goal, changes=changes, periods=60)
    for b in range(5):
        parameters = {name: values[b : b + 1] for name, values in changes.items()}
        single = closed_loop(
            model_based, hframe, start[b : b + 1], goal[b : b + 1], changes=parameters, periods=60
        )
        np.testing.assert_allclose(single.actions[0], batch.actions[b], rtol=0.0, atol=1e-9)


def test_masked_reset_clears_only_those_stages(hframe: Machine, model_based: ModelBasedController) -> None:
    start, goal = random_points(2, 10), random_points(2, 11)
    closed_loop(model_based, hframe, start, goal, periods=80)
    model = MotionModel(hframe)
    observation = {"observation": model.observation(model.goal_state(goal)), "desired_goal": goal}
    first = ModelBasedController(hframe, PERIOD).act(observation)
    model_based.reset(np.array([True, False]))
    actions = model_based.act(observation)
    np.testing.assert_array_equal(actions[0], first[0])
    assert not np.array_equal(actions[1], first[1])


def test_gains_depend_on_the_machine(hframe: Machine, model_based: ModelBasedController) -> None:
    heavier = ModelBasedController(hframe.replace({"x.mass": 6.0}), PERIOD)
    assert not np.allclose(heavier.transfers.gains[31, 0], model_based.transfers.gains[31, 0])


def test_settles_a_machine_with_other_masses_gears_and_belts(hframe: Machine) -> None:
    changes = {"x.mass": 8.0, "y.mass": 2.0, "left.EA": 3e4, "right.EA": 3e4}
    machine = hframe.replace(changes | {"motor1.gear_ratio": 4.0, "motor2.gear_ratio": 4.0})
    controller = ModelBasedController(machine, PERIOD)
    loop = closed_loop(controller, machine, random_points(16, 12), random_points(16, 13), periods=150)
    assert loop.error[:, 130:].max() < 2e-4


def test_settles_sooner_if_it_models_the_effects(hframe: Machine, model_based: ModelBasedController) -> None:
    """A force of 10 N on the cart stretches the belts; with a model of it the motors go beyond."""
    pushed = hframe.with_effects(
        EFFECTS["constant_force"].at("y", size=10.0), EFFECTS["asymmetric_viscous"].at("x", a=0.3)
    )
    start, goal = random_points(64, 14), random_points(64, 15)
    with_model = closed_loop(ModelBasedController(pushed, PERIOD), pushed, start, goal)
    without_model = closed_loop(model_based, pushed, start, goal)
    assert with_model.error[:, 100:].max() < 5e-5
    assert np.sum(with_model.error > 2e-4) < 0.9 * np.sum(without_model.error > 2e-4)


def test_a_replaced_action_is_not_taken_for_a_disturbance(
    hframe: Machine, model_based: ModelBasedController
) -> None:
    """While friction holds the stage, each voltage is the one that was applied plus the same feedback."""
    model = MotionModel(hframe)
    observation = {
        "observation": model.observation(model.goal_state(np.zeros((1, 2)))),
        "desired_goal": np.array([[5e-5, 0.0]]),
    }
    _, second, third = (model_based.act(observation) for _ in range(3))
    applied = np.array([[0.03, -0.02]])
    model_based.replace_last_action(applied)
    np.testing.assert_allclose(model_based.act(observation) - applied, third - second, rtol=1e-6)


@pytest.mark.parametrize(("delay_s", "longest_s"), [(0.0, 0.55), (0.005, 0.7)])
def test_settles_under_a_load_that_swings_on(hframe: Machine, delay_s: float, longest_s: float) -> None:
    """At the goal, a load of 0.3 of the cart's mass pulls by newtons, stretching belts by tenths of a mm."""
    machine = hframe.with_effects(EFFECTS["payload_swing"].at("y", f0=1.8, zeta=0.04, r=0.3))
    if delay_s:
        machine = machine.with_effects(EFFECTS["input_delay"].at("drives", d=delay_s))
    scores = evaluate("pid", machine, randomize="none", episodes=16).scores["controllers"]["pid"]
    assert scores["settling_s"]["0.2mm"]["mean"] < longest_s
