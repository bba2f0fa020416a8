"""Logs of Klipper's data_logger (PREFIX.json.gz): commanded motion, steps, accelerometers and angle sensors.

The file is a stream of JSON messages, compressed by gzip, with a character 3 after each. A message with the
entry "q" belongs to a subscription, whose name is the kind of data and the name of the part, such as
"adxl345:bed". All times are those of the printer's main board, in s. The file PREFIX.index.gz beside it is
not needed.
"""

from __future__ import annotations

import json
import zlib
from collections import defaultdict
from collections.abc import Iterator, Sequence
from itertools import accumulate
from pathlib import Path
from typing import Any

import numpy as np
from typing_extensions import override

from ....arrays import Array
from ....errors import InputError
from ....files import refuse_expansion, refuse_many_values
from ...recording import LONGEST_RUN
from ...tables.text_reader import Progress
from ..log import Log
from .base import KNOWN_CONTENT, LOG_FORMATS, LogFormat
from .tables import Rows, TimedTable, log_of_tables, signal_columns, table_in_memory

_END = b"\x03"  # of a message
_BLOCK = 1 << 16  # compressed bytes that are expanded at a time; the size is checked after each block
# s; commanded motions, which the log has as pieces of constant acceleration, are given at this period without
# sensors.
_PERIOD = 1e-3
_MOST_STEPS = 65535  # in one row of steps; the printer's board counts them with 16 bits
_MOTIONS, _STEPS = "trapq", "stepq"  # kinds of data that are commands
_PER_TURN = 65536.0  # steps of an angle sensor per turn
_ACCELERATION = ("x_acceleration [mm/s^2]", "y_acceleration [mm/s^2]", "z_acceleration [mm/s^2]")
_MOTION = tuple(
    f"{axis}{ending}" for axis in "xyz" for ending in (" [mm]", "_velocity [mm/s]", "_acceleration [mm/s^2]")
)


@LOG_FORMATS.register("klipper_data_logger")
class KlipperDataLogs(LogFormat):
    """Files that scripts/motan/data_logger.py of Klipper writes."""

    suffixes = (".json.gz",)
    precedence = KNOWN_CONTENT

    @override
    def recognizes(self, path: Path, start: bytes) -> bool:
        """Recognize compressed JSON by its name."""
        return path.name.lower().endswith(".json.gz")

    @override
    def is_log(self, path: Path) -> bool:
        """Return whether compressed JSON is a log, and not another file such as an index.

        The messages of a log end with the byte 0x03, of which one must be in the beginning of the file.
        """
        with open(path, "rb") as file:
            try:
                return _END in zlib.decompressobj(31).decompress(file.read(_BLOCK))
            except zlib.error:
                return False

    @override
    def open(self, path: Path) -> list[Log]:
        """Read the motions, steps and measurements of sensors to which the logger subscribed, as one log.

        Other subscriptions are left out; a remark names them.

        Raises:
            InputError: If the file is another kind of compressed JSON, or has no motions and no measurements.
        """
        if not self.is_log(path):
            advice = "of compressed JSON only those are read; export a table as CSV"
            raise InputError(f"{path}: is no log of Klipper's data_logger; {advice}")
        blocks: dict[str, list[dict[str, Any]]] = defaultdict(list)
        unread: set[str] = set()
        is_complete = True
        for message in _messages(path):
            if message is None:
                is_complete = False
                continue
            name, params = message.get("q"), message.get("params")
            if not isinstance(name, str) or not isinstance(params, dict):
                continue
            if name.partition(":")[0] in (*_TABLES, _MOTIONS):
                blocks[name].append(params)
            else:
                unread.add(name)
        kinds = {name: name.partition(":")[0] for name in sorted(blocks)}
        tables = [_TABLES[kind](path, name, blocks[name]) for name, kind in kinds.items() if kind != _MOTIONS]
        measured = [t.reader((), None)[0] for t in tables if not t.name.startswith(_STEPS)]
        measured_s = np.unique(np.concatenate([np.empty(0), *measured]))
        motions = [name for name, kind in kinds.items() if kind == _MOTIONS]
        tables += [_motion(path, name, blocks[name], measured_s) for name in motions]
        if not tables:
            problem = f"subscriptions: {', '.join(sorted(unread)) or 'none'}"
            raise InputError(f"{path}: has no motions or measurements of Klipper ({problem})")
        remarks = ["it is a log of Klipper's data_logger"]
        if not is_complete:
            remarks.append("its last message is incomplete and left out")
        if unread:
            remarks.append(f"subscriptions that are not read: {', '.join(sorted(unread))}")
        return [log_of_tables(path, tables, tuple(remarks))]


def _messages(path: Path) -> Iterator[dict[str, Any] | None]:
    """Yield the messages of a file; None for an incomplete one at its end."""
    stream, rest, size, number = zlib.decompressobj(31), b"", 0, 0
    with open(path, "rb") as file:
        while block := file.read(_BLOCK):
            try:
                content = stream.decompress(block)
            except zlib.error as error:
                raise InputError(f"{path}: cannot be decompressed after {number} messages: {error}") from None
            size += len(content)
            refuse_expansion(path, size)
            *parts, rest = (rest + content).split(_END)
            for part in parts:
                number += 1
                try:
                    message = json.loads(part)
                except (ValueError, RecursionError):
                    raise InputError(f"{path}, message {number}: is not valid JSON") from None
                if isinstance(message, dict):
                    yield message
    if rest or not stream.eof:
        yield None


def _rows(path: Path, name: str, params: Sequence[dict[str, Any]], width: int) -> Array:
    """Return the rows in the entry "data" of messages as numbers, shape (rows, width)."""
    rows = [row for block in params if isinstance(block.get("data"), list) for row in block["data"]]
    refuse_many_values(path, len(rows), width)
    try:
        table = np.array(rows, np.float64).reshape(len(rows), -1)
    except (ValueError, TypeError):
        table = np.empty((0, 0))
    if rows and table.shape[1] < width:
        raise InputError(f"{path}, {name}: the rows of its data must be lists of {width} numbers")
    return table[:, :width] if rows else np.empty((0, width))


def _sensor(path: Path, name: str, params: Sequence[dict[str, Any]]) -> TimedTable:
    """Return the measurements of an accelerometer."""
    table = _rows(path, name, params, 4)
    return _in_memory(name, _ACCELERATION, table[:, 0], list(table[:, 1:].T))


def _angle(path: Path, name: str, params: Sequence[dict[str, Any]]) -> TimedTable:
    """Return the angles of a sensor in turns."""
    table = _rows(path, name, params, 2)
    return _in_memory(name, ("angle [rev]",), table[:, 0], [table[:, 1] / _PER_TURN])


def _steps(path: Path, name: str, params: Sequence[dict[str, Any]]) -> TimedTable:
    """Return the commanded position of a stepper motor after each of its steps.

    A row [interval, count, add] of the data stands for steps at growing distances in ticks of the clock; a
    negative count means steps backward.
    """
    times, positions, total = [], [], 0
    for number, block in enumerate(params, start=1):
        try:
            rows = np.array(block["data"], np.int64).reshape(-1, 3)
            first, last = int(block["first_clock"]), int(block["last_clock"])
            begin, end = float(block["first_step_time"]), float(block["last_step_time"])
            position, distance = float(block["start_position"]), float(block["step_distance"])
        except (KeyError, TypeError, ValueError, OverflowError):
            raise InputError(f"{path}, {name}, block {number}: is not the data of a stepper motor") from None
        counts = np.abs(rows[:, 1])
        if np.any(counts > _MOST_STEPS):
            raise InputError(f"{path}, {name}, block {number}: has more than {_MOST_STEPS} steps in a row")
        total += int(counts.sum())
        refuse_many_values(path, total, 2)
        k = (
            np.concatenate([np.arange(1, count + 1) for count in counts.tolist()])
            if len(rows)
            else np.empty(0)
        )
        interval, add = (np.repeat(rows[:, column], counts) for column in (0, 2))
        lengths = counts * rows[:, 0] + rows[:, 2] * counts * (counts - 1) // 2  # ticks of each row
        before = np.repeat(np.array([0, *accumulate(lengths.tolist())])[:-1], counts)
        ticks = before + k * interval + add * k * (k - 1) // 2 - (rows[0, 0] if len(rows) else 0)
        times.append(begin + ticks * ((end - begin) / (last - first) if last != first else 0.0))
        positions.append(position + distance * np.cumsum(np.repeat(np.sign(rows[:, 1]), counts)))
    return _in_memory(name, ("position [mm]",), np.concatenate(times), [np.concatenate(positions)])


def _motion(path: Path, name: str, params: Sequence[dict[str, Any]], measured_s: Array) -> TimedTable:
    """Return commanded positions, velocities and accelerations of the axes, of which the log has the pieces.

    A piece of constant acceleration has its time, duration, initial speed, acceleration, initial position and
    direction. Without times of sensors' measurements, the motion is given every millisecond.
    """
    rows = [row for block in params if isinstance(block.get("data"), list) for row in block["data"]]
    try:
        table = np.array([[*row[:4], *row[4][:3], *row[5][:3]] for row in rows], np.float64).reshape(
            len(rows), 10
        )
    except (ValueError, TypeError, IndexError):
        raise InputError(f"{path}, {name}: its data are not pieces of a motion") from None
    table = table[np.argsort(table[:, 0], kind="stable")]
    duration = float(table[-1, 0] + table[-1, 1] - table[0, 0]) if len(table) else 0.0
    if not duration <= LONGEST_RUN:
        raise InputError(
            f"{path}, {name}: lasts {duration:.6g} s; a recording lasts at most {LONGEST_RUN:.6g} s"
        )

    def read(indices: Sequence[int], progress: Progress | None) -> Rows:
        if not len(table):
            return np.empty(0), [np.empty(0) for _ in indices], []
        time_s = table[0, 0] + _PERIOD * np.arange(int(duration / _PERIOD) + 1)
        given = f"every {_PERIOD * 1e3:g} ms"
        if len(measured_s):
            time_s, given = measured_s, "at the times of the sensors"
        piece = np.maximum(np.searchsorted(table[:, 0], time_s, "right") - 1, 0)
        since, length, speed, acceleration = time_s - table[piece, 0], *table[piece, 1:4].T
        within = np.clip(since, 0.0, length)
        moves = since <= length
        along = (
            (speed + 0.5 * acceleration * within) * within,
            np.where(moves, speed + acceleration * within, 0.0),
            np.where(moves, acceleration, 0.0),
        )
        values = []
        for index in indices:
            axis, derivative = divmod(index, 3)
            value = along[derivative] * table[piece, 7 + axis]
            values.append(value + table[piece, 4 + axis] if derivative == 0 else value)
        return time_s, values, [f"{name}: commanded motion, given {given}"]

    return TimedTable(name, signal_columns([f"{name}/{ending}" for ending in _MOTION]), read)


def _in_memory(name: str, endings: Sequence[str], time_s: Array, values: Sequence[Array]) -> TimedTable:
    """Return a table whose values are known; its columns are NAME/ENDING."""
    return table_in_memory([f"{name}/{ending}" for ending in endings], name, time_s, values)


# By the kind of data, the part of the subscription's name before the colon; motions follow the times of the
# sensors.
_TABLES = {
    _STEPS: _steps,
    "angle": _angle,
    **dict.fromkeys(("adxl345", "lis2dw", "lis3dh", "mpu9250", "icm20948", "bmi160"), _sensor),
}
