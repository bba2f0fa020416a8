"""The commands as a user calls them: output, exit codes, and one line for every error."""

from __future__ import annotations

import dataclasses
import io
import itertools
import json
import os
import re
import shutil
import subprocess
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console
from rich.table import Table

from hframe_gym import agents
from hframe_gym.cli.control_commands import training_proposal
from hframe_gym.cli.options import CONTROL_PERIOD
from hframe_gym.cli.tables.identification import effect_lines, identification_table
from hframe_gym.cli.tables.machines import effect_table, machine_table
from hframe_gym.cli.tables.scores import BANDS, protocol_tables, score_table
from hframe_gym.controllers import CONTROLLERS, ModelBasedController
from hframe_gym.data_validation import Finding, print_findings
from hframe_gym.effects import EFFECTS
from hframe_gym.effects.smooth_table import TABLE_FAMILY
from hframe_gym.envs import TASKS, EnvConfig
from hframe_gym.errors import InputError
from hframe_gym.evaluation import file_labels
from hframe_gym.exporters import EXPORTERS
from hframe_gym.identification import simulate_recording
from hframe_gym.machine import BUILTIN_MACHINES, Machine
from hframe_gym.recordings import load_recording, machine_to_dict
from hframe_gym.registry import Registry, load_plugins
from tests.identification.report.axis_results import effect_entry, report_with

pytestmark = pytest.mark.integration

Command = Callable[..., tuple[int, str, str]]

ROOT = Path(__file__).parents[1]
COMMANDS = (
    *("simulate", "import", "check", "identify", "report", "train", "evaluate", "play", "export"),
    *("machines", "effects", "kernel"),
)


@pytest.fixture
def diverging_machine(tmp_path: Path, hframe: Machine) -> Path:
    """Return a machine.json whose belts push instead of pull once they are stretched by more than 1 um."""
    contents = machine_to_dict(hframe)
    contents["effects"] = [
        {"name": "belt_hardening", "site": "belts", "parameters": {"h": {"value": -1e12, "unit": "1/m^2"}}}
    ]
    path = tmp_path / "diverging.json"
    path.write_text(json.dumps(contents))
    return path


def assert_refused(result: tuple[int, str, str], *fragments: str, code: int = 2) -> None:
    """Assert that a command failed with a code and one line on standard error that contains the fragments."""
    exit_code, _, err = result
    assert exit_code == code
    assert err.startswith("hframe: ")
    assert err.count("\n") == 1
    for fragment in fragments:
        assert fragment in err


def test_simulate_keeps_times_and_columns(hframe_command: Command, tmp_path: Path, hframe: Machine) -> None:
    source = ROOT / "examples/rig_b/run_01.csv.gz"
    code, _, _ = hframe_command(
        "simulate", "--machine", "hframe", "--inputs", source, "--out", tmp_path / "p.csv"
    )
    assert code == 0
    measured, predicted = load_recording(source, hframe), load_recording(tmp_path / "p.csv", hframe)
    np.testing.assert_allclose(predicted.time_s, measured.time_s, rtol=1e-9)
    np.testing.assert_allclose(predicted.inputs, measured.inputs, rtol=1e-8)
    lasers = [hframe.output_channels.index(channel) for channel in ("x_m", "y_m")]
    np.testing.assert_allclose(predicted.outputs[0, lasers], measured.outputs[0, lasers], atol=1e-3)


def test_simulate_starts_where_identification_starts(
    hframe_command: Command, tmp_path: Path, hframe: Machine
) -> None:
    source = ROOT / "examples/rig_b/run_01.csv.gz"
    hframe_command("simulate", "--inputs", source, "--out", tmp_path / "p.csv")
    recording = load_recording(source, hframe)
    expected = simulate_recording(hframe, recording)
    np.testing.assert_allclose(
        load_recording(tmp_path / "p.csv", hframe).outputs, expected.outputs, rtol=1e-6, atol=1e-9
    )


@pytest.mark.parametrize(
    ("cells", "header", "location"),
    [
        ({}, "time_s,v1_V,v2_V,phi1_rad,phi2_rad,x_m,w_m", "column w_m"),
        ({(4, "v2_V"): "oops"}, None, "row 4, column v2_V"),
        ({(4, "time_s"): "4.9"}, None, "row 4, column time_s"),
    ],
)
def test_simulate_refuses_a_faulty_recording_and_writes_nothing(
    cells: dict[tuple[int, str], str],
    header: str | None,
    location: str,
    hframe_command: Command,
    write_run: Callable[..., Path],
    tmp_path: Path,
) -> None:
    path = write_run(cells=cells, **({"header": header} if header else {}))
    before = set(tmp_path.iterdir())
    assert_refused(
        hframe_command("simulate", "--inputs", path, "--out", tmp_path / "p.csv"), str(path), location
    )
    assert set(tmp_path.iterdir()) == before


def test_simulate_refuses_inputs_that_make_the_motion_diverge(
    hframe_command: Command, write_run: Callable[..., Path], tmp_path: Path
) -> None:
    path = write_run(cells={(row, "v1_V"): "1e30" for row in range(10, 21)})
    result = hframe_command("simulate", "--inputs", path, "--out", tmp_path / "p.csv")
    assert_refused(result, "machine 'hframe'", "check the inputs and the machine's parameters")
    assert not (tmp_path / "p.csv").exists()


def test_evaluate_refuses_a_machine_whose_motion_diverges(
    hframe_command: Command, diverging_machine: Path, tmp_path: Path
) -> None:
    options = ("--machine", diverging_machine, "--episodes", 2, "--out", tmp_path / "out")
    assert_refused(hframe_command("evaluate", "textbook-pid", *options), "machine 'hframe'")
    assert not (tmp_path / "out").exists()


def test_identify_refuses_a_faulty_recording_before_it_writes(
    hframe_command: Command, write_run: Callable[..., Path], tmp_path: Path
) -> None:
    write_run("a.csv", cells={(4, "x_m"): "oops"})
    assert_refused(
        hframe_command("identify", tmp_path, "--out", tmp_path / "out"), "a.csv, row 4, column x_m"
    )
    assert_refused(hframe_command("identify", tmp_path, "--out", tmp_path), "is the folder of the recordings")
    assert not (tmp_path / "out").exists()


def test_a_fault_in_the_data_stops_identify_and_is_the_exit_code_of_check(
    hframe_command: Command, tmp_path: Path, hframe: Machine, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Negate one column: `check` exits with 1, `identify` refuses and names it, and --force fits."""
    runs, out = tmp_path / "runs", tmp_path / "out"
    runs.mkdir()
    header = ",".join(["time_s", *hframe.input_channels, *hframe.output_channels])
    for path in sorted((ROOT / "examples/rig_b").glob("run_0[12]*")):
        run = load_recording(path, hframe)
        table = np.column_stack([run.time_s, run.inputs, run.outputs * [1.0, 1.0, -1.0, 1.0]])
        np.savetxt(runs / f"{run.name}.csv", table, fmt="%.9g", delimiter=",", header=header, comments="")
    code, printed, _ = hframe_command("check", runs)
    assert code == 1
    assert "fault: x_m has the wrong sign" in printed
    refused = hframe_command("identify", runs, "--out", out)
    assert_refused(refused, f"all runs of {runs}: x_m has the wrong sign: correct the columns", "--force")
    assert not out.exists()

    def begin_fit(*_args: object, **_keywords: object) -> None:
        raise InputError("the fit begins")

    monkeypatch.setattr("hframe_gym.identification.identify", begin_fit)
    assert_refused(hframe_command("identify", runs, "--out", out, "--force"), "the fit begins")


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


def test_evaluate_by_protocol_writes_a_result_file_per_controller(
    hframe_command: Command, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    from hframe_gym.evaluation import PROTOCOLS, read_result

    short = dataclasses.replace(PROTOCOLS["reach-v1"], draws=2, duration_s=0.2)
    short = dataclasses.replace(short, digest=short.compute_digest())
    monkeypatch.setitem(PROTOCOLS, "reach-v1", short)
    bounds = {"free": np.full(2, 0.1), "held": np.full(2, np.nan)}  # the stored ones are of other draws
    for module in ("hframe_gym.evaluation", "hframe_gym.evaluation.protocol_results"):
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


@pytest.mark.parametrize(
    "contents",
    [None, '{"schema": 1', "[]", '{"schema": 1}'],
    ids=["missing", "truncated", "a list", "incomplete"],
)
def test_report_refuses_a_damaged_folder(
    contents: str | None, hframe_command: Command, tmp_path: Path
) -> None:
    if contents is not None:
        (tmp_path / "report.json").write_text(contents)
    assert_refused(hframe_command("report", tmp_path), str(tmp_path))


@pytest.mark.parametrize("option", ["--inputs", "--machine"])
@pytest.mark.parametrize("kind", ["missing", "binary", "folder"])
def test_unreadable_files_are_named(option: str, kind: str, hframe_command: Command, tmp_path: Path) -> None:
    path = tmp_path / ("file.csv" if option == "--inputs" else "file.json")
    if kind == "binary":
        path.write_bytes(bytes(range(256)))
    elif kind == "folder":
        path.mkdir()
    others = () if option == "--inputs" else ("--inputs", ROOT / "examples/rig_b/run_01.csv.gz")
    assert_refused(hframe_command("simulate", option, path, *others, "--out", tmp_path / "p.csv"), str(path))


@pytest.mark.parametrize(
    ("command", "options"),
    [("identify", (ROOT / "examples/rig_b",)), ("train", ("ppo",)), ("evaluate", ("pid",))],
)
def test_a_file_in_place_of_the_output_folder_is_refused(
    command: str, options: tuple[object, ...], hframe_command: Command, tmp_path: Path
) -> None:
    (tmp_path / "file").touch()
    assert_refused(hframe_command(command, *options, "--out", tmp_path / "file"), "--out", "must be a folder")


def broken_table() -> None:
    """Fail as a defect of the package would."""
    raise KeyError("a defect")


def test_an_internal_error_is_one_line_with_exit_code_1(
    hframe_command: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hframe_gym.cli.tables.machines.effect_table", broken_table)
    assert_refused(
        hframe_command("effects"), "internal error", "HFRAME_DEBUG=1", "KeyError: 'a defect'", code=1
    )


def test_debugging_shows_the_traceback_of_an_internal_error(
    hframe_command: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hframe_gym.cli.tables.machines.effect_table", broken_table)
    monkeypatch.setenv("HFRAME_DEBUG", "1")
    with pytest.raises(KeyError, match="a defect"):
        hframe_command("effects")


def test_evaluate_scores_and_warns_of_an_agent_trained_on_another_machine(
    hframe_command: Command, tmp_path: Path
) -> None:
    options = ("--machine", "hframe-linear", "--episodes", 2, "--seed", 3, "--out", tmp_path)
    code, out, err = hframe_command("evaluate", "ppo", "pid", *options)
    assert code == 0
    assert err.splitlines() == [
        "hframe: warning: agent ppo: trained on machine 'hframe', evaluated on 'hframe-linear'. Its scores may be poor."
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
    text = "from hframe_gym.envs import TASKS, Reach\n@TASKS.register('toy-move')\nclass Move(Reach):\n    pass\n"
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


def printed(table: Table, width: int) -> str:
    """Return a table as a terminal of a width shows it, and check that nothing is cut."""
    console = Console(width=width, record=True, file=io.StringIO())
    console.print(table)
    text = console.export_text()
    assert "…" not in text
    assert max(map(len, text.splitlines())) <= width
    return text


@pytest.mark.parametrize("width", [80, 60])
@pytest.mark.parametrize("metric", ["settling_s", "contour_mm"])
def test_scores_are_not_cut(metric: str, width: int) -> None:
    success = {band: {"1mm": 1.0, "0.2mm": 0.998, "0.05mm": 0.125}[band] for band in BANDS}
    keys = BANDS if metric == "settling_s" else ("rms", "max")
    errors = {key: {"mean": 1.2345 + i} for i, key in enumerate(keys)}
    score = {"success": success, metric: errors, "tracking_mm": errors, "final_error_mm": {"mean": 0.0123}}
    names = ("pid", "my_package.my_controllers:a-controller")
    scores = {
        "task": "reach",
        "episodes": 512,
        "machine": "hframe",
        "randomize": "default",
        "sensors": "state",
    }
    text = printed(score_table({**scores, "seed": 0, "controllers": dict.fromkeys(names, score)}), width)
    assert "pid" in text.split()
    for number in ("100.0", "99.8", "12.5", *(f"{cell['mean']:.3f}" for cell in errors.values())):
        assert text.count(number) >= len(names)


def test_a_band_in_which_nothing_settles_has_no_settling_time() -> None:
    """The mean is then the length of the episodes, which is no settling time; what is left says how near it came."""
    bands = {"1mm": 0.5, "0.2mm": 0.0, "0.05mm": 0.0}
    settling = {band: {"mean": 1.5} for band in bands}
    bound = {"0.2mm": {"ratio_of_means": {"mean": 5.9}}}
    left = {"mean": 2.26, "median": 2.26}
    score = {"success": bands, "settling_s": settling, "over_bound": bound, "final_error_mm": left}
    scores = {
        "task": "reach",
        "episodes": 512,
        "machine": "hframe",
        "randomize": "none",
        "sensors": "state",
        "seed": 0,
    }
    text = printed(score_table({**scores, "controllers": {"idle": score}}), 80)
    assert text.split()[-8:] == ["50.0", "0.0", "0.0", "1.500", "-", "-", "-", "2.26"]
    part = {f"settling_s.{band}": {"success": bands[band], "mean": 1.5, "ci95": (1.4, 1.5)} for band in bands}
    result = {
        "protocol": "reach-v1",
        "entry": {"name": "idle"},
        "scores": {"reach": {"final_error_mm": left, **part}},
    }
    (table,) = protocol_tables([result])
    # Nor a ratio to the bound.
    assert printed(table, 80).split()[-7:] == ["idle", "50.0", "0.0", "0.0", "-", "-", "2.26"]


def test_machines_lists_the_built_in_machines(hframe_command: Command) -> None:
    code, out, _ = hframe_command("machines")
    assert code == 0
    assert {"hframe", "hframe-linear", "axis"} <= set(out.split())


@pytest.mark.parametrize("width", [80, 60])
def test_errors_of_an_identification_are_not_cut(width: int) -> None:
    channels = ("phi1_rad", "phi2_rad", "x_m", "bridge_left_m")
    errors = {channel: {"rmse": 1.2345e-5, "noise_ratio": 1234.5} for channel in channels} | {
        "force_error": 0.5
    }
    text = printed(identification_table(report_with(errors)), width)
    assert set(channels) <= set(text.split())
    assert text.count("0.0123 mrad") == text.count("12.3 µm") == 3 * 2
    assert text.count("1234 x") == 3 * len(channels)


@pytest.mark.parametrize("width", [80, 60])
def test_machines_and_effects_are_not_cut(width: int) -> None:
    assert set(BUILTIN_MACHINES) <= set(printed(machine_table(), width).split())
    assert set(EFFECTS) <= set(printed(effect_table(), width).split())


@pytest.mark.parametrize("width", [80, 60])
def test_findings_are_not_cut(width: int) -> None:
    findings = [
        Finding(
            "advice", "a_run_with_a_very_long_name_2026_11_22", "bottom.rest_length", "what was found " * 9
        )
    ]
    console = Console(width=width, record=True, file=io.StringIO(), force_terminal=True)
    print_findings(findings, console)
    text = console.export_text()
    assert "…" not in text
    assert max(map(len, text.splitlines())) <= width


@pytest.mark.parametrize("columns", [None, "80"])
@pytest.mark.parametrize("command", ["effects", "machines"])
def test_names_are_complete_where_the_output_is_no_terminal(
    command: str, columns: str | None, hframe_command: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("COLUMNS", raising=False)
    if columns:
        monkeypatch.setenv("COLUMNS", columns)
    names = set(EFFECTS if command == "effects" else BUILTIN_MACHINES)
    code, out, _ = hframe_command(command)
    assert code == 0
    assert names <= set(out.split())
    assert max(map(len, out.splitlines())) <= 80


def closed_pipe_command(*words: object, both: bool = False) -> tuple[int, str]:
    """Run a command whose output nobody reads; return its exit code and its standard error."""
    read_end, write_end = os.pipe()
    os.close(read_end)
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    errors = write_end if both else subprocess.PIPE
    command = [sys.executable, "-m", "hframe_gym", *map(str, words)]
    run = subprocess.run(command, stdout=write_end, stderr=errors, env=environment, check=False)
    os.close(write_end)
    return run.returncode, (run.stderr or b"").decode()


@pytest.mark.parametrize("both", [False, True])
def test_a_command_completes_its_work_if_nobody_reads_its_output(both: bool, tmp_path: Path) -> None:
    log = ROOT / "examples/rig_b/run_01.csv.gz"
    assert closed_pipe_command("import", log, "--out", tmp_path / "runs", both=both) == (0, "")
    assert [path.name for path in (tmp_path / "runs").iterdir()] == ["run_01.csv.gz"]
    assert closed_pipe_command("--help" if both else "effects", both=both) == (0, "")
    if both:
        assert closed_pipe_command("check", tmp_path / "none", both=both)[0] == 2


def test_the_line_of_usage_names_arguments_in_capitals(hframe_command: Command) -> None:
    for words, usage in (
        (("check",), "check [OPTIONS] RUNS_DIR"),
        (("play",), "play [OPTIONS] [CONTROLLER]"),
        (("machines", "show"), "machines show [OPTIONS] MACHINE"),
        (("evaluate",), "evaluate [OPTIONS] CONTROLLERS..."),
    ):
        assert usage in hframe_command(*words, "--help")[1]


def test_kernel_prints_python_source(hframe_command: Command) -> None:
    code, out, _ = hframe_command("kernel", "hframe")
    assert code == 0
    compile(out, "kernel", "exec")
    assert out.count("\ndef ") > 3


def test_version(hframe_command: Command) -> None:
    code, out, _ = hframe_command("--version")
    assert code == 0
    assert out.startswith("hframe_gym 0.")


@pytest.mark.parametrize("command", COMMANDS)
def test_help_has_an_example(command: str, hframe_command: Command) -> None:
    code, out, _ = hframe_command(command, "--help")
    assert code == 0
    assert "Example" in out
    assert f"hframe {command}" in out


def test_the_help_lists_the_commands_in_the_order_of_the_work(hframe_command: Command) -> None:
    _, out, _ = hframe_command("--help")
    listed = re.findall(r"^│ ([a-z]+) ", out, re.MULTILINE)
    work = ["machines", "import", "check", "identify", "report", "evaluate", "train", "export", "app"]
    assert listed[: len(work)] == work
    assert "Further commands" not in out  # every command has its place


@pytest.mark.parametrize(
    ("words", "name"),
    [
        (("evaluate", "textbook-pidd"), "textbook-pid"),
        (("evaluate", "pid", "--task", "trak"), "track"),
        (("evaluate", "pid", "--machine", "corexi"), "corexy"),
        (("evaluate", "pid", "--randomize", "defualt"), "default"),
        (("evaluate", "pid", "--sensors", "machin"), "machine"),
        (("evaluate", "pid", "--protocol", "reach-v2"), "reach-v1"),
        (("train", "ppoo"), "ppo"),
    ],
)
def test_a_misspelled_name_has_a_suggestion(
    words: tuple[str, ...], name: str, hframe_command: Command, tmp_path: Path
) -> None:
    code, _, error = hframe_command(*words, "--out", tmp_path)
    assert code == 2
    assert error.endswith(f"; did you mean {name!r}?\n")


def test_identified_effects_are_listed_with_their_parameters_and_a_table_by_its_points() -> None:
    values = {"dF": (2.8393, 4.2e-4, "N"), "n": (2.0, None, "1")}
    parameters = {k: dict(zip(("value", "std", "unit"), v, strict=True)) for k, v in values.items()}
    stribeck = effect_entry("stribeck_friction", "x", parameters=parameters)
    table = stribeck | {"name": "smooth_force[time]", "family": TABLE_FAMILY, "held_out_gain": 0.95}
    assert effect_lines(report_with(effects=[stribeck, table])) == [
        "smooth force[time] at x: a table of 1 points",
        "stribeck friction at x: dF = 2.8393 +- 0.00042 N, n = 2",
    ]


def test_controllers_of_equal_name_have_plots_of_their_own() -> None:
    names = ["out/ppo", "pid", "ppo", "other/ppo", "module:name"]
    assert file_labels(names) == ["ppo", "pid", "ppo_2", "ppo_3", "module-name"]


@pytest.mark.parametrize("command", COMMANDS)
def test_paragraphs_of_help_fill_the_terminal(
    command: str, hframe_command: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The line breaks of docstrings, at 120 columns, do not appear."""
    monkeypatch.setenv("COLUMNS", "200")
    _, out, _ = hframe_command(command, "--help")
    prose = out.partition("Example")[0].splitlines()
    for line, following in itertools.pairwise(prose):
        if line.strip() and following.strip():
            assert len(line.rstrip()) + len(following.split()[0]) > 150, line


@pytest.mark.parametrize(("registry", "words"), [(TASKS, ("evaluate",)), (EXPORTERS, ("export",))])
def test_help_lists_what_was_registered_since_the_last_call(
    registry: Registry[Any], words: tuple[str, ...], hframe_command: Command
) -> None:
    assert "late-part" not in hframe_command(*words, "--help")[1]
    registry.register("late-part")(registry.get(next(iter(registry))))
    try:
        assert "late-part" in hframe_command(*words, "--help")[1]
    finally:
        registry.unregister("late-part")
    assert "late-part" not in hframe_command(*words, "--help")[1]


@pytest.mark.parametrize(
    ("command", "choices"),
    [
        (
            "evaluate",
            (
                "pid,",
                "adaptive-pid,",
                "textbook-pid,",
                "residual,",
                "reach,",
                "track,",
                "default,",
                "wide,",
                "state",
                "rig",
            ),
        ),
        ("train", ("ppo,", "residual,", "sac,", "sac_her", "adapt,", "identified")),
    ],
)
def test_help_lists_the_registered_choices(
    command: str, choices: tuple[str, ...], hframe_command: Command
) -> None:
    _, out, _ = hframe_command(command, "--help")
    words = out.replace("│", " ").split()
    for choice in choices:
        assert any(word.startswith(choice) for word in words), choice


def test_the_package_imports_and_steps_without_the_extras() -> None:
    code = (
        "import sys\n"
        "for name in ('matplotlib', 'jinja2', 'pygame', 'torch', 'stable_baselines3', 'pyarrow', 'casadi'):\n"
        "    sys.modules[name] = None\n"
        "import hframe_gym, hframe_gym.cli, hframe_gym.controllers, gymnasium\n"
        "env = gymnasium.make('HFrame-v0'); env.reset(seed=0); env.step(env.action_space.sample())\n"
    )
    subprocess.run([sys.executable, "-W", "error", "-c", code], check=True)


def test_import_converts_a_folder_of_logs_that_check_then_accepts(
    hframe_command: Command, tmp_path: Path
) -> None:
    source = np.loadtxt(ROOT / "examples/rig_b/run_01.csv.gz", delimiter=",", skiprows=1)[:800]
    (tmp_path / "logs").mkdir()
    for name in ("a", "b"):
        lines = ["Zeit [ms];U1;U2;phi1 [deg];phi2 [deg];Laser X;Y [mm]"]
        scales = [1e3, 1, 1, 180 / np.pi, 180 / np.pi, 1e3, 1e3]
        lines += [";".join(f"{value:.12g}".replace(".", ",") for value in row) for row in source * scales]
        (tmp_path / "logs" / f"{name}.txt").write_text("\n".join(lines))
    (tmp_path / "map.toml").write_text(
        "[map]\nv1_V = 'U1'\nv2_V = 'V2'\nx_m = 'Laser X'\n[scale]\nx_m = 0.001\n"
    )
    options = ("--mapping", tmp_path / "map.toml", "--out", tmp_path / "runs")
    result = hframe_command("import", tmp_path / "logs", *options)
    assert_refused(result, "--map v2_V=V2: there is no such column; the columns are Zeit [ms], U1, U2")
    assert_refused(
        hframe_command("import", tmp_path / "logs", *options, "--map", "U2"), "--map U2: must be CHANNEL=COL"
    )
    assert_refused(
        hframe_command("import", tmp_path / "logs", *options, "--scale", "x_m=a"), "'a' is not a factor"
    )
    assert not (tmp_path / "runs").exists()
    code, out, _ = hframe_command(
        "import", tmp_path / "logs", *options, "--map", "v2_V=U2", "--format", "parquet"
    )
    assert code == 0
    assert "phi1 [deg] angle deg phi1_rad (deg to rad)" in " ".join(out.split())
    assert (
        f"wrote 2 runs to {tmp_path / 'runs'}. Next: hframe check {tmp_path / 'runs'} --machine hframe" in out
    )
    run = load_recording(tmp_path / "runs" / "b.parquet", BUILTIN_MACHINES["hframe"]())
    np.testing.assert_allclose(np.column_stack([run.time_s, run.inputs, run.outputs]), source, rtol=1e-10)
    code, out, _ = hframe_command("check", tmp_path / "runs")
    assert code == 0
    assert "faults: 0" in out


def test_a_single_run_cannot_be_identified_and_the_message_says_how_to_cut_it(
    hframe_command: Command, tmp_path: Path
) -> None:
    shutil.copy(ROOT / "examples/rig_b/run_01.csv.gz", tmp_path)
    result = hframe_command("identify", tmp_path, "--out", tmp_path / "out")
    command = f"hframe import {tmp_path / 'run_01.csv.gz'} --out RUNS --split-at-rests"
    assert_refused(result, "has the single run 'run_01' of", command)
    assert not (tmp_path / "out").exists()


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


@pytest.mark.parametrize(
    ("words", "missing", "example"),
    [
        ("train", "Missing argument 'algorithm'", "hframe train ppo --out out/ppo"),
        (
            "evaluate",
            "Missing argument 'controllers'",
            "hframe evaluate pid textbook-pid --episodes 64 --html",
        ),
        (
            "evaluate --ray",
            "Missing argument 'controllers'",
            "hframe evaluate pid textbook-pid --episodes 64 --html",
        ),
        ("evaluate pid", "Missing option '--out'", "hframe evaluate pid textbook-pid --episodes 64 --html"),
        ("export dataset", "Missing argument 'controllers'", "hframe export dataset pid ppo --episodes 100"),
        (
            "simulate",
            "Missing option '--inputs'",
            "hframe simulate --machine hframe --inputs examples/rig_b/",
        ),
        ("kernel", "Missing argument 'machine'", "hframe kernel hframe"),
        ("examples", "Missing option '--out'", "hframe examples --out examples"),
        ("import", "Missing argument 'logs'", "hframe import log.txt"),
        ("check", "Missing argument 'runs_dir'", "hframe check examples/rig_a"),
        ("identify", "Missing argument 'runs_dir'", "hframe identify examples/rig_a --out out/rig_a"),
        ("report", "Missing argument 'folder'", "hframe report out/rig_a --open"),
        ("effects new", "Missing argument 'name'", "hframe effects new rail_catch --from out/rig"),
        ("machines show", "Missing argument 'machine'", "hframe machines show my.json"),
        ("machines new", "--like and --out: missing", "hframe machines new --like corexy --out my.json"),
    ],
)
def test_a_command_without_what_it_needs_says_what_is_missing_with_an_example(
    words: str, missing: str, example: str, hframe_command: Callable[..., tuple[int, str, str]]
) -> None:
    code, _, errors = hframe_command(*words.split())
    assert code == 2
    assert errors.startswith(f"hframe: {missing}")
    assert f"for example: {example}" in errors or f"for example {example}" in errors
    assert errors.count("\n") == 1


def test_a_group_without_a_command_prints_its_help_and_says_what_is_missing(
    hframe_command: Callable[..., tuple[int, str, str]],
) -> None:
    code, out, errors = hframe_command("export")
    assert code == 2
    assert "state-space" in out
    assert errors == "hframe: Missing command (see --help)\n"


def test_play_shows_a_machine_with_one_axis(hframe_command: Callable[..., tuple[int, str, str]]) -> None:
    pytest.importorskip("pygame")
    assert hframe_command("play", "--machine", "axis", "--frames", "1")[0] == 0
