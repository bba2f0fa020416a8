"""Traces of CODESYS and controllers built on it: a block of a text file for each variable, with its times."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from typing_extensions import override

from ....errors import InputError
from ..log import Log
from .base import KNOWN_TEXT, LOG_FORMATS, LogFormat
from .tables import TimedTable, log_of_tables, table_in_memory

_START = b"[key]; [value]"
_VARIABLE = re.compile(r"^\d+\.Variable; *(.+?) *$", re.MULTILINE)
_ROW = re.compile(r"^; *([-+\d.eE]+); *([-+\w.]+) *$", re.MULTILINE)
_TRUTH = {"TRUE": 1.0, "FALSE": 0.0}
_MILLISECONDS = 1e-3  # s, the unit of the times


@LOG_FORMATS.register("codesys_trace")
class CodesysTraces(LogFormat):
    """Traces saved as text (.trace.csv or .txt)."""

    precedence = KNOWN_TEXT

    @override
    def recognizes(self, path: Path, start: bytes) -> bool:
        """Recognize the first words of a trace."""
        return start.removeprefix(b"\xef\xbb\xbf").startswith(_START)

    @override
    def open(self, path: Path) -> list[Log]:
        """Read the samples of all variables, each with its own times, into one log.

        Raises:
            InputError: If no variable has samples, or the samples are not readable.
        """
        text = path.read_text(encoding="utf-8-sig", errors="replace")
        starts = [*_VARIABLE.finditer(text)]
        ends = [match.start() for match in starts[1:]] + [len(text)]
        tables = [
            _table(path, match[1], text[match.end() : end]) for match, end in zip(starts, ends, strict=True)
        ]
        if not any(table.columns for table in tables):
            raise InputError(f"{path}: is a trace of CODESYS without samples; record it, and save it again")
        remarks = ("it is a trace of CODESYS", "times are taken in ms")
        return [log_of_tables(path, [table for table in tables if table.columns], remarks)]


def _table(path: Path, name: str, block: str) -> TimedTable:
    """Return the table of a variable from its block; without samples, the table has no columns."""
    rows = _ROW.findall(block)
    try:
        samples = np.array([[float(time), _number(value)] for time, value in rows]).reshape(-1, 2)
    except ValueError as error:
        raise InputError(f"{path}, variable {name}: {error}; remove the variable from the trace") from None

    names = [name] if len(samples) else []
    return table_in_memory(names, name, samples[:, 0] * _MILLISECONDS, [samples[:, 1]])


def _number(value: str) -> float:
    """Return a value as a number; truth values are 1 and 0."""
    return _TRUTH[value] if value in _TRUTH else float(value)
