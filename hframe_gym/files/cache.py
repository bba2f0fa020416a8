"""Find the folder in which generated simulation code and its compiled form are cached."""

from __future__ import annotations

import getpass
import os
import shutil
import stat
import tempfile
import warnings
from functools import lru_cache
from pathlib import Path

from ..operating_system import user_folder

_CACHE_ROOM = 32e6  # bytes that must be free; a kernel takes about 50 kB, Numba's code of all loops 2 MB


def cache_folder() -> Path:
    """Return the folder in which generated simulation code and its compiled form are kept; create it.

    It is the first of these folders that can be written and has 32 MB of room: `$HFRAME_CACHE` (if set),
    `hframe_gym` in the user's cache folder, a private folder in the system's temporary folder. If none is
    usable, it is a new temporary folder. If it is not the first one, a warning is issued.

    Returns:
        Existing folder that can be written.
    """
    explicit = os.environ.get("HFRAME_CACHE")
    usual = str(user_folder("cache") / "hframe_gym")
    return _first_usable(
        (explicit, usual) if explicit else (usual,), f"{tempfile.gettempdir()}/{_private_name()}"
    )


def _private_name() -> str:
    """Return a name for a folder of this user in a temporary folder that users may share."""
    return f"hframe_gym-{os.getuid() if hasattr(os, 'getuid') else getpass.getuser()}"


@lru_cache
def _first_usable(preferred: tuple[str, ...], temporary: str) -> Path:
    """Return the first folder that can be written and has room, and warn if it is not the preferred one."""
    for folder in (*preferred, temporary):
        path = Path(folder)
        try:
            path.mkdir(parents=True, exist_ok=True, mode=0o700 if folder == temporary else 0o755)
            free = shutil.disk_usage(path).free
            # Windows knows only in this way whether a folder can be written.
            with tempfile.TemporaryFile(dir=path):
                pass
        except OSError:
            continue
        if free > _CACHE_ROOM and (folder != temporary or _private(path)):
            break
    else:
        path = Path(tempfile.mkdtemp(prefix="hframe_gym-"))
    if str(path) != preferred[0]:
        problem = f"{preferred[0]} cannot be written or is full; compiled code is cached in {path}"
        advice = "Set HFRAME_CACHE to a folder that stays, so that later runs start quickly"
        warnings.warn(f"{problem}. {advice}", RuntimeWarning, stacklevel=2)
    return path


def _private(path: Path) -> bool:
    """Return whether this user alone can write a folder in the temporary folder: its code is executed."""
    if not hasattr(os, "getuid"):
        return True  # each user of Windows has a temporary folder
    details = path.lstat()
    return stat.S_ISDIR(details.st_mode) and details.st_uid == os.getuid() and not details.st_mode & 0o077
