"""Files that appear complete or not at all."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def atomic_file(path: str | Path) -> Iterator[Path]:
    """Write a file through a temporary one that replaces it at the end.

    Args:
        path: File to write; its folder is created if necessary.

    Yields:
        A temporary path in the same folder, with the same ending. If the block raises an error, the temporary file is
        deleted and the old file stays.
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
    """Write a text file in UTF-8, completely or not at all.

    Args:
        path: File to write; its folder is created if necessary.
        text: Content.
    """
    with atomic_file(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
