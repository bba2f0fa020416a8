"""Read tables of numbers with a header from CSV or Parquet files, and paths of points for the task `track`.

Rows are counted from 1, the first row below the header. An empty cell is NaN.
"""

from __future__ import annotations

import gzip
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from ...arrays import Array
from ...errors import InputError, one_line
from ...files import refuse_expansion, refuse_many_values
from ...operating_system import quoted
from .text_format import detect_format
from .text_reader import Progress, read_columns

SUFFIXES = (".csv", ".csv.gz", ".parquet")
_DEFAULT_MACHINE = "hframe"  # that of the option --machine


class ForeignFormatError(InputError):
    """A table is not UTF-8 with commas between the cells, decimal points and a header in the first line."""


def read_table(
    path: Path, progress: Progress | None = None, max_rows: int | None = None
) -> tuple[list[str], dict[str, Array]]:
    """Read a table of numbers with a header line.

    Args:
        path: A CSV file (.csv, or .csv.gz compressed by gzip) or a Parquet file (.parquet).
        progress: Called with the number of bytes read since the last call.
        max_rows: Number of rows after which reading stops. Default: all rows are read.

    Returns:
        Names of the columns in the order of the file, and the values of each column by its name, in the unit
        of the file, shape (rows,); NaN where a cell is empty or is a word such as NA, NaN or #N/A.

    Raises:
        ForeignFormatError: If the table has another format, such as semicolons between the columns.
        InputError: If the file cannot be read, rows differ in length, or a cell is not a number. The message
            names file, row and column.
    """
    if not path.is_file():
        raise InputError(f"{path}: {'is a folder, give one file of it' if path.is_dir() else 'no such file'}")
    if path.suffix != ".parquet":
        return _read_csv(path, progress, max_rows)
    table = _read_parquet(path, max_rows)
    if progress is not None:
        progress(path.stat().st_size)
    return table


def recording_files(folder: Path) -> list[Path]:
    """List the recordings, .csv, .csv.gz and .parquet, of a folder alphabetically, without hidden files."""
    return sorted(
        p
        for p in folder.iterdir()
        if p.name.endswith(SUFFIXES) and not p.name.startswith(".") and p.is_file()
    )


def compressed_by_name(
    path: Path, file: IO[bytes], level: int = 9
) -> AbstractContextManager[IO[bytes] | gzip.GzipFile]:
    """Return a stream that writes to an opened file, compressed by gzip if the file's name ends in .gz.

    Equal contents give identical files, because the header of gzip gets no name and no time.

    Args:
        path: Name that the file will have; only its suffix matters.
        file: File that is open for writing bytes.
        level: Compression level of gzip, 0 to 9; higher levels take longer and save space.

    Returns:
        Stream for bytes, to be used in a `with` statement, at whose end the compressed data are complete.
    """
    if path.suffix != ".gz":
        return nullcontext(file)
    return gzip.GzipFile("", "wb", level, file, mtime=0)


def import_command(path: Path, machine_name: str) -> str:
    """Return the command `hframe import ... RUNS` that converts a log to recordings, for error messages.

    Args:
        path: Log, or folder of logs.
        machine_name: Name of the machine. Unless it is the default, the command has `--machine MACHINE`, in
            which the user replaces MACHINE by the machine's file.
    """
    machine = "" if machine_name == _DEFAULT_MACHINE else " --machine MACHINE"
    return f"hframe import {quoted(str(path))}{machine} --out RUNS"


def cell_text(path: Path, name: str, column: Array, row: int) -> str:
    """Return a text that names the place of a value in a file and the value itself, for messages.

    Args:
        column: Values of the column, in its unit, shape (rows,).
        row: Index of the row, from 0.

    Returns:
        Text such as "run.csv, row 3, column x_m: 25", with rows from 1, or "run.csv, row 3, column x_m:
        value" for an empty cell, so that " is empty" can follow.
    """
    value = "value" if np.isnan(column[row]) else f"{column[row]:g}"
    return f"{path}, row {row + 1}, column {name}: {value}"


def refuse_rows(path: Path, name: str, column: Array, invalid: NDArray[np.bool_], reason: str) -> None:
    """Raise an error if a column of a file has invalid values; the message shows the first one.

    Args:
        column: Values of the column, in its unit, shape (rows,).
        invalid: True for each invalid row, shape (rows,).
        reason: Text that follows the value in the message, for example "is infinite".

    Raises:
        InputError: If any row is invalid. The message names file, row, column and the value.
    """
    if invalid.any():
        raise InputError(f"{cell_text(path, name, column, int(np.argmax(invalid)))} {reason}")


def refuse_decreasing_times(path: Path, time_s: Array) -> None:
    """Raise an InputError, with file and row, if times `time_s`, s, shape (rows,), fail to increase."""
    backward = np.flatnonzero(np.diff(time_s) <= 0.0)
    if len(backward):
        row = int(backward[0]) + 2
        now, before = time_s[row - 1], time_s[row - 2]
        change = f"repeats row {row - 1}" if now == before else f"goes back, row {row - 1} is {before:.9g}"
        raise InputError(f"{path}, row {row}, column time_s: {now:.9g} {change}; times must increase")


def read_path(path: str | Path) -> tuple[Array, Array | None]:
    """Read the path that the tool follows in the task `track`: columns x_m and y_m, and optionally time_s.

    Returns:
        Points (x, y) of the tool, m, shape (n, 2), and their times, s, shifted so that the first is zero,
        shape (n,), or None if the file has no times.

    Raises:
        InputError: If the file cannot be read or has other columns, fewer than two rows, a cell that is empty
            or infinite, or times that do not increase. The message names the file, and row and column where
            there is one.
    """
    path = Path(path)
    header, columns = read_table(path)
    for name in header:
        if name not in ("time_s", "x_m", "y_m") or header.count(name) > 1:
            raise InputError(
                f"{path}, column {name}: a path has the columns x_m, y_m or time_s, x_m, y_m, once each"
            )
    for name in ("x_m", "y_m"):
        if name not in columns:
            raise InputError(f"{path}, column {name}: missing (the header has {', '.join(header)})")
    for name, column in columns.items():
        refuse_rows(path, name, column, ~np.isfinite(column), "is not a finite number")
    points = np.column_stack([columns["x_m"], columns["y_m"]])
    if len(points) < 2:
        raise InputError(f"{path}: a path needs at least two rows, it has {len(points)}")
    if "time_s" not in columns:
        return points, None
    refuse_decreasing_times(path, columns["time_s"])
    return points, columns["time_s"] - columns["time_s"][0]


def _read_csv(
    path: Path, progress: Progress | None, max_rows: int | None
) -> tuple[list[str], dict[str, Array]]:
    """Read a CSV file in the format of recordings; other formats are refused with advice."""
    layout = detect_format(path)
    if layout.deviations:
        raise ForeignFormatError(f"{path}: cannot be read: {', '.join(layout.deviations)}")
    header = list(layout.names)
    values, _ = read_columns(path, layout, range(len(header)), progress=progress, max_rows=max_rows)
    for name, kind in zip(header, layout.kinds, strict=True):
        if kind == "stamp":
            raise ForeignFormatError(f"{path}, column {name}: has dates or times of day instead of numbers")
    return header, dict(zip(header, values, strict=True))


def open_parquet(path: Path) -> Any:
    """Open a Parquet file without reading its columns, and check that they are not too large for the memory.

    Raises:
        InputError: If pyarrow is missing, the file is damaged, two columns have the same name, the columns
            have more than 1e9 values, or their content is larger than 64 MB and than 100 times the file.
    """
    try:
        import pyarrow.parquet as parquet
    except ImportError:
        raise InputError(f"{path}: reading Parquet files needs pip install 'hframe_gym[parquet]'") from None
    try:
        file = parquet.ParquetFile(path)
        content, names = file.metadata, file.schema_arrow.names
        groups = [content.row_group(i) for i in range(content.num_row_groups)]
        size = sum(
            group.column(j).total_uncompressed_size for group in groups for j in range(content.num_columns)
        )
    except Exception as error:  # pyarrow raises many types, some of them private
        raise InputError(f"{path}: cannot be read: {one_line(error)}") from None
    refuse_many_values(path, content.num_rows, content.num_columns)
    refuse_expansion(path, max(size, 8 * content.num_rows * content.num_columns))
    repeated = next((name for name in names if names.count(name) > 1), None)
    if repeated is not None:
        raise InputError(f"{path}, column {repeated}: appears twice")
    return file


def read_parquet_column(path: Path, file: Any, name: str, max_rows: int | None = None) -> Any:
    """Read one column, a `pyarrow.ChunkedArray`, of a file that `open_parquet` has opened.

    Args:
        path: The file, for messages.
        file: The opened file.
        name: Name of the column, which the file must have.
        max_rows: Number of rows after which reading stops. Default: all rows are read.

    Raises:
        InputError: If the column is damaged.
    """
    try:
        if max_rows is None:
            return file.read(columns=[name]).column(0)
        content = file.metadata
        ends = np.cumsum([content.row_group(i).num_rows for i in range(content.num_row_groups)])
        groups = range(min(int(np.searchsorted(ends, max_rows)) + 1, len(ends)))
        return file.read_row_groups(list(groups), columns=[name]).column(0)[:max_rows]
    except Exception as error:  # pyarrow raises many types, some of them private
        raise InputError(f"{path}, column {name}: cannot be read: {one_line(error)}") from None


def parquet_numbers(path: Path, name: str, column: Any) -> Array:
    """Convert a Parquet column to numbers, shape (rows,), NaN where empty.

    Args:
        path: The file, for messages.
        name: Name of the column, for messages.
        column: Column as `read_parquet_column` returns it.

    Raises:
        InputError: If its values are no numbers, or one cannot be converted exactly.
    """
    try:
        return np.asarray(column.cast("double").to_numpy(), np.float64)
    except Exception as error:  # pyarrow raises many types, some of them private
        raise InputError(
            f"{path}, column {name}: {column.type} cannot be converted to numbers: {one_line(error)}"
        ) from None


def _read_parquet(path: Path, max_rows: int | None) -> tuple[list[str], dict[str, Array]]:
    """Read a Parquet file whose columns are all numbers."""
    file = open_parquet(path)
    from pyarrow import types

    for field in file.schema_arrow:
        kind = field.type
        if types.is_temporal(kind):
            raise ForeignFormatError(
                f"{path}, column {field.name}: has dates or times ({kind}) instead of numbers"
            )
        if not (
            types.is_integer(kind) or types.is_floating(kind) or types.is_decimal(kind) or types.is_null(kind)
        ):
            raise InputError(f"{path}, column {field.name}: has values of the type {kind} instead of numbers")
    names = list(file.schema_arrow.names)
    columns = {name: read_parquet_column(path, file, name, max_rows) for name in names}
    return names, {name: parquet_numbers(path, name, column) for name, column in columns.items()}
