"""Messages to the user: the exception for invalid input, missing extras, and warnings about several runs."""

from __future__ import annotations

import difflib
import math
import numbers
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager


class InputError(ValueError):
    """A file or an argument is invalid.

    The message is one line that names the file, the row, column or field, and what to do. Commands print it
    and exit with code 2.
    """


@contextmanager
def naming_extra(extra: str, need: str) -> Iterator[None]:
    """Catch a failed import in the `with` block; the new error names the extra to install.

    Args:
        extra: Extra of this package that installs what the block imports, such as "report".
        need: What needs the import, for the message, such as "plots need matplotlib".

    Raises:
        ImportError: If a package is missing; the message is `need` and the command that installs the extra.
    """
    try:
        yield
    except ImportError as error:
        raise ImportError(f"{need}: pip install 'hframe_gym[{extra}]'") from error


_LONGEST_REASON = 300  # characters; those of other libraries may hold a whole file or definition


def one_line(error: Exception) -> str:
    """Return an exception's message in one line, or the name of its type if the message is empty.

    Longer messages are cut after 300 characters.
    """
    return " ".join(str(error).split())[:_LONGEST_REASON] or type(error).__name__


def suggestion(name: object, names: Iterable[str]) -> str:
    """Return the hint "; did you mean 'corexy'?" for an unknown name; "" if no name is similar."""
    similar = difflib.get_close_matches(str(name), list(names), 1)
    return f"; did you mean {similar[0]!r}?" if similar else ""


def example_names(name: object, names: Sequence[str]) -> str:
    """Return names to list in a message on an unknown name: those similar to it, or else the first three."""
    similar = difflib.get_close_matches(str(name), names, cutoff=0.4) or names[:3]
    return f"names are, for example, {', '.join(similar)}"


def first_of(names: Sequence[str], most: int = 10) -> str:
    """List the first names of several, or other short texts, in a message, and count the others."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more


def is_number(value: object) -> bool:
    """Return whether a value is a finite real number of Python or NumPy; a bool is not."""
    if not isinstance(value, numbers.Real) or isinstance(value, bool):
        return False
    try:
        return math.isfinite(value)
    except OverflowError:  # an integer beyond the largest floating-point number
        return False


def is_integer(value: object) -> bool:
    """Return whether a value has an integer type of Python or NumPy; a bool and the float 2.0 do not."""
    return isinstance(value, numbers.Integral) and not isinstance(value, bool)


def name_runs(names: Iterable[str]) -> str:
    """Shorten a list of run names to one phrase for a message, such as "run_01 and 2 more runs"."""
    first, *others = dict.fromkeys(names)
    return f"{first} and {len(others)} more run{'s' if len(others) > 1 else ''}" if others else first


def merge_run_warnings(warnings: Iterable[tuple[str, str]]) -> tuple[str, ...]:
    """Merge equal warnings (run's name, text) on several runs to lines "run_01 and 2 more runs: TEXT"."""
    runs: dict[str, list[str]] = {}
    for run, text in warnings:
        runs.setdefault(text, []).append(run)
    return tuple(f"{name_runs(names)}: {text}" for text, names in runs.items())
