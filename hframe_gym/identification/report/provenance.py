"""Where a result comes from: when it was made, from which files, and with which version.

No name of a user: pages of results are passed on.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from ...version import __version__

_BLOCK = 1 << 20  # bytes read at once


def provenance(files: Sequence[Path]) -> dict[str, Any]:
    """Describe where a result that is written now comes from.

    Args:
        files: Files of the recordings; empty if the recordings come from no files.

    Returns:
        "software": package and version; "time": date and time of day in UTC, ISO 8601; "files": "name", "bytes" and
        "sha256" of each file that can be read.
    """
    return {
        "software": f"hframe_gym {__version__}",
        "time": datetime.now(UTC).isoformat(timespec="seconds"),
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
