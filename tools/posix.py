"""Benchmarks and tools that kill, limit or measure processes as only POSIX systems can."""

from __future__ import annotations

import sys


def require_posix(program: str) -> None:
    """End a program with one line where there is no POSIX; docs/platforms.md says which programs need it.

    Args:
        program: Name of the program's module, for the message.

    Raises:
        SystemExit: If the module `resource` is missing, as on Windows.
    """
    try:
        import resource  # noqa: F401
    except ImportError:
        sys.exit(
            f"python -m {program}: this system has no module `resource`, with which it limits and measures "
            "processes; run it on Linux, or in the Windows Subsystem for Linux (docs/platforms.md)"
        )


def peak_megabytes() -> float:
    """Return the largest resident memory that this process has had so far, MB; on Linux."""
    import resource

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024e-6
