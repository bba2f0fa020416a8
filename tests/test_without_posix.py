"""The package and its commands run where nothing of POSIX alone exists, and processes start by spawn."""

from __future__ import annotations

import ast
import importlib.util
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from hframe_gym.effects import EFFECTS
from hframe_gym.machine import BUILTIN_MACHINES
from hframe_gym.recordings import Recording, write_recording
from tests.without_posix.absent_names import MODULES, NAMES

ROOT = Path(__file__).parents[1]
ABSENT = ROOT / "tests" / "without_posix"


def run_without_posix(*words: object, folder: Path) -> str:
    """Run Python without the names that only POSIX systems have; return what it prints."""
    paths = os.pathsep.join([str(ABSENT), str(ROOT)])
    finished = subprocess.run(
        [sys.executable, *map(str, words)],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": paths, "COLUMNS": "120"},
        capture_output=True,
        text=True,
        encoding="utf-8",
    )
    assert finished.returncode == 0, finished.stderr
    assert "Traceback" not in finished.stderr
    return finished.stdout


def hframe_without_posix(*commands: str, folder: Path) -> None:
    """Run commands, one after the other in one process, without the names that only POSIX systems have."""
    code = f"""
import shlex, sys
from hframe_gym.__main__ import main
for command in {commands!r}:
    sys.argv = ["hframe", *shlex.split(command)]
    try:
        main()
    except SystemExit as end:
        assert not end.code, (command, end.code)
"""
    run_without_posix("-c", code, folder=folder)


@pytest.fixture(scope="module")
def work(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder, a blank in its name, with three short runs of an axis with an undeclared effect."""
    folder = tmp_path_factory.mktemp("my logs")
    axis = BUILTIN_MACHINES["axis"]()
    truth = axis.with_effects(EFFECTS["constant_force"].at("x", size=0.7))
    (folder / "runs").mkdir()
    rng = np.random.default_rng(3)
    time_s = np.arange(1000) * 1e-3
    for k in range(3):
        inputs = np.repeat(rng.uniform(-2.0, 2.0, (20, 1)), 50, axis=0)
        inputs[:50] = 0.0
        outputs = truth.simulate(time_s, inputs).outputs + rng.normal(0.0, 20e-6, (1000, 1))
        write_recording(folder / "runs" / f"run {k + 1}.csv", Recording("", time_s, inputs, outputs), axis)
    return folder


def posix_names(source: Path) -> list[str]:
    """Return the names of POSIX that a module uses, but for those that it checks with `hasattr`."""
    text, found = source.read_text("utf-8"), []
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            found += [alias.name for alias in node.names if alias.name.partition(".")[0] in MODULES]
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            found += [node.module] if node.module.partition(".")[0] in MODULES else []
            found += [a.name for a in node.names if a.name in NAMES.get(node.module, ())]
        elif isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            module, name = node.value.id, node.attr
            if name in NAMES.get(module, ()) and f'hasattr({module}, "{name}")' not in text:
                found.append(f"{module}.{name}")
    return found


def test_no_module_of_the_package_uses_a_name_of_posix_without_asking_for_it() -> None:
    """Also in code that no test executes."""
    sources = [
        *(ROOT / "hframe_gym").rglob("*.py"),
        *(ROOT / "agents").rglob("*.py"),
        ROOT / "tools" / "tasks.py",
    ]
    assert len(sources) > 200
    assert {
        str(source.relative_to(ROOT)): names for source in sources if (names := posix_names(source))
    } == {}


def test_names_are_absent_for_this_project_and_present_for_others(tmp_path: Path) -> None:
    code = """
import multiprocessing, os, select, signal, subprocess, time
for module in ("fcntl", "resource", "pwd", "grp", "termios"):
    try:
        exec(f"import {module}")
    except ModuleNotFoundError:
        continue
    raise SystemExit(module)
names = [(os, "fork"), (os, "getuid"), (os, "sched_getaffinity"), (os, "O_TMPFILE"), (signal, "SIGKILL"),
         (signal, "SIGHUP"), (select, "poll"), (time, "tzset")]
for module, name in names:
    assert not hasattr(module, name), name
try:
    multiprocessing.get_context("fork")
except ValueError:
    print(multiprocessing.get_context().get_start_method(), subprocess.run(["true"]).returncode)
"""
    assert run_without_posix("-c", code, folder=tmp_path) == "spawn 0\n"


@pytest.mark.integration
def test_environments_run(work: Path) -> None:
    code = """
import gymnasium as gym, numpy as np, hframe_gym
env = gym.make("HFrame-v0", randomize="default")
env.reset(seed=0)
assert np.isfinite(env.step(env.action_space.sample())[1])
envs = gym.make_vec("HFrame-v0", num_envs=16)
envs.reset(seed=0)
assert np.isfinite(envs.step(envs.action_space.sample())[1]).all()
print("done")
"""
    assert run_without_posix("-c", code, folder=work) == "done\n"


@pytest.mark.integration
def test_commands_run(work: Path) -> None:
    hframe_without_posix(
        "simulate --machine axis --inputs 'runs/run 1.csv' --out 'predicted 1.csv'",
        "check runs --machine axis",
        "import 'runs/run 1.csv' --machine axis --out 'imported runs'",
        "identify runs --machine axis --jobs 2 --out answer",
        "report answer",
        "evaluate pid --episodes 2 --html --out scores",
        folder=work,
    )
    files = {path.relative_to(work).as_posix() for path in work.rglob("*") if path.is_file()}
    expected = {"predicted 1.csv", "imported runs/run 1.csv.gz", "answer/report.json", "answer/report.html"}
    assert files >= expected | {"scores/scores.json", "scores/pid.png", "scores/scorecard.html"}
    assert not [name for name in files if "/.hframe" in f"/{name}"]


@pytest.mark.train
@pytest.mark.skipif(importlib.util.find_spec("stable_baselines3") is None, reason="needs the extra agents")
def test_training_runs(work: Path) -> None:
    """In this process; `identify --jobs 2` above spawns others."""
    hframe_without_posix("train ppo --steps 1 --out agent", folder=work)
    assert (work / "agent" / "agent.json").is_file()
