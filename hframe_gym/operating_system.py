"""What differs between Linux, macOS and Windows: cores, memory, folders for users' files, quotation marks."""

from __future__ import annotations

import ctypes
import os
import shlex
import signal
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

# Environment variable and default below the user's folder, by kind of files and by the beginning of
# `sys.platform`.
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


# Options of `mallopt` of the GNU C library, and what it uses at most when it adapts them itself, bytes.
_RETURNED_ABOVE, _SEPARATE_ABOVE = -1, -3
_ADAPTED = {_SEPARATE_ABOVE: 32 << 20, _RETURNED_ABOVE: 64 << 20}
# Batches of predictions of usual runs take 1 to 60 MiB each, and a few of them exist at a time.
_KEPT = {_SEPARATE_ABOVE: 64 << 20, _RETURNED_ABOVE: 512 << 20}


@contextmanager
def reused_memory() -> Iterator[None]:
    """Let the process keep the memory of freed arrays for new arrays, as a context manager or a decorator.

    By default the GNU C library returns the memory of large arrays to the system at once. The system must
    clear every page before the next array gets it, which takes longer than the arithmetic of an array that is
    used a few times. At the end of the block the memory is returned. Other C libraries are left as they are.
    """
    library = ctypes.CDLL(None) if sys.platform == "linux" else None
    if library is None or not hasattr(library, "mallopt") or not hasattr(library, "malloc_trim"):
        yield
        return
    for option, size in _KEPT.items():
        library.mallopt(option, size)
    try:
        yield
    finally:
        for option, size in _ADAPTED.items():
            library.mallopt(option, size)
        library.malloc_trim(0)


def user_folder(
    kind: Literal["cache", "data"], system: str = sys.platform, variables: Mapping[str, str] | None = None
) -> Path:
    """Return the folder in which programs keep files of the current user; it may not exist yet.

    Args:
        kind: "cache" for files that can be made again, "data" for others.
        system: Operating system as in `sys.platform`.
        variables: Environment variables. Default: those of this process.

    Returns:
        `$XDG_CACHE_HOME` or `$XDG_DATA_HOME` where it is set; else, for "cache", ~/.cache on Linux,
        ~/Library/Caches on macOS, `%LOCALAPPDATA%` on Windows; for "data", ~/.local/share,
        ~/Library/Application Support, `%LOCALAPPDATA%`.
    """
    variables = os.environ if variables is None else variables
    variable, below_home = _FOLDERS[kind].get(system, _FOLDERS[kind][""])
    chosen = variables.get(f"XDG_{kind.upper()}_HOME") or variables.get(variable)
    return Path(chosen) if chosen else Path(os.path.expanduser("~")) / below_home


def own_group() -> dict[str, Any]:
    """Return arguments of `subprocess.Popen` that let `interrupt` stop the new process but not this one.

    On Windows, they create a process group for it; on other systems, they change nothing, because the
    signal of `interrupt` reaches only the new process there.
    """
    return {"creationflags": getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0)}


def interrupt(process: subprocess.Popen[str]) -> None:
    """Interrupt a process as Ctrl-C would; it must have been started with the arguments of `own_group`."""
    process.send_signal(getattr(signal, "CTRL_BREAK_EVENT", signal.SIGINT))


def quoted(word: str, system: str = sys.platform) -> str:
    """Quote a word, such as a path, for the system's shell, in a command that a message proposes."""
    return subprocess.list2cmdline([word]) if system == "win32" else shlex.quote(word)
