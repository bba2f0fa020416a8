"""The `hframe` command: read files, call the library, print.

Exit codes: 0 for success; 1 for an internal error, or if `hframe check` found a fault; 2 for invalid input,
with one line that says what is wrong and where.

Every module `*_commands` registers its commands with `app` when it is imported here.
"""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Callable
from functools import cache
from typing import Annotated, Any

import typer
from typer import Option

from ..version import NAME_AND_VERSION
from . import (
    app_commands,
    control_commands,
    export_commands,
    identify_commands,
    machine_commands,
    recording_commands,
)
from .application import app
from .messages import DEBUG_VARIABLE, FAULT_FOUND, describe_failure, print_warning
from .output import closed_output_tolerated, log

__all__ = [
    "app",
    "app_commands",
    "control_commands",
    "export_commands",
    "identify_commands",
    "machine_commands",
    "main",
    "recording_commands",
]


def _print_version(requested: bool) -> None:
    """Print the version and exit if --version is given."""
    if requested:
        log(NAME_AND_VERSION)
        raise typer.Exit


@app.callback()
def options(
    version: Annotated[
        bool, Option("--version", callback=_print_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    """H-frame stages: simulate, identify from measured data, train and evaluate controllers."""


@cache
def _command() -> Any:
    """Return the click command with all subcommands, which Typer would build again (20 ms) for each call."""
    return typer.main.get_command(app)


def main(interrupted: Callable[[], bool] = lambda: False) -> None:
    """Run the `hframe` command; an exception is printed as one line.

    With the environment variable `HFRAME_DEBUG` (`DEBUG_VARIABLE`), exceptions keep their traceback.

    Args:
        interrupted: Function that returns whether the process has received a signal to end (SIGINT, SIGTERM);
            an exception is then raised and not printed.

    Raises:
        SystemExit: With exit code 0 (success), 1 (internal error, a fault that `hframe check` found, or a
            question that the user ended) or 2 (faulty input or arguments).
    """
    with closed_output_tolerated(), warnings.catch_warnings():
        warnings.simplefilter("always", UserWarning)
        warnings.showwarning = print_warning
        try:
            # Otherwise Typer prints its errors about options in a box of several lines.
            code = _command()(sys.argv[1:] or ["--help"], standalone_mode=False)
        except typer.Abort:  # the user ended a question
            raise SystemExit(FAULT_FOUND) from None
        except Exception as error:
            if os.environ.get(DEBUG_VARIABLE) or interrupted():
                raise
            code, line = describe_failure(error)
            print(f"hframe: {line}", file=sys.stderr)
            raise SystemExit(code) from None
    raise SystemExit(code if isinstance(code, int) else 0)
