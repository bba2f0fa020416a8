"""Folders for the output of commands: one writer at a time, and nothing left by processes that were killed.

The lock belongs to the open folder and not to a file in it, so that the operating system releases it when the process
ends for any reason. `atomic_files` collects the new files of a folder in a hidden subfolder, which becomes `COMMIT` by
one rename when all files are complete. From then on these files count as the folder's content. They are then moved to
their names; if a kill interrupts this, the next process that opens the folder completes it.
"""

from __future__ import annotations

import errno
import fcntl
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from .errors import InputError

COMMIT = ".hframe-commit"  # folder of complete new files, on their way to their names
UNFINISHED = ".hframe-new-"  # start of the names of files and folders that are not complete yet
_HELD: set[Path] = set()  # folders that this process has locked


@contextmanager
def locked_folder(folder: str | Path) -> Iterator[Path]:
    """Lock a folder during the `with` block, so that no other process of this package writes to it.

    The folder is created if it does not exist. What a killed process left in it is cleaned up first: complete files are
    moved to their names (`move_committed`), incomplete ones are removed. The lock also ends if this process is killed.
    A folder that was created here is removed again if it is still empty at the end. If this process has locked the
    folder already, the block does nothing.

    Args:
        folder: Folder for the output of a command.

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
    path.mkdir(parents=True, exist_ok=True)
    descriptor = os.open(path, os.O_RDONLY | os.O_DIRECTORY)
    try:
        if not lock(descriptor):
            raise InputError(f"{folder}: another hframe command is writing to this folder; wait or choose another one")
        if not os.access(path, os.W_OK):
            code = errno.EROFS if os.statvfs(path).f_flag & os.ST_RDONLY else errno.EACCES
            raise OSError(code, os.strerror(code), str(folder))
        _HELD.add(path)
        move_committed(path)
        _remove_remains(path)
        yield Path(folder)
    finally:
        _HELD.discard(path)
        with suppress(OSError):  # not empty
            for new in created:
                new.rmdir()
        os.close(descriptor)


def complete_commit(folder: str | Path) -> None:
    """Move the new files that a killed process left in the subfolder .hframe-commit to their names.

    `output_batch` writes the new files of a folder completely before it moves the first one. If it is killed between
    two moves, the folder holds new files beside old ones. Call this function before you read files of a folder that
    belong together. While any process has locked the folder, the function does nothing.

    Args:
        folder: Folder that `output_batch` may have written.

    Raises:
        OSError: If there are files to move and the folder cannot be written.
    """
    if not (Path(folder) / COMMIT).is_dir() or Path(folder).resolve() in _HELD:
        return
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        if lock(descriptor):
            move_committed(Path(folder))
    finally:
        os.close(descriptor)


@contextmanager
def scratch_folder() -> Iterator[Path]:
    """Provide an empty temporary folder; it is deleted at the end of the `with` block.

    It is for libraries that can write only to a path. Scratch folders that killed processes of the same user left are
    deleted at the beginning.

    Yields:
        Empty folder in the system's folder for temporary files.

    Raises:
        OSError: If the folder cannot be created.
    """
    prefix = f"hframe_gym-scratch-{os.getuid()}-"
    for path in Path(tempfile.gettempdir()).glob(f"{prefix}*"):
        with suppress(OSError):
            descriptor = os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
            try:
                if os.fstat(descriptor).st_uid == os.getuid() and lock(descriptor):
                    shutil.rmtree(path, ignore_errors=True)
            finally:
                os.close(descriptor)
    with tempfile.TemporaryDirectory(prefix=prefix, ignore_cleanup_errors=True) as name:
        descriptor = os.open(name, os.O_RDONLY | os.O_DIRECTORY)
        try:
            lock(descriptor)
            yield Path(name)
        finally:
            os.close(descriptor)


def lock(descriptor: int) -> bool:
    """Lock an open file or folder for this process, if no other process has locked it.

    Args:
        descriptor: File descriptor of the open file or folder; closing it ends the lock.

    Returns:
        True if this process now has the lock, or if the file system has no locks; False if another process has it.
    """
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:  # a file system without locks
        return True
    return True


def move_committed(folder: Path) -> None:
    """Complete the changes to a folder that `output_batch` has prepared in its subfolder .hframe-commit.

    For each file in .hframe-commit/removed, the file with the same relative path in the folder is deleted. Each file in
    .hframe-commit/new is moved to its relative path in the folder. If a call is interrupted, the next one does the
    rest. The caller has locked the folder.

    Args:
        folder: Folder that contains .hframe-commit; without this subfolder nothing happens.

    Raises:
        OSError: If the folder cannot be written.
    """
    commit = folder / COMMIT
    for marker in sorted((commit / "removed").rglob("*")):
        if not marker.is_dir():
            (folder / marker.relative_to(commit / "removed")).unlink(missing_ok=True)
    for file in sorted((commit / "new").rglob("*")):
        if not file.is_dir():
            file.replace(with_parents(folder / file.relative_to(commit / "new")))
    if commit.is_dir():
        shutil.rmtree(commit)


def with_parents(path: Path) -> Path:
    """Create the folder of a file, and the folders above it, where they do not exist.

    Args:
        path: Path of the file.

    Returns:
        The same path.

    Raises:
        OSError: If the folder cannot be created.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    return path


def _remove_remains(folder: Path) -> None:
    """Remove incomplete files and folders of killed processes; the folder is locked."""
    for path in folder.glob(f"{UNFINISHED}*"):
        if path.is_dir():
            shutil.rmtree(path, ignore_errors=True)
            continue
        with suppress(OSError), path.open("rb") as file:
            if lock(file.fileno()):
                path.unlink()
