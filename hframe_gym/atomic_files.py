"""Write files so that a reader finds either the complete new file or the old one, never a part."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def atomic_file(path: str | Path) -> Iterator[Path]:
    """Provide a temporary path to write to, and move it to `path` when the `with` block ends without an error.

    Args:
        path: File to write; its folder is created if necessary.

    Yields:
        Path of an empty temporary file in the same folder, with the same suffix. If the block raises an error, the
        temporary file is deleted and an existing file at `path` is unchanged.

    Raises:
        OSError: If the folder cannot be created or written.
    """
    target = Path(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(dir=target.parent, prefix=f".{target.name}-", suffix="".join(target.suffixes))
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        temporary.chmod(0o644)  # mkstemp makes files that only their owner can read
        os.replace(temporary, target)
    finally:
        temporary.unlink(missing_ok=True)


def write_text(path: str | Path, text: str) -> None:
    """Write a text file in UTF-8; if writing fails, an existing file is unchanged.

    Args:
        path: File to write; its folder is created if necessary.
        text: Content of the file.

    Raises:
        OSError: If the folder cannot be created or written.
    """
    with atomic_file(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
