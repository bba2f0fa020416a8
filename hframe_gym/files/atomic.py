"""Write files so that a reader finds either the complete new file or the old one, and one writer per folder.

New files are written in a hidden folder beside the output, the stage, and get their names when they are
complete. A stage has a lock, which the operating system releases when the process ends for any reason: a
stage without a locked lock was left by a killed process. Everything here works on Linux, macOS and Windows.
"""

from __future__ import annotations

import errno
import io
import os
import secrets
import shutil
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from contextvars import ContextVar
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from ..errors import InputError

if TYPE_CHECKING:
    from filelock import BaseFileLock

STAGE = ".hframe"  # the stage of a locked folder; that of a single file is .hframe-NAME
_SCRATCH = "hframe_gym-scratch-"
_POLL_S = 0.01  # a file that another process writes is free after milliseconds
# Virus scanners and indexers of Windows open new files for less than this; meanwhile these cannot be moved.
_SCANNER_S = 1.0
_ATTEMPTS = 20  # to make a folder that other processes remove


class _Stage:
    """Hidden folder with a lock, for files that are not complete or have not got their names yet.

    `new` and `removed` mirror the relative paths of the files that will be written and removed. The file
    `complete` appears when all of them are on the disk: from then on the changes count, and whoever has the
    lock finishes them.
    """

    def __init__(self, path: Path) -> None:
        self.path, self.lock, self.complete = path, path / "lock", path / "complete"
        self.new, self.removed = path / "new", path / "removed"

    @contextmanager
    def locked(self, *, wait: bool) -> Iterator[bool]:
        """Create and lock the folder, and remove it in the end; False if another process has locked it."""
        from filelock import FileLock, Timeout  # takes 50 ms, and most commands begin with reading

        lock, attempts = FileLock(self.lock), 0
        while not lock.is_locked:
            try:
                self.path.mkdir(parents=True, exist_ok=True)
                lock.acquire(timeout=-1 if wait else 0, poll_interval=_POLL_S)
            except Timeout:
                break
            except OSError as error:
                attempts += 1
                removed = isinstance(error, FileNotFoundError | FileExistsError) or _in_use(error)
                if not removed or attempts == _ATTEMPTS:
                    with suppress(OSError):  # not empty
                        self.path.rmdir()
                    raise
                time.sleep(_POLL_S)  # its former owner removes the folder in this moment
        try:
            yield lock.is_locked
        finally:
            if lock.is_locked:
                self._remove(lock)

    def _remove(self, lock: BaseFileLock) -> None:
        """Remove the folder, unless complete changes could not be finished, and end the lock."""
        self.discard()
        if not self.complete.exists():
            with suppress(OSError):  # Windows removes the file itself when the lock ends, and not before
                self.lock.unlink()  # not later: it may be another process's lock then
        lock.release()
        with suppress(OSError):  # not empty
            self.path.rmdir()

    def discard(self) -> None:
        """Remove what is not complete."""
        if self.complete.exists():
            return
        for path in self.path.glob("*"):
            if path.is_dir():
                shutil.rmtree(path, ignore_errors=True)
            elif path != self.lock:
                with suppress(OSError):
                    path.unlink()

    def commit(self, folder: Path) -> None:
        """Make the changes of a folder together: once `complete` exists, even if this process ends."""
        new, removed = _files(self.new), _files(self.removed)
        if not new and not removed:
            return
        for name in new:
            _with_parents(folder / name)
        for name in (*new, *removed):
            if (folder / name).exists():  # a file that cannot be replaced is found before the first one is
                _move(folder / name, folder / name)
        self.complete.touch()
        try:
            self.finish(folder)
        except BaseException:  # a signal: the changes count, so finish them
            self.finish(folder)
            raise

    def finish(self, folder: Path) -> None:
        """Finish complete changes of a folder; if a call is interrupted, the next one does the rest."""
        if not self.complete.exists():
            return
        new, removed = _files(self.new), _files(self.removed)
        # a folder from elsewhere could have a stage that changes files of this user
        for name in (*new, *removed):
            if not (folder / name).parent.resolve().is_relative_to(folder):
                raise InputError(f"{folder}: {name.parent} is a link out of this folder; delete {self.path}")
        for name in removed:
            (folder / name).unlink(missing_ok=True)
        for name in new:
            _move(self.new / name, _with_parents(folder / name))
        self.complete.unlink()
        self.discard()


class _Batch(NamedTuple):
    """The present `output_batch`: its folder, absolute, and the folder's stage."""

    folder: Path
    stage: _Stage


_BATCH: ContextVar[_Batch | None] = ContextVar("_BATCH", default=None)
_HELD: dict[Path, _Stage] = {}  # stages of the folders that this process has locked


def _in_batch(path: Path) -> tuple[_Stage, Path] | None:
    """Return the present batch's stage and a file's relative path, if there is a batch with the file."""
    batch = _BATCH.get()
    absolute = Path(os.path.abspath(path.parent.resolve() / path.name))
    if batch is None or not absolute.is_relative_to(batch.folder):
        return None
    return batch.stage, absolute.relative_to(batch.folder)


@contextmanager
def atomic_file(path: str | Path) -> Iterator[io.BufferedRandom]:
    """Provide a binary file that replaces the file at `path` when the `with` block ends without an error.

    Until then a reader sees the old file. If another process writes the same file, this one waits for it, so
    that the last one wins. Inside an `output_batch` of its folder, or of a folder above, the file appears
    only at the end of the batch.

    Args:
        path: File to write; its folder is created if it does not exist.

    Yields:
        Empty file, open for writing and reading. If the block raises an error, an existing file at `path` is
        unchanged.

    Raises:
        InputError: If `path` exists and is not a regular file, but a folder or a device, for example; or if
            Windows cannot replace it because it is open in another program.
        OSError: If the folder cannot be created or written, or the disk is full; the error names `path`.
    """
    target = Path(path)
    if target.exists() and not target.is_file():
        raise InputError(f"{path}: is no regular file, so it is not replaced; choose another name")
    found = _in_batch(target)
    with _naming(target, every=True), ExitStack() as cleanup:
        if found is not None:
            stage, final = found[0], _with_parents(found[0].new / found[1])
        else:
            # Names may have 255 bytes, that of the stage as well; files that share a stage only wait for each
            # other.
            stage, final = _Stage(_with_parents(target).parent / f"{STAGE}-{target.name[:50]}"), target
            cleanup.enter_context(stage.locked(wait=True))
            stage.discard()  # what a killed process left
        unfinished = stage.path / f"unfinished-{secrets.token_hex(4)}"
        cleanup.callback(unfinished.unlink, missing_ok=True)
        with unfinished.open("x+b") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        _move(unfinished, final)


def write_text(path: str | Path, text: str) -> None:
    """Write a text file in UTF-8; if writing fails, an existing file is unchanged.

    Inside an `output_batch` of its folder, or of a folder above, the file appears only at the end of the
    batch.

    Args:
        path: File to write; its folder is created if it does not exist.
        text: Content of the file; line ends are written as they are, on every operating system.

    Raises:
        InputError: If `path` exists and is not a regular file, but a folder or a device, for example; or if
            Windows cannot replace it because it is open in another program.
        OSError: If the folder cannot be created or written, or the disk is full; the error names `path`.
    """
    with atomic_file(path) as file:
        file.write(text.encode())


def remove_file(path: str | Path) -> None:
    """Remove a file if it exists.

    Inside an `output_batch` of its folder, or of a folder above, the file disappears only at the end of the
    batch.
    """
    target = Path(path)
    found = _in_batch(target)
    if found is None:
        target.unlink(missing_ok=True)
        return
    stage, name = found
    (stage.new / name).unlink(missing_ok=True)
    if target.exists():
        _with_parents(stage.removed / name).touch()


def newest(path: str | Path) -> Path:
    """Return a path from which a file's current content can be read, also while an `output_batch` writes it.

    A file that is written inside an `output_batch` does not appear under its name until the batch ends. Until
    then its content is in a temporary file.

    Returns:
        Path of the temporary file, valid until the batch ends, if the current `output_batch` has written the
        file; else `path`.
    """
    found = _in_batch(Path(path))
    if found is None or not (found[0].new / found[1]).exists():
        return Path(path)
    return found[0].new / found[1]


@contextmanager
def output_batch(folder: str | Path) -> Iterator[Path]:
    """Make the files that the `with` block writes to a folder appear together at its end, or none of them.

    It applies to files in the folder and its subfolders that are written with `atomic_file` or `write_text`,
    or removed with `remove_file`. The folder is locked until the block ends, so that no other process of this
    package writes to it. A batch of the same folder or of a subfolder within this block becomes part of this
    batch.

    Args:
        folder: Folder of the files; created if it does not exist.

    Yields:
        The folder.

    Raises:
        InputError: If another process writes to the folder, or Windows cannot replace a file because it is
            open in another program.
        OSError: If the folder cannot be created or written, or the disk is full.
    """
    if _in_batch(Path(folder)) is not None:
        yield Path(folder)
        return
    with locked_folder(folder):
        path = Path(folder).resolve()
        stage = _HELD[path]
        token = _BATCH.set(_Batch(path, stage))
        try:
            yield Path(folder)
            stage.commit(path)
        finally:
            _BATCH.reset(token)
            stage.discard()


@contextmanager
def locked_folder(folder: str | Path) -> Iterator[Path]:
    """Lock a folder during the `with` block, so that no other process of this package writes to it.

    The folder is created if it does not exist. What killed processes left in it is cleaned up first: complete
    changes are finished, everything else is removed. The lock also ends if this process is killed. A folder
    that was created here is removed again if it is still empty at the end. If this process has locked the
    folder already, the block does nothing.

    Yields:
        The folder.

    Raises:
        InputError: If another process has locked the folder.
        OSError: If the folder cannot be created or written.
    """
    path = Path(folder).resolve()
    if path in _HELD:
        yield Path(folder)
        return
    created = [p for p in (path, *path.parents) if not p.exists()]
    stage = _Stage(path / STAGE)
    try:
        with _naming(Path(folder)):
            _make_folder(path)
            with stage.locked(wait=False) as mine:
                if not mine:
                    problem = "another hframe command is writing to this folder; wait or choose another one"
                    raise InputError(f"{folder}: {problem}")
                stage.finish(path)
                stage.discard()
                _remove_stages(path, f"{STAGE}-")
                _HELD[path] = stage
                try:
                    yield Path(folder)
                finally:
                    del _HELD[path]
    finally:
        with suppress(OSError):  # not empty
            for new in created:
                new.rmdir()


def complete_commit(folder: str | Path) -> None:
    """Finish the file moves that a killed process left half done in a folder.

    `output_batch` writes the new files of a folder completely before it moves the first one to its name. If
    it is killed between two moves, the folder holds new files beside old ones. Call this function before you
    read files of a folder that belong together. It does nothing while a process has locked the folder.

    Raises:
        OSError: If there are files to move and the folder cannot be written.
    """
    path = Path(folder).resolve()
    stage = _Stage(path / STAGE)
    if path in _HELD or not stage.complete.exists():
        return
    with _naming(Path(folder)), stage.locked(wait=False) as mine:
        if mine:
            stage.finish(path)


@contextmanager
def scratch_folder() -> Iterator[Path]:
    """Provide an empty temporary folder and delete it at the end of the `with` block.

    It is for libraries that can only write to a path. Scratch folders that killed processes of the same user
    left are deleted at the beginning.

    Yields:
        Empty folder in the system's folder for temporary files.

    Raises:
        OSError: If the folder cannot be created.
    """
    _remove_stages(Path(tempfile.gettempdir()), _SCRATCH)
    stage = _Stage(Path(tempfile.mkdtemp(prefix=_SCRATCH)))
    with stage.locked(wait=True):  # wait: another process may just look whether the folder is still used
        stage.new.mkdir()
        yield stage.new


def _remove_stages(folder: Path, prefix: str) -> None:
    """Remove the stages of killed processes in a folder; those of others cannot be locked, so they stay."""
    for path in folder.glob(f"{prefix}*"):
        if path.is_symlink() or not path.is_dir():
            continue
        with suppress(OSError):
            path.rmdir()  # was left before it had a lock
        with suppress(OSError):
            if (path / "lock").is_file():
                with _Stage(path).locked(wait=False):
                    pass


def _files(folder: Path) -> list[Path]:
    """Return the relative paths of all files below a folder in a fixed order."""
    return sorted(path.relative_to(folder) for path in folder.rglob("*") if not path.is_dir())


def _move(source: Path, target: Path) -> None:
    """Give a file another name, replacing a file; moving a file to itself tells whether it can be moved."""
    deadline = time.monotonic() + _SCANNER_S
    while True:
        try:
            if source == target:
                os.rename(source, target)
            else:
                os.replace(source, target)
        except PermissionError as error:
            if not _in_use(error):
                raise
            if time.monotonic() > deadline:
                advice = "close it there and run the command again"
                raise InputError(
                    f"{target}: is open in another program, or write-protected; {advice}"
                ) from error
            time.sleep(_POLL_S)
        else:
            return


def _in_use(error: OSError) -> bool:
    """Return whether Windows refuses something because a file is open: access denied or sharing violation."""
    return getattr(error, "winerror", None) in (5, 32)


def _with_parents(path: Path) -> Path:
    """Create a file's folder, and the folders above it, where they do not exist; return the file's path."""
    _make_folder(path.parent)
    return path


def _make_folder(path: Path) -> None:
    """Create a folder and those above it where they do not exist; an error says which of them is a file."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError):
        file = next(p for p in (path, *path.parents) if p.exists() and not p.is_dir())
        raise NotADirectoryError(errno.ENOTDIR, "is a file, but must be a folder", str(file)) from None


@contextmanager
def _naming(path: Path, *, every: bool = False) -> Iterator[None]:
    """Let the operating system's errors name a path that users know, not a stage (every: or of none)."""
    try:
        yield
    except OSError as error:
        if STAGE in str(error.filename) or (every and error.filename is None):
            error.filename, error.filename2 = str(path), None
        raise
