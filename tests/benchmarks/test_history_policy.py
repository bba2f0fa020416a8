"""Test the entry `history` of `gap-v1`: what its policy observes, and how it begins."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("stable_baselines3")

from benchmarks.gap import history_policy
from benchmarks.gap.catalog import get_entry
from benchmarks.gap.history_policy import PERIODS, HistoryController, HistoryVecEnv, train
from benchmarks.gap.plants import declared_machine
from benchmarks.gap.recorder import Recorder
from hframe_gym.controllers import CONTROLLERS, OutputFeedbackController
from hframe_gym.envs import Reach, Track
from tests.benchmarks.test_gap import IDEAL

MACHINE = declared_machine()


@pytest.fixture(scope="module", autouse=True)
def _few_environments() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(history_policy, "ENVIRONMENTS", 16)
        yield


def test_a_policy_begins_as_the_controller_that_it_corrects() -> None:
    model = train(MACHINE, "track", 0, 0)
    pid, history = CONTROLLERS.get("pid")(MACHINE, 0.01), HistoryController(MACHINE, model)
    rng = np.random.default_rng(0)
    for k in range(3):
        state = rng.uniform(-0.01, 0.01, (2, 8)).astype(np.float32)
        goals = {"desired_goal": np.full((2, 2), 0.01 * k), "preview": np.full((2, 20), 0.02)}
        observation = {"observation": state, "achieved_goal": state[:, :2], **goals}
        action = history.act(observation)
        np.testing.assert_allclose(action, np.clip(pid.act(observation), -1.0, 1.0), atol=1e-6)
        pid.replace_last_action(action)


def test_the_history_moves_by_a_period_and_begins_anew_with_an_episode() -> None:
    model = train(MACHINE, "reach", 0, 0)
    envs = model.get_env()
    assert isinstance(envs, HistoryVecEnv)
    first = envs.reset().reshape(16, PERIODS, -1)
    np.testing.assert_array_equal(first, np.repeat(first[:, :1], PERIODS, axis=1))
    outputs = np.tile([[1.0, -1.0], [-1.0, 1.0]], (8, 1))
    second = envs.step(outputs)[0].reshape(16, PERIODS, -1)
    np.testing.assert_array_equal(second[:, 1:], first[:, :-1])
    assert not np.array_equal(second[:, 0], first[:, 0])
    for _ in range(79):
        observation, _, done, infos = envs.step(outputs)
    assert done.all()
    begun = observation.reshape(16, PERIODS, -1)
    np.testing.assert_array_equal(begun, np.repeat(begun[:, :1], PERIODS, axis=1))
    ended = infos[0]["terminal_observation"].reshape(PERIODS, -1)
    assert not np.array_equal(ended[0], ended[1])


def test_policies_are_trained_once_and_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(history_policy, "STEPS", {"reach": 0, "track": 0})
    make = get_entry("history-seed3")
    assert (make.name, make.track, make.learned) == ("history-seed3", "zero-shot", True)
    for _ in range(2):
        entry = make()
        entry.prepare(MACHINE, Recorder(IDEAL, allowed=False), tmp_path / "plant")
        monkeypatch.setattr(history_policy, "train", None)
    for task in (Reach(), Track(path="circle", size=0.05, speed=0.3)):
        assert isinstance(entry.controller(task), OutputFeedbackController)
