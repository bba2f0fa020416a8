"""Atomic files and folders: a failed or interrupted write leaves the old or the new output, and no trace."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
import threading
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import pytest
from filelock import FileLock

from hframe_gym.errors import InputError
from hframe_gym.files import (
    atomic,
    atomic_file,
    complete_commit,
    locked_folder,
    newest,
    output_batch,
    remove_file,
    scratch_folder,
    write_text,
)
from tests.parallel.worker_tasks import write_repeatedly

OLD = {"a.txt": "old a", "gone.txt": "old", "plots/p.txt": "old plot"}
NEW = {"a.txt": "new a", "added.txt": "new", "plots/p.txt": "new plot"}


def contents(folder: Path) -> dict[str, str]:
    """Return the text of every file below a folder, hidden ones included, by its relative path."""
    return {p.relative_to(folder).as_posix(): p.read_text() for p in sorted(folder.rglob("*")) if p.is_file()}


def write_old(folder: Path) -> None:
    for name, text in OLD.items():
        write_text(folder / name, text)


def write_new(folder: Path) -> None:
    with output_batch(folder):
        for name, text in NEW.items():
            write_text(folder / name, text)
        remove_file(folder / "gone.txt")


@pytest.mark.parametrize("below", ["out.txt", "deep/out.txt"])
def test_a_file_where_a_folder_must_be_is_named(tmp_path: Path, below: str) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(NotADirectoryError, match="is a file, but must be a folder") as error:
        write_text(tmp_path / "file" / below, "")
    assert error.value.filename == str(tmp_path / "file")


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


def test_a_file_is_written_into_a_new_folder_and_is_readable_by_others(tmp_path: Path) -> None:
    path = tmp_path / "new" / "out.txt"
    old = os.umask(0o022)
    write_text(path, "text µ")
    os.umask(old)
    assert path.read_text(encoding="utf-8") == "text µ"
    assert path.stat().st_mode & 0o777 == 0o644
    assert list(path.parent.iterdir()) == [path]


@pytest.mark.parametrize(
    "make",
    [
        Path.mkdir,
        pytest.param(
            getattr(os, "mkfifo", None),
            marks=pytest.mark.skipif(
                not hasattr(os, "mkfifo"), reason="this system has no named pipes in folders"
            ),
        ),
    ],
)
def test_what_is_no_regular_file_is_not_replaced(make: Callable[[Path], None], tmp_path: Path) -> None:
    """A device, for example: `--json /dev/null` of an administrator must not replace it."""
    path = tmp_path / "special"
    make(path)
    before = path.stat().st_mode
    with pytest.raises(InputError, match="special: is no regular file"):
        write_text(path, "text")
    assert path.stat().st_mode == before


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


def _write_new_until(folder: Path, calls: int) -> int:
    """Write the new output in a child process that ends at a system call; return its exit code."""
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
@pytest.mark.skipif(
    not hasattr(os, "fork"), reason="forks a process for each system call at which it ends it"
)
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
        f"import time\nfrom hframe_gym.files import locked_folder\n"
        f"with locked_folder({str(tmp_path)!r}):\n print('locked', flush=True)\n time.sleep(60)"
    )
    root = Path(__file__).parents[2]
    environment = os.environ | {"PYTHONPATH": str(root)}
    with subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, text=True, env=environment
    ) as process:
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


def leave_stage(path: Path) -> None:
    """Write what a killed process leaves: a stage with a lock file that none has locked, and half a file."""
    (path / "new").mkdir(parents=True)
    (path / "lock").touch()
    (path / "new" / "a.txt").write_text("half")
    (path / "unfinished-1").write_text("half")


def test_remains_of_killed_processes_are_removed_but_not_those_of_living_ones(tmp_path: Path) -> None:
    leave_stage(tmp_path / ".hframe")
    leave_stage(tmp_path / ".hframe-b.txt")
    (tmp_path / ".hframe-my-notes").mkdir()
    (tmp_path / ".hframe-my-notes" / "note.txt").write_text("mine")
    with locked_folder(tmp_path):
        assert sorted(contents(tmp_path)) == [".hframe-my-notes/note.txt", ".hframe/lock"]
    assert contents(tmp_path) == {".hframe-my-notes/note.txt": "mine"}
    with atomic_file(tmp_path / "b.txt") as file:
        with locked_folder(tmp_path):
            pass
        file.write(b"living")
    assert (tmp_path / "b.txt").read_text() == "living"


def test_the_next_writer_of_a_file_removes_the_remains_of_a_killed_one(tmp_path: Path) -> None:
    leave_stage(tmp_path / ".hframe-out.csv")
    write_text(tmp_path / "out.csv", "new")
    assert contents(tmp_path) == {"out.csv": "new"}


def test_writers_of_one_file_wait_for_each_other(tmp_path: Path) -> None:
    path = tmp_path / "out.txt"
    with atomic_file(path) as first:
        second = threading.Thread(target=write_text, args=(path, "second"))
        second.start()
        second.join(0.2)
        assert second.is_alive()
        first.write(b"first")
    second.join(10.0)
    assert contents(tmp_path) == {"out.txt": "second"}


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


def test_scratch_folders_of_killed_processes_are_removed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    with scratch_folder() as living:
        dead = tmp_path / "hframe_gym-scratch-dead"
        leave_stage(dead)
        with scratch_folder():
            assert living.is_dir()
            assert not dead.exists()
    assert list(tmp_path.iterdir()) == []


def leave_commit(folder: Path) -> None:
    """Write what a process leaves that is killed between the commit of a batch and its first move."""
    leave_stage(folder / ".hframe")
    (folder / ".hframe" / "new" / "a.txt").write_text("new")
    (folder / ".hframe" / "removed").mkdir()
    (folder / ".hframe" / "removed" / "gone.txt").touch()
    (folder / ".hframe" / "complete").touch()


def test_a_commit_is_not_completed_while_its_process_lives(tmp_path: Path) -> None:
    write_old(tmp_path)
    leave_commit(tmp_path)
    with FileLock(tmp_path / ".hframe" / "lock"):
        complete_commit(tmp_path)
        assert contents(tmp_path).items() >= OLD.items()
    complete_commit(tmp_path)
    assert contents(tmp_path) == {"a.txt": "new", "plots/p.txt": "old plot"}


def test_the_next_writer_completes_the_commit_of_a_killed_process(tmp_path: Path) -> None:
    write_old(tmp_path)
    leave_commit(tmp_path)
    with output_batch(tmp_path):
        write_text(tmp_path / "added.txt", "new")
        assert (tmp_path / "a.txt").read_text() == "new"
    assert contents(tmp_path) == {"a.txt": "new", "added.txt": "new", "plots/p.txt": "old plot"}


def test_a_commit_from_elsewhere_changes_no_file_outside_its_folder(tmp_path: Path) -> None:
    """A folder that somebody sends may have any content, also a link to a folder of this user."""
    mine, folder = tmp_path / "mine", tmp_path / "sent"
    write_old(mine)
    (folder / ".hframe" / "removed" / "link").mkdir(parents=True)
    (folder / ".hframe" / "removed" / "link" / "gone.txt").touch()
    (folder / ".hframe" / "complete").touch()
    (folder / "link").symlink_to(mine)
    with pytest.raises(InputError, match="link is a link out of this folder; delete"):
        complete_commit(folder)
    assert contents(mine) == OLD


@pytest.mark.integration
def test_writers_that_create_and_remove_stages_at_once_disturb_nobody(tmp_path: Path) -> None:
    with ProcessPoolExecutor(4, mp_context=get_context("spawn")) as pool:
        results = list(pool.map(partial(write_repeatedly, tmp_path), range(4)))
    assert [whole for whole, _ in results] == [100] * 4
    assert max(refused for _, refused in results) < 100
    found = contents(tmp_path)
    assert set(found) == {"same.txt", "batch/a", "batch/b"}
    assert found["batch/a"] == found["batch/b"]


def windows_error(number: int) -> PermissionError:
    """Return the error by which Windows refuses to move a file that is open in another program."""
    error = PermissionError(errno.EACCES, "The process cannot access the file")
    error.winerror = number  # type: ignore[attr-defined]
    return error


@pytest.mark.parametrize("write", [write_new, lambda folder: write_text(folder / "a.txt", "new")])
def test_a_file_that_is_open_in_another_program_of_windows_is_named(
    write: Callable[[Path], None], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_old(tmp_path)
    for name in ("rename", "replace"):
        move = getattr(os, name)

        def refuse(source: Path, target: Path, move: Callable[..., None] = move) -> None:
            if Path(target) == tmp_path / "a.txt":
                raise windows_error(32)
            move(source, target)

        monkeypatch.setattr(os, name, refuse)
    monkeypatch.setattr(atomic, "_SCANNER_S", 0.05)
    with pytest.raises(
        InputError, match=r"a\.txt: is open in another program, or write-protected; close it there"
    ):
        write(tmp_path)
    assert contents(tmp_path) == OLD


def test_a_file_that_a_virus_scanner_opens_for_a_moment_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    refusals = [windows_error(5), windows_error(32)]
    replace = os.replace

    def scanned(source: Path, target: Path) -> None:
        if refusals:
            raise refusals.pop()
        replace(source, target)

    monkeypatch.setattr(os, "replace", scanned)
    write_text(tmp_path / "a.txt", "new")
    assert contents(tmp_path) == {"a.txt": "new"}


def test_a_file_named_like_a_stage_and_a_very_long_name(tmp_path: Path) -> None:
    names = ("output", "x" * 250, "lock", "new")
    with locked_folder(tmp_path):
        for name in names:
            write_text(tmp_path / name, name)
    assert contents(tmp_path) == {name: name for name in names}


def test_a_file_system_without_locks_is_written_with_a_warning(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fcntl = pytest.importorskip("fcntl", reason="only there, filelock uses flock")

    def missing(*_: object) -> None:
        raise OSError(errno.ENOSYS, os.strerror(errno.ENOSYS))

    monkeypatch.setattr(fcntl, "flock", missing)
    with pytest.warns(UserWarning, match="flock not supported"):
        write_new(tmp_path)
    assert contents(tmp_path) == NEW
