"""Commands on controllers: train, evaluate and play."""

from __future__ import annotations

import dataclasses
import json
import re
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hframe_gym import agents
from hframe_gym.cli.control_commands import training_proposal
from hframe_gym.cli.options import CONTROL_PERIOD
from hframe_gym.controllers import CONTROLLERS, ModelBasedController
from hframe_gym.effects import EFFECTS
from hframe_gym.envs import TASKS, EnvConfig
from hframe_gym.evaluation import file_labels
from hframe_gym.machine import Machine
from hframe_gym.recordings import save_machine
from hframe_gym.registry import load_plugins
from tests.cli.running import Command, assert_refused

pytestmark = pytest.mark.integration


def test_evaluate_refuses_a_machine_whose_motion_diverges(
    hframe_command: Command, diverging_machine: Path, tmp_path: Path
) -> None:
    options = ("--machine", diverging_machine, "--episodes", 2, "--out", tmp_path / "out")
    assert_refused(hframe_command("evaluate", "textbook-pid", *options), "machine 'hframe'")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("options", "fragments"),
    [
        (("pid", "--period", "0"), ("period", "positive")),
        (("pid", "--period", "nan"), ("period", "positive")),
        (("pid", "--period", "10"), ("period is 10 s", "at least one control period")),
        (("no-such-controller",), ("no-such-controller", "pid", "textbook-pid")),
        (("no_such_module:pid",), ("no_such_module",)),
        (("pid", "--task", "juggle"), ("juggle", "reach, track")),
        (("pid", "--path", "circle"), ("--path circle", "reach")),
        (("pid", "--task", "track", "--path", "triangle"), ("triangle", "circle")),
        (("pid", "--randomize", "some"), ("some", "default, wide")),
        (("pid", "--sensors", "some"), ("some", "state, rig, machine")),
        (("pid", "--machine", "no_such_file.json"), ("no_such_file.json",)),
    ],
)
def test_evaluate_refuses_wrong_options_in_one_line(
    options: tuple[str, ...], fragments: tuple[str, ...], hframe_command: Command, tmp_path: Path
) -> None:
    assert_refused(hframe_command("evaluate", *options, "--out", tmp_path / "out"), *fragments)
    assert not (tmp_path / "out").exists()


def test_evaluate_says_which_effects_the_design_leaves_out(
    hframe_command: Command, hframe: Machine, tmp_path: Path
) -> None:
    gap = EFFECTS["gear_backlash"].at("motor1", d=2e-3, J=4e-5, F=0.02, B=1e-4, K=280.0, Z=0.1)
    save_machine(hframe.with_effects(gap), tmp_path / "machine.json")
    options = ("--machine", tmp_path / "machine.json", "--episodes", 2, "--out", tmp_path / "out")
    code, out, _ = hframe_command("evaluate", "pid", *options)
    assert code == 0
    assert "designed without gear_backlash@motor1" in out


def test_evaluate_by_protocol_writes_a_result_file_per_controller(
    hframe_command: Command, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    from hframe_gym.evaluation import PROTOCOLS, read_result

    short = dataclasses.replace(PROTOCOLS["reach-v1"], draws=2, duration_s=0.2)
    short = dataclasses.replace(short, digest=short.compute_digest())
    monkeypatch.setitem(PROTOCOLS, "reach-v1", short)
    bounds = {"free": np.full(2, 0.1), "held": np.full(2, np.nan)}  # the stored ones are of other draws
    for module in ("hframe_gym.evaluation", "hframe_gym.evaluation.protocols.result_file"):
        monkeypatch.setattr(f"{module}.protocol_bounds", lambda name: bounds)
    code, out, _ = hframe_command(
        "evaluate", "pid", "textbook-pid", "--protocol", "reach-v1", "--out", tmp_path
    )
    assert code == 0
    assert "reach-v1, reach" in out
    assert "bound" in out
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "reach-v1_pid.json",
        "reach-v1_textbook-pid.json",
    ]
    assert read_result(tmp_path / "reach-v1_pid.json").entry.name == "pid"


@pytest.mark.parametrize(
    ("options", "fragments"),
    [
        (("pid", "--protocol", "reach-v1", "--seed", 3), ("--seed", "leave --seed out")),
        (("pid", "--protocol", "reach-v1", "--html"), ("--html",)),
        (("pid", "--protocol", "reach"), ("protocol 'reach'", "reach-v1, track-v1, hard-v1")),
        (("nobody", "--protocol", "track-v1"), ("controller 'nobody'",)),
    ],
)
def test_evaluate_by_protocol_refuses_what_the_protocol_fixes(
    hframe_command: Command, tmp_path: Path, options: tuple[Any, ...], fragments: tuple[str, ...]
) -> None:
    assert_refused(hframe_command("evaluate", *options, "--out", tmp_path / "out"), *fragments)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("options", "fragments"),
    [
        (("no-such-recipe",), ("no recipe for no-such-recipe on reach", "ppo on reach")),
        (("ppo", "--task", "juggle"), ("task 'juggle' is unknown", "reach, track")),
        (("ppo", "--randomize", "some"), ("some", "default, wide")),
        (("ppo", "--resume"), ("nothing to resume",)),
    ],
)
def test_train_refuses_wrong_options_in_one_line(
    options: tuple[str, ...], fragments: tuple[str, ...], hframe_command: Command, tmp_path: Path
) -> None:
    assert_refused(hframe_command("train", *options, "--out", tmp_path / "out"), *fragments)


@pytest.mark.parametrize("words", [("train", "ppo"), ("evaluate", "ppo", "--episodes", "2")])
def test_missing_torch_is_reported_with_the_extra(
    words: tuple[str, ...], hframe_command: Command, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    for module in ("torch", "stable_baselines3", "stable_baselines3.ppo"):
        monkeypatch.setitem(sys.modules, module, None)
    result = hframe_command(*words, "--out", tmp_path / "out")
    assert_refused(result, "pip install 'hframe_gym[agents]'")


def test_evaluate_scores_and_warns_of_an_agent_trained_on_another_machine(
    hframe_command: Command, tmp_path: Path
) -> None:
    options = ("--machine", "hframe-linear", "--episodes", 2, "--seed", 3, "--out", tmp_path)
    code, out, err = hframe_command("evaluate", "ppo", "pid", *options)
    assert code == 0
    assert err.splitlines() == [
        "hframe: warning: agent ppo: trained on machine 'hframe', evaluated on 'hframe-linear'. "
        "Its scores may be poor."
    ]
    scores = json.loads((tmp_path / "scores.json").read_text())
    assert list(scores["controllers"]) == ["ppo", "pid"]
    assert f"{scores['controllers']['pid']['settling_s']['0.2mm']['mean']:.3f}" in out


def test_evaluate_does_not_warn_on_the_machine_of_the_training(
    hframe_command: Command, tmp_path: Path
) -> None:
    code, _, err = hframe_command("evaluate", "ppo", "--episodes", 2, "--out", tmp_path)
    assert (code, err) == (0, "")


PLUGIN = '''
from dataclasses import dataclass
import numpy as np
from hframe_gym.controllers import CONTROLLERS, Controller
from hframe_gym.envs import TASKS, Reach

@CONTROLLERS.register("toy-zero")
class Zero(Controller):
    """Apply no voltage."""
    def act(self, observation):
        return np.zeros((len(observation["observation"]), len(self.machine.drives)))

@TASKS.register("toy-reach")
@dataclass(frozen=True)
class ToyReach(Reach):
    """Reach a point."""
'''


def test_evaluate_takes_a_controller_and_a_task_of_another_module(
    hframe_command: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "toy_plugin.py").write_text(PLUGIN)
    monkeypatch.syspath_prepend(tmp_path)
    options = ("--task", "toy_plugin:toy-reach", "--episodes", 2, "--out", tmp_path / "out")
    code, _, err = hframe_command("evaluate", "toy_plugin:toy-zero", *options)
    assert (code, err) == (0, "")
    scores = json.loads((tmp_path / "out/scores.json").read_text())
    assert scores["controllers"]["toy_plugin:toy-zero"]["success"]["1mm"] == 0.0


@pytest.mark.train
@pytest.mark.usefixtures("brief_evaluations")
@pytest.mark.parametrize("task", ["folder_tasks:toy-move", "toy-move"], ids=["module and name", "plugin"])
def test_train_takes_a_task_of_a_module_in_the_current_folder(
    task: str, hframe_command: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [folder for folder in sys.path if folder])
    monkeypatch.delitem(sys.modules, "folder_tasks", raising=False)
    text = (
        "from hframe_gym.envs import TASKS, Reach\n"
        "@TASKS.register('toy-move')\n"
        "class Move(Reach):\n"
        "    pass\n"
    )
    Path("folder_tasks.py").write_text(text)
    if ":" not in task:
        monkeypatch.setenv("HFRAME_PLUGINS", "folder_tasks")
    load_plugins.cache_clear()
    try:
        code, out, err = hframe_command("train", "ppo", "--task", task, "--steps", 1, "--out", "agent")
        assert (code, err) == (0, "")
        assert f"Next: hframe evaluate agent pid --machine hframe --task {task} --out agent/scores" in out
        code, _, err = hframe_command("evaluate", "agent", "--task", task, "--episodes", 2, "--out", "out")
        assert (code, err) == (0, "")
        assert json.loads(Path("agent/card.json").read_text())["task"] == task
        code, out, _ = hframe_command("evaluate", "pid", "--task", task, "--episodes", 2, "--out", "out")
        assert f"Next: hframe train ppo --machine hframe --task {task} --out FOLDER" in out
    finally:
        TASKS.unregister("toy-move")
        load_plugins.cache_clear()


def test_evaluate_follows_a_path(hframe_command: Command, tmp_path: Path) -> None:
    options = ("--task", "track", "--path", "square", "--episodes", 2, "--out", tmp_path)
    code, out, _ = hframe_command("evaluate", "pid", *options)
    assert code == 0
    scores = json.loads((tmp_path / "scores.json").read_text())
    assert "square" in scores["task"]
    assert f"{scores['controllers']['pid']['contour_mm']['rms']['mean']:.3f}" in out


def test_evaluate_writes_a_scorecard_with_the_warnings(
    hframe_command: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("matplotlib")

    def make_pid(machine: Machine, period: float) -> ModelBasedController:
        warnings.warn("this controller is not for this machine", stacklevel=2)
        return ModelBasedController(machine, period)

    monkeypatch.setattr(make_pid, "feedback", "state", raising=False)
    monkeypatch.setitem(CONTROLLERS._parts, "warning-pid", make_pid)
    code, out, err = hframe_command("evaluate", "warning-pid", "--episodes", 2, "--html", "--out", tmp_path)
    assert code == 0
    assert "hframe: warning: this controller is not for this machine" in err
    page = (tmp_path / "scorecard.html").read_text()
    assert f"wrote {tmp_path / 'scorecard.html'}" in " ".join(out.split())
    assert "<li>this controller is not for this machine</li>" in page


def test_controllers_of_equal_name_have_plots_of_their_own() -> None:
    names = ["out/ppo", "pid", "ppo", "other/ppo", "module:name"]
    assert file_labels(names) == ["ppo", "pid", "ppo_2", "ppo_3", "module-name"]


def test_a_scorecard_of_one_axis_has_its_positions(hframe_command: Command, tmp_path: Path) -> None:
    words = ("evaluate", "pid", "--machine", "axis", "--episodes", 2, "--html", "--out", tmp_path)
    code, out, _ = hframe_command(*words)
    assert code == 0
    assert re.search(
        r"Path of the tool under pid, worst episode \(\d+\), from -?\d+ mm to the goal at -?\d+ mm",
        (tmp_path / "scorecard.html").read_text(),
    )
    assert (
        "Next: hframe train ppo --machine axis --task reach --out FOLDER, then evaluate FOLDER too\n" in out
    )


def test_the_control_period_of_the_commands_is_that_of_the_environments() -> None:
    assert EnvConfig.period == CONTROL_PERIOD


def test_a_proposal_to_train_names_what_differs_from_the_recipe(monkeypatch: pytest.MonkeyPatch) -> None:
    recipe = agents.load_recipe("ppo", "reach")
    slow = dataclasses.replace(recipe, env={**recipe.env, "period": 0.02, "randomize": "wide"})
    same = (
        "Next: hframe train ppo --machine 'my rig.json' --task reach --out FOLDER, then evaluate FOLDER too"
    )
    assert training_proposal("my rig.json", "reach", recipe.randomize, recipe.period) == same
    monkeypatch.setattr(agents, "load_recipe", lambda name, task: slow)
    assert training_proposal("my rig.json", "reach", "wide", 0.02) == same
    other = training_proposal("hframe", "reach", "default", 0.01)
    assert " --randomize default --out FOLDER" in other
    assert other.endswith(" too with --period 0.02, the control period of the recipe")
    monkeypatch.undo()
    assert training_proposal("hframe", "my_package.tasks:juggle", "default", 0.01) == ""


def test_the_proposed_commands_quote_names_with_blanks(hframe_command: Command, tmp_path: Path) -> None:
    machine, runs = tmp_path / "my rig.json", tmp_path / "first runs"
    assert hframe_command("machines", "new", "--like", "axis", "--out", machine)[0] == 0
    assert "hframe check RUNS --machine 'my rig.json'" in machine.read_text()
    rows = [f"{i / 1000},{np.sin(i / 50)},{1e-3 * (1 - np.cos(i / 50))}" for i in range(200)]
    (tmp_path / "log.csv").write_text("\n".join(["time_s,v_V,x_m", *rows]))
    out = hframe_command("import", tmp_path / "log.csv", "--machine", machine, "--out", runs)[1]
    assert f"Next: hframe check '{runs}' --machine '{machine}'\n" in out


@pytest.mark.train
@pytest.mark.usefixtures("brief_evaluations")
def test_the_proposed_commands_repeat_randomization_and_period(
    hframe_command: Command, tmp_path: Path
) -> None:
    options = ("--machine", "axis", "--randomize", "wide")
    words = ("evaluate", "pid", *options, "--period", 0.005, "--episodes", 2, "--out", tmp_path / "scores")
    proposed = (
        "hframe train ppo --machine axis --task reach --randomize wide --out FOLDER, then evaluate FOLDER too"
    )
    assert (
        f"Next: {proposed} with --period 0.01, the control period of the recipe\n"
        in hframe_command(*words)[1]
    )
    folder = tmp_path / "an agent"
    out = hframe_command("train", "ppo", *options, "--steps", 1, "--out", folder)[1]
    assert "trained 4096 steps, not 1: a run ends with a whole rollout" in out
    proposed = f"pid --machine axis --task reach --randomize wide --out '{folder / 'scores'}' --html"
    assert f"Next: hframe evaluate '{folder}' {proposed}\n" in out
    again = hframe_command("train", "ppo", *options, "--steps", 1, "--out", folder)
    assert_refused(again, "holds the agent ppo of machine 'axis', seed 0", "--resume", "--force")
    assert hframe_command("train", "ppo", *options, "--steps", 1, "--force", "--out", folder)[0] == 0


def test_play_shows_a_machine_with_one_axis(hframe_command: Callable[..., tuple[int, str, str]]) -> None:
    pytest.importorskip("pygame")
    assert hframe_command("play", "--machine", "axis", "--frames", "1")[0] == 0
