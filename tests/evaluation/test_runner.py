"""Tests of rollouts, evaluations and the plot of an episode."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hframe_gym.controllers import Controller, ModelBasedController, TextbookPID
from hframe_gym.effects import EFFECTS
from hframe_gym.envs import Track
from hframe_gym.errors import InputError
from hframe_gym.evaluation import (
    Episodes,
    Scenario,
    evaluate,
    plot_episode,
    rollout,
    save_plot,
    score_episodes,
    write_scores,
)
from hframe_gym.evaluation.advice import assumptions
from hframe_gym.evaluation.episodes import Command
from hframe_gym.machine import BUILTIN_MACHINES

pytestmark = pytest.mark.integration

HFRAME = BUILTIN_MACHINES["hframe"]()


class Idle(Controller):
    """Zero voltage."""

    def act(self, observation: Mapping[str, Any]) -> Any:
        return np.zeros((len(observation["observation"]), 2))


class Push(Idle):
    """Twice the rated voltage on both drives, which pushes along y."""

    def act(self, observation: Mapping[str, Any]) -> Any:
        return np.full((len(observation["observation"]), 2), 2.0)


def test_a_stage_without_voltage_rests_and_takes_no_energy() -> None:
    run = rollout(Idle(HFRAME), Scenario(HFRAME, episodes=3, duration_s=0.05))
    assert run.position.shape == (3, 51, 2)
    np.testing.assert_array_equal(run.position, np.repeat(run.position[:, :1], 51, axis=1))
    np.testing.assert_array_equal(run.energy_J, 0.0)
    np.testing.assert_allclose(run.peak_belt_force_N, 0.0, atol=1e-9)


def test_actions_are_clipped_and_energy_is_that_of_the_motors() -> None:
    """In the first period the motors take V^2/R less the power of their back-EMF."""
    run = rollout(Push(HFRAME), Scenario(HFRAME, randomize="none", episodes=2, duration_s=0.01))
    assert run.volts.max() == 12.0
    stalled = 2 * 12.0**2 / 0.71 * 0.01
    assert np.all((0.3 * stalled < run.energy_J) & (run.energy_J < stalled))
    assert np.all(run.peak_belt_force_N > 10.0)


def test_energy_and_belt_force_of_a_machine_with_tied_parameters() -> None:
    """The belts and radii of idlers are tied to other parameters."""
    machine = HFRAME.with_effects(
        EFFECTS["idler_inertia"].at("machine", J_left=0.5e-4, J_right=0.5e-4, B_left=0.0018, B_right=0.0018)
    )
    run = rollout(Push(HFRAME), Scenario(machine, randomize="none", episodes=2, duration_s=0.01))
    stalled = 2 * 12.0**2 / 0.71 * 0.01
    assert np.all((0.3 * stalled < run.energy_J) & (run.energy_J < stalled))
    assert np.all(run.peak_belt_force_N > 10.0)


def test_same_seed_gives_every_controller_the_same_episodes() -> None:
    trial = Scenario(HFRAME, episodes=6, seed=5, duration_s=1.0)
    answer, runs = evaluate({"pid": ModelBasedController(HFRAME), "textbook": TextbookPID(HFRAME)}, trial)
    np.testing.assert_array_equal(runs["pid"].position[:, 0], runs["textbook"].position[:, 0])
    np.testing.assert_array_equal(runs["pid"].goal, runs["textbook"].goal)
    again = rollout(ModelBasedController(HFRAME), Scenario(HFRAME, episodes=6, seed=5, duration_s=1.0))
    np.testing.assert_array_equal(again.position, runs["pid"].position)
    # An episode depends on its seed only, not on the batch.
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
        "drives",
        "command",
        "period_s",
        "controllers",
    }


def test_scores_are_written_completely_or_not_at_all(tmp_path: Path) -> None:
    answer, _ = evaluate({"idle": Idle(HFRAME)}, Scenario(HFRAME, episodes=2, duration_s=0.02))
    path = write_scores(tmp_path / "new", answer)
    assert json.loads(path.read_text()) == answer
    before = path.read_text()
    with pytest.raises(ValueError, match="JSON"):
        write_scores(tmp_path / "new", {"bad": float("nan")})
    assert path.read_text() == before
    assert [p.name for p in (tmp_path / "new").iterdir()] == ["scores.json"]


def test_a_resting_tool_stays_on_the_path_and_falls_behind_its_goal() -> None:
    run = rollout(Idle(HFRAME), Scenario(HFRAME, task=Track(path="square"), episodes=3, duration_s=0.5))
    assert run.contour is not None
    assert run.contour.max() < 1e-9
    # 0.3 m/s less half of the lead-in of 0.2 s: 120 mm along a square of 50 mm.
    corner = np.linalg.norm(run.position[:, -1] - run.goal[:, -1], axis=1)
    assert np.all((corner > 0.01) & (corner < 0.0708))


@pytest.mark.parametrize("path", ["circle", "square"])
def test_the_model_based_controller_tracks_a_path_at_both_periods(path: str) -> None:
    for period, limit_mm in ((0.01, 0.2), (0.002, 0.1)):
        trial = Scenario(HFRAME, task=Track(path=path), episodes=16, period=period, duration_s=0.8)
        card = score_episodes(rollout(ModelBasedController(HFRAME, period), trial))
        assert card["contour_mm"]["rms"]["mean"] < limit_mm
        assert abs(card["delay_ms"]["mean"]) < 0.3


def test_previewed_goals_are_one_control_period_apart() -> None:
    observations = []

    class Recorder(Idle):
        def act(self, observation: Mapping[str, Any]) -> Any:
            observations.append(observation)
            return super().act(observation)

    rollout(Recorder(HFRAME), Scenario(HFRAME, task="track", episodes=2, period=0.005, duration_s=0.05))
    first, second = observations[3]["preview"], observations[4]["desired_goal"]
    assert first.shape == (2, 40)
    np.testing.assert_allclose(first[:, :2], second, atol=1e-7)


def test_evaluation_by_names_and_keywords() -> None:
    scores, episodes = evaluate(
        ["textbook-pid", "textbook-pid", "pid"], HFRAME, episodes=3, seed=7, duration_s=0.2
    )
    assert list(scores["controllers"]) == list(episodes) == ["textbook-pid", "pid"]
    assert (scores["episodes"], scores["seed"], scores["machine"]) == (3, 7, "hframe")
    np.testing.assert_array_equal(
        episodes["pid"].volts,
        rollout(ModelBasedController(HFRAME), Scenario(HFRAME, episodes=3, seed=7, duration_s=0.2)).volts,
    )


@pytest.mark.parametrize(
    ("options", "message"),
    [({"period": 0.0}, "period is 0.0"), ({"task": "fly"}, "fly"), ({"randomize": "much"}, "much")],
)
def test_wrong_options_are_rejected(options: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        evaluate("textbook-pid", HFRAME, episodes=2, duration_s=0.1, **options)


def test_a_diverging_machine_is_reported_with_its_name() -> None:
    """Belts that lose their stiffness at 6 mm of stretch: the motion escapes at once."""
    soft = EFFECTS["belt_hardening"].at("belts", h=-1e9)
    machine = HFRAME.with_effects(soft).replace(name="diverging")
    with pytest.raises(InputError, match="machine 'diverging': the simulated motion diverges"):
        rollout(Push(machine), Scenario(machine, randomize="none", episodes=2, duration_s=1.0))


def recorded(contour: bool = False) -> Episodes:
    """Return two recorded episodes of 31 samples and three control periods."""
    rng = np.random.default_rng(0)
    return Episodes(
        time_s=1e-3 * np.arange(31),
        position=rng.normal(0.0, 0.01, (2, 31, 2)),
        goal=np.zeros((2, 31, 2)),
        contour=np.abs(rng.normal(0.0, 1e-4, (2, 31))) if contour else None,
        volts=rng.uniform(-12.0, 12.0, (2, 3, 2)),
        rated=np.full(2, 12.0),
        energy_J=np.zeros(2),
        peak_belt_force_N=np.zeros(2),
    )


@pytest.mark.parametrize("contour", [False, True])
def test_plot_is_written_completely(tmp_path: Path, contour: bool) -> None:
    pytest.importorskip("matplotlib")
    save_plot(tmp_path / "run.png", recorded(contour), 1, title="idle")
    assert (tmp_path / "run.png").stat().st_size > 1000
    assert [p.name for p in tmp_path.iterdir()] == ["run.png"]


def test_curves_are_those_of_the_episode() -> None:
    pytest.importorskip("matplotlib")
    episodes = recorded(contour=True)
    path, error, _ = plot_episode(episodes, 1).axes
    np.testing.assert_allclose(path.lines[1].get_xydata(), 1e3 * episodes.position[1])
    np.testing.assert_allclose(error.lines[0].get_ydata(), 1e3 * episodes.goal_error[1])


def test_an_episode_that_does_not_exist_is_rejected() -> None:
    pytest.importorskip("matplotlib")
    with pytest.raises(IndexError, match="episode 2 of 2"):
        plot_episode(recorded(), 2)


def test_a_missing_matplotlib_is_reported_with_its_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(ImportError, match=r"hframe_gym\[report\]"):
        plot_episode(recorded())


def test_one_axis_is_plotted_over_time() -> None:
    episodes = evaluate("pid", "axis", episodes=2, duration_s=0.3).episodes["pid"]
    axes = plot_episode(episodes).axes[0]
    assert axes.get_xlabel() == "time, s"
    np.testing.assert_allclose(axes.lines[0].get_ydata(), 1e3 * episodes.position[0, :, 0])


@pytest.mark.parametrize(
    ("machine", "label"), [("hframe", "voltage, V"), ("wheel", "voltage, V"), ("servo", "set point, rad")]
)
def test_commands_have_the_name_and_unit_of_the_drives(machine: str, label: str) -> None:
    """A duty cycle is a voltage in simulations."""
    assert Command.of(BUILTIN_MACHINES[machine]()).label == label


def test_plots_and_scores_of_a_servo_have_set_points_instead_of_voltages() -> None:
    evaluation = evaluate("set-point", "servo", episodes=2, duration_s=0.1)
    assert evaluation.scores["command"] == {"name": "set point", "unit": "rad"}
    axes = plot_episode(evaluation.episodes["set-point"]).axes
    assert axes[2].get_ylabel() == "set point, rad (dashed: rated)"
    assert assumptions(evaluation.scores)["Control period"].endswith("; set points are held in between")


def test_an_evaluation_needs_a_controller() -> None:
    with pytest.raises(InputError, match="at least one controller"):
        evaluate([])
