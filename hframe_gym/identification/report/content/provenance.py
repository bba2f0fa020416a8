"""Where a result comes from: when it was made, from which files, and with which version.

No name of a user: pages of results are passed on.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

from ....version import NAME_AND_VERSION
from .document import File, Made


def provenance(files: Sequence[Path]) -> Made:
    """Return the origin of a result: the present time, the version of the package and the recordings' files.

    Args:
        files: Files of the recordings, of which name, size in bytes and SHA-256 are stated; those that do not
            exist are left out. Empty if the recordings come from no files.
    """
    return Made(
        software=NAME_AND_VERSION,
        time=datetime.now(UTC).isoformat(timespec="seconds"),
        files=[_description(path) for path in files if path.is_file()],
    )


def _description(path: Path) -> File:
    """Return the name, size and hash of a file."""
    with path.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256")
    return File(name=path.name, bytes=path.stat().st_size, sha256=digest.hexdigest())
