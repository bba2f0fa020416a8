"""The command line application: the Typer object, and its classes of commands and groups with help."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable
from difflib import get_close_matches
from importlib import import_module
from itertools import pairwise
from typing import Any, TypeVar

import typer
from typer.core import TyperCommand, TyperGroup
from typing_extensions import override

from ..help_texts import with_choices
from ..parallel import LOCAL_RAY

_Function = TypeVar("_Function", bound=Callable[..., Any])


class Command(TyperCommand):
    """Typer command whose line of usage names its arguments in capitals, such as RUNS_DIR."""

    @override
    def collect_usage_pieces(self, ctx: Any) -> list[str]:
        """Return the words of the usage line after the name of the command: "[OPTIONS]" and the arguments.

        Typer alone writes a required argument as "{runs_dir}", which looks like an unfilled placeholder.
        """
        return [
            piece.replace("{", "").replace("}", "").upper() for piece in super().collect_usage_pieces(ctx)
        ]


class CommandGroup(TyperGroup):
    """Group of commands, such as `hframe machines`; without a command, it runs its command `list`, if any.

    Paragraphs of the help pages fill the width of the terminal; Typer alone would keep the line breaks of
    docstrings.
    """

    @override
    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse the command line of the group; if it names no command, parse it as `list`."""
        rest: list[str] = super().parse_args(ctx, args or ["list"] * ("list" in self.commands))
        return rest

    @override
    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Find the command that the first word names, as Typer does.

        If the word is no command, not even a misspelled one, and the group has the command `show`, the usage
        error proposes `hframe GROUP show WORD`.
        """
        name, names = args[0], list(self.commands)
        if "show" in names and name not in names and name[:1] != "-" and not get_close_matches(name, names):
            ctx.fail(
                f"{name!r} is none of the commands {', '.join(names)}; "
                f"if you want to see it: hframe {self.name} show {name}"
            )
        return super().resolve_command(ctx, args)

    @override
    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return a command, with each paragraph of its help as one line, so that it fills the terminal."""
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
        """Return the names of the commands in the order of the work, then the other ones."""
        order = [name for names in _PANELS.values() for name in names]
        names = super().list_commands(ctx)
        return sorted(names, key=lambda name: order.index(name) if name in order else len(order))

    @override
    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return a command, assigned to its panel of the help page."""
        command = super().get_command(ctx, cmd_name)
        if command is not None:
            command.rich_help_panel = next(
                (panel for panel, names in _PANELS.items() if cmd_name in names), "Further commands"
            )
        return command


class Application(typer.Typer):
    """Typer application whose commands are of the class `Command` by default."""

    @override
    def command(
        self, name: str | None = None, *, cls: type[TyperCommand] | None = Command, **settings: Any
    ) -> Callable[[_Function], _Function]:
        """Return a decorator that adds a command, as Typer's, of the class `Command` by default."""
        return super().command(name, cls=cls, **settings)


app = Application(
    cls=MainGroup,
    help="H-frame stages: simulate, identify from measured data, train and evaluate controllers.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
)
_RAY_ADDRESS = re.compile(rf"auto|{LOCAL_RAY}|[^\s/]+:\d+")  # other words after --ray are no address


def register_agents() -> None:
    """Register the trained agents as controllers, also if the package is not installed with entry points."""
    import_module("hframe_gym.agents")


class CommandWithChoices(Command):
    """Command whose help texts may contain placeholders for registered names, such as {tasks}.

    The placeholders (`help_texts.registered_choices`) are replaced when the help is printed, so that no other
    command waits for the imports of the registries. The option --ray may have no value.
    """

    @override
    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse the command line; the option --ray without a cluster's address gets the value "local"."""
        words = []
        for word, following in pairwise([*args, ""]):
            words += [word] if word != "--ray" or _RAY_ADDRESS.fullmatch(following) else [word, LOCAL_RAY]
        return super().parse_args(ctx, words)

    @override
    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Write the help page, with registered names in place of the placeholders."""
        with_help = [parameter for parameter in self.params if getattr(parameter, "help", None)]
        texts = [parameter.help for parameter in with_help]  # type: ignore[attr-defined]
        for parameter, text in zip(with_help, texts, strict=True):
            parameter.help = with_choices(text)  # type: ignore[attr-defined]
        super().format_help(ctx, formatter)
        for parameter, text in zip(
            with_help, texts, strict=True
        ):  # other names may be registered at the next call
            parameter.help = text  # type: ignore[attr-defined]
