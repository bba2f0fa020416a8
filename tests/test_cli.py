"""The commands as a user calls them: exit codes, one line of error, nothing half-written."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from hframe_gym.cli import main
from hframe_gym.machine import Machine
from hframe_gym.recordings import load_recording

Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def hframe_command(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    def run(*words: object) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["hframe", *map(str, words)])
        try:
            main()
            code = 0
        except SystemExit as stop:
            code = stop.code if isinstance(stop.code, int) else 0
        printed = capsys.readouterr()
        return code, printed.out, printed.err

    return run


def test_simulate_keeps_times_and_columns(hframe_command: Run, tmp_path: Path, hframe: Machine) -> None:
    source = Path("examples/rig_b/run_01.csv.gz")
    code, _, _ = hframe_command("simulate", "--machine", "hframe", "--inputs", source, "--out", tmp_path / "p.csv")
    assert code == 0
    given, predicted = load_recording(source, hframe), load_recording(tmp_path / "p.csv", hframe)
    np.testing.assert_allclose(predicted.time_s, given.time_s, rtol=1e-9)
    np.testing.assert_allclose(predicted.inputs, given.inputs, rtol=1e-8)
    np.testing.assert_allclose(predicted.outputs[0], given.outputs[0], atol=1e-3)


@pytest.mark.parametrize(
    ("cells", "header", "place"),
    [
        ({}, "time_s,v1_V,v2_V,phi1_rad,phi2_rad,x_m,w_m", "column w_m"),
        ({(4, "v2_V"): "oops"}, None, "row 4, column v2_V"),
        ({(4, "time_s"): "4.9"}, None, "row 4, column time_s"),
    ],
)
def test_simulate_refuses_in_one_line_and_writes_nothing(
    cells: dict[tuple[int, str], str],
    header: str | None,
    place: str,
    hframe_command: Run,
    write_run: Callable[..., Path],
    tmp_path: Path,
) -> None:
    path = write_run(cells=cells, **({"header": header} if header else {}))
    before = set(tmp_path.iterdir())
    code, _, err = hframe_command("simulate", "--inputs", path, "--out", tmp_path / "p.csv")
    assert code == 2
    assert err.count("\n") == 1
    assert str(path) in err
    assert place in err
    assert set(tmp_path.iterdir()) == before


def test_identify_refuses_before_it_writes(hframe_command: Run, write_run: Callable[..., Path], tmp_path: Path) -> None:
    write_run("a.csv", cells={(4, "x_m"): "oops"})
    code, _, err = hframe_command("identify", tmp_path, "--out", tmp_path / "out")
    assert code == 2
    assert "a.csv, row 4, column x_m" in err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("command", ["machines", "effects"])
def test_tables(command: str, hframe_command: Run) -> None:
    code, out, _ = hframe_command(command)
    assert code == 0
    assert ("hframe" if command == "machines" else "stribeck") in out


@pytest.mark.parametrize(
    "command", ["simulate", "check", "identify", "report", "train", "evaluate", "machines", "effects"]
)
def test_help_has_an_example(command: str, hframe_command: Run) -> None:
    code, out, _ = hframe_command(command, "--help")
    assert code == 0
    assert "Example" in out
    assert f"hframe {command}" in out


def test_the_package_imports_without_the_extras() -> None:
    code = (
        "import sys\n"
        "for name in ('matplotlib', 'jinja2', 'pygame', 'torch', 'stable_baselines3', 'pyarrow'):\n"
        "    sys.modules[name] = None\n"
        "import hframe_gym, hframe_gym.cli, gymnasium\n"
        "env = gymnasium.make('HFrame-v0'); env.reset(seed=0); env.step(env.action_space.sample())\n"
    )
    subprocess.run([sys.executable, "-W", "error", "-c", code], check=True)
