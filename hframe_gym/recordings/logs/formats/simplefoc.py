"""Output of the monitor of SimpleFOC: rows of tabs without a header, in the order of its variables."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

from typing_extensions import override

from ..log import Log, LogColumn
from .base import KNOWN_TEXT, LOG_FORMATS, LogFormat
from .text import open_text_table

_ALL = (
    *(("target", ""), ("voltage.q", "V"), ("voltage.d", "V"), ("current.q", "mA"), ("current.d", "mA")),
    *(("velocity", "rad/s"), ("angle", "rad")),
)
# By the number of columns: the default of monitor_variables, and all.
_VARIABLES = {
    4: tuple(entry for entry in _ALL if entry[0] in ("target", "voltage.q", "velocity", "angle")),
    7: _ALL,
}
_MESSAGE = re.compile(r"^(?:\d\d:\d\d:\d\d\.\d+ -> )?(?:MOT|MON):", re.MULTILINE)
# A row between two equal letters, `monitor_start_char` and `monitor_end_char`.
_ENCLOSED = re.compile(r"^(?:\d\d:\d\d:\d\d\.\d+ -> )?([A-Za-z])[-+\d.]+(?:\t[-+\d.]+)+\1\s*$", re.MULTILINE)


@LOG_FORMATS.register("simplefoc")
class SimpleFocLogs(LogFormat):
    """Serial output of a motor with SimpleFOC, with its messages or with letters around the rows."""

    precedence = KNOWN_TEXT

    @override
    def recognizes(self, path: Path, start: bytes) -> bool:
        """Recognize messages such as "MOT: Init", or rows between two equal letters."""
        text = start.decode("ascii", errors="replace").replace("\r", "")
        return _MESSAGE.search(text) is not None or len(_ENCLOSED.findall(text)) > 1

    @override
    def open(self, path: Path) -> list[Log]:
        """Open the table; 4 or 7 columns without names get those of SimpleFOC's monitor variables."""
        log = open_text_table(path, ("it is the output of SimpleFOC's monitor",))
        unnamed = [
            column for column in log.columns if column.kind == "number" and column.header.startswith("#")
        ]
        variables = _VARIABLES.get(len(unnamed))
        if variables is None:
            return [log]
        names = dict(zip([column.header for column in unnamed], variables, strict=True))
        columns = [
            _named(column, *names[column.header]) if column.header in names else column
            for column in log.columns
        ]
        kind = "all" if len(unnamed) == len(_ALL) else "the usual"
        remark = (
            f"{len(unnamed)} columns, taken for {kind} monitor_variables; name others by their numbers, "
            "such as '#2'"
        )
        return [dataclasses.replace(log, columns=tuple(columns), remarks=(*log.remarks, remark))]


def _named(column: LogColumn, name: str, unit: str) -> LogColumn:
    """Return a column with the name and the unit of a variable."""
    return dataclasses.replace(column, header=name, name=name, unit=unit)
