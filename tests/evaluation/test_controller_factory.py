from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hframe_gym.controllers import AdaptivePID, ModelBasedController, OutputFeedbackController, TextbookPID
from hframe_gym.errors import InputError
from hframe_gym.evaluation import Scenario, make_controller, rollout, scores
from hframe_gym.evaluation.controller_factory import shipped


def test_names_make_controllers() -> None:
    assert type(make_controller("pid", Scenario())) is ModelBasedController
    assert type(make_controller("adaptive-pid", Scenario())) is AdaptivePID
    assert type(make_controller("textbook-pid", Scenario())) is TextbookPID
    assert type(make_controller("pid", Scenario(sensors="rig"))) is OutputFeedbackController


def test_the_pid_settles_from_a_rig_s_sensors() -> None:
    trial = Scenario(sensors="rig", episodes=48)
    card = scores(rollout(make_controller("pid", trial), trial))
    assert card["success"]["0.2mm"] == 1.0
    assert card["settling_s"]["0.2mm"]["mean"] < 0.31


@pytest.mark.parametrize(
    ("name", "trial", "message"),
    [
        ("nobody", Scenario(), "'nobody' is none of pid, adaptive-pid, textbook-pid"),
        ("textbook-pid", Scenario(sensors="rig"), "needs the full state"),
        ("adaptive-pid", Scenario(sensors="rig"), "needs the full state"),
        ("adaptive-pid", Scenario("axis"), "full-state control needs"),
        ("pid", Scenario("axis"), "full-state control needs"),
        ("pid", Scenario("hframe-order20"), "full-state control needs"),
        ("pid", Scenario(period=-1.0), "period"),
    ],
)
def test_what_cannot_be_is_refused(name: str, trial: Scenario, message: str) -> None:
    with pytest.raises(InputError, match=message):
        make_controller(name, trial)


def test_a_folder_that_is_no_agent_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="is not an agent"):
        make_controller(str(tmp_path), Scenario())


def test_a_shipped_agent_is_found_by_the_beginning_of_its_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("ppo-seed0", "ppo-seed1", "sac"):
        folder = tmp_path / "shipped" / "reach" / name
        folder.mkdir(parents=True)
        (folder / "agent.json").write_text("{}")
    monkeypatch.setattr("hframe_gym.evaluation.controller_factory.resources.files", lambda _: tmp_path)
    assert shipped("ppo", "reach").name == "ppo-seed0"
    assert shipped("ppo-seed1", "reach").name == "ppo-seed1"
    assert shipped("sac", "reach").name == "sac"
    with pytest.raises(InputError, match="for track \\(none does\\)"):
        shipped("ppo", "track")


def test_same_draws_whatever_the_sensors() -> None:
    runs = [rollout(make_controller("pid", t), t) for t in (Scenario(episodes=3), Scenario(episodes=3, sensors="rig"))]
    np.testing.assert_array_equal(runs[0].position[:, 0], runs[1].position[:, 0])
    np.testing.assert_array_equal(runs[0].goal, runs[1].goal)
