"""The command line application: the Typer object, the options that several commands have, and its output."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

app = typer.Typer(
    help="H-frame stages: simulate, identify from measured data, train and evaluate controllers.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
)
console = Console(soft_wrap=True)

MachineOption = Annotated[str, typer.Option(help="A machine.json or a built-in name (see `hframe machines`).")]
OutOption = Annotated[Path, typer.Option(help="Folder for the results; created if it does not exist.")]
TaskOption = Annotated[str, typer.Option(help="Task: {tasks}, or module:name.")]
RandomizeOption = Annotated[str, typer.Option(help="Randomization of each episode's machine: {randomizations}.")]
RecordingsArgument = Annotated[Path, typer.Argument(help="A folder of recordings, one run per file.")]


def log(line: str) -> None:
    """Print a plain line immediately, on a terminal or in a log.

    Args:
        line: Text without markup.
    """
    console.print(line, markup=False, highlight=False)
