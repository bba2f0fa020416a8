"""Logs of signals with their own times: build a log from tables of columns that share their times."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ....arrays import Array
from ...quantities import split_unit
from ...tables.text_reader import Progress
from ..log import Log, LogColumn

MOST_ITEMS = 64  # of a list that is read; longer ones are images, scans and the like, not signals
_UNIT = re.compile(r"\s\[[^\]]*\]$")
_INDEX = re.compile(r"(?:\[\d+\])+$")
# Times, float64 in s or datetime64[ns], values of columns, shape (rows,) each, and sentences for the user
# about what was left out.
Rows: TypeAlias = tuple[NDArray[Any], list[Array], list[str]]


@dataclass(frozen=True)
class TimedTable:
    """Columns of a log that share their times, such as the fields of a topic.

    Attributes:
        name: Name of the table, such as the topic, for messages.
        columns: Columns without that of the times.
        reader: Function (indices, progress) that reads the times and the values of the columns with these
            indices in `columns`, shape (rows,) each, and sentences for the user about what was left out.
            `progress`, if any, is called with the number of bytes read since the last call.
        time_kind: "number" for times in s, or "stamp" for instants.
    """

    name: str
    columns: tuple[LogColumn, ...]
    reader: Callable[[Sequence[int], Progress | None], Rows]
    time_kind: str = "number"


def signal_columns(names: Sequence[str]) -> tuple[LogColumn, ...]:
    """Build columns of numbers for signals named by paths; a unit at the end of a name is recognized.

    Args:
        names: Names such as "/arm/angle_deg" or "/arm/angle [deg]"; both columns have the unit "deg".
    """
    columns = []
    for name in names:
        stated = _UNIT.search(name)  # a unit in brackets may have a slash as well
        end = name.rfind("/", 0, stated.start() if stated else len(name)) + 1
        folder, last = name[:end], name[end:]
        index = _INDEX.search(last)
        plain, unit = split_unit(last[: index.start()] if index else last)
        columns.append(LogColumn(name, f"{folder}{plain}{index[0] if index else ''}", unit, "number"))
    return tuple(columns)


def table_in_memory(names: Sequence[str], name: str, time_s: Array, values: Sequence[Array]) -> TimedTable:
    """Return a table whose values are in memory, for `log_of_tables`.

    Args:
        names: Name of each column, possibly with its unit (`signal_columns`).
        name: Name of the table.
        time_s: Times, s, shape (rows,).
        values: Values of each column, in its unit, shape (rows,) each.
    """

    def read(indices: Sequence[int], progress: Progress | None) -> Rows:
        return time_s, [values[index] for index in indices], []

    return TimedTable(name, signal_columns(names), read)


def log_of_tables(path: Path, tables: Sequence[TimedTable], remarks: tuple[str, ...], part: str = "") -> Log:
    """Build a log from several tables, each of which has its own times.

    Of columns with the same header, in one or in several tables, all but the first get a number: "x", "x.2",
    "x.3".

    When columns are read, the rows of each table are sorted by time, and of rows with equal times the last is
    kept.

    Args:
        remarks: Sentences for the user about the file.
        part: Name of the part of the file; "" if it is one log.
    """
    times = [LogColumn(f"time of {table.name}", "time", "s", table.time_kind) for table in tables]
    columns: list[LogColumn] = []
    seen: Counter[str] = Counter()
    for table, time in zip(tables, times, strict=True):
        for column in table.columns:
            seen[column.header] += 1
            number = f".{seen[column.header]}" if seen[column.header] > 1 else ""
            columns.append(replace(column, header=column.header + number, time=time))
    # Table and index in it by index in `columns` followed by `times`; None stands for the times.
    places: list[tuple[int, int | None]] = [
        (t, c) for t, table in enumerate(tables) for c in range(len(table.columns))
    ]
    places += [(t, None) for t in range(len(tables))]

    def read(indices: Sequence[int], progress: Progress | None) -> tuple[list[NDArray[Any]], list[str]]:
        values: dict[int, NDArray[Any]] = {}
        remarks: list[str] = []
        for number, table in enumerate(tables):
            wanted = {index: places[index][1] for index in indices if places[index][0] == number}
            if not wanted:
                continue
            numbers = [column for column in wanted.values() if column is not None]
            time_values, read_values, said = table.reader(numbers, progress)
            rows, order_remarks = _ordered(table.name, time_values)
            by_column = dict(zip(numbers, read_values, strict=True))
            for index, column_number in wanted.items():
                values[index] = (time_values if column_number is None else by_column[column_number])[rows]
            remarks += [*said, *order_remarks]
        return [values[index] for index in indices], remarks

    return Log(path, tuple(columns), remarks, read, part, tuple(times))


def _ordered(name: str, time: NDArray[Any]) -> tuple[NDArray[np.intp], list[str]]:
    """Return the rows in order of time, the last of equal times only, and remarks about the others."""
    remarks = []
    rows = np.argsort(time, kind="stable")
    if np.any(np.diff(rows) < 0):
        remarks.append(f"{name}: rows sorted by time")
    ordered = time[rows]
    is_last = np.append(ordered[1:] != ordered[:-1], True)[: len(ordered)]
    repeated = int(np.sum(~is_last))
    if repeated:
        remarks.append(
            f"{name}: {repeated} of {len(time)} rows have the time of the row after them and are left out"
        )
    return rows[is_last], remarks
