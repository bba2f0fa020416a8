"""The tasks of the repository without make: what they run, and when they install."""

from __future__ import annotations

import os
import re
import subprocess
from pathlib import Path
from types import SimpleNamespace

import pytest

from tools import tasks

ROOT = Path(__file__).parents[1]


@pytest.fixture
def commands(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Let tasks work in a copy of the repository's few files that they need, and collect what they run."""
    for name in ("pyproject.toml", "constraints.txt"):
        (tmp_path / name).write_text((ROOT / name).read_text("utf-8"), "utf-8")
    (tmp_path / "hframe_gym").mkdir()
    (tmp_path / "agents").mkdir()
    ran: list[str] = []

    def record(words: list[str], cwd: Path, env: dict[str, str]) -> SimpleNamespace:
        assert cwd == tmp_path
        assert env == {name: os.environ[name] for name in os.environ if name != "PYTHONDONTWRITEBYTECODE"}
        ran.append(" ".join([Path(words[0]).stem, *words[1:]]))
        return SimpleNamespace(returncode=3 if "ruff" in words[0] else 0)

    monkeypatch.setenv("PYTHONDONTWRITEBYTECODE", "1")
    monkeypatch.setattr(subprocess, "run", record)
    monkeypatch.setattr(tasks.venv, "create", lambda folder, with_pip: (folder / "bin").mkdir(parents=True))
    monkeypatch.setattr(tasks, "ROOT", tmp_path)
    for name in ("ENVIRONMENT", "PROGRAMS", "INSTALLED"):
        monkeypatch.setattr(tasks, name, tmp_path / getattr(tasks, name).relative_to(ROOT))
    return ran


def test_a_task_installs_first_and_again_only_after_a_change(commands: list[str], tmp_path: Path) -> None:
    tasks.main(["demo"])
    assert [line.split(" -c ")[0] for line in commands[:2]] == [
        "python -m pip install -q --disable-pip-version-check --no-compile"
    ] * 2
    assert [line.split()[0:2] for line in commands[2:]] == [["hframe", "identify"], ["hframe", "evaluate"]]
    assert (tmp_path / "hframe_gym" / "agents").resolve() == tmp_path / "agents"
    commands.clear()
    tasks.main(["test"])
    assert commands == ["pytest -n auto --dist worksteal"]
    later = (tmp_path / ".venv" / ".installed").stat().st_mtime + 10.0
    os.utime(tmp_path / "constraints.txt", (later, later))
    commands.clear()
    tasks.main(["test"])
    assert len(commands) == 3
    commands.clear()
    tasks.main(["slow"])
    assert commands[-1] == "pytest -m slow --durations=10"


def test_a_failed_step_ends_the_task_with_its_exit_code(commands: list[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        tasks.main(["check"])
    assert stop.value.code == 3
    assert commands[-1] == "ruff format --check ."


def test_the_torch_of_the_installation_is_the_pinned_one() -> None:
    pinned = re.search(r"^torch==(\S+)$", (ROOT / "constraints.txt").read_text("utf-8"), re.MULTILINE)
    assert pinned is not None
    assert tasks.PACKAGES[0] == (f"torch=={pinned[1]}",)
