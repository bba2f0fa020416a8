"""Parquet files, read with pyarrow (extra `parquet`)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from ....errors import InputError, one_line
from ....files import refuse_expansion
from ...tables.table_file import open_parquet, parquet_numbers, read_parquet_column
from ...tables.text_reader import Progress
from ..log import Log, LogColumn, log_columns
from .base import LOG_FORMATS, LogFormat
from .tables import MOST_ITEMS, signal_columns


@LOG_FORMATS.register("parquet")
class ParquetLogs(LogFormat):
    """Tables in Parquet files."""

    suffixes = (".parquet",)

    @override
    def recognizes(self, path: Path, start: bytes) -> bool:
        """Recognize the first bytes of a Parquet file."""
        return start.startswith(b"PAR1")

    @override
    def open(self, path: Path) -> list[Log]:
        """Open the table as one log; each item of a column of lists is a column."""
        table = ParquetTable(path)

        def read(indices: Sequence[int], progress: Progress | None) -> tuple[list[NDArray[Any]], list[str]]:
            return table.read(indices, progress), []

        return [Log(path, table.columns, ("it is a Parquet file",), read)]


class ParquetTable:
    """Columns of a Parquet file; a column of lists gives one for each item, as "state[0]", "state[1]"."""

    def __init__(self, path: Path, item_names: Mapping[str, Sequence[str]] | None = None) -> None:
        """Open a file and determine its columns.

        Args:
            item_names: Names of the items of lists by column, which are used if their number fits:
                "state.elbow".

        Raises:
            InputError: If pyarrow is missing, or the file is damaged or too large.
        """
        self.path = path
        self._file = open_parquet(path)
        # Name of the column in the file, and item of its lists.
        self._sources: list[tuple[str, int | None]] = []
        columns: list[LogColumn] = []
        rows = self._file.metadata.num_rows
        for field in self._file.schema_arrow:
            items = self._number_of_items(field)
            refuse_expansion(path, 8 * rows * (items or 1))
            if not items:
                self._sources.append((field.name, None))
                columns += log_columns([field.name], [""], [_kind(field.type)])
                continue
            self._sources += [(field.name, item) for item in range(items)]
            known = (item_names or {}).get(field.name, ())
            if len(known) == items:
                columns += log_columns(
                    [f"{field.name}.{name}" for name in known], [""] * items, ["number"] * items
                )
            else:
                columns += signal_columns([f"{field.name}[{item}]" for item in range(items)])
        self.columns = tuple(columns)

    def read(self, indices: Sequence[int], progress: Progress | None = None) -> list[NDArray[Any]]:
        """Read columns: numbers or instants (datetime64[ns]), shape (rows,) each.

        Args:
            indices: Indices of the columns in the attribute `columns`.
            progress: Called with the number of bytes read since the last call.

        Raises:
            InputError: If a column contains texts or is damaged.
        """
        lists: dict[str, NDArray[Any]] = {}
        values: list[NDArray[Any]] = []
        for index in indices:
            name, item = self._sources[index]
            if item is not None:
                if name not in lists:
                    lists[name] = self._items(name)
                values.append(np.ascontiguousarray(lists[name][:, item]))
            elif self.columns[index].kind == "text":
                kind = self._file.schema_arrow.field(name).type
                raise InputError(f"{self.path}, column {name}: contains {kind}, not numbers")
            else:
                column = read_parquet_column(self.path, self._file, name)
                is_stamp = self.columns[index].kind == "stamp"
                values.append((_stamps if is_stamp else parquet_numbers)(self.path, name, column))
            if progress is not None:
                progress(self.path.stat().st_size // len(indices))
        return values

    def _number_of_items(self, field: Any) -> int:
        """Return the number of items of a column of lists; 0 for other columns and for long lists."""
        from pyarrow import compute, types

        kind = field.type
        is_list = types.is_list(kind) or types.is_large_list(kind) or types.is_fixed_size_list(kind)
        if not is_list or _kind(kind.value_type) != "number":
            return 0
        if types.is_fixed_size_list(kind):
            items = kind.list_size
        else:
            first = read_parquet_column(self.path, self._file, field.name, max_rows=1)
            items = (compute.list_value_length(first).to_pylist() or [0])[0] or 0
        return items if items <= MOST_ITEMS else 0

    def _items(self, name: str) -> NDArray[np.float64]:
        """Return the numbers of a column of lists, shape (rows, items), in rows of equal length."""
        from pyarrow import compute

        column = read_parquet_column(self.path, self._file, name)
        lengths = compute.list_value_length(column).fill_null(0).to_numpy()
        items = sum(source == name for source, _ in self._sources)
        if np.any(lengths != items):
            row = int(np.argmax(lengths != items))
            problem = f"has a list of {lengths[row]} items, the first row one of {items}"
            raise InputError(f"{self.path}, row {row + 1}, column {name}: {problem}")
        flat = parquet_numbers(self.path, name, compute.list_flatten(column))
        return flat.reshape(len(lengths), items)


def _kind(data: Any) -> str:
    """Return what a column of a type contains: "number", "stamp" or "text"."""
    from pyarrow import types

    if types.is_timestamp(data) or types.is_time(data) or types.is_date(data):
        return "stamp"
    numeric = (
        types.is_integer(data) or types.is_floating(data) or types.is_decimal(data) or types.is_null(data)
    )
    return "number" if numeric or types.is_boolean(data) else "text"


def _stamps(path: Path, name: str, column: Any) -> NDArray[np.datetime64]:
    """Convert a column of dates or times of a Parquet file to instants."""
    import pyarrow as arrow

    try:
        if arrow.types.is_time(column.type):
            column = column.cast(arrow.time64("ns")).cast(arrow.int64())
        return column.cast(arrow.timestamp("ns")).to_numpy().astype("datetime64[ns]")
    except arrow.ArrowException as error:
        raise InputError(
            f"{path}, column {name}: {column.type} cannot be converted to times: {one_line(error)}"
        ) from None
