"""Write files that belong together, also those that a worker process has made."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TypeVar

from ..errors import InputError
from .atomic import atomic_file, output_batch, scratch_folder

Result = TypeVar("Result")


def output_folder(path: str | Path) -> Path:
    """Check the value of the option --out: return it as the path of a folder, which may not exist yet.

    Raises:
        InputError: If the path is a file.
    """
    folder = Path(path)
    if folder.exists() and not folder.is_dir():
        raise InputError(f"--out {folder}: is a file, but must be a folder")
    return folder


def files_of(write: Callable[[Path], Result]) -> tuple[Result, dict[str, bytes]]:
    """Run a function that writes files to a temporary folder; return its result and the files' contents.

    A worker process must not write to the folders of its caller. It returns the contents by relative path,
    and the calling process writes them with `write_files`.
    """
    with scratch_folder() as scratch:
        folder = scratch / "files"  # the scratch folder itself is locked
        folder.mkdir()
        result = write(folder)
        paths = sorted(path for path in folder.rglob("*") if path.is_file())
        return result, {str(path.relative_to(folder)): path.read_bytes() for path in paths}


def write_files(folder: str | Path, files: Mapping[str, bytes]) -> None:
    """Write contents, by relative path, to files of a folder; all files appear together, or none does.

    The folder is created if it does not exist. Existing files of these names are replaced, others stay.

    Raises:
        InputError: If another process writes to the folder.
        OSError: If the folder cannot be written, or the disk is full.
    """
    with output_batch(folder):
        for name, content in files.items():
            with atomic_file(Path(folder) / name) as file:
                file.write(content)
