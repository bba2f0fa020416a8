"""Failures and warnings of a command as one line each, and its exit codes."""

from __future__ import annotations

import errno
import os
import re
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from ..errors import InputError
from .output import plain_text

_PACKAGE = Path(__file__).parents[1]
FULL_DISK = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
INPUT_AT_FAULT, INTERNAL_ERROR = 2, 1
_FEW_COMMANDS = 8  # of a group such as `hframe machines`; all commands of hframe are in its help
FAULT_FOUND = 1  # exit code of `hframe check` where the recordings have a fault
_PLAIN_WORDS = {  # for those of pydantic about a value such as 2min or 10ms
    "Input should be a valid number, unable to parse string as a number": "must be a number without a unit",
    "Input should be a valid integer, unable to parse string as an integer": (
        "must be a whole number without a unit"
    ),
}
DEBUG_VARIABLE = "HFRAME_DEBUG"  # if set, errors keep their traceback


@contextmanager
def value_errors_as_input_errors() -> Iterator[None]:
    """Convert each ValueError raised inside a `with` block to an InputError with the same message."""
    try:
        yield
    except ValueError as error:
        raise InputError(str(error)) from error


def describe_failure(error: Exception) -> tuple[int, str]:
    """Convert an exception to an exit code and a one-line message.

    Returns:
        The code is 2 (`INPUT_AT_FAULT`) if the user can correct the cause, such as an InputError, a missing
        package, a full disk or a diverging simulation; else 1 (`INTERNAL_ERROR`).
    """
    from ..dynamics import NotFiniteError

    usage = getattr(error, "format_message", None)  # of Typer's errors about options
    text = plain_text(" ".join((usage() if usage else str(error)).split()))
    if usage:
        text = text.replace("Value error, ", "")  # the mark of pydantic, with which Typer checks choices
        for words, plain in _PLAIN_WORDS.items():
            text = text.replace(words, plain)
        text = text or "Missing command"  # Typer prints the help of a group without a message
        return INPUT_AT_FAULT, f"{text} ({_example(error, text)}see --help)"
    if isinstance(error, InputError | ImportError):
        return INPUT_AT_FAULT, text
    if isinstance(error, NotFiniteError):
        return INPUT_AT_FAULT, f"{text.rstrip('.')}: check the inputs and the machine's parameters"
    if isinstance(error, OSError) and (error.filename is not None or error.errno in FULL_DISK):
        place = "writing" if error.filename is None else str(error.filename)
        advice = (
            "; make room or write to another disk (nothing was replaced)" if error.errno in FULL_DISK else ""
        )
        return INPUT_AT_FAULT, plain_text(f"{place}: {error.strerror}{advice}")
    hint = f"set {DEBUG_VARIABLE}=1 to see the traceback"
    return INTERNAL_ERROR, f"internal error, please report it ({hint}): {type(error).__name__}: {text}"


def _example(error: Exception, text: str) -> str:
    """Return the example of the command in whose words something is missing or too much; "" without any.

    Of a group whose command is unknown, these are its commands, if they are few.
    """
    command = getattr(getattr(error, "ctx", None), "command", None)
    names = list(getattr(command, "commands", {}))
    if names:
        unknown = text.startswith("No such command") and "Did you mean" not in text
        return f"choose {', '.join(names)}; " if unknown and len(names) <= _FEW_COMMANDS else ""
    found = re.search(r"Examples?:\s+(hframe .+)", getattr(command, "help", None) or "")
    wrong_words = type(error).__name__ in ("MissingParameter", "UsageError")  # not the value of an option
    return f"for example: {found[1].strip()}; " if found and wrong_words else ""


def print_warning(
    message: Warning | str, category: type[Warning], filename: str = "", *_args: Any, **_keywords: Any
) -> None:
    """Print a warning as one line on standard error (assigned to `warnings.showwarning`).

    Warnings of other libraries are left out, because they concern calls that the user did not write. So are
    NumPy's warnings about overflow: a search tries machines that diverge, and reports them where it matters.
    """
    path = Path(filename)
    foreign = "site-packages" in path.parts and not path.is_relative_to(_PACKAGE)
    if (foreign or issubclass(category, RuntimeWarning)) and not os.environ.get(DEBUG_VARIABLE):
        return
    print(f"hframe: warning: {plain_text(' '.join(str(message).split()))}", file=sys.stderr)


@contextmanager
def collect_warnings() -> Iterator[list[str]]:
    """Collect the texts of all UserWarnings in the `with` block, for a report; they are still printed.

    Yields:
        List to which each warning adds its text.
    """
    texts: list[str] = []
    show = warnings.showwarning

    def collect(message: Warning | str, category: type[Warning], *arguments: Any, **keywords: Any) -> None:
        if issubclass(category, UserWarning):
            texts.append(str(message))
        show(message, category, *arguments, **keywords)

    warnings.showwarning = collect
    try:
        yield texts
    finally:
        warnings.showwarning = show
