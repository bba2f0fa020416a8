"""Run tests as on an operating system without POSIX: `python -m pytest -p tests.without_posix`.

The project's code, and that of its tests, finds neither the modules nor the names that only POSIX systems have
(`fcntl`, `os.fork`, `signal.SIGKILL`, ...), and processes start by `spawn` only. This is not Windows: paths, file
locks and the console remain those of this system.
"""

from . import sitecustomize

__all__ = ["sitecustomize"]
