"""Folder in which compiled code is kept between processes."""

from __future__ import annotations

import os
import shutil
import tempfile
import warnings
from functools import lru_cache
from pathlib import Path

_CACHE_ROOM = 32e6  # bytes that must be free; a kernel takes about 50 kB, Numba's code of all loops 2 MB


def cache_folder() -> Path:
    """Return the folder in which generated simulation code and its compiled form are cached; create it if missing.

    It is the first of these folders that can be written and has 32 MB of room: `$HFRAME_CACHE` (if set), `hframe_gym`
    in the user's cache folder, a private folder in the system's temporary folder. If none is usable, it is a new
    temporary folder. A warning is issued if it is not the first one.

    Returns:
        Existing folder that can be written.
    """
    explicit = os.environ.get("HFRAME_CACHE")
    root = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    preferred = (explicit, f"{root}/hframe_gym") if explicit else (f"{root}/hframe_gym",)
    return _first_usable(preferred, f"{tempfile.gettempdir()}/hframe_gym-{os.getuid()}")


@lru_cache
def _first_usable(preferred: tuple[str, ...], temporary: str) -> Path:
    """Return the first folder that can be written and has room, and warn if it is not the preferred one."""
    for folder in (*preferred, temporary):
        path = Path(folder)
        try:
            path.mkdir(parents=True, exist_ok=True, mode=0o700 if folder == temporary else 0o755)
            details, free = path.lstat(), shutil.disk_usage(path).free
        except OSError:
            continue
        # The code in it is executed: in the shared temporary folder it must belong to this user alone.
        private = details.st_uid == os.getuid() and not details.st_mode & 0o077
        if os.access(path, os.W_OK) and free > _CACHE_ROOM and (private or folder != temporary):
            break
    else:
        path = Path(tempfile.mkdtemp(prefix="hframe_gym-"))
    if str(path) != preferred[0]:
        problem = f"{preferred[0]} cannot be written or is full; compiled code is cached in {path}"
        advice = "Set HFRAME_CACHE to a folder that stays, so that later runs start quickly"
        warnings.warn(f"{problem}. {advice}", RuntimeWarning, stacklevel=2)
    return path
