"""The PID that adapts beside the one that does not, on stages that are off their machine file."""

from __future__ import annotations

import numpy as np
import pytest
from closed_loop import PERIOD, PREVIEW, circles, closed_loop, random_points, random_stages

from hframe_gym.controllers import AdaptivePID, ModelBasedController
from hframe_gym.effects import EFFECTS
from hframe_gym.envs import Track
from hframe_gym.evaluation import Scenario, rollout
from hframe_gym.machine import BUILTIN_MACHINES, Machine

COUNT = 32


@pytest.fixture(scope="module")
def adaptive(hframe: Machine) -> AdaptivePID:
    return AdaptivePID(hframe, PERIOD)


KNOWN = {
    "nothing": (),
    "dead band": (EFFECTS["dead_band"].at("motor1", Vd=0.5, drop=0.5),),
    "forces": (EFFECTS["stribeck_friction"].at("x", dF=1.5, vs=0.03), EFFECTS["constant_force"].at("y", size=5.0)),
}


@pytest.mark.parametrize("known", KNOWN)
def test_is_closer_to_circles_than_the_pid(hframe: Machine, known: str) -> None:
    machine = hframe.with_effects(*KNOWN[known])
    goals, changes = circles(COUNT, 2), random_stages(hframe, COUNT, 3)
    rms = [
        np.sqrt(np.mean(closed_loop(kind(machine, PERIOD), machine, goals[:, 0], goals, changes=changes).error ** 2))
        for kind in (AdaptivePID, ModelBasedController)
    ]
    assert rms[0] < 0.6 * rms[1]


def test_is_closer_to_circles_across_a_dead_time(hframe: Machine) -> None:
    machine = hframe.with_effects(EFFECTS["input_delay"].at("drives", d=0.013))
    trial = Scenario(machine, task=Track(previews=12), episodes=COUNT, seed=7)
    rms = [
        np.sqrt(np.mean(rollout(kind(machine, PERIOD), trial).contour ** 2, axis=1)).mean()
        for kind in (AdaptivePID, ModelBasedController)
    ]
    assert rms[0] < 0.85 * rms[1]


def test_every_drawn_stage_comes_to_rest_at_its_goal(hframe: Machine, adaptive: AdaptivePID) -> None:
    start, goal = random_points(COUNT, 4), random_points(COUNT, 5)
    run = closed_loop(adaptive, hframe, start, goal, changes=random_stages(hframe, COUNT, 6))
    assert run.error[:, -10:].max() < 5e-5


def test_on_the_machine_itself_it_arrives_where_the_pid_does(
    hframe: Machine, adaptive: AdaptivePID, pid: ModelBasedController
) -> None:
    start, goal = random_points(COUNT, 4), random_points(COUNT, 5)
    first, second = (closed_loop(c, hframe, start, goal).error for c in (adaptive, pid))
    assert np.abs(first - second)[:, -1].max() < 5e-5


def test_forgets_on_reset(hframe: Machine, adaptive: AdaptivePID) -> None:
    goals, changes = circles(3, 4, periods=30), random_stages(hframe, 3, 5)
    first, again = (closed_loop(adaptive, hframe, goals[:, 0], goals, changes=changes, periods=30) for _ in range(2))
    np.testing.assert_array_equal(first.actions, again.actions)


def test_a_preview_that_ends_too_soon_is_refused(hframe: Machine) -> None:
    observation = {
        "observation": np.zeros((1, 8)),
        "desired_goal": np.zeros((1, 2)),
        "preview": np.zeros((1, 2 * PREVIEW)),
    }
    AdaptivePID(hframe, PERIOD).act(observation)
    with pytest.raises(ValueError, match="the preview ends 3 periods after the dead time, not 4"):
        AdaptivePID(hframe, PERIOD).act(observation | {"preview": np.zeros((1, 6))})


@pytest.mark.parametrize("name", ["axis", "hframe-order20"])
def test_machines_that_it_cannot_control_are_refused(name: str) -> None:
    with pytest.raises(ValueError, match="full-state control needs"):
        AdaptivePID(BUILTIN_MACHINES[name](), PERIOD)
