"""What all commands have in common: help, names, errors, and output that nobody reads."""

from __future__ import annotations

import itertools
import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from hframe_gym.envs import TASKS
from hframe_gym.exporters import EXPORTERS
from hframe_gym.registry import Registry
from tests.cli.running import COMMANDS, ROOT, Command, assert_refused

pytestmark = pytest.mark.integration


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


def test_machines_lists_the_built_in_machines(hframe_command: Command) -> None:
    code, out, _ = hframe_command("machines")
    assert code == 0
    assert {"hframe", "hframe-linear", "axis"} <= set(out.split())


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


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("machines new my", "for example: hframe machines new --like corexy --travel"),
        ("effects shwo", "No such command 'shwo'"),
        ("effects shwo", "choose list, new;"),
        ("identify runs --out o --budget 2min", "'--budget': must be a number without a unit"),
        ("train ppo --out o --seed 1e3", "'--seed': must be a whole number without a unit"),
        ("train ppo_track --out o", "did you mean 'ppo' for the task track?"),
        ("evaluate pid --out o --randomize lots", "identified, or, in Python, give a list"),
        ("evaluate pid --out o --machine .", "machine '.' is a folder without machine.json"),
        ("evaluate mine.toml --out o", "controller 'mine.toml': this file is no controller; choose pid"),
    ],
)
def test_a_wrong_word_is_answered_with_a_right_one(
    words: str,
    message: str,
    hframe_command: Callable[..., tuple[int, str, str]],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.toml").write_text("steps = 10")
    code, _, errors = hframe_command(*words.split())
    assert code == 2
    assert message in errors


def test_a_group_without_a_command_prints_its_help_and_says_what_is_missing(
    hframe_command: Callable[..., tuple[int, str, str]],
) -> None:
    code, out, errors = hframe_command("export")
    assert code == 2
    assert "state-space" in out
    assert errors == "hframe: Missing command (see --help)\n"
