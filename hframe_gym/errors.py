"""Messages to the user: the exception for invalid files and arguments, and warnings about several runs."""

from __future__ import annotations

from collections.abc import Iterable


class InputError(ValueError):
    """A file or an argument is invalid.

    The message is one line that names the file, the row, column or field, and what to do. Commands print it and exit
    with code 2.
    """


def name_runs(names: Iterable[str]) -> str:
    """Name several runs in short.

    Args:
        names: Names of runs, at least one; repeated names count once.

    Returns:
        The first name and the number of further names, such as "run_01 and 2 more runs".
    """
    first, *others = dict.fromkeys(names)
    return f"{first} and {len(others)} more run{'s' if len(others) > 1 else ''}" if others else first


def merge_run_warnings(warnings: Iterable[tuple[str, str]]) -> tuple[str, ...]:
    """Merge equal warnings about several runs.

    Args:
        warnings: Name of a run and sentence about it, each.

    Returns:
        Lines of text such as "run_01 and 2 more runs: no laser measures.", one for each different sentence, in the
        order of first occurrence.
    """
    runs: dict[str, list[str]] = {}
    for run, text in warnings:
        runs.setdefault(text, []).append(run)
    return tuple(f"{name_runs(names)}: {text}" for text, names in runs.items())
