from __future__ import annotations

import numpy as np
import pytest
from closed_loop import PERIOD, closed_loop, random_points, random_stages

from hframe_gym.controllers import ModelBasedController, MotionModel
from hframe_gym.effects.asymmetric_viscous import EFFECT as ASYMMETRIC_VISCOUS
from hframe_gym.effects.constant_force import EFFECT as CONSTANT_FORCE
from hframe_gym.machine import BUILTIN_MACHINES, Machine


def test_reaches_a_grid_of_the_workspace_and_stays(hframe: Machine, pid: ModelBasedController) -> None:
    grid = np.array([[x, y] for x in np.linspace(-0.25, 0.25, 5) for y in np.linspace(-0.16, 0.16, 5)])
    run = closed_loop(pid, hframe, grid[::-1].copy(), grid)
    assert run.error[:, 100:].max() < 5e-5


def test_reaches_goals_on_random_machines_and_stays(hframe: Machine, pid: ModelBasedController) -> None:
    start, goal = random_points(64, 1), random_points(64, 2)
    run = closed_loop(pid, hframe, start, goal, changes=random_stages(hframe, 64, 3))
    assert run.error[:, 100:].max() < 2e-4
    settled = np.argmax(run.error[:, ::-1] > 2e-4, axis=1)
    assert PERIOD * np.mean(run.error.shape[1] - settled) < 0.33


def test_never_exceeds_the_rated_voltage(hframe: Machine, pid: ModelBasedController) -> None:
    run = closed_loop(pid, hframe, random_points(16, 4), random_points(16, 5), changes=random_stages(hframe, 16, 6))
    assert np.abs(run.actions).max() <= 1.0
    assert np.abs(run.actions).max() > 0.9


def test_batch_equals_batches_of_one(hframe: Machine, pid: ModelBasedController) -> None:
    start, goal = random_points(5, 7), random_points(5, 8)
    changes = random_stages(hframe, 5, 9)
    whole = closed_loop(pid, hframe, start, goal, changes=changes, periods=60)
    for b in range(5):
        own = {name: values[b : b + 1] for name, values in changes.items()}
        one = closed_loop(pid, hframe, start[b : b + 1], goal[b : b + 1], changes=own, periods=60)
        np.testing.assert_allclose(one.actions[0], whole.actions[b], rtol=0.0, atol=1e-9)


def test_masked_reset_forgets_only_those_stages(hframe: Machine, pid: ModelBasedController) -> None:
    start, goal = random_points(2, 10), random_points(2, 11)
    closed_loop(pid, hframe, start, goal, periods=80)
    state = np.array([[*g, -sum(g) / 0.0194, (g[0] - g[1]) / 0.0194, 0, 0, 0, 0] for g in goal])
    fresh = ModelBasedController(hframe, PERIOD).act({"observation": state, "desired_goal": goal})
    pid.reset(np.array([True, False]))
    kept = pid.act({"observation": state, "desired_goal": goal})
    np.testing.assert_array_equal(kept[0], fresh[0])
    assert not np.array_equal(kept[1], fresh[1])


def test_gains_follow_the_machine(hframe: Machine, pid: ModelBasedController) -> None:
    heavier = ModelBasedController(hframe.replace({"x.mass": 6.0}), PERIOD)
    assert not np.allclose(heavier.transfers.gains[31, 0], pid.transfers.gains[31, 0])


def test_settles_machines_that_it_was_not_made_for_first(hframe: Machine) -> None:
    """Other masses, gear and belts, without a number changed by hand."""
    machine = hframe.replace(
        {
            "x.mass": 8.0,
            "y.mass": 2.0,
            "motor1.gear_ratio": 4.0,
            "motor2.gear_ratio": 4.0,
            "left.EA": 3e4,
            "right.EA": 3e4,
        }
    )
    run = closed_loop(
        ModelBasedController(machine, PERIOD), machine, random_points(16, 12), random_points(16, 13), periods=150
    )
    assert run.error[:, 130:].max() < 2e-4


def test_a_machine_with_its_effects_settles_sooner_than_one_without(hframe: Machine, pid: ModelBasedController) -> None:
    """A push of 10 N on the cart stretches the belts: who knows of it aims the motors beyond."""
    pushed = hframe.with_effects(CONSTANT_FORCE.at("y", size=10.0), ASYMMETRIC_VISCOUS.at("x", a=0.3))
    start, goal = random_points(64, 14), random_points(64, 15)
    aware = closed_loop(ModelBasedController(pushed, PERIOD), pushed, start, goal)
    blind = closed_loop(pid, pushed, start, goal)
    assert aware.error[:, 100:].max() < 5e-5
    assert np.sum(aware.error > 2e-4) < 0.9 * np.sum(blind.error > 2e-4)


@pytest.mark.parametrize("name", ["axis", "hframe-order20"])
def test_refuses_machines_without_full_state(name: str) -> None:
    with pytest.raises(ValueError, match="full-state control needs"):
        ModelBasedController(BUILTIN_MACHINES[name]())


def test_refuses_a_period_that_is_not_positive(hframe: Machine) -> None:
    with pytest.raises(ValueError, match="period"):
        ModelBasedController(hframe, 0.0)


def test_refuses_observations_of_another_shape(pid: ModelBasedController) -> None:
    with pytest.raises(ValueError, match="observation has shape"):
        pid.act({"observation": np.zeros((3, 7)), "desired_goal": np.zeros((3, 2))})


def test_what_was_applied_in_its_place_is_no_disturbance(hframe: Machine) -> None:
    """Held by friction near its goal, each voltage is the one that the stage had and the same feedback more."""
    controller = ModelBasedController(hframe)
    state = MotionModel(hframe).observation(MotionModel(hframe).goal_state(np.zeros((1, 2))))
    seen = {"observation": state, "desired_goal": np.array([[5e-5, 0.0]])}
    _, second, third = (controller.act(seen) for _ in range(3))
    given = np.array([[0.03, -0.02]])
    controller.applied(given)
    np.testing.assert_allclose(controller.act(seen) - given, third - second, rtol=1e-6)
