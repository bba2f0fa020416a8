from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hframe_gym.controllers import ModelBasedController, TextbookPID
from hframe_gym.effects import EFFECTS
from hframe_gym.envs import Track
from hframe_gym.evaluation import Scenario, evaluate, rollout, scores, write_scores
from hframe_gym.machine import BUILTIN_MACHINES

HFRAME = BUILTIN_MACHINES["hframe"]()


class Idle:
    """No voltage at all."""

    def act(self, observation: Mapping[str, Any]) -> Any:
        return np.zeros((len(observation["observation"]), 2))

    def reset(self, mask: Any = None) -> None:
        """Nothing to forget."""


class Push(Idle):
    """Beyond the rated voltage along y."""

    def act(self, observation: Mapping[str, Any]) -> Any:
        return np.full((len(observation["observation"]), 2), 2.0)


def test_an_idle_stage_rests_and_costs_nothing() -> None:
    run = rollout(Idle(), Scenario(HFRAME, episodes=3, duration_s=0.05))
    assert run.position.shape == (3, 51, 2)
    np.testing.assert_array_equal(run.position, np.repeat(run.position[:, :1], 51, axis=1))
    np.testing.assert_array_equal(run.energy_J, 0.0)
    np.testing.assert_allclose(run.peak_belt_force_N, 0.0, atol=1e-9)


def test_actions_are_clipped_and_energy_covers_what_moving_takes() -> None:
    """The first period costs U^2/R of both motors less what their back-EMF saves."""
    run = rollout(Push(), Scenario(HFRAME, randomize="none", episodes=2, duration_s=0.01))
    assert run.volts.max() == 12.0
    stalled = 2 * 12.0**2 / 0.71 * 0.01
    assert np.all((0.3 * stalled < run.energy_J) & (run.energy_J < stalled))
    assert np.all(run.peak_belt_force_N > 10.0)


def test_energy_and_belt_force_of_a_stage_with_idlers() -> None:
    """Their belts and radii have no parameters of their own, but those that they are tied to."""
    machine = HFRAME.with_effects(
        EFFECTS["idler_inertia"].at("machine", J_left=0.5e-4, J_right=0.5e-4, B_left=0.0018, B_right=0.0018)
    )
    run = rollout(Push(), Scenario(machine, randomize="none", episodes=2, duration_s=0.01))
    stalled = 2 * 12.0**2 / 0.71 * 0.01
    assert np.all((0.3 * stalled < run.energy_J) & (run.energy_J < stalled))
    assert np.all(run.peak_belt_force_N > 10.0)


def test_same_seed_same_draws_for_every_controller() -> None:
    trial = Scenario(HFRAME, episodes=6, seed=5, duration_s=1.0)
    answer, runs = evaluate({"pid": ModelBasedController(HFRAME), "textbook": TextbookPID(HFRAME)}, trial)
    np.testing.assert_array_equal(runs["pid"].position[:, 0], runs["textbook"].position[:, 0])
    np.testing.assert_array_equal(runs["pid"].goal, runs["textbook"].goal)
    again = rollout(ModelBasedController(HFRAME), Scenario(HFRAME, episodes=6, seed=5, duration_s=1.0))
    np.testing.assert_array_equal(again.position, runs["pid"].position)
    # An episode is its seed's, whatever the batch.
    later = rollout(ModelBasedController(HFRAME), Scenario(HFRAME, episodes=3, seed=8, duration_s=1.0))
    np.testing.assert_allclose(later.position, runs["pid"].position[3:], atol=1e-9)
    assert answer["controllers"]["pid"]["success"]["0.2mm"] == 1.0
    assert set(answer) == {
        "schema",
        "machine",
        "task",
        "randomize",
        "episodes",
        "seed",
        "sensors",
        "period_s",
        "controllers",
    }


def test_scores_are_written_whole_or_not_at_all(tmp_path: Path) -> None:
    answer, _ = evaluate({"idle": Idle()}, Scenario(HFRAME, episodes=2, duration_s=0.02))
    path = write_scores(tmp_path / "new", answer)
    assert json.loads(path.read_text()) == answer
    before = path.read_text()
    with pytest.raises(ValueError, match="JSON"):
        write_scores(tmp_path / "new", {"bad": float("nan")})
    assert path.read_text() == before
    assert [p.name for p in (tmp_path / "new").iterdir()] == ["scores.json"]


def test_refuses_less_than_a_period() -> None:
    with pytest.raises(ValueError, match="at least one control period"):
        rollout(Idle(), Scenario(HFRAME, episodes=1, duration_s=0.001))


def test_an_idle_tool_stays_on_the_path_and_falls_behind_its_goal() -> None:
    run = rollout(Idle(), Scenario(HFRAME, task=Track(path="square"), episodes=3, duration_s=0.5))
    assert run.contour is not None
    assert run.contour.max() < 1e-9
    # 0.3 m/s less half of the lead-in of 0.2 s: 120 mm along a square of 50 mm.
    corner = np.linalg.norm(run.position[:, -1] - run.goal[:, -1], axis=1)
    assert np.all((corner > 0.01) & (corner < 0.0708))


@pytest.mark.parametrize("path", ["circle", "square"])
def test_the_model_based_pid_follows_a_path_at_both_periods(path: str) -> None:
    for period, most in ((0.01, 0.2), (0.002, 0.1)):
        trial = Scenario(HFRAME, task=Track(path=path), episodes=16, period=period, duration_s=0.8)
        card = scores(rollout(ModelBasedController(HFRAME, period), trial))
        assert card["contour_mm"]["rms"]["mean"] < most
        assert abs(card["delay_ms"]["mean"]) < 0.3


def test_a_controller_s_preview_is_a_period_apart_whatever_the_recording() -> None:
    class Watch(Idle):
        def act(self, observation: Mapping[str, Any]) -> Any:
            self.seen = getattr(self, "seen", [])
            self.seen.append(observation)
            return super().act(observation)

    watch = Watch()
    rollout(watch, Scenario(HFRAME, task="track", episodes=2, period=0.005, duration_s=0.05))
    first, second = watch.seen[3]["preview"], watch.seen[4]["desired_goal"]
    assert first.shape == (2, 40)
    np.testing.assert_allclose(first[:, :2], second, atol=1e-7)


def test_picture_of_an_episode(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    from hframe_gym.evaluation.plotting import save

    run = rollout(Idle(), Scenario(HFRAME, episodes=2, duration_s=0.03))
    save(tmp_path / "run.png", run, 1, title="idle")
    assert (tmp_path / "run.png").stat().st_size > 1000
    assert [p.name for p in tmp_path.iterdir()] == ["run.png"]
    followed = rollout(Idle(), Scenario(HFRAME, task="track", episodes=1, duration_s=0.03))
    save(tmp_path / "run.png", followed)
    with pytest.raises(IndexError, match="episode 2 of 2"):
        save(tmp_path / "none.png", run, 2)


def test_picture_without_matplotlib_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    from hframe_gym.evaluation.plotting import draw

    monkeypatch.setitem(__import__("sys").modules, "matplotlib.figure", None)
    with pytest.raises(ImportError, match=r"hframe_gym\[report\]"):
        draw(rollout(Idle(), Scenario(HFRAME, episodes=1, duration_s=0.01)))
