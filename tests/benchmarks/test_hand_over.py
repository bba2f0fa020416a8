"""A controller takes over from another one within a distance of the goal, for good."""

from __future__ import annotations

from typing import Any

import numpy as np

from benchmarks.gap.plants import declared_machine
from benchmarks.hand_over import HandOver
from hframe_gym.arrays import Array
from hframe_gym.controllers import Controller


class Constant(Controller):
    """Controller that always commands the same, and remembers what was applied."""

    def __init__(self, command: float) -> None:
        super().__init__(declared_machine(), 0.01)
        self.command, self.applied = command, np.zeros((0, 2))

    def act(self, observation: Any) -> Array:
        return np.full((len(observation["observation"]), 2), self.command)

    def replace_last_action(self, actions: Array) -> None:
        self.applied = actions


def test_the_second_controller_keeps_what_it_took_over() -> None:
    first, second = Constant(-0.5), Constant(2.0)
    both = HandOver(first, second, 0.02)

    def acted(*distances: float) -> list[float]:
        position = np.zeros((len(distances), 8))
        goal = np.stack([distances, np.zeros(len(distances))], axis=1)
        actions = both.act({"observation": position, "desired_goal": goal})
        np.testing.assert_array_equal(first.applied, actions)
        np.testing.assert_array_equal(second.applied, actions)
        return actions[:, 0].tolist()

    assert acted(0.1, 0.01) == [-0.5, 1.0]
    assert acted(0.019, 0.05) == [1.0, 1.0]
    both.reset(np.array([False, True]))
    assert acted(0.05, 0.05) == [1.0, -0.5]
    both.reset()
    assert acted(0.05, 0.05, 0.05) == [-0.5, -0.5, -0.5]
