"""Paths, line ends and encodings of Windows; what can be tried on any system."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from hframe_gym.envs import TASKS
from hframe_gym.errors import InputError
from hframe_gym.evaluation import Scenario, make_controller
from hframe_gym.machine import BUILTIN_MACHINES
from hframe_gym.recordings import load_machine, load_recordings, save_machine
from hframe_gym.registry import names_module

ROOT = Path(__file__).parents[1]


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("my_package.control:my-controller", True),
        ("control:pid", True),
        (r"C:\agents\ppo", False),
        ("C:/agents/ppo", False),
        (r"\\server\share:x\ppo", False),
        ("ppo", False),
        (":pid", False),
    ],
)
def test_a_path_with_a_drive_is_no_module(name: str, expected: bool) -> None:
    assert names_module(name) is expected


@pytest.mark.parametrize("name", [r"C:\agents\my ppo", r"agents\my ppo", "agents/my ppo"])
def test_a_missing_agent_folder_is_called_so(name: str) -> None:
    with pytest.raises(InputError, match="there is no such folder"):
        make_controller(name, Scenario("hframe"))


ENCODINGS: dict[str, Callable[[str], bytes]] = {
    "CRLF": lambda text: text.replace("\n", "\r\n").encode(),
    "CRLF and byte order mark": lambda text: b"\xef\xbb\xbf" + text.replace("\n", "\r\n").encode(),
    "written by > in PowerShell": lambda text: text.replace("\n", "\r\n").encode("utf-16"),
}


@pytest.mark.parametrize("encode", ENCODINGS.values(), ids=ENCODINGS)
def test_a_machine_is_read_with_the_line_ends_and_encodings_of_windows(
    encode: Callable[[str], bytes], tmp_path: Path
) -> None:
    path = tmp_path / "my machine.json"
    save_machine(BUILTIN_MACHINES["corexy"](), path)
    before = load_machine(path)
    path.write_bytes(encode(path.read_text("utf-8")))
    assert load_machine(path).parameters == before.parameters


@pytest.mark.parametrize("encode", list(ENCODINGS.values())[:2], ids=list(ENCODINGS)[:2])
def test_recordings_and_mappings_are_read_with_line_ends_of_windows(
    encode: Callable[[str], bytes], tmp_path: Path, hframe_command: Callable[..., tuple[int, str, str]]
) -> None:
    logs, runs = tmp_path / "my logs", tmp_path / "my runs"
    logs.mkdir()
    time_s = np.arange(200) * 1e-3
    rows = [f"{t:.3f},{0.0 if t < 0.05 else 2.0},{max(0.0, t - 0.05) ** 2:.9f}" for t in time_s]
    (logs / "run 1.csv").write_bytes(encode("\n".join(["clock,volts,pos", *rows]) + "\n"))
    mapping = {"map": {"time_s": "clock", "v_V": "volts", "x_m": "pos"}}
    (logs / "mapping.json").write_bytes(encode(json.dumps(mapping, indent=1)))
    code, _, errors = hframe_command(
        *("import", logs / "run 1.csv", "--mapping", logs / "mapping.json", "--machine", "axis"),
        *("--format", "csv", "--out", runs),
    )
    assert code == 0, errors
    (runs / "run 1.csv").write_bytes(encode((runs / "run 1.csv").read_text("utf-8")))
    (recording,) = load_recordings(runs, BUILTIN_MACHINES["axis"]())
    np.testing.assert_allclose(recording.time_s - recording.time_s[0], time_s, atol=1e-9)


@pytest.mark.parametrize("encode", list(ENCODINGS.values())[:2], ids=list(ENCODINGS)[:2])
def test_a_path_to_follow_is_read_with_line_ends_of_windows(
    encode: Callable[[str], bytes], tmp_path: Path
) -> None:
    path = tmp_path / "my path.csv"
    corners = "x_m,y_m\n-0.05,-0.05\n0.05,-0.05\n0.05,0.05\n-0.05,0.05\n"
    path.write_bytes(encode(corners))
    assert TASKS.get("track")(path=str(path))  # type: ignore[call-arg]


def test_names_that_the_console_cannot_show_are_escaped(tmp_path: Path) -> None:
    finished = subprocess.run(
        [sys.executable, "-m", "hframe_gym", "examples", "--out", "测试"],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(ROOT), "PYTHONIOENCODING": "cp1252"},
        capture_output=True,
    )
    assert finished.returncode == 0, finished.stderr
    assert (tmp_path / "测试").is_dir()
