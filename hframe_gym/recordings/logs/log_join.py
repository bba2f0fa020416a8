"""Join logs of one motion, such as a file of the commands and a file of the measurements."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from ...errors import InputError
from ..tables.text_reader import Progress
from .log import Log, LogColumn, headers_text
from .log_files import open_logs


def open_joined(path: Path, others: Sequence[Path]) -> list[Log]:
    """Open the logs of a file; each gets the columns of the other files.

    Raises:
        InputError: If a file cannot be opened, or another file holds several logs.
    """
    logs = open_logs(path)
    for other in others:
        joined = open_logs(other)
        if len(joined) > 1:
            titles = ", ".join(log.part or log.run for log in joined)
            raise InputError(
                f"--join {other}: holds {len(joined)} logs ({titles}); "
                f"save the one that belongs to {path.name} alone"
            )
        logs = [_joined(log, joined[0]) for log in logs]
    return logs


def _joined(log: Log, other: Log) -> Log:
    """Return a log with the columns of two files; the second's are renamed where names agree."""
    headers = [column.header for column in (*log.columns, *log.times)]
    renamed: dict[LogColumn, LogColumn] = {}
    for position, column in enumerate((*other.columns, *other.times), start=len(log.columns) + 1):
        header = _free_header(column, position, headers)
        headers.append(header)
        name = header if header.startswith("#") else column.name
        renamed[column] = dataclasses.replace(column, header=header, name=name, file=other.path.name)
    times = tuple(renamed[time] for time in other.times)
    columns = tuple(
        dataclasses.replace(renamed[c], time=renamed[c.time] if c.time else None) for c in other.columns
    )
    origins = [(source, column) for source in (log, other) for column in source.columns]
    origins += [(source, time) for source in (log, other) for time in source.times]

    def read(indices: Sequence[int], progress: Progress | None) -> tuple[list[NDArray[Any]], list[str]]:
        values: dict[int, NDArray[Any]] = {}
        remarks: list[str] = []
        for source in (log, other):
            wanted = [index for index in indices if origins[index][0] is source]
            if wanted:
                arrays, own_remarks = source.read([origins[index][1] for index in wanted], progress)
                values |= dict(zip(wanted, arrays, strict=True))
                remarks += own_remarks
        return [values[index] for index in indices], remarks

    remark = f"joined with {other.title}, whose columns are {headers_text((*columns, *times))}"
    return dataclasses.replace(
        log,
        columns=(*log.columns, *columns),
        times=(*log.times, *times),
        remarks=(*log.remarks, remark, *other.remarks),
        reader=read,
    )


def _free_header(column: LogColumn, position: int, headers: Collection[str]) -> str:
    """Return the header of a column that no other has: its own, "#7" without a name, or "time.2"."""
    if column.header.startswith("#") and column.header[1:].isdigit():
        return f"#{position}"
    header, number = column.header, 1
    while header in headers:
        number += 1
        header = f"{column.header}.{number}"
    return header
