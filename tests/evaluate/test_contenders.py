from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hframe_gym import InputError
from hframe_gym.control import AdaptivePID, ModelPID, Observed, TextbookPID
from hframe_gym.evaluate import Trial, contender, rollout, scores
from hframe_gym.evaluate.contenders import shipped


def test_names_make_controllers() -> None:
    assert type(contender("pid", Trial())) is ModelPID
    assert type(contender("adaptive-pid", Trial())) is AdaptivePID
    assert type(contender("textbook-pid", Trial())) is TextbookPID
    assert type(contender("pid", Trial(sensors="rig"))) is Observed


def test_the_pid_settles_from_a_rig_s_sensors() -> None:
    trial = Trial(sensors="rig", episodes=48)
    card = scores(rollout(contender("pid", trial), trial))
    assert card["success"]["0.2mm"] == 1.0
    assert card["settling_s"]["0.2mm"]["mean"] < 0.31


@pytest.mark.parametrize(
    ("name", "trial", "message"),
    [
        ("nobody", Trial(), "'nobody' is none of pid, adaptive-pid, textbook-pid"),
        ("textbook-pid", Trial(sensors="rig"), "needs the full state"),
        ("adaptive-pid", Trial(sensors="rig"), "needs the full state"),
        ("adaptive-pid", Trial("axis"), "full-state control needs"),
        ("pid", Trial("axis"), "full-state control needs"),
        ("pid", Trial("hframe-order20"), "full-state control needs"),
        ("pid", Trial(period=-1.0), "period"),
    ],
)
def test_what_cannot_be_is_refused(name: str, trial: Trial, message: str) -> None:
    with pytest.raises(InputError, match=message):
        contender(name, trial)


def test_a_folder_that_is_no_agent_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="is not an agent"):
        contender(str(tmp_path), Trial())


def test_a_shipped_agent_is_found_by_the_beginning_of_its_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("ppo-seed0", "ppo-seed1", "sac"):
        folder = tmp_path / "shipped" / "reach" / name
        folder.mkdir(parents=True)
        (folder / "agent.json").write_text("{}")
    monkeypatch.setattr("hframe_gym.evaluate.contenders.resources.files", lambda _: tmp_path)
    assert shipped("ppo", "reach").name == "ppo-seed0"
    assert shipped("ppo-seed1", "reach").name == "ppo-seed1"
    assert shipped("sac", "reach").name == "sac"
    with pytest.raises(InputError, match="for track \\(none does\\)"):
        shipped("ppo", "track")


def test_same_draws_whatever_the_sensors() -> None:
    runs = [rollout(contender("pid", t), t) for t in (Trial(episodes=3), Trial(episodes=3, sensors="rig"))]
    np.testing.assert_array_equal(runs[0].position[:, 0], runs[1].position[:, 0])
    np.testing.assert_array_equal(runs[0].goal, runs[1].goal)
