"""Write files so that a reader finds either the complete new file or the old one, never a part.

On file systems with the flag `O_TMPFILE` (Linux), a file has no name while it is written: if the process is killed,
nothing is left behind. `output_batch` extends this to several files of a folder, which appear together;
`locked_folders` describes how.
"""

from __future__ import annotations

import errno
import fcntl
import io
import os
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from pathlib import Path

from .errors import InputError
from .locked_folders import COMMIT, UNFINISHED, locked_folder, move_committed, with_parents

_MAX_OPEN = 200  # files without names in a batch; processes may usually have 1024 open files
# Errors by which a file system says that it has no files without names.
_NO_UNNAMED_FILES = {errno.EOPNOTSUPP, errno.EINVAL, errno.EISDIR, errno.ENOENT}


class _NewFile:
    """A file that is written now and gets its name later.

    Args:
        folder: Existing folder on the file system of the target.
        target: Path that the file gets; errors name it.
    """

    def __init__(self, folder: Path, target: Path) -> None:
        self.target = target
        self._name: Path | None = None  # only where a file needs a name from the beginning
        try:
            self.stream = open(os.open(folder, getattr(os, "O_TMPFILE", 0) | os.O_RDWR, 0o666), "w+b")  # noqa: SIM115
        except OSError as error:
            if error.errno not in _NO_UNNAMED_FILES:
                raise _with_name(error, target) from None
            self._name = folder / f"{UNFINISHED}{secrets.token_hex(8)}"
            self.stream = self._name.open("x+b")
        with suppress(OSError):  # tells `locked_folder` that the file has a living owner
            fcntl.flock(self.stream, fcntl.LOCK_EX | fcntl.LOCK_NB)

    @property
    def readable(self) -> Path:
        """Path by which this process can read the content before the file has its name."""
        self.stream.flush()
        return self._name or Path(f"/proc/self/fd/{self.stream.fileno()}")

    def move_to(self, path: Path) -> None:
        """Give the file the name `path`, which must not exist, once its content is on the disk."""
        self.stream.flush()
        os.fsync(self.stream.fileno())
        if self._name is not None:
            self._name.rename(path)
            self._name = None
            return
        # Only with the descriptor of a folder does Python follow the link in /proc.
        folder = os.open(path.parent, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.link(self.readable, path.name, dst_dir_fd=folder, follow_symlinks=True)
        finally:
            os.close(folder)

    def close(self) -> None:
        """Release the file; without a name it disappears."""
        with suppress(OSError):  # a full disk was reported when the content was flushed
            self.stream.close()
        if self._name is not None:
            self._name.unlink(missing_ok=True)


class _Batch:
    """New and removed files of a folder that become visible together."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.files: dict[Path, _NewFile] = {}  # by the relative path in the folder
        self.removed: set[Path] = set()
        self._stage = folder / f"{UNFINISHED}{secrets.token_hex(8)}"

    def add(self, name: Path, file: _NewFile) -> None:
        """Take over a complete file; with very many of them, the first ones get a temporary name."""
        if name in self.files:
            self.files[name].close()
        self.files[name] = file
        self.removed.discard(name)
        if len(self.files) > _MAX_OPEN:
            file.move_to(with_parents(self._stage / "new" / name))
            file.close()

    def commit(self) -> None:
        """Make all changes visible by one rename, then move the files to their names."""
        try:
            for name in (*self.files, *self.removed):
                with_parents(self.folder / name)
            for name, file in self.files.items():
                if not file.stream.closed:
                    file.move_to(with_parents(self._stage / "new" / name))
            for name in self.removed:
                with_parents(self._stage / "removed" / name).touch()
            self._stage.rename(self.folder / COMMIT)
        except OSError as error:
            raise _with_name(error, self.folder) from None
        try:
            move_committed(self.folder)
        except BaseException:  # a signal: the changes are made, so finish them
            move_committed(self.folder)
            raise

    def close(self) -> None:
        """Release all files; those that are not committed disappear."""
        for file in self.files.values():
            file.close()
        shutil.rmtree(self._stage, ignore_errors=True)


_BATCH: ContextVar[_Batch | None] = ContextVar("_BATCH", default=None)


@contextmanager
def atomic_file(path: str | Path) -> Iterator[io.BufferedRandom]:
    """Provide a binary file to write to; it replaces the file at `path` when the `with` block ends without an error.

    Until then a reader sees the old file. Inside an `output_batch` of its folder, or of a folder above, the file
    appears only at the end of the batch.

    Args:
        path: File to write; its folder is created if it does not exist.

    Yields:
        Empty file, open for writing and reading. If the block raises an error, an existing file at `path` is unchanged.

    Raises:
        InputError: If `path` exists and is not a regular file, but a folder or a device, for example.
        OSError: If the folder cannot be created or written, or the disk is full; the error names `path`.
    """
    target = Path(path)
    if target.exists() and not target.is_file():
        raise InputError(f"{path}: is no regular file, so it is not replaced; choose another name")
    batch = _BATCH.get()
    name = _name_in(batch, target)
    if batch is None or name is None:
        target.parent.mkdir(parents=True, exist_ok=True)
    file = _NewFile(target.parent if batch is None or name is None else batch.folder, target)
    kept = False
    try:
        try:
            yield file.stream
            file.stream.flush()
            if batch is not None and name is not None:
                batch.add(name, file)
                kept = True
                return
            temporary = target.parent / f"{UNFINISHED}{secrets.token_hex(8)}"
            try:
                file.move_to(temporary)
                temporary.replace(target)
            finally:
                temporary.unlink(missing_ok=True)
        except OSError as error:
            raise _with_name(error, target) from error
    finally:
        if not kept:
            file.close()


def write_text(path: str | Path, text: str) -> None:
    """Write a text file in UTF-8; if writing fails, an existing file is unchanged.

    Inside an `output_batch` of its folder, or of a folder above, the file appears only at the end of the batch.

    Args:
        path: File to write; its folder is created if it does not exist.
        text: Content of the file.

    Raises:
        InputError: If `path` exists and is not a regular file, but a folder or a device, for example.
        OSError: If the folder cannot be created or written, or the disk is full; the error names `path`.
    """
    with atomic_file(path) as file:
        file.write(text.encode())


def remove_file(path: str | Path) -> None:
    """Remove a file if it exists.

    Inside an `output_batch` of its folder, or of a folder above, the file disappears only at the end of the batch.

    Args:
        path: File to remove.

    Raises:
        OSError: If the file cannot be removed.
    """
    target = Path(path)
    batch = _BATCH.get()
    name = _name_in(batch, target)
    if batch is None or name is None:
        target.unlink(missing_ok=True)
        return
    if name in batch.files:
        batch.files.pop(name).close()
    if target.exists():
        batch.removed.add(name)


def newest(path: str | Path) -> Path:
    """Return a path from which the current content of a file can be read, also while an `output_batch` writes it.

    A file that is written inside an `output_batch` does not appear under its name until the batch ends. Until then its
    content is in a temporary file.

    Args:
        path: Path of the file.

    Returns:
        Path of the temporary file, valid until the batch ends, if the present batch has written the file; else `path`.
    """
    batch = _BATCH.get()
    name = _name_in(batch, Path(path))
    return batch.files[name].readable if batch is not None and name in batch.files else Path(path)


@contextmanager
def output_batch(folder: str | Path) -> Iterator[Path]:
    """Make the files that the `with` block writes to a folder appear together at its end, or none of them.

    It applies to files in the folder and its subfolders that are written with `atomic_file` or `write_text`, or removed
    with `remove_file`. The folder is locked until the block ends, so that no other process of this package writes to
    it. A batch of the same folder or of a subfolder within this block becomes part of this batch.

    Args:
        folder: Folder of the files; created if it does not exist.

    Yields:
        The folder.

    Raises:
        InputError: If another process writes to the folder.
        OSError: If the folder cannot be created or written, or the disk is full.
    """
    if _name_in(_BATCH.get(), Path(folder)) is not None:
        yield Path(folder)
        return
    with locked_folder(folder):
        batch = _Batch(Path(folder).resolve())
        token = _BATCH.set(batch)
        try:
            yield Path(folder)
            _BATCH.reset(token)
            if batch.files or batch.removed:
                batch.commit()
        finally:
            if _BATCH.get() is batch:
                _BATCH.reset(token)
            batch.close()


def _name_in(batch: _Batch | None, path: Path) -> Path | None:
    """Return the path of a file relative to the folder of a batch, None if there is no batch or the file is outside."""
    if batch is None:
        return None
    absolute = Path(os.path.abspath(path.parent.resolve() / path.name))
    return absolute.relative_to(batch.folder) if absolute.is_relative_to(batch.folder) else None


def _with_name(error: OSError, path: Path) -> OSError:
    """Return an error of the operating system that names the path which the user knows."""
    if error.filename is None or UNFINISHED in str(error.filename) or str(error.filename).startswith("/proc/"):
        error.filename, error.filename2 = str(path), None
    return error
