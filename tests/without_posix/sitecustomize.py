"""Hide from the project's code what only POSIX systems have, in this process and in those that it starts.

Python imports a module of this name at its start if its folder is on PYTHONPATH. What the standard library and other
packages import is not changed: on Windows they have their own implementations.
"""

from __future__ import annotations

import builtins
import multiprocessing
import multiprocessing.context
import os
import select
import signal
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

FOLDER = Path(__file__).resolve().parent
ROOT = FOLDER.parents[1]
# https://docs.python.org/3/library: "Availability: Unix" or "not Windows"
MODULES = frozenset(
    [
        "crypt",
        "fcntl",
        "grp",
        "nis",
        "ossaudiodev",
        "posix",
        "pty",
        "pwd",
        "readline",
        "resource",
        "spwd",
        "syslog",
        "termios",
        "tty",
    ]
)
_OS = """
    chown chroot ctermid fchdir fchmod fchown fdatasync fork forkpty fpathconf fstatvfs fwalk getegid geteuid getgid
    getgrouplist getgroups getloadavg getpgid getpgrp getpriority getresgid getresuid getsid getuid getxattr initgroups
    killpg lchown listxattr lockf major makedev memfd_create minor mkfifo mknod nice openpty pathconf pipe2
    posix_fadvise posix_fallocate posix_spawn posix_spawnp pread preadv pwrite pwritev readv register_at_fork
    removexattr sched_getaffinity sched_getparam sched_getscheduler sched_setaffinity sched_yield sendfile setegid
    seteuid setgid setgroups setpgid setpriority setregid setresgid setresuid setreuid setsid setuid setxattr statvfs
    sync sysconf tcgetpgrp tcsetpgrp ttyname uname wait wait3 wait4 waitid writev
    O_ASYNC O_CLOEXEC O_DIRECT O_DIRECTORY O_DSYNC O_NOATIME O_NOCTTY O_NOFOLLOW O_NONBLOCK O_PATH O_RSYNC O_SYNC
    O_TMPFILE ST_RDONLY
"""
_SIGNAL = """
    SIGALRM SIGBUS SIGCHLD SIGCONT SIGHUP SIGIO SIGKILL SIGPIPE SIGPROF SIGQUIT SIGSTOP SIGTSTP SIGTTIN SIGTTOU SIGUSR1
    SIGUSR2 SIGVTALRM SIGWINCH SIGXCPU SIGXFSZ alarm getitimer pause pthread_kill pthread_sigmask setitimer
    siginterrupt sigpending sigwait
"""
NAMES: Mapping[str, frozenset[str]] = {
    "os": frozenset(_OS.split()),
    "signal": frozenset(_SIGNAL.split()),
    "time": frozenset(("tzset", "pthread_getcpuclockid", "clock_getres", "clock_gettime")),
    "select": frozenset(("poll", "epoll", "kqueue")),
}


class _Partial(ModuleType):
    """A module without some of its names; what is set on it is set on the module."""

    def __init__(self, module: ModuleType, absent: frozenset[str]) -> None:
        super().__init__(module.__name__)
        object.__setattr__(self, "_hidden", (module, absent))

    def __getattribute__(self, name: str) -> Any:
        module, absent = object.__getattribute__(self, "_hidden")
        if name in absent:
            raise AttributeError(f"module {module.__name__!r} has no attribute {name!r} (without POSIX)")
        return getattr(module, name)

    def __setattr__(self, name: str, value: object) -> None:
        setattr(object.__getattribute__(self, "_hidden")[0], name, value)

    def __delattr__(self, name: str) -> None:
        delattr(object.__getattribute__(self, "_hidden")[0], name)


PARTIAL = {module.__name__: _Partial(module, NAMES[module.__name__]) for module in (os, select, signal, time)}
_import = builtins.__import__


def _is_ours(scope: Mapping[str, Any] | None) -> bool:
    """Return whether the code that imports something is the project's."""
    file = (scope or {}).get("__file__")
    if not file:  # a command line with -c
        return (scope or {}).get("__name__") == "__main__"
    path = os.path.realpath(file)
    return path.startswith(f"{ROOT}{os.sep}") and f"{os.sep}.venv{os.sep}" not in path and "site-packages" not in path


def _import_without_posix(
    name: str,
    globals: Mapping[str, Any] | None = None,
    locals: Mapping[str, Any] | None = None,
    fromlist: Sequence[str] | None = (),
    level: int = 0,
) -> ModuleType:
    """Import a module as `__import__` does, for the project's code without what only POSIX systems have."""
    top = name.partition(".")[0]
    if level == 0 and (top in MODULES or top in PARTIAL) and _is_ours(globals):
        if top in MODULES:
            raise ModuleNotFoundError(f"No module named {name!r} (without POSIX)", name=name)
        if name == top or not fromlist:
            return PARTIAL[top]
    return _import(name, globals, locals, fromlist or (), level)


def install() -> None:
    """Hide the names in this process and, by PYTHONPATH, in those that it starts; leave only the start method spawn."""
    builtins.__import__ = _import_without_posix  # type: ignore[assignment]
    contexts: dict[str, Any] = multiprocessing.context._concrete_contexts  # type: ignore[attr-defined]
    for method in ("fork", "forkserver"):
        contexts.pop(method, None)
    multiprocessing.set_start_method("spawn", force=True)
    if str(FOLDER) not in os.environ.get("PYTHONPATH", "").split(os.pathsep):
        paths = [str(FOLDER), *filter(None, [os.environ.get("PYTHONPATH")])]
        os.environ["PYTHONPATH"] = os.pathsep.join(paths)
    sys.modules.setdefault("sitecustomize", sys.modules[__name__])


install()
