"""Read tables of numbers with a header from CSV or Parquet files, and paths of points for the task `track`.

Rows are counted from 1, the first row below the header. An empty cell is NaN.
"""

from __future__ import annotations

import csv
import gzip
import io
import re
import zlib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError

Array = NDArray[np.float64]

_EMPTY_CELL = re.compile(r"(?<=,)[ \t]*(?=[,\r\n]|\Z)|(?m:^)(?=,)")
SUFFIXES = (".csv", ".csv.gz", ".parquet")


def read_table(path: Path) -> tuple[list[str], dict[str, Array]]:
    """Read a table of numbers with a header line.

    Args:
        path: A CSV file (.csv, or .csv.gz compressed by gzip) or a Parquet file (.parquet).

    Returns:
        Names of the columns in the order of the file.
        Values of each column by its name, shape (rows,), NaN where a cell is empty.

    Raises:
        InputError: If the file cannot be read, rows differ in length, or a cell is not a number. The message names
            file, row and column.
    """
    if not path.is_file():
        raise InputError(f"{path}: no such file")
    return _read_parquet(path) if path.suffix == ".parquet" else _read_csv(path)


def refuse_rows(path: Path, name: str, column: Array, invalid: NDArray[np.bool_], reason: str) -> None:
    """Check a column of a file: raise an error that names the first invalid value, if there is one.

    Args:
        path: File of the column, for the message.
        name: Name of the column, for the message.
        column: Values of the column, shape (rows,).
        invalid: True for each invalid row, shape (rows,).
        reason: Text that follows the value in the message, for example "is infinite".

    Raises:
        InputError: If any row is invalid. The message names file, row, column and the value, unless that is empty.
    """
    if invalid.any():
        row = int(np.argmax(invalid))
        value = "value" if np.isnan(column[row]) else f"{column[row]:g}"
        raise InputError(f"{path}, row {row + 1}, column {name}: {value} {reason}")


def refuse_decreasing_times(path: Path, time_s: Array) -> None:
    """Check that times increase strictly; raise an error otherwise.

    Args:
        path: File of the times, for the message.
        time_s: Times, s, shape (rows,).

    Raises:
        InputError: If a time is not greater than the one before. The message names file and row.
    """
    backward = np.flatnonzero(np.diff(time_s) <= 0.0)
    if len(backward):
        row = int(backward[0]) + 2
        now, before = time_s[row - 1], time_s[row - 2]
        change = f"repeats row {row - 1}" if now == before else f"goes back, row {row - 1} is {before:.9g}"
        raise InputError(f"{path}, row {row}, column time_s: {now:.9g} {change}; times must increase")


def read_path(path: str | Path) -> tuple[Array, Array | None]:
    """Read the path that the tool follows in the task `track`: columns x_m and y_m, and optionally time_s.

    Args:
        path: CSV or Parquet file of the path.

    Returns:
        Points (x, y) of the tool, m, shape (n, 2).
        Times of the points, s, shifted so that the first is zero, shape (n,); None if the file has no times.

    Raises:
        InputError: If the file cannot be read or has other columns, fewer than two rows, a cell that is empty or
            infinite, or times that do not increase. The message names file, row and column.
    """
    path = Path(path)
    header, columns = read_table(path)
    for name in header:
        if name not in ("time_s", "x_m", "y_m") or header.count(name) > 1:
            raise InputError(f"{path}, column {name}: a path has the columns x_m, y_m or time_s, x_m, y_m, once each")
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


def _read_csv(path: Path) -> tuple[list[str], dict[str, Array]]:
    """Read a CSV file with NumPy's fast reader, or cell by cell if some cells are not numbers."""
    try:
        opened = gzip.open(path, "rb") if path.suffix == ".gz" else open(path, "rb")  # noqa: SIM115
        with opened as file:
            text = file.read().decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: cannot be read: not UTF-8 text ({error.reason}); save it as CSV UTF-8") from None
    except (OSError, EOFError, zlib.error) as error:
        raise InputError(f"{path}: cannot be read: {error}") from None
    if "\n" not in text:
        text = text.replace("\r", "\n")  # line ends of old spreadsheets
    first_line, _, body = text.lstrip().partition("\n")
    if first_line.startswith(("#", "sep=")):
        raise InputError(f"{path}: the first line must be the header, it is {first_line.strip()!r}")
    for separator, word in ((";", "semicolons"), ("\t", "tabs")):
        if separator in first_line and "," not in first_line:
            raise InputError(f"{path}: columns are separated by {word}; use commas, and points as decimal marks")
    try:
        header = [name.strip() for name in next(csv.reader([first_line.strip()]), [])]
        if not header:
            raise InputError(f"{path}: empty")
        if not body.strip():
            return header, {name: np.zeros(0) for name in header}
        table = _read_numbers(body)
        if table is None and _EMPTY_CELL.search(body):
            table = _read_numbers(_EMPTY_CELL.sub("nan", body))  # the fast reader refuses empty cells
        if table is None:
            return header, _read_cells(path, header, body)
    except csv.Error as error:
        raise InputError(f"{path}: cannot be read: {error}") from None
    if table.shape[1] != len(header):
        raise InputError(f"{path}, row 1: {table.shape[1]} cells under {len(header)} columns")
    return header, dict(zip(header, np.ascontiguousarray(table.T), strict=True))


def _read_numbers(body: str) -> Array | None:
    """Read rows of numbers with NumPy's fast reader; None if it refuses a cell or the rows differ in length."""
    try:
        return np.loadtxt(io.StringIO(body), delimiter=",", comments=None, ndmin=2)
    except ValueError:
        return None


def _read_cells(path: Path, header: list[str], body: str) -> dict[str, Array]:
    """Read the rows of a CSV file cell by cell; the first faulty cell is refused."""
    rows = [row for row in csv.reader(io.StringIO(body)) if row]
    for number, row in enumerate(rows, start=1):
        if len(row) != len(header):
            raise InputError(f"{path}, row {number}: {len(row)} cells under {len(header)} columns")
    columns: dict[str, Array] = {}
    for j, name in enumerate(header):
        cells = [row[j].strip() or "nan" for row in rows]
        try:
            columns[name] = np.array(cells, dtype=float)
        except ValueError:
            columns[name] = np.array([_number(path, i, name, cell) for i, cell in enumerate(cells, start=1)])
    return columns


def _number(path: Path, row: int, column: str, cell: object) -> float:
    """Convert a cell to a number; None is NaN."""
    try:
        return float("nan" if cell is None else cell)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        advice = "; rows of units or comments are not allowed" if row == 1 else ""
        raise InputError(f"{path}, row {row}, column {column}: {cell!r} is not a number{advice}") from None


def _read_parquet(path: Path) -> tuple[list[str], dict[str, Array]]:
    """Read a Parquet file with pyarrow, an optional dependency."""
    try:
        import pyarrow.parquet as parquet
    except ImportError:
        raise InputError(f"{path}: reading Parquet files needs pip install 'hframe_gym[parquet]'") from None
    try:
        table = parquet.read_table(path)
    except Exception as error:  # pyarrow raises many types, some of them private
        raise InputError(f"{path}: cannot be read: {' '.join(str(error).split())}") from None
    columns = {}
    for name in table.column_names:
        column = table[name]
        if str(column.type) in ("double", "float", "halffloat") or str(column.type).startswith(("int", "uint")):
            columns[name] = column.cast("double").to_numpy()
        else:
            columns[name] = np.array([_number(path, i, name, v) for i, v in enumerate(column.to_pylist(), start=1)])
    return list(table.column_names), columns
