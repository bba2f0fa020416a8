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
MAX_SEED = 2**31 - 1
console = Console(soft_wrap=True)

MachineOption = Annotated[str, typer.Option(help="A machine.json or a built-in name (see `hframe machines`).")]
OutOption = Annotated[Path, typer.Option(help="Folder for the results; created if it does not exist.")]
MaxRowsOption = Annotated[
    int,
    typer.Option(
        "--max-rows", min=1000, help="Rows of all runs together beyond which only the beginning of each run is used."
    ),
]
TaskOption = Annotated[str, typer.Option(help="Task: {tasks}, or module:name.")]
RandomizeOption = Annotated[str, typer.Option(help="Randomization of each episode's machine: {randomizations}.")]
EpisodesOption = Annotated[int, typer.Option(min=1, max=10**6, help="Number of episodes of each controller.")]
PeriodOption = Annotated[float, typer.Option(help="Control period in seconds, 1e-5 to 10.")]
RecordingsArgument = Annotated[Path, typer.Argument(help="A folder of recordings, one run per file.")]
RayOption = Annotated[
    str | None,
    typer.Option(
        metavar="[ADDRESS]",
        help="Run on Ray: the cluster's auto or HOST:PORT; without an address, Ray is started on this machine.",
    ),
]


def log(line: str) -> None:
    """Print a plain line immediately, on a terminal or in a log.

    Args:
        line: Text without markup.
    """
    console.print(plain_text(line), markup=False, highlight=False)


def plain_text(text: str) -> str:
    """Replace characters that would control the terminal, which names in files may contain.

    Args:
        text: Text to print.

    Returns:
        The text with their escape sequences in Python's notation in place of such characters.
    """
    return "".join(c if c.isprintable() or c in "\n\t" else repr(c)[1:-1] for c in text)
