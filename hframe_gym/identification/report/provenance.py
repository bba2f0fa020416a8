"""Where a result comes from: who made it, when, from which files, and with which version."""

from __future__ import annotations

import getpass
import hashlib
from collections.abc import Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

_BLOCK = 1 << 20  # bytes read at once


def provenance(files: Sequence[Path]) -> dict[str, Any]:
    """Describe where a result that is written now comes from.

    Args:
        files: Files of the recordings; empty if the recordings come from no files.

    Returns:
        "software": package and version; "time": date and time of day in UTC, ISO 8601; "by": name of the user on this
        computer, "" if it has none; "files": "name", "bytes" and "sha256" of each file that can be read.
    """
    try:
        user = getpass.getuser()
    except (KeyError, OSError, ImportError):  # a container may have no name for the user
        user = ""
    return {
        "software": f"hframe_gym {version('hframe_gym')}",
        "time": datetime.now(UTC).isoformat(timespec="seconds"),
        "by": user,
        "files": [_description(path) for path in files if path.is_file()],
    }


def _description(path: Path) -> dict[str, Any]:
    """Return the name, size and hash of a file."""
    digest, size = hashlib.sha256(), 0
    with path.open("rb") as file:
        while block := file.read(_BLOCK):
            digest.update(block)
            size += len(block)
    return {"name": path.name, "bytes": size, "sha256": digest.hexdigest()}
