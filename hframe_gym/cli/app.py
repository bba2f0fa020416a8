"""The command line application: the Typer object, the options of several commands, their help, and the output."""

from __future__ import annotations

import errno
import inspect
import os
import re
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from enum import StrEnum
from importlib import import_module
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, TypeVar

import typer
from rich.console import Console
from typer.core import TyperCommand, TyperGroup
from typing_extensions import override

from ..help_texts import with_choices
from ..parallel import LOCAL_RAY

_Function = TypeVar("_Function", bound=Callable[..., Any])


class RunFormats(StrEnum):
    """File formats of recordings."""

    CSV_GZ = "csv.gz"
    CSV = "csv"
    PARQUET = "parquet"


class Command(TyperCommand):
    """Typer command whose line of usage names its arguments in capitals, such as RUNS_DIR."""

    @override
    def collect_usage_pieces(self, ctx: Any) -> list[str]:
        """Return the words of the line of usage after the name of the command: "[OPTIONS]" and the arguments.

        Typer writes a required one as "{runs_dir}", which looks like a placeholder that was not filled in.
        """
        return [
            piece.replace("{", "").replace("}", "").upper() for piece in super().collect_usage_pieces(ctx)
        ]


class CommandGroup(TyperGroup):
    """Group of commands, such as `hframe machines`; without a command, it runs its command `list` if it has one.

    Paragraphs of the help pages fill the width of the terminal; Typer alone would keep the line breaks of docstrings.
    """

    @override
    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse the command line of the group; without a command, that of `list`."""
        rest: list[str] = super().parse_args(ctx, args or ["list"] * ("list" in self.commands))
        return rest

    @override
    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return a command, without line breaks within the paragraphs of its help, so that these fill the terminal."""
        command = super().get_command(ctx, cmd_name)
        if command is not None and command.help:
            paragraphs = inspect.cleandoc(command.help).split("\n\n")
            command.help = "\n\n".join(paragraph.replace("\n", " ") for paragraph in paragraphs)
        return command


# The commands in the order in which a user needs them; the help lists them first, in panels.
_PANELS = {
    "The way from logs to a controller": (
        *("machines", "import", "check", "identify", "report", "evaluate", "train", "export"),
        "app",
    ),
    "Beside it": ("examples", "simulate", "play", "effects", "kernel"),
}


class MainGroup(CommandGroup):
    """The group of all commands, listed in the order of the work."""

    @override
    def list_commands(self, ctx: Any) -> list[str]:
        """Return the names of the commands in the order of the work; others follow."""
        order = [name for names in _PANELS.values() for name in names]
        names = super().list_commands(ctx)
        return sorted(names, key=lambda name: order.index(name) if name in order else len(order))

    @override
    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return a command, with the panel of the help page in which it is listed."""
        command = super().get_command(ctx, cmd_name)
        if command is not None:
            command.rich_help_panel = next(
                (panel for panel, names in _PANELS.items() if cmd_name in names), "Further commands"
            )
        return command


class Application(typer.Typer):
    """Typer application whose commands are of the class `Command` unless another one is given."""

    @override
    def command(
        self, name: str | None = None, *, cls: type[TyperCommand] | None = Command, **settings: Any
    ) -> Callable[[_Function], _Function]:
        """Return a decorator that makes a function a command."""
        return super().command(name, cls=cls, **settings)


app = Application(
    cls=MainGroup,
    help="H-frame stages: simulate, identify from measured data, train and evaluate controllers.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
)
MAX_SEED = 2**31 - 1
_RAY_ADDRESS = re.compile(rf"auto|{LOCAL_RAY}|[^\s/]+:\d+")  # other words after --ray are no address


class _TolerantStream:
    """Text stream that discards what is written after its reader has gone, and passes on everything else."""

    def __init__(self, stream: Any) -> None:
        self._stream = stream

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        """Write a text, or discard it if nobody reads the stream any more."""
        try:
            return int(self._stream.write(text))
        except OSError as error:
            self._discard(error)
            return len(text)

    def flush(self) -> None:
        """Pass on what was written, or discard it if nobody reads the stream any more."""
        try:
            self._stream.flush()
        except OSError as error:
            self._discard(error)

    def _discard(self, error: OSError) -> None:
        """Connect a stream without a reader to the null device, to which its buffer can be written; raise others."""
        if error.errno != errno.EPIPE and not (os.name == "nt" and error.errno == errno.EINVAL):
            raise error
        with suppress(OSError, ValueError):  # a stream without a file, such as that of a test
            null = os.open(os.devnull, os.O_WRONLY)
            os.dup2(null, self._stream.fileno())
            os.close(null)


@contextmanager
def closed_output_tolerated() -> Iterator[None]:
    """Let the work inside a `with` block go on if the reader of its output ends, as in `hframe import LOGS | head`."""
    streams = sys.stdout, sys.stderr
    sys.stdout, sys.stderr = _TolerantStream(sys.stdout), _TolerantStream(sys.stderr)
    try:
        yield
        sys.stdout.flush()
    finally:
        sys.stdout, sys.stderr = streams


console = Console(soft_wrap=True)

MachineOption = Annotated[
    str, typer.Option(help="A machine.json or a built-in name (see `hframe machines`).")
]
OutOption = Annotated[Path, typer.Option(help="Folder for the results; created if it does not exist.")]
MaxRowsOption = Annotated[
    int,
    typer.Option(
        "--max-rows",
        min=1000,
        help="Largest number of rows of all runs together. Of each of N runs, the first max-rows / N rows are used, "
        "but at least 20,000.",
    ),
]
TaskOption = Annotated[
    str, typer.Option(help="Task: {tasks}, or module:name, also of my_module.py in this folder.")
]
RandomizeOption = Annotated[
    str, typer.Option(help="Randomization of each episode's machine: {randomizations}.")
]
EpisodesOption = Annotated[int, typer.Option(min=1, max=10**6, help="Number of episodes of each controller.")]
ControllersArgument = Annotated[
    list[str],
    typer.Argument(
        help="Controllers: {controllers}, a shipped agent ({agents}), the folder of a trained agent, "
        "a model of stable-baselines3 (NAME.zip), or module:name."
    ),
]
SensorsOption = Annotated[
    str,
    typer.Option(help="What controllers observe: {sensors}; state is exact, the others are measurements."),
]
CONTROL_PERIOD = 0.01  # s, as in EnvConfig, which is not imported because it would delay every command
PeriodOption = Annotated[float, typer.Option(help="Control period in seconds, 1e-5 to 10.")]
RecordingsArgument = Annotated[Path, typer.Argument(help="A folder of recordings, one run per file.")]
RayOption = Annotated[
    str | None,
    typer.Option(
        metavar="[ADDRESS]",
        help="Run on a Ray cluster at HOST:PORT, or auto to find it; with --ray alone, Ray starts on this machine.",
    ),
]


def register_agents() -> None:
    """Register the trained agents as controllers, also if the package is not installed and has no entry points."""
    import_module("hframe_gym.agents")


def log(line: str) -> None:
    """Print a line of text at once, also if the output is not a terminal; markup of rich in it is printed as it is."""
    console.print(plain_text(line), markup=False, highlight=False)


def plain_text(text: str) -> str:
    """Return a text with every character that could control the terminal replaced by its escape sequence.

    Names in files may contain such characters. Line feeds and tabs stay.
    """
    return "".join(c if c.isprintable() or c in "\n\t" else repr(c)[1:-1] for c in text)


class CommandWithChoices(Command):
    """Command whose help texts may contain placeholders of `help_texts.registered_choices`, for example {tasks}.

    They are replaced when the help is printed, so that no other command waits for the imports of the registries. The
    option --ray may have no value.
    """

    @override
    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse the command line; the option --ray without the address of a cluster gets the value "local"."""
        words = []
        for word, following in pairwise([*args, ""]):
            words += [word] if word != "--ray" or _RAY_ADDRESS.fullmatch(following) else [word, LOCAL_RAY]
        return super().parse_args(ctx, words)

    @override
    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Write the help page, with the names of the registered tasks, controllers etc. for their placeholders."""
        for parameter in self.params:
            help_text = getattr(parameter, "help", None)
            if help_text:
                parameter.help = with_choices(help_text)  # type: ignore[attr-defined]
        super().format_help(ctx, formatter)
