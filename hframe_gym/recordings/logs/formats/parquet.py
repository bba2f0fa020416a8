"""Parquet files, read with pyarrow (extra `parquet`)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....errors import InputError
from ...table_file import open_parquet, parquet_numbers, read_parquet_column
from ...text_reader import Progress
from ..log import Log, log_columns
from .base import LOG_FORMATS, LogFormat


@LOG_FORMATS.register("parquet")
class ParquetLogs(LogFormat):
    """Tables in Parquet files."""

    suffixes = (".parquet",)

    def recognizes(self, path: Path, start: bytes) -> bool:
        """Recognize the beginning of Parquet files."""
        return start.startswith(b"PAR1")

    def open(self, path: Path) -> list[Log]:
        """Read the schema; columns have the shape (rows,)."""
        return [_open_parquet(path)]


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

    return Log(path, log_columns([f.name for f in fields], [""] * len(fields), kinds), ("it is a Parquet file",), read)


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
