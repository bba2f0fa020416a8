"""Columns of logs and recordings, how an import would use them, and curves with few enough points to draw."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..arrays import Array
from ..dynamics import NotFiniteError
from ..errors import InputError
from ..identification import simulate_recording
from ..machine import Machine
from ..recordings import (
    TIME,
    ChannelSource,
    Log,
    MappingOptions,
    Recording,
    load_recording,
    map_columns,
    open_logs,
)
from ..web_page import extreme_rows

POINTS = 1600  # of a curve: two for each of 800 pixels
_FILES_KEPT = 4  # logs whose values stay in memory
_RUNS_KEPT, _SIZES_KEPT = 16, 4096
_MOST_SIMULATED = 200_000  # rows of a run that is simulated while somebody waits; a second of processor time


@dataclass(frozen=True)
class Curve:
    """Values over time of a column or channel.

    Attributes:
        name: Header of the column, or name of the channel.
        note: How an import would use the column, in words.
        time: Times, s, or row numbers, shape (n,).
        values: Values, in the unit that the note or name states, shape (n,); NaN where there is none.
        held: Whether each value holds until the next one, as for an input.
        used: Whether an import would use the column.
        others: Further curves over the same times, by name, shape (n,), such as simulated measurements.
    """

    name: str
    note: str
    time: Array
    values: Array
    held: bool = False
    used: bool = True
    others: Mapping[str, Array] = field(default_factory=dict)


def thinned(
    time: Array, values: Array, first: float = -math.inf, last: float = math.inf, count: int = POINTS
) -> list[list[float | None]]:
    """Reduce a long curve to the smallest and the largest value of each of many short intervals.

    Args:
        time: Times, increasing, shape (n,).
        values: Values, shape (n,); NaN in gaps.
        first: First time to keep, in the unit of the times.
        last: Last time to keep, in the unit of the times.
        count: Largest number of points, at least 4.

    Returns:
        Pairs of time and value; the value is None where all values of an interval are missing.
    """
    begin, end = np.searchsorted(time, first), np.searchsorted(time, last, side="right")
    time, values = time[max(begin - 1, 0) : end + 1], values[max(begin - 1, 0) : end + 1]
    rows = extreme_rows([values], count // 2) if len(time) > count else np.arange(len(time))
    return [
        [t, v if math.isfinite(v) else None]
        for t, v in zip(time[rows].tolist(), values[rows].tolist(), strict=True)
    ]


@dataclass(frozen=True)
class LogView:
    """A log as the user sees it: its curves, and how an import would use its columns.

    Attributes:
        log: The log.
        curves: Curve of each column of numbers except the time.
        sources: Sources of the channels; empty if the import would be refused.
        problem: Why the import would be refused; "" if it would not.
        has_time: Whether the curves are over time, s, not over row numbers.
    """

    log: Log
    curves: list[Curve]
    sources: list[ChannelSource]
    problem: str
    has_time: bool


def view_log(path: Path, machine: Machine, options: MappingOptions) -> LogView:
    """Read the first log of a file and determine how an import would use each of its columns.

    Args:
        options: Columns, units and factors that the user has assigned to channels.

    Returns:
        The log's curves; a column that is used as a channel is converted to the channel's unit.

    Raises:
        InputError: If the file cannot be read.
    """
    log = open_log(path)
    try:
        sources, problem = map_columns(log, machine, options), ""
    except InputError as error:
        sources, problem = [], str(error).removeprefix(f"{log.path}: ").removeprefix(f"{log.path}, ")
    values = _values_of(path, path.stat().st_mtime_ns, path.stat().st_size)
    time, has_time = _times(sources, values)
    by_header = {s.column.header: s for s in sources if s.column is not None}
    curves = []
    for column in log.columns:
        if column.header not in values or len(values[column.header]) != len(time):
            continue
        source = by_header.get(column.header)
        if source is not None and source.channel == TIME:
            continue
        raw = values[column.header]
        if source is None:
            unit = f", {column.unit}" if column.unit else ""
            curves.append(Curve(column.header, f"not used{unit}", time, raw, used=False))
            continue
        held = source.channel in machine.input_channels
        drawn = raw if source.integrate else source.conversion.apply(raw)
        converted = "" if np.array_equal(drawn, raw, equal_nan=True) else ", drawn converted"
        remark = f" ({source.remark}{converted})" if source.remark else ""
        curves.append(Curve(column.header, f"\u2192 {source.channel}{remark}", time, drawn, held))
    return LogView(log, curves, sources, problem, has_time)


def open_log(path: Path) -> Log:
    """Open a file and return its first log; an InputError if the file cannot be read."""
    return open_logs(path)[0]


@lru_cache(maxsize=_FILES_KEPT)
def _values_of(path: Path, modified: int, size: int) -> dict[str, Array]:
    """Return a file's columns of numbers and times by header; time stamps are converted to seconds."""
    log = open_log(path)
    columns = [column for column in log.columns if column.kind != "text"]
    arrays: list[NDArray[Any]]
    try:
        arrays, _ = log.read(columns)
    except InputError:  # one column has a cell that is not a number; the others can be drawn
        readable, arrays = [], []
        for column in columns:
            try:
                arrays += log.read([column])[0]
                readable.append(column)
            except InputError:
                continue
        columns = readable
    values = {}
    for column, array in zip(columns, arrays, strict=True):
        if np.issubdtype(array.dtype, np.datetime64):
            array = np.where(np.isnat(array), np.nan, (array - array[0]) / np.timedelta64(1, "s"))
        values[column.header] = np.asarray(array, np.float64)
    return values


def _times(sources: Sequence[ChannelSource], values: dict[str, Array]) -> tuple[Array, bool]:
    """Return the times of a log, s, or its row numbers if the times are not known; time stamps begin at 0."""
    source = next((s for s in sources if s.channel == TIME), None)
    length = max((len(array) for array in values.values()), default=0)
    rows = np.arange(length, dtype=np.float64)
    if source is None or source.column is None:
        return rows, False
    raw = values.get(source.column.header, rows)
    time = raw if source.column.kind == "stamp" else source.conversion.apply(raw)
    if (
        len(time) != length
        or not np.all(np.diff(time[np.isfinite(time)]) >= 0.0)
        or not np.isfinite(time).all()
    ):
        return rows, False
    return time, True


def run_curves(path: Path, machine: Machine) -> list[Curve]:
    """Return a curve for each input and output of an imported run; an InputError if the run is faulty."""
    run = _run(path, path.stat().st_mtime_ns, _Recorded(machine))
    columns = [*run.inputs.T, *run.outputs.T]
    names = [*machine.input_channels, *machine.output_channels]
    held = [True] * len(machine.input_channels) + [False] * len(machine.output_channels)
    return [Curve(n, "", run.time_s, c, h) for n, c, h in zip(names, columns, held, strict=True)]


def run_size(path: Path, machine: Machine) -> tuple[int, float]:
    """Return the number of rows and the duration, s, of an imported run; an InputError if it is faulty."""
    return _size(path, path.stat().st_mtime_ns, _Recorded(machine))


def simulated_outputs(path: Path, machine: Machine) -> dict[str, Array]:
    """Simulate a machine over an imported run, as `hframe simulate` does.

    Returns:
        Simulated measurements by output channel, in its unit, shape (n,); empty if the run has more than
        200,000 rows, it cannot be simulated, or the motion diverges.
    """
    run = _run(path, path.stat().st_mtime_ns, _Recorded(machine))
    if len(run.time_s) > _MOST_SIMULATED:
        return {}
    try:
        trajectory = simulate_recording(machine, run).trajectory
    except (InputError, NotFiniteError):
        return {}
    return dict(zip(trajectory.channels, trajectory.outputs.T, strict=True))


class _Recorded:
    """A machine as a key of a cache: machines with the same channels read the same run."""

    def __init__(self, machine: Machine) -> None:
        self.machine = machine
        self._channels = machine.input_channels, machine.output_channels

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Recorded) and self._channels == other._channels

    def __hash__(self) -> int:
        return hash(self._channels)


@lru_cache(maxsize=_RUNS_KEPT)
def _run(path: Path, modified: int, recorded: _Recorded) -> Recording:
    """Return a run, which stays in memory."""
    return load_recording(path, recorded.machine)


@lru_cache(maxsize=_SIZES_KEPT)
def _size(path: Path, modified: int, recorded: _Recorded) -> tuple[int, float]:
    """Return the number of rows and the duration, s, of a run."""
    time_s = load_recording(path, recorded.machine).time_s
    return len(time_s), float(time_s[-1] - time_s[0])
