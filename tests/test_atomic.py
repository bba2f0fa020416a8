"""Atomic files and folders: a failed or interrupted write leaves the old output or the new one, and no trace."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from hframe_gym import atomic_files, locked_folders
from hframe_gym.atomic_files import atomic_file, newest, output_batch, remove_file, write_text
from hframe_gym.errors import InputError
from hframe_gym.locked_folders import complete_commit, locked_folder, scratch_folder

OLD = {"a.txt": "old a", "gone.txt": "old", "plots/p.txt": "old plot"}
NEW = {"a.txt": "new a", "added.txt": "new", "plots/p.txt": "new plot"}


def contents(folder: Path) -> dict[str, str]:
    """Return the text of every file below a folder, hidden ones included, by its relative path."""
    return {str(p.relative_to(folder)): p.read_text() for p in sorted(folder.rglob("*")) if p.is_file()}


def write_old(folder: Path) -> None:
    for name, text in OLD.items():
        write_text(folder / name, text)


def write_new(folder: Path) -> None:
    with output_batch(folder):
        for name, text in NEW.items():
            write_text(folder / name, text)
        remove_file(folder / "gone.txt")


@pytest.fixture(params=["without names", "with names"])
def _unnamed(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Run a test as on Linux, and as where files need names from the beginning."""
    if request.param == "with names":
        monkeypatch.setattr(os, "O_TMPFILE", 0)  # opening a folder for writing then fails with EISDIR


@pytest.mark.usefixtures("_unnamed")
def test_a_failed_write_keeps_the_old_file_and_leaves_no_temporary_file(tmp_path: Path) -> None:
    path = tmp_path / "out.txt"
    write_text(path, "old")

    def fail() -> None:
        with atomic_file(path) as file:
            file.write(b"half")
            raise RuntimeError

    with pytest.raises(RuntimeError):
        fail()
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.usefixtures("_unnamed")
def test_a_file_is_written_into_a_new_folder_and_is_readable_by_others(tmp_path: Path) -> None:
    path = tmp_path / "new" / "out.txt"
    old = os.umask(0o022)
    write_text(path, "text µ")
    os.umask(old)
    assert path.read_text(encoding="utf-8") == "text µ"
    assert path.stat().st_mode & 0o777 == 0o644
    assert list(path.parent.iterdir()) == [path]


@pytest.mark.parametrize("make", [Path.mkdir, os.mkfifo])
def test_what_is_no_regular_file_is_not_replaced(make: Callable[[Path], None], tmp_path: Path) -> None:
    """A device, for example: `--json /dev/null` of an administrator must not replace it."""
    path = tmp_path / "special"
    make(path)
    before = path.stat().st_mode
    with pytest.raises(InputError, match="special: is no regular file"):
        write_text(path, "text")
    assert path.stat().st_mode == before


@pytest.mark.usefixtures("_unnamed")
def test_a_batch_appears_at_its_end_and_can_be_read_before(tmp_path: Path) -> None:
    write_old(tmp_path)
    with output_batch(tmp_path):
        with output_batch(tmp_path / "plots"):  # joins the outer one
            write_text(tmp_path / "plots" / "p.txt", "new plot")
        write_text(tmp_path / "a.txt", "first")
        write_text(tmp_path / "a.txt", "new a")
        assert newest(tmp_path / "a.txt").read_text() == "new a"
        assert (tmp_path / "a.txt").read_text() == "old a"
    assert contents(tmp_path) == OLD | {"a.txt": "new a", "plots/p.txt": "new plot"}
    write_old(tmp_path)
    write_new(tmp_path)
    assert contents(tmp_path) == NEW


@pytest.mark.usefixtures("_unnamed")
def test_an_error_in_a_batch_leaves_the_old_output(tmp_path: Path) -> None:
    write_old(tmp_path)

    def fail() -> None:
        with output_batch(tmp_path):
            write_text(tmp_path / "a.txt", "new a")
            remove_file(tmp_path / "gone.txt")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fail()
    assert contents(tmp_path) == OLD


@pytest.mark.usefixtures("_unnamed")
def test_a_batch_of_more_files_than_may_be_open(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(atomic_files, "_MAX_OPEN", 3)
    expected = {f"{i}.txt": str(i) for i in range(8)}
    with output_batch(tmp_path):
        for name, text in expected.items():
            write_text(tmp_path / name, text)
    assert contents(tmp_path) == expected


def _write_new_until(folder: Path, calls: int) -> int:
    """Write the new output in a child process that ends at one of its system calls; return the child's exit code."""
    child = os.fork()
    if child:
        return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    left = calls

    def counted(function: Callable[..., Any]) -> Callable[..., Any]:
        def call(*arguments: Any, **keywords: Any) -> Any:
            nonlocal left
            left -= 1
            if left == 0:
                os._exit(9)  # like kill -9: no cleanup runs
            return function(*arguments, **keywords)

        return call

    for name in ("open", "link", "rename", "replace", "unlink", "rmdir", "mkdir", "fsync"):
        setattr(os, name, counted(getattr(os, name)))
    try:
        write_new(folder)
    finally:
        os._exit(0)


@pytest.mark.integration
@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")
def test_a_kill_at_every_system_call_leaves_the_old_or_the_new_output(tmp_path: Path) -> None:
    states, code = [], 9
    while code:
        folder = tmp_path / str(len(states))
        write_old(folder)
        code = _write_new_until(folder, len(states) + 1)
        complete_commit(folder)
        with locked_folder(folder):
            pass
        state = contents(folder)
        assert state in (OLD, NEW), len(states)
        states.append(state == NEW)
    assert states == sorted(states)  # old before the commit, new after it
    assert states.count(False) > 10
    assert states.count(True) > 3  # some kills were between the commit and the last move


def test_a_second_process_is_refused_until_the_first_one_is_killed(tmp_path: Path) -> None:
    code = (
        f"import time\nfrom hframe_gym.locked_folders import locked_folder\n"
        f"with locked_folder({str(tmp_path)!r}):\n print('locked', flush=True)\n time.sleep(60)"
    )
    root = Path(__file__).parents[1]
    environment = os.environ | {"PYTHONPATH": str(root)}
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True, env=environment) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "locked\n"
        with (
            pytest.raises(InputError, match="another hframe command is writing to this folder"),
            locked_folder(tmp_path),
        ):
            pass
        process.kill()
    with locked_folder(tmp_path):  # no stale lock
        pass
    assert list(tmp_path.iterdir()) == []


def test_remains_of_a_killed_process_are_removed_but_not_those_of_a_living_one(tmp_path: Path) -> None:
    (tmp_path / ".hframe-new-dead").write_text("half")
    (tmp_path / ".hframe-new-folder" / "new").mkdir(parents=True)
    living = atomic_files._NewFile(tmp_path, tmp_path / "b.txt")
    living.move_to(tmp_path / ".hframe-new-living")
    with locked_folder(tmp_path):
        assert [p.name for p in tmp_path.iterdir()] == [".hframe-new-living"]
    living.close()
    with locked_folder(tmp_path):
        assert list(tmp_path.iterdir()) == []


def test_a_new_folder_without_output_is_removed(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="input"), locked_folder(tmp_path / "a" / "b"):
        raise ValueError("input")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("write", [write_new, lambda folder: write_text(folder / "a.txt", "new")])
def test_a_full_disk_is_reported_with_the_path_and_leaves_the_old_output(
    write: Callable[[Path], None], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(descriptor: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    write_old(tmp_path)
    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space left") as caught:
        write(tmp_path)
    assert str(caught.value.filename).startswith(str(tmp_path))
    assert ".hframe" not in caught.value.filename
    assert contents(tmp_path) == OLD


def test_scratch_folders_of_killed_processes_are_removed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    with scratch_folder() as living:
        dead = living.with_name(living.name + "dead")
        (dead / "data").mkdir(parents=True)
        with scratch_folder():
            assert living.is_dir()
            assert not dead.exists()
    assert list(tmp_path.iterdir()) == []


def test_a_commit_is_not_completed_while_its_process_lives(tmp_path: Path) -> None:
    commit = tmp_path / ".hframe-commit" / "new"
    commit.mkdir(parents=True)
    (commit / "a.txt").write_text("new")
    descriptor = os.open(tmp_path, os.O_RDONLY)
    assert locked_folders.lock(descriptor)
    complete_commit(tmp_path)
    assert (commit / "a.txt").exists()
    os.close(descriptor)
    complete_commit(tmp_path)
    assert contents(tmp_path) == {"a.txt": "new"}
