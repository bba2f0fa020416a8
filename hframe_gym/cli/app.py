"""The command line application: the Typer object, the options of several commands, their help, and the output."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterable
from enum import StrEnum
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from typer.core import TyperCommand, TyperGroup

from ..distributed import LOCAL_RAY
from ..registry import load_plugins


class RunFormats(StrEnum):
    """File formats of recordings."""

    CSV_GZ = "csv.gz"
    CSV = "csv"
    PARQUET = "parquet"


class CommandGroup(TyperGroup):
    """Group of commands, such as `hframe machines`; without a command, it runs its command `list` if it has one.

    Paragraphs of the help pages fill the width of the terminal; Typer alone would keep the line breaks of docstrings.
    """

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse the command line of the group, as Click does.

        Args:
            ctx: Click context of the group.
            args: Words of the command line after the name of the group.

        Returns:
            Words that are left for the command.
        """
        rest: list[str] = super().parse_args(ctx, args or ["list"] * ("list" in self.commands))
        return rest

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return a command, without line breaks within the paragraphs of its help, so that these fill the terminal.

        Args:
            ctx: Click context of the group.
            cmd_name: Name of the command.

        Returns:
            The command, or None if the group has none of this name.
        """
        command = super().get_command(ctx, cmd_name)
        if command is not None and command.help:
            paragraphs = inspect.cleandoc(command.help).split("\n\n")
            command.help = "\n\n".join(paragraph.replace("\n", " ") for paragraph in paragraphs)
        return command


app = typer.Typer(
    cls=CommandGroup,
    help="H-frame stages: simulate, identify from measured data, train and evaluate controllers.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
)
MAX_SEED = 2**31 - 1
_RAY_ADDRESS = re.compile(rf"auto|{LOCAL_RAY}|[^\s/]+:\d+")  # other words after --ray are no address
console = Console(soft_wrap=True)

MachineOption = Annotated[str, typer.Option(help="A machine.json or a built-in name (see `hframe machines`).")]
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
TaskOption = Annotated[str, typer.Option(help="Task: {tasks}, or module:name, also of my_module.py in this folder.")]
RandomizeOption = Annotated[str, typer.Option(help="Randomization of each episode's machine: {randomizations}.")]
EpisodesOption = Annotated[int, typer.Option(min=1, max=10**6, help="Number of episodes of each controller.")]
ControllersArgument = Annotated[
    list[str],
    typer.Argument(
        help="Controllers: {controllers}, a shipped agent ({agents}), the folder of a trained agent, "
        "a model of stable-baselines3 (NAME.zip), or module:name."
    ),
]
SensorsOption = Annotated[
    str, typer.Option(help="What controllers observe: {sensors}; state is exact, the others are measurements.")
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
    """Print a line of text at once, also if the output is not a terminal.

    Args:
        line: Text; markup of rich in it is printed as it is.
    """
    console.print(plain_text(line), markup=False, highlight=False)


def plain_text(text: str) -> str:
    """Make a text safe to print: names in files may contain characters that control the terminal.

    Args:
        text: Text to print.

    Returns:
        The text with every character that is not printable, except line feeds and tabs, replaced by its escape sequence
        in Python's notation.
    """
    return "".join(c if c.isprintable() or c in "\n\t" else repr(c)[1:-1] for c in text)


def registered_choices() -> dict[str, str]:
    """List the names that some options accept, such as names of tasks and controllers, for the help texts.

    Plugins are imported first.

    Returns:
        Names separated by commas, by the placeholder that stands for them in the help texts, for example {"tasks":
        "reach, track"}. The placeholders are agents, algorithms, controllers, protocols, randomizations, sensors and
        tasks.
    """
    from ..agents import recipe_names, shipped_agent_names
    from ..controllers import CONTROLLERS
    from ..envs import RANDOMIZATION_PRESETS, SENSOR_PRESETS, TASKS
    from ..evaluation import PROTOCOLS

    load_plugins()
    algorithms = sorted({name.rpartition("_")[0] for name in recipe_names()})
    choices: dict[str, Iterable[str]] = {
        "agents": shipped_agent_names(),
        "algorithms": algorithms,
        "controllers": CONTROLLERS,
        "protocols": PROTOCOLS,
        "randomizations": RANDOMIZATION_PRESETS,
        "sensors": SENSOR_PRESETS,
        "tasks": TASKS,
    }
    return {placeholder: ", ".join(names) for placeholder, names in choices.items()}


class CommandWithChoices(TyperCommand):
    """Typer command whose help texts may contain placeholders of `registered_choices`, for example {tasks}.

    They are replaced when the help is printed, so that no other command waits for the imports of the registries. The
    option --ray may have no value.
    """

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse the command line and store the values of options and arguments in the context, as Click does.

        The option --ray (run on Ray, a library for parallel computing on clusters) may be followed by the address of a
        cluster. If it is not, the value "local" is stored: Ray then starts on this machine.

        Args:
            ctx: Click context of the command, which receives the values by name in its attribute `params`.
            args: Words after the command's name.

        Returns:
            Words that no option or argument has used.
        """
        words = []
        for word, following in zip(args, [*args[1:], ""], strict=True):
            words += [word] if word != "--ray" or _RAY_ADDRESS.fullmatch(following) else [word, LOCAL_RAY]
        return super().parse_args(ctx, words)

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Write the help page, with the names of the registered tasks, controllers etc. for their placeholders.

        Args:
            ctx: Click context of the command.
            formatter: Click formatter that receives the text.
        """
        choices = registered_choices()
        for parameter in self.params:
            help_text = getattr(parameter, "help", None)
            if help_text:
                parameter.help = help_text.format(**choices)  # type: ignore[attr-defined]
        super().format_help(ctx, formatter)
