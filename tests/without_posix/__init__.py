"""Plugin of pytest for tests as on a system without POSIX: `python -m pytest -p tests.without_posix`.

The project's code, and that of its tests, finds neither the modules nor the names that only POSIX systems
have (`fcntl`, `os.fork`, `signal.SIGKILL`, ...), and processes start by `spawn` only. This is not Windows:
paths, file locks and the console remain those of this system.
"""

from __future__ import annotations

import sys
from pathlib import Path


def pytest_load_initial_conftests() -> None:
    """Hide the names before the tests import the package."""
    sys.path.insert(0, str(Path(__file__).parent))  # processes that tests start have it on PYTHONPATH
    from hide_posix import install

    install()
