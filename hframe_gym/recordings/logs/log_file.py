"""Open the logs of controllers and data loggers: text of any format, MATLAB .mat files and Parquet files."""

from __future__ import annotations

import re
import subprocess
import sys
import tempfile
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import InputError
from ...file_limits import refuse_expansion
from ..quantities import Meaning, is_unit, meaning_of, normalize_unit, split_unit
from ..table_file import open_parquet, parquet_numbers, read_parquet_column
from ..text_format import detect_format
from ..text_reader import Progress, read_columns
from .foreign_files import FOREIGN_SUFFIXES, is_json, refuse_foreign_file
from .sysid_json import SysIdTest, is_sysid_file, read_tests

LOG_SUFFIXES = (".csv", ".txt", ".tsv", ".dat", ".log", ".asc", ".prn", ".lvm", ".mat", ".parquet")

ROW_NUMBER = "row number"  # kind of a column that is not in the file, but counts its rows from 0

_MAT_HEADER = 128  # bytes before the first variable in MATLAB files of version 5 to 7
_MAT_COMPRESSED = 15  # type of a compressed variable
# Compressed bytes per step. A byte expands to 1032 at most, a step to 64 MB; the size is checked after each step.
_MAT_BLOCK = 1 << 16


@dataclass(frozen=True)
class LogColumn:
    """Column of a log.

    Attributes:
        header: Name as written in the file, with a number if it is repeated ("Time.2").
        name: Name without its unit.
        unit: Unit from the header or from a row of units; "" if neither has one.
        kind: "number", "stamp" (dates or times of day), "text", or "row number" (not in the file).
        rows: Number of rows; None if all columns of the file have the same number.
    """

    header: str
    name: str
    unit: str
    kind: str
    rows: int | None = None

    @property
    def meaning(self) -> Meaning:
        """Physical quantity of the column by its name and unit."""
        if self.kind == "stamp":
            return Meaning("time", "", "unit", "")
        return meaning_of(self.name, self.unit)


@dataclass(frozen=True)
class Log:
    """Log file whose columns are known and whose values are read on demand.

    Attributes:
        path: The file.
        columns: Its columns in the order of the file.
        remarks: Remarks for the user on the file's format, where it differs from that of a recording.
        reader: Function that reads the values of columns by index, see `read`.
        part: Name of the part of the file that this log is; "" if the file is one log.
    """

    path: Path
    columns: tuple[LogColumn, ...]
    remarks: tuple[str, ...]
    reader: Callable[[Sequence[int], Progress | None], tuple[list[NDArray[Any]], list[str]]]
    part: str = ""

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
            columns: Columns of this log, from its attribute `columns`.
            progress: Called with the number of bytes read since the last call.

        Returns:
            values: One array per column, in the unit of the file, shape (rows,): float64, NaN where a cell is empty, or
                datetime64[ns] for time stamps. Columns of a MATLAB file may differ in their numbers of rows.
            remarks: Sentences for the user about rows that were left out.

        Raises:
            InputError: If a cell is not a number or the file cannot be read. The message names file, row and column.
        """
        return self.reader([self.columns.index(column) for column in columns], progress)

    def columns_called(self, reference: str) -> list[LogColumn]:
        """Find the columns that a user may mean by a reference.

        Args:
            reference: "#3" for the third column, a header, or a name without its unit.

        Returns:
            All columns that meet the first of these criteria that is met at all: number equal to the reference; equal
            header; equal header but for upper and lower case; equal name without unit but for upper and lower case.
            Empty if no column meets any of them.
        """
        if re.fullmatch(r"#\d+", reference) and 1 <= int(reference[1:]) <= len(self.columns):
            return [self.columns[int(reference[1:]) - 1]]
        exact = [column for column in self.columns if column.header == reference]
        same_header = [column for column in self.columns if column.header.lower() == reference.lower()]
        same_name = [column for column in self.columns if column.name.lower() == reference.lower()]
        return exact or same_header or same_name

    def columns_named_like(self, channel: str) -> list[LogColumn]:
        """Find the columns that have the name of a channel.

        Args:
            channel: Name of a channel with its unit, such as "x_m".

        Returns:
            The column whose header equals the channel's name. If there is none: all columns with the same name without
            unit (case, blanks and punctuation do not matter).
        """
        name = plain_name(split_unit(channel)[0])
        named = [column for column in self.columns if plain_name(column.name) == name]
        return [column for column in self.columns if column.header == channel] or named


def plain_name(name: str) -> str:
    """Simplify a name for comparisons.

    Args:
        name: Name of a column.

    Returns:
        The name in lower case without blanks and punctuation, except "#"; for example "posx" for "Pos. X".
    """
    return re.sub(r"[^\w#]|_", "", name.lower())


def headers_text(columns: Sequence[LogColumn]) -> str:
    """List the headers of columns in one text, for messages.

    Args:
        columns: Columns of a log.

    Returns:
        Headers separated by commas; a unit from a row of units follows its header in brackets.
    """
    return ", ".join(c.header if c.name != c.header or not c.unit else f"{c.header} [{c.unit}]" for c in columns)


def open_logs(path: Path) -> list[Log]:
    """Open a log of a controller or data logger (text, MATLAB, Parquet or SysId file), and determine its columns.

    The kind is detected from the content of the file; the ending of its name matters only for MATLAB and JSON files.

    Args:
        path: File of the log.

    Returns:
        The logs of the file with the names, units and numbers of rows of their columns: one for each test in a JSON
        file of SysId, else one. Values, shape (rows,), are read by `Log.read`.

    Raises:
        InputError: If the file is empty, has no columns of numbers, or is of a kind that cannot be read. The message
            says how to export it.
    """
    with open(path, "rb") as file:
        start = file.read(128)
    if start.startswith(b"PAR1"):
        return [_open_parquet(path)]
    refuse_foreign_file(path, start)
    if start.startswith(b"MATLAB") or path.suffix.lower() == ".mat":
        return [_open_mat(path)]
    if is_json(path, start):
        return [_open_test(path, test) for test in read_tests(path)]
    return [_open_text(path)]


def _columns(headers: Sequence[str], units: Sequence[str], kinds: Sequence[str]) -> tuple[LogColumn, ...]:
    """Build the columns of a table; repeated names get a number, empty ones that of the column."""
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


def _open_text(path: Path) -> Log:
    """Open a table in text."""
    layout = detect_format(path)

    def read(indices: Sequence[int], progress: Progress | None) -> tuple[list[NDArray[Any]], list[str]]:
        return read_columns(path, layout, indices, lenient=True, progress=progress)

    return Log(path, _columns(layout.names, layout.units, layout.kinds), layout.deviations, read)


def _open_test(path: Path, test: SysIdTest) -> Log:
    """Open a test of a JSON file of SysId, whose values are in memory."""

    def read(indices: Sequence[int], progress: Progress | None) -> tuple[list[NDArray[Any]], list[str]]:
        return [test.columns[index] for index in indices], []

    columns = _columns(test.names, [""] * len(test.names), ["number"] * len(test.names))
    return Log(path, columns, test.remarks, read, test.name)


def _open_parquet(path: Path) -> Log:
    """Open a Parquet file with pyarrow, an optional dependency."""
    file = open_parquet(path)
    import pyarrow as arrow

    fields = list(file.schema_arrow)

    def kind(data: Any) -> str:
        types = arrow.types
        if types.is_timestamp(data) or types.is_time(data) or types.is_date(data):
            return "stamp"
        numeric = types.is_integer(data) or types.is_floating(data) or types.is_decimal(data) or types.is_null(data)
        return "number" if numeric or types.is_boolean(data) else "text"

    kinds = [kind(field.type) for field in fields]

    def read(indices: Sequence[int], progress: Progress | None) -> tuple[list[NDArray[Any]], list[str]]:
        values: list[NDArray[Any]] = []
        for index in indices:
            name = fields[index].name
            if kinds[index] == "text":
                raise InputError(f"{path}, column {name}: contains {fields[index].type}, not numbers")
            column = read_parquet_column(path, file, name)
            values.append(
                parquet_numbers(path, name, column) if kinds[index] == "number" else _stamps(path, name, column)
            )
            if progress is not None:
                progress(path.stat().st_size // len(indices))
        return values, []

    return Log(path, _columns([f.name for f in fields], [""] * len(fields), kinds), ("it is a Parquet file",), read)


def _stamps(path: Path, name: str, column: Any) -> NDArray[np.datetime64]:
    """Convert a column of dates or times of a Parquet file to instants."""
    import pyarrow as arrow

    try:
        if arrow.types.is_time(column.type):
            column = column.cast(arrow.time64("ns")).cast(arrow.int64())
        return column.cast(arrow.timestamp("ns")).to_numpy().astype("datetime64[ns]")
    except arrow.ArrowException as error:
        reason = " ".join(str(error).split())
        raise InputError(f"{path}, column {name}: {column.type} cannot be converted to times: {reason}") from None


def _open_mat(path: Path) -> Log:
    """Open a MATLAB file up to version 7; columns are its vectors and the columns of its matrices, also in structs."""
    _refuse_large_variables(path)
    vectors = _mat_vectors(path)
    if not vectors:
        advice = (
            "save plain arrays or a struct of arrays; tables, timetables and timeseries are readable only in MATLAB"
        )
        raise InputError(f"{path}: has no arrays of numbers; {advice}")
    kinds = ["number"] * len(vectors)
    columns = tuple(
        LogColumn(column.header, column.name, column.unit, column.kind, len(vector))
        for column, (_, vector) in zip(
            _columns([name for name, _ in vectors], [""] * len(vectors), kinds), vectors, strict=True
        )
    )

    def read(indices: Sequence[int], progress: Progress | None) -> tuple[list[NDArray[Any]], list[str]]:
        if progress is not None:
            progress(path.stat().st_size)
        return [vectors[index][1] for index in indices], []

    return Log(path, columns, ("it is a MATLAB file",), read)


def _mat_vectors(path: Path) -> list[tuple[str, NDArray[np.float64]]]:
    """Return the names and values of all vectors of a MATLAB file, which a process of its own reads.

    SciPy's reader can end the process on damaged files (segmentation fault), which no exception handler sees.
    """
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder, "vectors.npz")
        # -P keeps the script's folder off sys.path, so that its modules cannot shadow others.
        command = [sys.executable, "-P", str(Path(__file__).with_name("matlab_vectors.py")), str(path), str(target)]
        run = subprocess.run(command, check=False, capture_output=True, text=True)
        if run.returncode:
            reason = run.stderr.strip().rpartition("\n")[2] if run.returncode > 0 else "it is damaged"
            raise InputError(f"{path}: cannot be read as a MATLAB file: {reason}")
        with np.load(target, allow_pickle=False) as content:
            return [(str(name), content[f"arr_{k}"]) for k, name in enumerate(content["names"])]


def _refuse_large_variables(path: Path) -> None:
    """Check the size of the compressed variables of a MATLAB file without keeping their content in memory."""
    size, content = 0, memoryview(path.read_bytes())
    position, order = _MAT_HEADER, ">u4" if bytes(content[126:128]) == b"MI" else "<u4"
    while position + 8 <= len(content):
        kind, length = np.frombuffer(content[position : position + 8], order).tolist()
        if kind == _MAT_COMPRESSED:
            stream, compressed = zlib.decompressobj(), content[position + 8 : position + 8 + length]
            for start in range(0, len(compressed), _MAT_BLOCK):
                try:
                    size += len(stream.decompress(compressed[start : start + _MAT_BLOCK]))
                except zlib.error:
                    break  # which the reader reports
                refuse_expansion(path, size)
        position += 8 + length


def find_logs(path: str | Path) -> tuple[list[Path], list[Path]]:
    """List the logs of a folder, which are recognized by the endings of their names.

    Args:
        path: A log, whatever its ending, or a folder of logs.

    Returns:
        logs: Files of the folder, in alphabetical order, that end in one of `LOG_SUFFIXES` (.csv, .txt, .mat, ...),
            possibly followed by .gz, except documents such as readme.txt, and JSON files of SysId; or the one log.
        other_files: The remaining files of the folder, except hidden ones.

    Raises:
        InputError: If the path does not exist, the folder has no logs, or two of them would become runs of the same
            name.
    """
    path = Path(path)
    if path.is_file():
        return [path], []
    if not path.is_dir():
        raise InputError(f"{path}: no such file or folder")
    files = sorted(p for p in path.iterdir() if p.is_file() and not p.name.startswith("."))
    logs = [p for p in files if _is_log(p)]
    if not logs:
        for file in files:
            if file.name.lower().endswith(FOREIGN_SUFFIXES):
                open_logs(file)  # which says why it is not read
        raise InputError(f"{path}: no logs ({', '.join(LOG_SUFFIXES)}) in this folder")
    for first, second in pairwise(sorted(logs, key=log_name)):
        if log_name(first) == log_name(second):
            raise InputError(f"{second}: would be the same run {log_name(first)!r} as {first.name}; rename one")
    return logs, [p for p in files if p not in logs]


def log_name(path: Path) -> str:
    """Return the name of the run to which a log is converted: its file name without .gz and without its ending.

    Args:
        path: File of the log.

    Returns:
        The name, for example "test_3" for test_3.csv.gz.
    """
    return Path(path.stem if path.suffix.lower() == ".gz" else path.name).stem


def _is_log(path: Path) -> bool:
    """Return whether a file of a folder is a log by its name; a JSON file, which may be a machine, by its content."""
    name = path.name.lower()
    if name.endswith(".json"):
        return is_sysid_file(path)
    return name.removesuffix(".gz").endswith(LOG_SUFFIXES) and not _is_document(path)


def _is_document(path: Path) -> bool:
    """Return whether a file describes the logs and is none itself: readme.txt, for example."""
    return path.name.lower() in ("readme.txt", "license.txt", "licence.txt", "notes.txt", "changelog.txt")
