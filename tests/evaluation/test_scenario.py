"""Tests of scenarios and of making controllers by name."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from hframe_gym.controllers import (
    CONTROLLERS,
    AdaptiveController,
    Controller,
    ModelBasedController,
    OutputFeedbackController,
    TextbookPID,
)
from hframe_gym.envs import Track
from hframe_gym.errors import InputError
from hframe_gym.evaluation import (
    CONTROLLER_SOURCES,
    ControllerSource,
    Scenario,
    evaluate,
    make_controller,
    rollout,
    score_episodes,
)
from hframe_gym.machine import BUILTIN_MACHINES

TOY_MODULE = '''
import numpy as np
from hframe_gym.controllers import CONTROLLERS, Controller

@CONTROLLERS.register("toy-p")
class Proportional(Controller):
    """Proportional feedback of the error along x and y on both drives."""

    def act(self, observation):
        error = observation["desired_goal"] - observation["observation"][:, :2]
        both = np.stack([error[:, 1] + error[:, 0], error[:, 1] - error[:, 0]], axis=1)
        return np.clip(-20.0 * both, -1.0, 1.0)
'''


@pytest.fixture
def toy_module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """Return the name of an importable module that registers the controller `toy-p`."""
    (tmp_path / "toy_controllers.py").write_text(TOY_MODULE)
    monkeypatch.syspath_prepend(tmp_path)
    yield "toy_controllers"
    CONTROLLERS._parts.pop("toy-p", None)
    import sys

    sys.modules.pop("toy_controllers", None)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"period": 0.0}, "period is 0.0"),
        ({"period": -0.01}, "period is -0.01"),
        ({"period": float("nan")}, "period is nan"),
        ({"episodes": 0}, "episodes is 0"),
        ({"duration_s": 0.001}, "period is 0.01 s and duration_s is 0.001 s: .* at least one control period"),
        ({"seed": -1}, "seed is -1"),
        ({"duration_s": float("inf")}, "duration_s is inf"),
    ],
)
def test_impossible_scenarios_are_rejected(changes: dict[str, float], message: str) -> None:
    with pytest.raises(InputError, match=message):
        Scenario(**changes)  # type: ignore[arg-type]


def test_the_controller_s_preview_has_its_period() -> None:
    task = Scenario(task=Track(previews=10, preview_s=0.01), period=0.004).controller_task
    assert isinstance(task, Track)
    assert (task.previews, task.preview_s) == (25, 0.004)


def test_names_make_controllers() -> None:
    assert type(make_controller("pid")) is ModelBasedController
    assert type(make_controller("adaptive-pid", "hframe")) is AdaptiveController
    assert type(make_controller("textbook-pid", BUILTIN_MACHINES["hframe"](), period=0.002)) is TextbookPID
    assert type(make_controller("pid", Scenario(sensors="rig"))) is OutputFeedbackController
    assert make_controller("textbook-pid", period=0.002).period == 0.002


@pytest.mark.parametrize("sensors", ["rig", "machine"])
def test_estimator_measures_what_the_environment_observes(sensors: str) -> None:
    """Both read the declared sensors, so the first measurements agree with their ranges and noise."""
    scenario = Scenario(sensors=sensors, episodes=4, duration_s=0.02)  # type: ignore[arg-type]
    controller = make_controller("pid", scenario)
    assert isinstance(controller, OutputFeedbackController)
    episodes = rollout(controller, scenario)
    assert controller.estimator.channels == 4
    np.testing.assert_allclose(episodes.position[:, -1], episodes.position[:, 0], atol=0.05)


@pytest.mark.integration
def test_pid_settles_from_rig_sensors() -> None:
    scenario = Scenario(sensors="rig", episodes=48)
    card = score_episodes(rollout(make_controller("pid", scenario), scenario))
    assert card["success"]["0.2mm"] == 1.0
    assert card["settling_s"]["0.2mm"]["mean"] < 0.31


@pytest.mark.parametrize(
    ("name", "scenario", "message"),
    [
        (
            "nobody",
            Scenario(),
            "controller 'nobody' is unknown; choose pid, adaptive-pid, predictive, set-point, textbook-pid",
        ),
        ("no_such_module:p", Scenario(), "cannot import 'no_such_module'"),
        ("textbook-pid", Scenario(sensors="rig"), "needs the full state"),
        ("adaptive-pid", Scenario(sensors="rig"), "needs the full state"),
        ("pid", Scenario("hframe-order20"), "the controllers need one or two axes, linear or rotary"),
    ],
)
def test_impossible_controllers_are_rejected(name: str, scenario: Scenario, message: str) -> None:
    with pytest.raises(InputError, match=message):
        make_controller(name, scenario)


def test_a_controller_of_another_module_is_evaluated(toy_module: str) -> None:
    name = f"{toy_module}:toy-p"
    scores, episodes = evaluate(name, episodes=4, duration_s=0.3, randomize="none")
    error = episodes[name].goal_error
    assert np.all(error[:, -1] < error[:, 0])
    assert set(scores["controllers"]) == {name}
    assert isinstance(make_controller("toy-p"), Controller)


def test_the_command_evaluates_a_controller_of_another_module(toy_module: str, tmp_path: Path) -> None:
    from typer.testing import CliRunner

    from hframe_gym.cli import app

    arguments = ["evaluate", f"{toy_module}:toy-p", "--episodes", "2", "--out", str(tmp_path / "out")]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    assert (tmp_path / "out" / "scores.json").is_file()


def test_a_source_makes_controllers_that_are_not_registered(monkeypatch: pytest.MonkeyPatch) -> None:
    class Source(ControllerSource):
        @staticmethod
        def make(name: str, scenario: Scenario) -> Controller | None:
            return (
                TextbookPID(scenario.declared_machine, scenario.period)
                if name == f"{scenario.task_name}-x"
                else None
            )

        @staticmethod
        def describe(scenario: Scenario) -> str:
            return f"{scenario.task_name}-x"

    monkeypatch.setitem(CONTROLLER_SOURCES._parts, "test", Source)
    assert type(make_controller("track-x", task="track")) is TextbookPID
    with pytest.raises(InputError, match=r"'track-x' is unknown; .*; or reach-x"):
        make_controller("track-x", task="reach")


def test_episodes_do_not_depend_on_the_sensors() -> None:
    scenarios = Scenario(episodes=3, duration_s=0.1), Scenario(episodes=3, duration_s=0.1, sensors="rig")
    first, second = (rollout(make_controller("pid", scenario), scenario) for scenario in scenarios)
    np.testing.assert_array_equal(first.position[:, 0], second.position[:, 0])
    np.testing.assert_array_equal(first.goal, second.goal)


def test_a_period_too_long_for_the_belts_is_told_once_and_another_suggested() -> None:
    with pytest.warns(
        UserWarning, match="slowest belt mode, 37 Hz, is above half the control rate of 50 Hz"
    ) as told:
        evaluate(["pid", "textbook-pid"], episodes=2, duration_s=0.1, period=0.02)
    assert len(told) == 1
    assert "--period 0.005" in str(told[0].message)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        evaluate("textbook-pid", episodes=2, duration_s=0.1)


def test_an_unstable_textbook_pid_is_told() -> None:
    with pytest.warns(UserWarning, match="textbook-pid is unstable on machine 'hframe-literal'"):
        make_controller("textbook-pid", "hframe-literal")


@pytest.mark.integration
@pytest.mark.parametrize(
    ("name", "sensors"),
    [("pid", "state"), ("pid", "machine"), ("adaptive-pid", "state"), ("textbook-pid", "state")],
)
def test_controllers_settle_one_axis(name: str, sensors: str) -> None:
    scenario = Scenario("axis", sensors=sensors, episodes=16, randomize="default")
    episodes = rollout(make_controller(name, scenario), scenario)
    assert episodes.position.shape[2] == 1
    assert episodes.goal_error[:, -1].max() < 2e-4
    assert score_episodes(episodes)["settling_s"]["1mm"]["p95"] < 0.5
