"""Messages to the user: the exception for invalid files and arguments, and warnings about several runs."""

from __future__ import annotations

import math
import numbers
from collections.abc import Iterable


class InputError(ValueError):
    """A file or an argument is invalid.

    The message is one line that names the file, the row, column or field, and what to do. Commands print it and exit
    with code 2.
    """


def is_number(value: object) -> bool:
    """Return whether an argument of a user is a finite real number.

    Args:
        value: Argument of any type.

    Returns:
        True for finite numbers of Python and NumPy; False for bool, texts, arrays, None, inf and nan.
    """
    return isinstance(value, numbers.Real) and not isinstance(value, bool) and math.isfinite(value)


def is_integer(value: object) -> bool:
    """Return whether an argument of a user is an integer.

    Args:
        value: Argument of any type.

    Returns:
        True for integers of Python and NumPy; False for bool and for a float such as 2.0.
    """
    return isinstance(value, numbers.Integral) and not isinstance(value, bool)


def name_runs(names: Iterable[str]) -> str:
    """Shorten a list of run names to one phrase for a message.

    Args:
        names: Names of runs (recordings), at least one; repeated names count once.

    Returns:
        The first name and the number of further names, such as "run_01 and 2 more runs"; a single name alone.
    """
    first, *others = dict.fromkeys(names)
    return f"{first} and {len(others)} more run{'s' if len(others) > 1 else ''}" if others else first


def merge_run_warnings(warnings: Iterable[tuple[str, str]]) -> tuple[str, ...]:
    """Merge warnings about several runs (recordings) that have the same text.

    Args:
        warnings: Pairs (name of a run, text of a warning about this run).

    Returns:
        One line for each different text, in the order of first occurrence, for example "run_01 and 2 more runs: x_m
        has no measurements.".
    """
    runs: dict[str, list[str]] = {}
    for run, text in warnings:
        runs.setdefault(text, []).append(run)
    return tuple(f"{name_runs(names)}: {text}" for text, names in runs.items())
