"""A log of a controller or data logger, in any file format: its columns, whose values are read on demand."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..quantities import Meaning, is_unit, meaning_of, normalize_unit, split_unit
from ..tables.text_reader import Progress

_LISTED = 200  # columns in a message; logs of robots have up to thousands of signals
ROW_NUMBER = "row number"  # kind of a column that is not in the file, but counts its rows from 0


@dataclass(frozen=True)
class LogColumn:
    """Column of a log.

    Attributes:
        header: Name as written in the file, with a number if it is repeated ("Time.2").
        name: Name without its unit.
        unit: Unit from the header or from a row of units; "" if neither has one.
        kind: "number", "stamp" (dates or times of day), "text", or "row number" (not in the file).
        rows: Number of rows; None if all columns of the file have the same number, or if `time` is known.
        time: Column of the sample times, if the format says which; it is one of the log's `times`.
        terms: Sign and column of each term, if this is no column of the file, but a sum of such columns.
        constant: Constant that is added to such a sum, in the unit of its columns.
        file: Name of the file that has the column, if its log was joined with others; "" for a column of the
            log's own.
    """

    header: str
    name: str
    unit: str
    kind: str
    rows: int | None = None
    time: LogColumn | None = None
    terms: tuple[tuple[float, LogColumn], ...] = ()
    constant: float = 0.0
    file: str = ""

    @property
    def in_file(self) -> tuple[LogColumn, ...]:
        """The columns of the file from which this one is computed: itself, or the terms of a sum."""
        return tuple(column for _, column in self.terms) or (self,)

    @property
    def meaning(self) -> Meaning:
        """Physical quantity of the column by its name and unit; for a sum, that of its first term."""
        if self.terms:
            return self.in_file[0].meaning
        if self.kind == "stamp":
            return Meaning("time", "", "unit", "")
        return meaning_of(self.name, self.unit)


@dataclass(frozen=True)
class Log:
    """Log file whose columns are known and whose values are read on demand.

    Attributes:
        path: The file.
        columns: Columns in the order of the file, numbered from "#1" for the user.
        remarks: Remarks for the user on the file's format, where it differs from that of a recording.
        reader: Function that reads the values of columns by index in `columns`, followed by `times`, see
            `read`.
        part: Name of the part of the file that this log is; "" if the file is one log.
        times: Columns of sample times that belong to certain columns, see `LogColumn.time`. They are not in
            `columns`.
        run: Name of the run to which the log is converted; "" for the name of the file, followed by the part.
    """

    path: Path
    columns: tuple[LogColumn, ...]
    remarks: tuple[str, ...]
    reader: Callable[[Sequence[int], Progress | None], tuple[list[NDArray[Any]], list[str]]]
    part: str = ""
    times: tuple[LogColumn, ...] = ()
    run: str = ""

    @property
    def place(self) -> Path:
        """The file, with the part of it after a comma, for messages."""
        return self.path.with_name(self.title)

    @property
    def title(self) -> str:
        """Name of the file and of the part of it, for the user."""
        return f"{self.path.name}, {self.part}" if self.part else self.path.name

    def read(
        self, columns: Sequence[LogColumn], progress: Progress | None = None
    ) -> tuple[list[NDArray[Any]], list[str]]:
        """Read the values of some columns of the log.

        Args:
            columns: Columns of this log, from its attributes `columns` and `times`, or sums of them.
            progress: Called with the number of bytes read since the last call.

        Returns:
            values: One array per column, in the unit of the file, shape (rows,): float64, NaN where a cell is
                empty, or datetime64[ns] for time stamps. Columns of a MATLAB file may differ in their numbers
                of rows.
            remarks: Sentences for the user about rows that were left out.

        Raises:
            InputError: If a cell is not a number or the file cannot be read. The message names file, row and
                column.
        """
        known = (*self.columns, *self.times)
        needed = list(dict.fromkeys(part for column in columns for part in column.in_file))
        arrays, remarks = self.reader([known.index(column) for column in needed], progress)
        values = dict(zip(needed, arrays, strict=True))
        for column in (column for column in columns if column.terms):
            summed = np.sum([sign * values[term] for sign, term in column.terms], axis=0)
            values[column] = summed + column.constant
        return [values[column] for column in columns], remarks

    def columns_called(self, reference: str) -> list[LogColumn]:
        """Find the columns that match a user's reference; none if no column does.

        The first criterion that any column meets decides: number equal to the reference; equal header; equal
        header except for case; equal name without unit except for case.

        Args:
            reference: "#3" for the third column, a header, or a name without its unit.
        """
        if re.fullmatch(r"#\d+", reference) and 1 <= int(reference[1:]) <= len(self.columns):
            return [self.columns[int(reference[1:]) - 1]]
        exact = [column for column in self.columns if column.header == reference]
        same_header = [column for column in self.columns if column.header.lower() == reference.lower()]
        same_name = [column for column in self.columns if column.name.lower() == reference.lower()]
        return exact or same_header or same_name

    def terms_called(self, reference: str) -> tuple[tuple[float, LogColumn], ...]:
        """Find the columns of a user's sum, such as "x + y" or "-#2 - #3", with their signs.

        Names may themselves contain signs: the longest matching name is used.

        Returns:
            Sign and column of each term; nothing if the reference is no sum of columns that `columns_called`
            finds.
        """
        text = reference.strip()
        sign, text = (-1.0, text[1:].strip()) if text.startswith("-") else (1.0, text)
        ends = [len(text), *(match.start() for match in reversed(list(re.finditer("[+-]", text))))]
        for end in ends:
            named, rest = self.columns_called(text[:end].strip()), text[end:]
            others = self.terms_called(rest.removeprefix("+")) if rest else ()
            if len(named) == 1 and (others or not rest):
                return ((sign, named[0]), *others)
        return ()

    def columns_named_like(self, channel: str) -> list[LogColumn]:
        """Find the columns that a channel may have by its name.

        Args:
            channel: Name of the channel with its unit, such as "x_m".

        Returns:
            The column with exactly this header; otherwise all columns of the same name without unit ("x"),
            except for case, blanks and punctuation.
        """
        name = plain_name(split_unit(channel)[0])
        named = [column for column in self.columns if plain_name(column.name) == name]
        return [column for column in self.columns if column.header == channel] or named


def plain_name(name: str) -> str:
    """Return a name in lower case without blanks and punctuation, except "#": "posx" for "Pos. X"."""
    return re.sub(r"[^\w#]|_", "", name.lower())


def headers_text(columns: Sequence[LogColumn]) -> str:
    """List the headers of columns for a message, separated by commas, each with its unit from a row of units.

    Columns of joined files are listed with their file, if not all are of one file. After 200 headers, the
    text only states how many more there are.
    """
    several = len({column.file for column in columns}) > 1
    listed = []
    for column in columns[:_LISTED]:
        units = f" [{column.unit}]" if column.name == column.header and column.unit else ""
        file = f" (of {column.file})" if several and column.file else ""
        listed.append(f"{column.header}{units}{file}")
    more = [f"and {len(columns) - _LISTED} more"] if len(columns) > _LISTED else []
    return ", ".join([*listed, *more])


def log_columns(headers: Sequence[str], units: Sequence[str], kinds: Sequence[str]) -> tuple[LogColumn, ...]:
    """Build the columns of a table.

    A repeated header gets a number ("x.2"), an empty one is "#" with its position from 1.

    Args:
        headers: Headers as written in the file, possibly with units.
        units: Units that the file states elsewhere, "" where it does not.
        kinds: What each column contains: "number", "stamp" or "text".
    """
    columns: list[LogColumn] = []
    for position, (written, unit, kind) in enumerate(zip(headers, units, kinds, strict=True), start=1):
        header = written.strip() or f"#{position}"
        name, unit_in_header = split_unit(header)
        if is_unit(unit) and not is_unit(unit_in_header):  # the brackets in the header have a remark, no unit
            unit_in_header = ""
        repeats = sum(column.header == header or column.header.startswith(f"{header}.") for column in columns)
        number = f".{repeats + 1}" if any(column.header == header for column in columns) else ""
        columns.append(LogColumn(header + number, name, unit_in_header or normalize_unit(unit), kind))
    return tuple(columns)


def vector_log(
    path: Path, vectors: Sequence[tuple[str, NDArray[np.float64]]], kind: str, part: str = ""
) -> Log:
    """Build a log from vectors in memory, such as those of an archive of arrays.

    Args:
        path: File that held the vectors.
        vectors: Names and values, shape (rows,) each, of possibly different lengths.
        kind: What the file is, with its article, for the log's remark, such as "an archive of NumPy".
        part: Name of the part of the file that this log is; "" if the file is one log.
    """
    names = [name for name, _ in vectors]
    named = log_columns(names, [""] * len(names), ["number"] * len(names))
    columns = tuple(
        dataclasses.replace(column, rows=len(vector))
        for column, (_, vector) in zip(named, vectors, strict=True)
    )

    def read(indices: Sequence[int], progress: Progress | None) -> tuple[list[NDArray[Any]], list[str]]:
        if progress is not None:
            progress(path.stat().st_size)
        return [vectors[index][1] for index in indices], []

    return Log(path, columns, (f"it is {kind}",), read, part)
