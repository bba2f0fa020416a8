"""What differs between Linux, macOS and Windows: cores, folders for a user's files, quotation marks of the shell."""

from __future__ import annotations

import os
import shlex
import signal
import subprocess
import sys
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

# Environment variable and default below the user's folder, by kind of files and by the beginning of `sys.platform`.
_FOLDERS = {
    "cache": {
        "win32": ("LOCALAPPDATA", "AppData/Local"),
        "darwin": ("", "Library/Caches"),
        "": ("", ".cache"),
    },
    "data": {
        "win32": ("LOCALAPPDATA", "AppData/Local"),
        "darwin": ("", "Library/Application Support"),
        "": ("", ".local/share"),
    },
}


def cores() -> int:
    """Return the number of cores that this process may use, at least 1; evaluated once per process."""
    return _cores(os.getpid())


@lru_cache(maxsize=1)
def _cores(process: int) -> int:
    """Return the number of cores that this process may use."""
    if hasattr(os, "process_cpu_count"):  # Python 3.13
        return os.process_cpu_count() or 1
    if hasattr(os, "sched_getaffinity"):  # neither macOS nor Windows
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def user_folder(
    kind: Literal["cache", "data"], system: str = sys.platform, variables: Mapping[str, str] | None = None
) -> Path:
    """Return the folder in which programs keep files of the present user; it need not exist.

    Args:
        kind: "cache" for files that can be made again, "data" for others.
        system: Operating system as in `sys.platform`.
        variables: Environment variables. Default: those of this process.

    Returns:
        `$XDG_CACHE_HOME` or `$XDG_DATA_HOME` where it is set; else, for "cache", ~/.cache on Linux, ~/Library/Caches on
        macOS, `%LOCALAPPDATA%` on Windows; for "data", ~/.local/share, ~/Library/Application Support, `%LOCALAPPDATA%`.
    """
    variables = os.environ if variables is None else variables
    variable, below_home = _FOLDERS[kind].get(system, _FOLDERS[kind][""])
    chosen = variables.get(f"XDG_{kind.upper()}_HOME") or variables.get(variable)
    return Path(chosen) if chosen else Path(os.path.expanduser("~")) / below_home


def own_group() -> dict[str, Any]:
    """Return the arguments of `subprocess.Popen` with which `interrupt` reaches a process alone."""
    return {"creationflags": getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0)}


def interrupt(process: subprocess.Popen[str]) -> None:
    """Send a process that was started with `own_group` what Ctrl-C on its terminal would send."""
    process.send_signal(getattr(signal, "CTRL_BREAK_EVENT", signal.SIGINT))


def quoted(word: str, system: str = sys.platform) -> str:
    """Quote a word of a command that a message proposes, such as a path, as the shell of a system needs it."""
    return subprocess.list2cmdline([word]) if system == "win32" else shlex.quote(word)
