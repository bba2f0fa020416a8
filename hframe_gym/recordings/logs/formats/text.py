"""Tables in text with any separator, decimal mark, header and encoding."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from numpy.typing import NDArray
from typing_extensions import override

from ...tables.text_format import detect_format
from ...tables.text_reader import Progress, read_columns
from ..log import Log, log_columns
from .base import ANY_TEXT, LOG_FORMATS, LogFormat

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
        unit_of: Function from the name of a column to its unit, for columns whose unit the file does not state.

    Raises:
        InputError: If the file is empty, is not text, or has no table.
    """
    layout = detect_format(path)

    def read(indices: Sequence[int], progress: Progress | None) -> tuple[list[NDArray[Any]], list[str]]:
        return read_columns(path, layout, indices, lenient=True, progress=progress)

    stated = [unit or unit_of(name) for name, unit in zip(layout.names, layout.units, strict=True)]
    return Log(path, log_columns(layout.names, stated, layout.kinds), (*remarks, *layout.deviations), read)
