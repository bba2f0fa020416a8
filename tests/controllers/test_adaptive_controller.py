"""Tests of the adaptive controller, compared with the model-based one on stages that differ from their machine file."""

from __future__ import annotations

import numpy as np
import pytest

from hframe_gym.controllers import AdaptiveController, ModelBasedController
from hframe_gym.effects import EFFECTS
from hframe_gym.envs import Track
from hframe_gym.errors import InputError
from hframe_gym.evaluation import Scenario, rollout
from hframe_gym.machine import Machine
from tests.controllers.closed_loop import PERIOD, PREVIEW, circles, closed_loop, random_points, random_stages

pytestmark = pytest.mark.integration

COUNT = 32
MODELED_EFFECTS = {
    "none": (),
    "dead band": (EFFECTS["dead_band"].at("motor1", Vd=0.5, drop=0.5),),
    "forces": (EFFECTS["stribeck_friction"].at("x", dF=1.5, vs=0.03), EFFECTS["constant_force"].at("y", size=5.0)),
}


@pytest.mark.parametrize("effects", MODELED_EFFECTS)
def test_tracks_circles_more_accurately(hframe: Machine, effects: str) -> None:
    machine = hframe.with_effects(*MODELED_EFFECTS[effects])
    goals, changes = circles(COUNT, 2), random_stages(hframe, COUNT, 3)
    adaptive_rms, model_based_rms = [
        np.sqrt(np.mean(closed_loop(kind(machine, PERIOD), machine, goals[:, 0], goals, changes=changes).error ** 2))
        for kind in (AdaptiveController, ModelBasedController)
    ]
    assert adaptive_rms < 0.6 * model_based_rms


def test_tracks_circles_more_accurately_with_a_dead_time(hframe: Machine) -> None:
    machine = hframe.with_effects(EFFECTS["input_delay"].at("drives", d=0.013))
    scenario = Scenario(machine, task=Track(previews=12), episodes=COUNT, seed=7)
    adaptive_rms, model_based_rms = [
        np.sqrt(np.mean(rollout(kind(machine, PERIOD), scenario).contour ** 2, axis=1)).mean()
        for kind in (AdaptiveController, ModelBasedController)
    ]
    assert adaptive_rms < 0.85 * model_based_rms


def test_randomized_stages_come_to_rest_at_their_goals(hframe: Machine, adaptive: AdaptiveController) -> None:
    start, goal = random_points(COUNT, 4), random_points(COUNT, 5)
    loop = closed_loop(adaptive, hframe, start, goal, changes=random_stages(hframe, COUNT, 6))
    assert loop.error[:, -10:].max() < 5e-5


def test_ends_where_the_model_based_controller_does_on_the_nominal_machine(
    hframe: Machine, adaptive: AdaptiveController, model_based: ModelBasedController
) -> None:
    start, goal = random_points(COUNT, 4), random_points(COUNT, 5)
    first, second = (closed_loop(c, hframe, start, goal).error for c in (adaptive, model_based))
    assert np.abs(first - second)[:, -1].max() < 5e-5


def test_reset_clears_the_memory(hframe: Machine, adaptive: AdaptiveController) -> None:
    goals, changes = circles(3, 4, periods=30), random_stages(hframe, 3, 5)
    first, second = (closed_loop(adaptive, hframe, goals[:, 0], goals, changes=changes, periods=30) for _ in range(2))
    np.testing.assert_array_equal(first.actions, second.actions)


def test_features_have_their_declared_sizes(hframe: Machine, adaptive: AdaptiveController) -> None:
    goals = circles(3, 4, periods=2)
    closed_loop(adaptive, hframe, goals[:, 0], goals, periods=2)
    for name, size in adaptive.feature_sizes.items():
        assert getattr(adaptive, name).shape == (3, size)


def test_preview_that_is_too_short_is_rejected(adaptive: AdaptiveController) -> None:
    observation = {"observation": np.zeros((1, 8)), "desired_goal": np.zeros((1, 2))}
    adaptive.act(observation | {"preview": np.zeros((1, 2 * PREVIEW))})
    with pytest.raises(InputError, match="the preview ends 3 periods after the dead time, 4 are needed"):
        adaptive.act(observation | {"preview": np.zeros((1, 6))})
