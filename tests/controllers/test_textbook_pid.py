"""Tests of the textbook PID."""

from __future__ import annotations

import numpy as np

from hframe_gym.controllers import ModelBasedController, TextbookPID
from hframe_gym.machine import BUILTIN_MACHINES, Machine
from tests.controllers.closed_loop import PERIOD, closed_loop, random_points


def test_settles_the_nominal_machine_more_slowly_than_the_model_based_controller(
    hframe: Machine, model_based: ModelBasedController
) -> None:
    start, goal = random_points(32, 1), random_points(32, 2)
    textbook = closed_loop(TextbookPID(hframe, PERIOD), hframe, start, goal)
    reference = closed_loop(model_based, hframe, start, goal)
    assert textbook.error[:, -1].max() < 2e-4
    assert np.abs(textbook.actions).max() <= 1.0
    assert np.sum(textbook.error > 2e-4) > 1.3 * np.sum(reference.error > 2e-4)


def test_gains_depend_on_the_machine(hframe: Machine) -> None:
    heavier = TextbookPID(hframe.replace({"x.mass": 8.0}), PERIOD)
    assert heavier.proportional[0] > TextbookPID(hframe, PERIOD).proportional[0]


def test_reset_clears_the_integrators_of_the_mask(hframe: Machine) -> None:
    controller = TextbookPID(hframe, PERIOD)
    observation = {"observation": np.zeros((2, 8)), "desired_goal": np.full((2, 2), 1e-3)}
    first = controller.act(observation)
    second = controller.act(observation)
    assert not np.array_equal(first, second)
    controller.reset(np.array([True, False]))
    third = controller.act(observation)
    np.testing.assert_array_equal(third[0], first[0])
    assert not np.array_equal(third[1], first[1])


def test_an_unstable_loop_is_told() -> None:
    # without gear its motors are light, and the belt modes dominate
    literal = BUILTIN_MACHINES["hframe-literal"]()
    assert "unstable on machine 'hframe-literal' at a control period of 0.01 s" in str(
        TextbookPID(literal).concern()
    )
    assert TextbookPID(BUILTIN_MACHINES["hframe"]()).concern() is None
    assert TextbookPID(BUILTIN_MACHINES["axis"]()).concern() is None
