"""Tables in text with any separator, decimal mark, header and encoding."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from ...tables.text_format import TextFormat, detect_format
from ...tables.text_reader import Progress, read_columns
from ..log import Log, log_columns, vector_log
from .base import ANY_TEXT, LOG_FORMATS, LogFormat

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
        """Take every file that no other format recognizes."""
        return path.is_file()

    @override
    def is_log(self, path: Path) -> bool:
        """Leave out texts that describe the logs."""
        return path.name.lower() not in _DOCUMENTS

    @override
    def open(self, path: Path) -> list[Log]:
        """Detect the table's format and the names of its columns."""
        return [open_text_table(path)]


def open_text_table(
    path: Path, remarks: tuple[str, ...] = (), unit_of: Callable[[str], str] = lambda name: ""
) -> Log:
    """Open a table in text.

    Args:
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
