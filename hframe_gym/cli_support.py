"""Common parts of the `hframe` commands: choices in help texts, options that need checks, and failures."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

from typer.core import TyperCommand

from .errors import InputError

INPUT_AT_FAULT, INTERNAL_ERROR = 2, 1
DEBUG_VARIABLE = "HFRAME_DEBUG"  # if set, errors keep their traceback


def registered_choices() -> dict[str, str]:
    """List the choices of the options that select a registered part.

    Returns:
        Names separated by commas, by the placeholder that the help texts use for them.
    """
    from .agents import recipe_names, shipped_agent_names
    from .controllers import CONTROLLERS
    from .envs import RANDOMIZATION_PRESETS, SENSOR_PRESETS, TASKS

    algorithms = sorted({name.rpartition("_")[0] for name in recipe_names()})
    choices: dict[str, Iterable[str]] = {
        "agents": shipped_agent_names(),
        "algorithms": algorithms,
        "controllers": CONTROLLERS,
        "randomizations": RANDOMIZATION_PRESETS,
        "sensors": SENSOR_PRESETS,
        "tasks": TASKS,
    }
    return {placeholder: ", ".join(names) for placeholder, names in choices.items()}


class CommandWithChoices(TyperCommand):
    """A command whose help texts may contain the placeholders of `registered_choices`.

    They are replaced when the help is printed, so that no other command waits for the imports of the registries.
    """

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Print the help.

        Args:
            ctx: Context of the command line.
            formatter: Formatter of the command line.
        """
        choices = registered_choices()
        for parameter in self.params:
            help_text = getattr(parameter, "help", None)
            if help_text:
                parameter.help = help_text.format(**choices)  # type: ignore[attr-defined]
        super().format_help(ctx, formatter)


def require_folder(path: Path) -> Path:
    """Check that a path can be a folder.

    Args:
        path: Value of --out.

    Returns:
        The path.

    Raises:
        InputError: If it is a file.
    """
    if path.exists() and not path.is_dir():
        raise InputError(f"--out {path}: is a file, but must be a folder")
    return path


def task_with_path(name: str, path: str | None) -> Any:
    """Build the task of a path.

    Args:
        name: Name of the task.
        path: Value of --path, or None for the task's default.

    Returns:
        The task, or its name if it follows no path.

    Raises:
        InputError: If the task is unknown, or follows no path although one is given.
    """
    from .envs import TASKS

    task_class: Any = TASKS.get(name)
    follows_path = is_dataclass(task_class) and "path" in {field.name for field in fields(task_class)}
    if path is not None and not follows_path:
        raise InputError(f"--path {path}: the task {name} follows no path")
    if not follows_path:
        return name
    return task_class() if path is None else task_class(path=path)


@contextmanager
def value_errors_as_input_errors() -> Iterator[None]:
    """Convert the ValueErrors with which the library refuses options.

    Yields:
        Nothing.

    Raises:
        InputError: If the block raises a ValueError.
    """
    try:
        yield
    except ValueError as error:
        raise InputError(str(error)) from error


def describe_failure(error: Exception) -> tuple[int, str]:
    """Describe an exception to the user.

    Args:
        error: What a command raised.

    Returns:
        Exit code and one line of text.
    """
    from .dynamics import NotFiniteError

    text = " ".join(str(error).split())
    if isinstance(error, InputError | ImportError):
        return INPUT_AT_FAULT, text
    if isinstance(error, NotFiniteError):
        return INPUT_AT_FAULT, f"{text}: check the inputs and the machine's parameters"
    if isinstance(error, OSError) and error.filename is not None:
        return INPUT_AT_FAULT, f"{error.filename}: {error.strerror}"
    hint = f"set {DEBUG_VARIABLE}=1 to see the traceback"
    return INTERNAL_ERROR, f"internal error, please report it ({hint}): {type(error).__name__}: {text}"
