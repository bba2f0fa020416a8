"""`hframe machines`: list, show, new and schema; and every block of docs/machine.md."""

from __future__ import annotations

import contextlib
import json
import math
import re
import shlex
import subprocess
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium as gym
import jsonschema
import pytest

from hframe_gym import cli
from hframe_gym.errors import InputError
from hframe_gym.machine import BUILTIN_MACHINES
from hframe_gym.recordings import MachineOptions, load_machine, machine_to_dict, new_machine, save_machine

pytestmark = pytest.mark.integration

Command = Callable[..., tuple[int, str, str]]
ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "machine.md").read_text("utf-8")


@pytest.fixture
def machines(hframe_command: Command) -> Command:
    """Return a function that runs `hframe machines` in this process: exit code, output, errors."""
    return partial(hframe_command, "machines")


def test_without_a_subcommand_the_built_in_machines_are_listed_within_80_columns(machines: Command) -> None:
    code, out, _ = machines()
    assert code == 0
    assert set(BUILTIN_MACHINES) <= set(out.split())
    table = [line for line in out.splitlines() if line.startswith(" ")]
    assert max(map(len, table)) <= 80
    assert "…" not in out


@pytest.mark.parametrize("name", ["hframe", "corexy", "axis", "hframe-order20"])
def test_show_prints_every_component_with_units_within_80_columns(name: str, machines: Command) -> None:
    code, out, _ = machines("show", name)
    assert code == 0
    machine = BUILTIN_MACHINES[name]()
    components = [*machine.coordinates, *machine.belts, *machine.drives]
    assert {*(c.name for c in components), *machine.output_channels} <= set(out.split())
    table = [line for line in out.splitlines() if line.startswith(" ")]
    assert max(map(len, table)) <= 80
    assert "…" not in out
    assert "ohm" in out
    assert "belt modes" in out


def test_show_prints_standard_deviations_and_effects(machines: Command, tmp_path: Path) -> None:
    import numpy as np

    from hframe_gym.effects import EFFECTS
    from hframe_gym.machine import Uncertainty

    machine = BUILTIN_MACHINES["axis"]().with_effects(EFFECTS["stribeck_friction"].at("x", dF=3.0, vs=0.03))
    save_machine(
        machine.replace(uncertainty=Uncertainty(("x.mass",), np.array([[4e-4]]))), tmp_path / "m.json"
    )
    code, out, _ = machines("show", tmp_path / "m.json")
    assert code == 0
    assert "1 +- 0.02 kg" in out
    assert "stribeck_friction@x" in out
    assert "dF = 3 N" in out


@pytest.mark.parametrize("name", ["hframe", "corexy", "axis"])
def test_show_draws_the_machine(name: str, machines: Command, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    picture = tmp_path / f"{name}.svg"
    code, out, _ = machines("show", name, "--plot", picture)
    assert code == 0
    assert f"wrote {picture}" in " ".join(out.split())
    assert picture.read_text().count("<path") > 20


def test_show_refuses_another_kind_of_picture_before_it_prints(machines: Command, tmp_path: Path) -> None:
    code, out, error = machines("show", "axis", "--plot", tmp_path / "axis.bmp")
    assert (code, out) == (2, "")
    assert "must end in one of .png, .svg, .pdf" in error


def test_the_drawing_without_matplotlib_names_the_extra(
    machines: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    code, _, error = machines("show", "axis", "--plot", tmp_path / "axis.png")
    assert code == 2
    assert "hframe_gym[report]" in error
    assert list(tmp_path.iterdir()) == []


def test_schema_prints_a_json_schema(machines: Command) -> None:
    code, out, _ = machines("schema")
    assert code == 0
    jsonschema.Draft202012Validator.check_schema(json.loads(out))


def test_new_writes_a_machine_and_never_overwrites_without_force(machines: Command, tmp_path: Path) -> None:
    path = tmp_path / "printer.json"
    words = ("new", "--like", "corexy", "--mass", "0.4,1.2", "--set", "x.coulomb=1.5", "--out", path)
    code, out, _ = machines(*words)
    assert code == 0
    assert "hframe machines show" in out
    machine = load_machine(path)
    assert (machine.name, machine.parameters["y.mass"], machine.parameters["x.coulomb"]) == (
        "printer",
        1.2,
        1.5,
    )
    before = path.read_bytes()
    code, _, error = machines(*words, "--Kt", "0.1")
    assert code == 2
    assert "exists already" in error
    assert path.read_bytes() == before
    assert machines(*words, "--Kt", "0.1", "--force")[0] == 0
    assert load_machine(path).parameters["motor1.Kt"] == 0.1


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--like", "corexy"), "--out: missing"),
        ((), "--like and --out: missing"),
        (("--like", "axis", "--out", "m.txt"), "must end in .json"),
        (("--like", "axis", "--out", "m.json", "--mass", "heavy"), "--mass: 'heavy' is not a number"),
        (("--like", "axis", "--out", "m.json", "--set", "x.mass"), "--set x.mass: write PARAMETER=VALUE"),
    ],
)
def test_new_names_a_wrong_option(
    words: tuple[str, ...], message: str, machines: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    code, _, error = machines("new", *words)
    assert code == 2
    assert message in error
    assert error.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_new_asks_on_a_terminal(tmp_path: Path) -> None:
    """Answer the questions of a command whose standard input is a pseudo-terminal."""
    pty = pytest.importorskip("pty")
    import os

    (tmp_path / "old.json").write_text("{}")
    # Each wrong answer is refused and asked for again: the template, two files, the travel in millimeters,
    # the command, a sensor, no sensors.
    answers = [
        "axes",
        "axis",
        "old.json",
        "rig.txt",
        "rig.json",
        "600",
        "0.6",
        "2.5",
        "0.075",
        "",
        "1e-5",
        "",
        "",
        "24",
    ]
    answers += ["curent", "", "speed@y", "", "0", "n", "500", "n"]
    controller, terminal = pty.openpty()
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-m", "hframe_gym", "machines", "new"]
    process = subprocess.Popen(
        command, cwd=tmp_path, stdin=terminal, stdout=subprocess.PIPE, env=environment, text=True
    )
    os.write(controller, "".join(f"{answer}\n" for answer in answers).encode())
    out, _ = process.communicate(timeout=120)
    os.close(controller)
    os.close(terminal)
    assert process.returncode == 0, out
    assert "axes: there is no such template" in out
    for refusal in (
        "old.json: exists already",
        "rig.txt: must end in .json",
        " 600: is it in millimeters? Give it in m",
        "curent: choose one of voltage, duty-cycle, current, torque, position, speed, stepper; "
        "did you mean 'current'?",
        "speed@y: speed is measured at a coordinate, and 'y' is none; choose one of x",
    ):
        assert refusal in out
    assert "no sensor is left: give the lines of encoders, or keep the linear sensor" in out
    assert "along x: 2.57 kg with the rotors, " in out
    assert out.count("check the units of the values you entered") == 1
    assert "--" not in out.partition("next: ")[0]  # a user who answers questions knows no options
    assert (tmp_path / "old.json").read_text() == "{}"
    machine = load_machine(tmp_path / "rig.json")
    assert machine.drives[0].gear_ratio == pytest.approx(2 * math.pi / 0.075)
    assert machine.drives[0].rated_voltage == 24.0
    assert machine.drives[0].Kt == 0.05
    assert [(s.channel, s.kind) for s in machine.sensors] == [("x_m", "encoder")]
    assert machine.coordinate("x").range == (-0.3, 0.3)


@pytest.mark.parametrize(
    ("like", "given", "typed", "sensors"),
    [
        ("corexy", {"encoder_lines": 0}, [], ["x_m", "y_m"]),
        ("axis", {"linear_sensor": False}, [0, 400], ["x_m"]),
        ("hframe", {"linear_sensor": False}, [0, 400], ["phi1_rad", "phi2_rad"]),
    ],
    ids=["no encoders", "the template has no encoders", "the template has encoders"],
)
def test_an_answer_that_leaves_no_sensor_is_asked_for_again(
    like: str,
    given: dict[str, Any],
    typed: list[int],
    sensors: list[str],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    """One part of the sensors is an option, the other a question."""
    from hframe_gym.cli import machine_questions

    said: list[str] = []
    confirmed = iter((False, True))
    numbers = iter(typed)

    def prompt(text: str, default: Any, type: Any = None) -> Any:
        return next(numbers) if text.startswith("Lines") else default

    monkeypatch.setattr(machine_questions.typer, "prompt", prompt)
    monkeypatch.setattr(machine_questions.typer, "confirm", lambda text, default: next(confirmed))
    answers = machine_questions.MachineAnswers(like, tmp_path / "m.json", given=given)
    options = machine_questions.ask(answers, said.append).options()
    assert [s.channel for s in machine_questions.new_machine(like, "m", options).sensors] == sensors
    assert sum(line.startswith("no sensor is left") for line in said) == 1


def test_with_the_radius_of_the_pulleys_nobody_is_asked_for_the_travel_per_turn(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    from hframe_gym.cli import machine_questions

    asked: list[str] = []

    def prompt(text: str, default: Any, type: Any = None) -> Any:
        asked.append(text)
        return default

    monkeypatch.setattr(machine_questions.typer, "prompt", prompt)
    monkeypatch.setattr(machine_questions.typer, "confirm", lambda text, default: True)
    for given, expected in (({}, 1), ({"pulley_radius": 0.012}, 0)):
        asked.clear()
        answers = machine_questions.MachineAnswers("axis", tmp_path / "m.json", given=given)
        machine_questions.ask(answers, print)
        assert sum(text.startswith("Travel per turn") for text in asked) == expected


def test_sensors_that_are_chosen_may_be_the_only_ones(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """A motor of which the log has the current and the speed."""
    from hframe_gym.cli import machine_questions

    answered = {"Further sensors": "speed@x, current@motor", "Lines of the encoders": 0}

    def prompt(text: str, default: Any, type: Any = None) -> Any:
        return next((value for start, value in answered.items() if text.startswith(start)), default)

    monkeypatch.setattr(machine_questions.typer, "prompt", prompt)
    monkeypatch.setattr(machine_questions.typer, "confirm", lambda text, default: False)
    answers = machine_questions.ask(machine_questions.MachineAnswers("axis", tmp_path / "m.json"), print)
    sensors = machine_questions.new_machine("axis", "m", answers.options()).sensors
    assert [(s.channel, s.kind) for s in sensors] == [("x_m_s", "speed"), ("motor_A", "current")]


@pytest.mark.parametrize("sensors", [("speed@x", "speed@x"), ("speed@x", "laser@x")])
def test_a_sensor_is_given_once(sensors: tuple[str, ...]) -> None:
    twin = "x_m_s" if sensors[1] == "speed@x" else "x_m"
    with pytest.raises(InputError, match=f"^--sensor {sensors[1]}: {twin} is this sensor already; give each"):
        new_machine("axis", "m", MachineOptions(sensor=sensors))


def test_accepted_defaults_give_the_template_to_the_last_digit(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    from hframe_gym.cli import machine_questions

    monkeypatch.setattr(machine_questions.sys.stdin, "isatty", lambda: True, raising=False)
    monkeypatch.setattr(machine_questions.typer, "prompt", lambda text, default, type=None: default)
    monkeypatch.setattr(machine_questions.typer, "confirm", lambda text, default: default)
    answers = machine_questions.MachineAnswers(like="hframe", out=tmp_path / "m.json")
    machine_questions.create_machine_file(machine_questions.ask(answers, print), force=False, log=print)
    assert load_machine(tmp_path / "m.json").parameters == BUILTIN_MACHINES["hframe"]().parameters


def test_a_new_corexy_machine_works_in_the_environment_and_under_the_pid(
    machines: Command, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    path, out = tmp_path / "printer.json", tmp_path / "pid"
    assert machines("new", "--like", "corexy", "--travel", "0.3,0.25", "--out", path)[0] == 0
    env = gym.make("HFrame-v0", machine=str(path))
    env.reset(seed=0)
    env.step(env.action_space.sample())
    words = ("evaluate", "pid", "--machine", path, "--period", "0.002", "--episodes", "8", "--out", out)
    monkeypatch.setattr(sys, "argv", ["hframe", *map(str, words)])
    with contextlib.suppress(SystemExit):
        cli.main()
    scores = json.loads((out / "scores.json").read_text())
    assert scores["controllers"]["pid"]["success"]["0.2mm"] == 1.0


def test_json_blocks_of_the_page_are_valid(tmp_path: Path) -> None:
    texts = re.findall(r"```json\n(.*?)```", PAGE, re.DOTALL)
    rig, belt, ties, servo, drive = map(json.loads, texts)
    for machine, channel in ((rig, "x_m"), (servo, "angle_rad")):
        (tmp_path / "rig.json").write_text(json.dumps(machine))
        assert load_machine(tmp_path / "rig.json").output_channels == (channel,)
    preset = machine_to_dict(BUILTIN_MACHINES["servo"]())
    (tmp_path / "rig.json").write_text(json.dumps(preset | {"drives": [drive]}))
    assert load_machine(tmp_path / "rig.json").drives[0].kind == "position"
    corexy = BUILTIN_MACHINES["corexy"]()
    assert belt["extension"] == corexy.belts[0].extension
    assert belt["length"] == corexy.belts[0].length
    assert {name: tuple(tie) for name, tie in ties["ties"].items()} == corexy.ties


@pytest.mark.slow
def test_blocks_of_the_page_run_in_order(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Run the worked examples of docs/machine.md as a reader would."""
    import os

    monkeypatch.chdir(tmp_path)
    (tmp_path / "rig.json").write_text(re.findall(r"```json\n(.*?)```", PAGE, re.DOTALL)[0])
    names: dict[str, object] = {}
    for language, block in re.findall(r"```(sh|python)\n(.*?)```", PAGE, re.DOTALL):
        if language == "python":
            exec(block, names)
            continue
        for line in block.splitlines():
            words = shlex.split(line, comments=True)
            assert words[0] == "hframe"
            command = [sys.executable, "-m", "hframe_gym", *words[1:]]
            environment = {**os.environ, "PYTHONPATH": str(ROOT)}
            run = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
            assert run.returncode == 0, f"{line}\n{run.stdout}\n{run.stderr}"
    rig = json.loads((tmp_path / "found" / "report.json").read_text())
    assert rig["verdict"] == "effect_found"
    assert [(e["name"], e["site"]) for e in rig["effects"]] == [("stribeck_friction", "x")]
    assert rig["after"]["held_out"]["x_m"]["noise_ratio"] < 1.2
    assert json.loads((tmp_path / "printer_found" / "report.json").read_text())["verdict"] == "no_effect"
    scores = json.loads((tmp_path / "printer_pid" / "scores.json").read_text())
    assert scores["controllers"]["pid"]["success"]["0.2mm"] == 1.0


@pytest.mark.parametrize(("task", "key"), [("reach", "final_error_mrad"), ("track", "tracking_mrad")])
def test_evaluate_scores_a_rotary_axis_in_mrad(
    task: str, key: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The table, the files and the page have angles."""
    out = tmp_path / "scores"
    words = [
        "evaluate",
        "pid",
        "--machine",
        "motor",
        "--task",
        task,
        "--episodes",
        "4",
        "--html",
        "--motions",
        "1",
    ]
    monkeypatch.setattr(sys, "argv", ["hframe", *words, "--out", str(out)])
    with contextlib.suppress(SystemExit):
        cli.main()
    assert "mrad" in capsys.readouterr().out
    scores = json.loads((out / "scores.json").read_text())["controllers"]["pid"]
    assert list(scores["success"]) == ["10mrad", "2mrad", "0.5mrad"]
    assert key in scores
    page = (out / "scorecard.html").read_text()
    assert " mrad" in page
    assert " mm" not in page
    assert (out / "pid.csv").read_text().splitlines()[0].split(",")[2:4] == ["shaft_rad", "shaft_goal_rad"]
