"""Command export: one subcommand for each registered exporter, with the exporter's fields as options."""

from __future__ import annotations

import dataclasses
import inspect
import typing
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer
from typer import Argument, Option
from typing_extensions import override

from ..errors import InputError, suggestion
from .application import CommandGroup, CommandWithChoices, app, register_agents
from .output import log

_HELP = """Write a machine, a controller or an agent in files of other tools; KIND is a command below.

A file or a folder of files appears complete, or not at all. It names the machine, this version and the units.

Example:  hframe export c --machine hframe --out out/c
"""
DATASET = "dataset"  # the kind that `hframe export CONTROLLER` means


class ExportGroup(CommandGroup):
    """Group with a command for each registered exporter; exporters are imported only when needed."""

    @override
    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse the command line; `hframe export CONTROLLER`, without a kind of export, writes a data set."""
        if args and args[0] not in ("--help", *self.list_commands(ctx)):
            if not args[0].startswith("-"):
                _require_controller(args[0], self.list_commands(ctx))
            log(f"data sets are now `hframe export {DATASET} ...`; the form without {DATASET} still works")
            args = [DATASET, *args]
        return super().parse_args(ctx, args)

    @override
    def list_commands(self, ctx: Any) -> list[str]:
        """List the registered kinds of export."""
        from ..exporters import EXPORTERS
        from ..registry import load_plugins

        load_plugins()
        return list(EXPORTERS)

    @override
    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return the command of an exporter, None if there is no such exporter."""
        if cmd_name not in self.list_commands(ctx):
            return None
        self.commands[cmd_name] = _command(cmd_name)
        return super().get_command(ctx, cmd_name)


app.add_typer(typer.Typer(cls=ExportGroup, help=_HELP, no_args_is_help=True), name="export")


def _require_controller(word: str, kinds: list[str]) -> None:
    """Raise an error if the first word after `hframe export` is no controller either."""
    from ..agents import shipped_agent_names
    from ..controllers import CONTROLLERS

    agents = {name.partition("-seed")[0] for name in (word, word.rpartition("-seed")[0])} & set(
        shipped_agent_names()
    )
    if word in CONTROLLERS or ":" in word or agents or Path(word).is_dir():
        return
    raise InputError(
        f"kind of export {word!r} is unknown; choose one of {', '.join(kinds)}{suggestion(word, kinds)}"
    )


def _command(kind: str) -> Any:
    """Build the command of an exporter from its fields."""
    from ..exporters import EXPORTERS

    exporter = EXPORTERS.get(kind)

    def run(out: Path, **options: Any) -> None:
        register_agents()
        exporter(**options).write(out, log)

    out = Annotated[
        Path, Option(help="Folder of the files, created if it does not exist, or one of the files.")
    ]
    types = typing.get_type_hints(exporter)
    parameters = [_parameter(f, types[f.name]) for f in dataclasses.fields(exporter)]
    arguments = [p for p in parameters if p.default is inspect.Parameter.empty]
    options = [p for p in parameters if p.default is not inspect.Parameter.empty]
    keyword = inspect.Parameter.KEYWORD_ONLY
    signature = inspect.Signature([*arguments, inspect.Parameter("out", keyword, annotation=out), *options])
    function: Callable[..., None] = run
    function.__signature__ = signature  # type: ignore[attr-defined]
    function.__annotations__ = {p.name: p.annotation for p in signature.parameters.values()}
    alone = typer.Typer(add_completion=False, rich_markup_mode="rich", pretty_exceptions_enable=False)
    alone.command(kind, cls=CommandWithChoices, help=inspect.getdoc(exporter))(function)
    return typer.main.get_command(alone)


def _parameter(field: dataclasses.Field[Any], hint: Any) -> inspect.Parameter:
    """Return the parameter of a command for a field of an exporter."""
    from ..exporters.base import ARGUMENT, CLI_TYPE, HELP, RANGE

    about = field.metadata
    text, default = about[HELP], field.default
    least, most = about[RANGE] or (None, None)
    if about[ARGUMENT]:
        declared, default = Argument(help=text), inspect.Parameter.empty
    elif hint is bool:
        declared = Option(f"--{field.name}", help=text)  # without --no-NAME
    else:
        declared = Option(help=text, min=least, max=most)
    kind = about[CLI_TYPE] or hint
    return inspect.Parameter(
        field.name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=Annotated[kind, declared]
    )
