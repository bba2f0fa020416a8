"""The commands as a user calls them: what tests of several commands share."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

Command = Callable[..., tuple[int, str, str]]

ROOT = Path(__file__).parents[2]
COMMANDS = (
    *("simulate", "import", "check", "identify", "report", "train", "evaluate", "play", "export"),
    *("machines", "effects", "kernel"),
)


def assert_refused(result: tuple[int, str, str], *fragments: str, code: int = 2) -> None:
    """Assert that a command failed with a code and one line on standard error that contains the fragments."""
    exit_code, _, err = result
    assert exit_code == code
    assert err.startswith("hframe: ")
    assert err.count("\n") == 1
    for fragment in fragments:
        assert fragment in err
