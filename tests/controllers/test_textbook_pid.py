from __future__ import annotations

import numpy as np
from closed_loop import PERIOD, closed_loop, random_points

from hframe_gym.controllers import TextbookPID
from hframe_gym.machine import Machine


def test_settles_the_nominal_machine_slower_than_the_model_based_one(hframe: Machine, pid: object) -> None:
    start, goal = random_points(32, 1), random_points(32, 2)
    plain = closed_loop(TextbookPID(hframe, PERIOD), hframe, start, goal)
    model = closed_loop(pid, hframe, start, goal)  # type: ignore[arg-type]
    assert plain.error[:, -1].max() < 2e-4
    assert np.abs(plain.actions).max() <= 1.0
    assert np.sum(plain.error > 2e-4) > 1.3 * np.sum(model.error > 2e-4)


def test_gains_follow_the_machine(hframe: Machine) -> None:
    heavier = TextbookPID(hframe.replace({"x.mass": 8.0}), PERIOD)
    assert heavier.proportional[0] > TextbookPID(hframe, PERIOD).proportional[0]


def test_reset_forgets_the_integral(hframe: Machine) -> None:
    controller = TextbookPID(hframe, PERIOD)
    seen = {"observation": np.zeros((2, 8)), "desired_goal": np.full((2, 2), 1e-3)}
    first = controller.act(seen)
    second = controller.act(seen)
    assert not np.array_equal(first, second)
    controller.reset(np.array([True, False]))
    third = controller.act(seen)
    np.testing.assert_array_equal(third[0], first[0])
    assert not np.array_equal(third[1], first[1])
