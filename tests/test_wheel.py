"""Test what a user installs: the wheel, with core dependencies only, in an empty environment elsewhere.

Every Python version of `VERSIONS` that is on the machine is tested: the running one, `pythonX.Y` on the path,
and those of pyenv. The tests build and install, so they need a package index.
"""

from __future__ import annotations

import csv
import json
import os
import shutil
import subprocess
import sys
import tarfile
from collections.abc import Sequence
from pathlib import Path

import pytest

import hframe_gym

pytestmark = pytest.mark.slow
ROOT = Path(__file__).parents[1]
RIG = ROOT / "examples" / "rig_b"
VERSIONS = ("3.11", "3.12", "3.13")
EXTRA_PACKAGES = (
    "casadi",
    "jinja2",
    "matplotlib",
    "pyarrow",
    "pygame",
    "sklearn",
    "stable_baselines3",
    "torch",
)
MAX_CORE_MB = 480  # LLVM (llvmlite) takes 180, SciPy 143, NumPy 71 and Numba 32
NOT_IN_SDIST = (".gitattributes", ".gitignore", ".pre-commit-config.yaml", "benchmarks/data/")
STEPS = """
import gymnasium as gym, numpy as np, hframe_gym
for environment in (gym.make("HFrame-v0"), gym.make("hframe_gym:HFrameTrack-v0", randomize="default")):
    environment.reset(seed=1)
    observation, reward, *_ = environment.step(np.ones(2, np.float32))
    assert np.isfinite(reward) and observation in environment.observation_space
environments = gym.make_vec("HFrame-v0", num_envs=16)
environments.reset(seed=1)
assert environments.step(environments.action_space.sample())[1].shape == (16,)
print("stepped")
"""


def run(command: Sequence[object], folder: Path, exit_code: int = 0) -> str:
    """Run a command outside the checkout and return its output; fail if its exit code differs."""
    hidden = ("PYTHONPATH", "PYTHONHOME", "VIRTUAL_ENV", "COLUMNS")
    environment = {name: value for name, value in os.environ.items() if name not in hidden}
    words = [str(word) for word in command]
    result = subprocess.run(words, cwd=folder, env=environment, capture_output=True, text=True)
    output = result.stdout + result.stderr
    assert result.returncode == exit_code, f"{words}: exit code {result.returncode}\n{output}"
    return output


def find_interpreter(version: str) -> str | None:
    """Return an interpreter of a version such as "3.12", None if the machine has none."""
    pyenv = sorted(Path.home().glob(f".pyenv/versions/{version}.*/bin/python"))
    for candidate in (sys.executable, shutil.which(f"python{version}"), *map(str, pyenv)):
        if candidate is not None:
            question = [candidate, "-c", "import sys; print('%d.%d' % sys.version_info[:2])"]
            if subprocess.run(question, capture_output=True, text=True).stdout.strip() == version:
                return candidate
    return None


@pytest.fixture(scope="module")
def distributions(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with the source distribution and the wheel that is built from it."""
    folder = tmp_path_factory.mktemp("dist")
    run([sys.executable, "-m", "build", "--outdir", folder, ROOT], folder)
    return folder


@pytest.fixture(scope="module", params=VERSIONS)
def installed(
    request: pytest.FixtureRequest, distributions: Path, tmp_path_factory: pytest.TempPathFactory
) -> Path:
    """Return the folder of the programs of an environment with the wheel and its core dependencies."""
    interpreter = find_interpreter(request.param)
    if interpreter is None:
        pytest.skip(f"Python {request.param} is not on this machine")
    folder = tmp_path_factory.mktemp(f"python{request.param}")
    run([interpreter, "-m", "venv", folder], folder)
    (wheel,) = distributions.glob("*.whl")
    programs = folder / "bin"
    run([programs / "python", "-m", "pip", "install", "-q", "-c", ROOT / "constraints.txt", wheel], folder)
    return programs


def test_the_core_install_has_no_extra_and_a_known_size(installed: Path, tmp_path: Path) -> None:
    code = f"import importlib.util as u; print([name for name in {EXTRA_PACKAGES} if u.find_spec(name)])"
    assert run([installed / "python", "-c", code], tmp_path).strip() == "[]"
    tools = ("pip", "setuptools", "pkg_resources", "_distutils_hack")  # of the empty environment
    (packages,) = (installed.parent / "lib").glob("python*/site-packages")
    folders = [path for path in packages.iterdir() if not path.name.startswith(tools)]
    files = [file for folder in folders for file in (folder.rglob("*") if folder.is_dir() else [folder])]
    megabytes = sum(file.stat().st_size for file in files if file.is_file()) / 1e6
    print(f"core install: {megabytes:.0f} MB")
    assert 50 < megabytes <= MAX_CORE_MB


def test_the_version_is_that_of_the_package(installed: Path, tmp_path: Path) -> None:
    expected = f"hframe_gym {hframe_gym.__version__}"
    assert run([installed / "hframe", "--version"], tmp_path).strip() == expected
    assert run([installed / "python", "-m", "hframe_gym", "--version"], tmp_path).strip() == expected
    code = "import importlib.metadata as m; print('hframe_gym', m.version('hframe_gym'))"
    assert run([installed / "python", "-c", code], tmp_path).strip() == expected


def test_recordings_are_simulated_checked_and_identified(installed: Path, tmp_path: Path) -> None:
    machines = run([installed / "python", "-m", "hframe_gym", "machines"], tmp_path)
    assert all(name in machines for name in ("hframe", "hframe-order20", "axis"))
    shutil.copytree(RIG, tmp_path / "runs")
    run(
        [installed / "hframe", "simulate", "--inputs", "runs/run_01.csv.gz", "--out", "predicted.csv"],
        tmp_path,
    )
    with (tmp_path / "predicted.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 2500
    assert all(abs(float(rows[-1][name])) < 0.5 for name in ("x_m", "y_m"))
    assert "faults: 0" in run([installed / "hframe", "check", "runs"], tmp_path)
    log = run([installed / "hframe", "identify", "runs", "--out", "result"], tmp_path)
    assert json.loads((tmp_path / "result" / "report.json").read_text())["verdict"] == "no_effect"
    assert (tmp_path / "result" / "machine.json").is_file()
    assert "report.html not written" in log
    assert "pip install 'hframe_gym[report]'" in log


def test_environments_step_and_controllers_are_evaluated(installed: Path, tmp_path: Path) -> None:
    assert run([installed / "python", "-W", "error", "-c", STEPS], tmp_path).strip().endswith("stepped")
    log = run([installed / "hframe", "evaluate", "pid", "--episodes", "4", "--out", "scores"], tmp_path)
    scores = json.loads((tmp_path / "scores" / "scores.json").read_text())
    assert scores["controllers"]["pid"]["success"]["1mm"] == 1.0
    assert "pip install 'hframe_gym[report]'" in log


@pytest.mark.parametrize("words", [("train", "ppo"), ("evaluate", "ppo", "--episodes", "2")])
def test_a_missing_extra_is_named(words: tuple[str, ...], installed: Path, tmp_path: Path) -> None:
    message = run([installed / "hframe", *words, "--out", "out"], tmp_path, exit_code=2)
    assert len(message.strip().splitlines()) == 1
    assert message.strip().endswith(": pip install 'hframe_gym[agents]'")
    assert not (tmp_path / "out").exists()


def test_pip_accepts_the_command_of_the_hints(installed: Path, tmp_path: Path) -> None:
    # The name need not be on an index: pip takes the installed package and adds the requirements of the
    # extra.
    pip = [installed / "python", "-m", "pip", "install", "--dry-run", "-c", ROOT / "constraints.txt"]
    lines = run([*pip, "hframe_gym[report]"], tmp_path).splitlines()
    (would_install,) = (line for line in lines if line.startswith("Would install"))
    assert "matplotlib" in would_install
    assert "hframe" not in would_install


def test_the_source_distribution_is_the_repository(distributions: Path) -> None:
    if not (ROOT / ".git").exists():
        pytest.skip("not a clone")
    (archive,) = distributions.glob("*.tar.gz")
    with tarfile.open(archive) as file:
        contained = {member.name.partition("/")[2] for member in file.getmembers() if member.isfile()}
    tracked = subprocess.run(
        ["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout.split()
    assert [path for path in tracked if path not in contained and not path.startswith(NOT_IN_SDIST)] == []
    assert [path for path in contained if path.startswith(NOT_IN_SDIST) or "hframe_gym/agents/" in path] == []
