"""Tables in text with any separator, decimal mark, header and encoding."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from ...tables.cells import is_missing
from ...tables.text_format import TextFormat, detect_format
from ...tables.text_reader import Progress, read_columns
from ..log import Log, log_columns, vector_log
from .base import ANY_TEXT, LOG_FORMATS, LogFormat
from .sysid import NO_TEST, STATES, are_states, numbered, tests_of_states

# Rows of a run, at least: a table without names that has fewer rows, and this many columns, has a quantity in
# each row.
_LEAST_ROWS = 20
_DOCUMENTS = ("readme.txt", "license.txt", "licence.txt", "notes.txt", "changelog.txt")


@LOG_FORMATS.register("text")
class TextLogs(LogFormat):
    """Tables in text, possibly compressed by gzip."""

    _ENDINGS = (".csv", ".txt", ".tsv", ".dat", ".log", ".asc", ".prn", ".lvm")
    suffixes = (*_ENDINGS, *(f"{ending}.gz" for ending in _ENDINGS))
    precedence = ANY_TEXT

    @override
    def recognizes(self, path: Path, start: bytes) -> bool:
        """Accept every file that no other format recognizes."""
        return path.is_file()

    @override
    def is_log(self, path: Path) -> bool:
        """Return whether a text file is a log, and not a description such as readme.txt."""
        return path.name.lower() not in _DOCUMENTS

    @override
    def open(self, path: Path) -> list[Log]:
        """Detect the table's format and the names of its columns; each test of SysId in it is a log."""
        log = open_text_table(path)
        tests = _tests(path, detect_format(path))
        return [_rows_of(log, name, first, end) for name, first, end in tests] or [log]


def _tests(path: Path, layout: TextFormat) -> list[tuple[str, int, int]]:
    """Return the tests that a column of texts marks: name, first row and the one after the last; or none."""
    texts = [k for k, kind in enumerate(layout.kinds) if kind == "text"]
    if not texts:
        return []
    beginnings, _ = read_columns(path, layout, texts, lenient=True, max_rows=_LEAST_ROWS, texts=texts)
    for column, beginning in zip(texts, beginnings, strict=True):
        if not {*_states(beginning)} <= {*STATES, NO_TEST}:
            continue
        (cells,), _ = read_columns(path, layout, [column], lenient=True, texts=[column])
        states = _states(cells)
        if are_states(states):
            return numbered(tests_of_states(states))
    return []


def _states(cells: NDArray[np.str_]) -> list[str]:
    """Return the states in a column of texts; an empty cell repeats the one above."""
    states: list[str] = []
    for cell in map(str.strip, cells.tolist()):
        unchanged = is_missing(cell) and cell != NO_TEST
        states.append((states or [NO_TEST])[-1] if unchanged else cell)
    return states


def _rows_of(log: Log, name: str, first: int, end: int) -> Log:
    """Return some rows of a log as a part of it."""

    def read(indices: Sequence[int], progress: Progress | None) -> tuple[list[NDArray[Any]], list[str]]:
        values, remarks = log.reader(indices, progress)
        return [column[first:end] for column in values], remarks

    return dataclasses.replace(log, reader=read, part=name)


def open_text_table(
    path: Path, remarks: tuple[str, ...] = (), unit_of: Callable[[str], str] = lambda name: ""
) -> Log:
    """Open a table in text, with one row for each time, or with one quantity in each row.

    Args:
        remarks: Sentences for the user about the file; those about its deviations from a recording follow.
        unit_of: Function from the name of a column to its unit, for columns whose unit the file does not
            state.

    Raises:
        InputError: If the file is empty, is not text, or has no table.
    """
    layout = detect_format(path)
    if rows := _quantities_in_rows(path, layout):
        return vector_log(path, rows, "a text with one quantity in each row")

    def read(indices: Sequence[int], progress: Progress | None) -> tuple[list[NDArray[Any]], list[str]]:
        return read_columns(path, layout, indices, lenient=True, progress=progress)

    stated = [unit or unit_of(name) for name, unit in zip(layout.names, layout.units, strict=True)]
    return Log(path, log_columns(layout.names, stated, layout.kinds), (*remarks, *layout.deviations), read)


def _quantities_in_rows(path: Path, layout: TextFormat) -> list[tuple[str, NDArray[np.float64]]]:
    """Return the numbered rows of a table without names in which each row is a quantity; otherwise none."""
    count = len(layout.names)
    named = any(name != f"#{k}" for k, name in enumerate(layout.names, start=1))
    if count < _LEAST_ROWS or named or set(layout.kinds) != {"number"}:
        return []
    columns, _ = read_columns(path, layout, range(count), lenient=True, max_rows=_LEAST_ROWS)
    rows = np.array(columns).T
    return [] if len(rows) >= _LEAST_ROWS else [(f"#{k}", row) for k, row in enumerate(rows, start=1)]
