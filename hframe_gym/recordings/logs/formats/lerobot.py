"""Data sets of LeRobot: Parquet files of episodes, whose names of motors stand in meta/info.json."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from ....errors import InputError
from ....files import read_json
from ...tables.text_reader import Progress
from ..log import Log
from .base import KNOWN_CONTENT, LOG_FORMATS, LogFormat
from .parquet import ParquetTable

_INFO = Path("meta", "info.json")
_EPISODE = "episode_index"
_COLUMNS = {_EPISODE, "frame_index", "timestamp"}
_LEVELS = 4  # folders between a file and that of its data set, at most


@LOG_FORMATS.register("lerobot")
class LeRobotLogs(LogFormat):
    """Parquet files of a data set of LeRobot, versions 2 and 3; each episode is a log."""

    suffixes = ()
    precedence = KNOWN_CONTENT

    @override
    def recognizes(self, path: Path, start: bytes) -> bool:
        """Recognize a Parquet file by its columns, which a data set of LeRobot must have.

        The result is False without pyarrow.
        """
        if not start.startswith(b"PAR1"):
            return False
        try:
            from pyarrow import parquet
        except ImportError:
            return False
        try:
            return set(parquet.read_schema(path).names) >= _COLUMNS
        except Exception:  # of many types for damaged files, which the reader of all Parquet files reports
            return False

    @override
    def logs_in(self, folder: Path) -> list[Path]:
        """Return the Parquet files of a data set, sorted by path; empty if the folder is none."""
        return sorted(folder.glob("data/*/*.parquet")) if (folder / _INFO).is_file() else []

    @override
    def open(self, path: Path) -> list[Log]:
        """Open a Parquet file of the data set; each episode in it is a log.

        Raises:
            InputError: If the file is damaged, or the rows of an episode are not together.
        """
        table = ParquetTable(path, _item_names(path))
        headers = [column.header for column in table.columns]
        (episodes,) = table.read([headers.index(_EPISODE)])
        numbers, first = np.unique(episodes, return_index=True)
        if not np.array_equal(np.repeat(numbers, np.diff([*first, len(episodes)])), episodes):
            raise InputError(f"{path}, column {_EPISODE}: the rows of an episode are not together")
        ends = [*first[1:], len(episodes)]
        whole: dict[int, NDArray[Any]] = {}  # columns that were read, which all episodes need
        return [
            _episode(path, table, whole, int(number), slice(int(begin), int(end)), len(numbers))
            for number, begin, end in zip(numbers, first, ends, strict=True)
        ]


def _episode(
    path: Path, table: ParquetTable, whole: dict[int, NDArray[Any]], number: int, rows: slice, episodes: int
) -> Log:
    """Return the log of an episode."""

    def read(indices: Sequence[int], progress: Progress | None) -> tuple[list[NDArray[Any]], list[str]]:
        missing = [index for index in indices if index not in whole]
        whole.update(zip(missing, table.read(missing), strict=True))
        if progress is not None:
            progress(path.stat().st_size // episodes)
        return [whole[index][rows] for index in indices], []

    remarks = ("it is a data set of LeRobot",)
    return Log(path, table.columns, remarks, read, f"episode {number}", run=f"episode_{number:06d}")


def _item_names(path: Path) -> dict[str, list[str]]:
    """Return the names of the items of each column of lists, from the data set's description if any."""
    info = next(
        (folder / _INFO for folder in list(path.parents)[:_LEVELS] if (folder / _INFO).is_file()), None
    )
    content = read_json(info) if info is not None else {}
    features = content.get("features") if isinstance(content, Mapping) else None
    if not isinstance(features, Mapping):
        return {}
    return {
        column: names
        for column, feature in features.items()
        if isinstance(feature, Mapping) and (names := _flat_names(feature.get("names")))
    }


def _flat_names(names: Any) -> list[str]:
    """Return the names in a list, or in the lists of a dictionary such as {"motors": [...]}; else none."""
    if isinstance(names, Mapping):
        return [name for group in names.values() for name in _flat_names(group)]
    return names if isinstance(names, list) and all(isinstance(name, str) for name in names) else []
