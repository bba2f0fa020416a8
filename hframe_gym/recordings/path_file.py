"""Paths for the task `track`: a table of points x_m, y_m, or of points with their times, time_s, x_m, y_m."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from .recording import _read_csv, _refuse

Array = NDArray[np.float64]


def read_path(path: str | Path) -> tuple[Array, Array | None]:
    """Points (n, 2), m, and their times (n,), s, from zero, or None where the file has none.

    Raises InputError naming file, row and column for other columns, fewer than two rows, a blank or infinite number,
    or times that do not increase.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path}: no such file")
    header, columns = _read_csv(path)
    for name in header:
        if name not in ("time_s", "x_m", "y_m") or header.count(name) > 1:
            raise InputError(f"{path}, column {name}: a path has the columns x_m, y_m or time_s, x_m, y_m, once each")
    for name in ("x_m", "y_m"):
        if name not in columns:
            raise InputError(f"{path}, column {name}: missing (the header has {', '.join(header)})")
    for name, column in columns.items():
        _refuse(path, name, column, ~np.isfinite(column), "is not a finite number")
    points = np.column_stack([columns["x_m"], columns["y_m"]])
    if len(points) < 2:
        raise InputError(f"{path}: a path needs at least two rows, it has {len(points)}")
    if "time_s" not in columns:
        return points, None
    time_s = columns["time_s"]
    backward = np.flatnonzero(np.diff(time_s) <= 0.0)
    if len(backward):
        row = int(backward[0]) + 2
        raise InputError(f"{path}, row {row}, column time_s: {time_s[row - 1]:.9g} is not after {time_s[row - 2]:.9g}")
    return points, time_s - time_s[0]
