"""Tests of the controller interface, its registry and output feedback."""

from __future__ import annotations

import numpy as np
import pytest

from hframe_gym.controllers import (
    CONTROLLERS,
    AdaptiveController,
    Controller,
    EpisodeStarts,
    FullStateController,
    ModelBasedController,
    OutputFeedbackController,
    StateEstimator,
    TextbookPID,
    suited_controllers,
)
from hframe_gym.controllers.base import SIMULATION_STEP_S
from hframe_gym.envs.config import LONGEST_STEP
from hframe_gym.errors import InputError
from hframe_gym.machine import BUILTIN_MACHINES, Machine


def test_shipped_controllers_are_registered() -> None:
    assert CONTROLLERS.get("pid") is ModelBasedController
    assert CONTROLLERS.get("adaptive-pid") is AdaptiveController
    assert CONTROLLERS.get("textbook-pid") is TextbookPID


def test_controllers_simulate_with_the_step_of_the_environments() -> None:
    assert SIMULATION_STEP_S == LONGEST_STEP


SUITED = suited_controllers(BUILTIN_MACHINES["hframe"]())


@pytest.mark.parametrize("period", [0.0, -0.01, np.inf, np.nan])
@pytest.mark.parametrize("kind", [*(CONTROLLERS.get(name) for name in SUITED), StateEstimator])
def test_period_that_is_not_positive_is_rejected(hframe: Machine, kind: type, period: float) -> None:
    with pytest.raises(InputError, match=r"period is .*, it must be a positive number of seconds"):
        kind(hframe, period)


@pytest.mark.parametrize("name", SUITED)
def test_observation_of_another_size_is_rejected(hframe: Machine, name: str) -> None:
    controller = CONTROLLERS.get(name)(hframe, 0.01)
    with pytest.raises(InputError, match=r"observation has shape \(3, 7\), it must be \(B, 8\)"):
        controller.act({"observation": np.zeros((3, 7)), "desired_goal": np.zeros((3, 2))})


def test_episode_starts_of_a_batch() -> None:
    starts = EpisodeStarts()
    assert starts.resize(3)
    np.testing.assert_array_equal(starts.mask, [True, True, True])
    starts.clear()
    starts.reset(np.array([False, True, False]))
    assert not starts.resize(3)
    np.testing.assert_array_equal(starts.mask, [False, True, False])
    starts.reset()
    assert starts.resize(2)


class _Recording(FullStateController):
    """Zero voltage; keeps its inputs."""

    def act_on_state(self, state: np.ndarray, goals: np.ndarray) -> np.ndarray:
        self.state, self.goals = state, goals
        return np.zeros((len(state), 2))


def test_full_state_controller_receives_belt_travel_and_the_goals_of_the_preview(hframe: Machine) -> None:
    controller = _Recording(hframe)
    state = np.arange(16.0).reshape(2, 8)
    goal, preview = np.array([[0.1, 0.2], [0.3, 0.4]]), np.arange(12.0).reshape(2, 6)
    observation = {"observation": controller.model.observation(state), "desired_goal": goal}
    controller.act(observation)
    np.testing.assert_allclose(controller.state, state, rtol=1e-14)
    np.testing.assert_array_equal(controller.goals, goal[:, None])
    controller.act(observation | {"preview": preview})
    np.testing.assert_array_equal(controller.goals[1], [[0.3, 0.4], [6.0, 7.0], [8.0, 9.0], [10.0, 11.0]])


class _Estimator:
    """An estimator that records what it is given and always estimates zero."""

    def __init__(self, template: StateEstimator) -> None:
        self.model, self.period, self.channels = template.model, template.period, template.channels
        self.sent: list[np.ndarray] = []
        self.measurements: list[np.ndarray] = []

    def reset(self, mask: object = None) -> None:
        self.sent.clear()

    def update(self, measurements: np.ndarray) -> np.ndarray:
        self.measurements.append(measurements)
        return np.zeros((len(measurements), 8))

    def send(self, volts: np.ndarray) -> None:
        self.sent.append(volts)

    def replace_last(self, volts: np.ndarray) -> None:
        self.sent[-1] = volts


class _Constant(Controller):
    """Actions beyond the rated voltage."""

    def act(self, observation):  # type: ignore[no-untyped-def]
        assert observation["observation"].shape == (1, 8)
        return np.full((1, 2), 1.5)


def test_output_feedback_passes_measurements_and_applied_voltages_to_the_estimator(hframe: Machine) -> None:
    estimator = _Estimator(StateEstimator(hframe, 0.01))
    controller = OutputFeedbackController(_Constant(hframe), estimator)
    readings = np.arange(8.0)[None]
    controller.act({"observation": readings, "desired_goal": np.zeros((1, 2))})
    np.testing.assert_array_equal(estimator.measurements[0], readings[:, :4])
    np.testing.assert_array_equal(estimator.sent[-1], [[12.0, 12.0]])
    controller.replace_last_action(np.array([[0.5, -0.25]]))
    np.testing.assert_array_equal(estimator.sent[-1], [[6.0, -3.0]])
