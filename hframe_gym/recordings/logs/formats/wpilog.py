"""Data logs of WPILib (.wpilog): entries with a name and a type, and records of their values with times.

A file begins with "WPILOG", the version and a text of any content. Each record has the number of its entry, a
size and a time in microseconds, in as many bytes as its first byte says. Records of entry 0 start an entry,
finish it or change its description, which may be the unit. All numbers are little-endian.

The tests of SysId are marked by an entry of texts, such as "sysid-test-state-drive": each becomes a log.
"""

from __future__ import annotations

import dataclasses
import json
import re
import struct
from array import array
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from typing_extensions import override

from ....arrays import Array
from ....errors import InputError, first_of
from ....files import refuse_many_values
from ...quantities import is_unit, normalize_unit
from ...tables.text_reader import Progress
from ..log import Log
from .base import KNOWN_CONTENT, LOG_FORMATS, LogFormat
from .sysid import NO_TEST, STATES, are_states, numbered, tests_of_states
from .tables import MOST_ITEMS, Rows, TimedTable, log_of_tables, signal_columns

_NUMBERS = {"boolean": "u1", "int64": "<i8", "float": "<f4", "double": "<f8"}  # NumPy types of the payloads
_STRUCT_NUMBERS = {
    **{f"{sign}int{bits}": f"<{sign or 'i'}{bits // 8}" for sign in ("", "u") for bits in (8, 16, 32, 64)},
    "bool": "u1",
    "char": "S1",
    "float": "<f4",
    "float32": "<f4",
    "double": "<f8",
    "float64": "<f8",
}
_DEEPEST = 8  # structures in structures
_LONGEST_STATE = 32  # characters of a state of SysId
_SCHEMA = "/.schema/"  # names of entries that describe structures begin so
_SCHEMA_TYPE = "structschema"
_MEMBER = re.compile(
    r"(?:(?:enum\s*)?\{[^}]*\}\s*)?(?P<type>\w+)\s+(?P<name>\w+)\s*(?:\[\s*(?P<count>\d+)\s*\])?"
)


@dataclass
class _Entry:
    """An entry and where its records are: times, us, and beginning and size of each payload, bytes."""

    name: str
    kind: str
    unit: str = ""
    times: array[int] = field(default_factory=lambda: array("q"))
    starts: array[int] = field(default_factory=lambda: array("q"))
    sizes: array[int] = field(default_factory=lambda: array("q"))


@LOG_FORMATS.register("wpilog")
class WpiLogs(LogFormat):
    """Data logs of WPILib, as robots, simulations and AdvantageScope write them."""

    suffixes = (".wpilog",)
    precedence = KNOWN_CONTENT

    @override
    def recognizes(self, path: Path, start: bytes) -> bool:
        """Recognize the first bytes of a data log of WPILib."""
        return start.startswith(b"WPILOG")

    @override
    def open(self, path: Path) -> list[Log]:
        """Read the entries of numbers, each with its own times, into one log, or one for each test of SysId.

        Texts and raw data are left out.

        Raises:
            InputError: If no entry has numbers.
        """
        content = path.read_bytes()
        entries, is_complete = _entries(path, content)
        remarks = ["it is a data log of WPILib"]
        if not is_complete:
            remarks.append("its last record is incomplete and left out")
        structures = _structures(content, entries)
        tables, left_out = [], []
        for entry in entries:
            table = _table(path, content, entry, structures)
            if table is not None:
                tables.append(table)
            elif entry.times and not entry.name.startswith(_SCHEMA):
                left_out.append(f"{entry.name} ({entry.kind})")
        if not tables:
            raise InputError(
                f"{path}: has no entries of numbers; entries: {', '.join(left_out[:20]) or 'none'}"
            )
        if left_out:
            remarks.append(f"entries without numbers: {first_of(left_out)}")
        refuse_many_values(path, sum(len(entry.times) for entry in entries), 1)
        tests = _tests(content, entries)
        if not tests:
            return [log_of_tables(path, tables, tuple(remarks))]
        remarks.append("it has tests of SysId, which become one run each")
        return [
            log_of_tables(path, [_during(table, begin, end) for table in tables], tuple(remarks), name)
            for name, begin, end in tests
        ]


def _entries(path: Path, content: bytes) -> tuple[list[_Entry], bool]:
    """Return all entries with their records, and whether the last record is complete."""
    if len(content) < 12:
        raise InputError(f"{path}: ends within its header")
    major = content[7]
    if major != 1:
        raise InputError(
            f"{path}: is a data log of version {major}, of which only version 1 is read; export it as CSV"
        )
    position = 12 + int.from_bytes(content[8:12], "little")
    by_number: dict[int, _Entry] = {}
    entries: dict[tuple[str, str], _Entry] = {}
    end = len(content)
    from_bytes = int.from_bytes
    while position < end:
        lengths = content[position]
        number_end = position + 2 + (lengths & 3)
        size_end = number_end + 1 + (lengths >> 2 & 3)
        start = size_end + 1 + (lengths >> 4 & 7)
        size = from_bytes(content[number_end:size_end], "little")
        if start + size > end:
            return list(entries.values()), False
        number = from_bytes(content[position + 1 : number_end], "little")
        if number == 0:
            _control(path, content, start, size, by_number, entries)
        else:
            entry = by_number.get(number)
            if entry is None:
                raise InputError(
                    f"{path}, byte {position}: has a record of the entry {number}, which is not started"
                )
            entry.times.append(from_bytes(content[size_end:start], "little", signed=start - size_end == 8))
            entry.starts.append(start)
            entry.sizes.append(size)
        position = start + size
    return list(entries.values()), True


def _control(
    path: Path,
    content: bytes,
    start: int,
    size: int,
    by_number: dict[int, _Entry],
    entries: dict[tuple[str, str], _Entry],
) -> None:
    """Start or finish an entry; an entry that starts again under the same name and type continues."""
    payload = content[start : start + size]
    try:
        (number,) = struct.unpack_from("<xI", payload)
        if payload[0] == 0:
            texts, position = [], 5
            for _ in range(3):
                (length,) = struct.unpack_from("<I", payload, position)
                texts.append(payload[position + 4 : position + 4 + length].decode())
                position += 4 + length
            name, kind, description = texts
            by_number[number] = entries.setdefault((name, kind), _Entry(name, kind))
            by_number[number].unit = _unit(description) or by_number[number].unit
        elif payload[0] == 1:
            by_number.pop(number, None)
    except (struct.error, UnicodeDecodeError):
        raise InputError(f"{path}, byte {start}: has a damaged control record") from None


def _unit(description: str) -> str:
    """Return the unit that an entry's description states, "Meter per Second" or {"unit": "m/s"}; else ""."""
    stated: Any = description
    if description.startswith("{"):
        try:
            content = json.loads(description)
        except (ValueError, RecursionError):
            return ""
        stated = content.get("unit") or content.get("units") if isinstance(content, dict) else ""
    if not isinstance(stated, str) or not stated:
        return ""
    parts = [normalize_unit(part) for part in re.split(r"\s+per\s+", stated.strip(), flags=re.IGNORECASE)]
    unit = normalize_unit("/".join(parts))
    return unit if is_unit(unit) else ""


def _tests(content: bytes, entries: Sequence[_Entry]) -> list[tuple[str, float, float]]:
    """Return name, begin and end of the tests of SysId, s, each from its first state to the next one."""
    tests = []
    marks = [(entry, states) for entry in entries if (states := _states(content, entry))]
    for entry, states in marks:
        order = np.argsort(np.array(entry.times), kind="stable")
        times, ordered = np.array(entry.times)[order] / 1e6, [states[k] for k in order]
        for state, begin, end in tests_of_states(ordered):
            name = f"{entry.name.rpartition('/')[2]}_{state}" if len(marks) > 1 else state
            tests.append((name, float(times[begin]), float(times[end]) if end < len(times) else np.inf))
    return numbered(sorted(tests, key=lambda test: test[1]))


def _states(content: bytes, entry: _Entry) -> list[str]:
    """Return the values of an entry that marks the tests of SysId; empty for another entry."""
    if entry.kind != "string" or not entry.times:
        return []
    states = []
    for start, size in zip(entry.starts, entry.sizes, strict=True):
        state = content[start : start + size] if size <= _LONGEST_STATE else b""
        states.append(state.decode("ascii", errors="replace"))
        if states[-1] not in (*STATES, NO_TEST):
            return []
    return states if are_states(states) else []


def _during(table: TimedTable, begin: float, end: float) -> TimedTable:
    """Return the rows of a table from a time, s, until before another."""

    def read(indices: Sequence[int], progress: Progress | None) -> Rows:
        time_s, values, remarks = table.reader(indices, progress)
        rows = (time_s >= begin) & (time_s < end)
        return time_s[rows], [column[rows] for column in values], remarks

    return dataclasses.replace(table, reader=read)


def _structures(content: bytes, entries: Sequence[_Entry]) -> dict[str, np.dtype[np.void]]:
    """Return the types of all structures that the file describes, by name."""
    texts = {}
    for entry in entries:
        if entry.kind == _SCHEMA_TYPE and entry.times:
            name = entry.name.removeprefix(_SCHEMA).removeprefix("struct:")
            texts[name] = content[entry.starts[-1] : entry.starts[-1] + entry.sizes[-1]].decode(
                errors="replace"
            )
    types = {name: _structure(name, texts, 0) for name in texts}
    return {name: kind for name, kind in types.items() if kind is not None}


def _structure(name: str, texts: dict[str, str], depth: int) -> np.dtype[np.void] | None:
    """Return the type of a structure; None if it has bit fields, is not described, or contains itself."""
    if depth > _DEEPEST or name not in texts:
        return None
    members: list[tuple[str, object, tuple[int, ...]]] = []
    for declaration in filter(None, map(str.strip, texts[name].split(";"))):
        match = _MEMBER.fullmatch(declaration)
        if match is None:
            return None
        inner = _STRUCT_NUMBERS.get(match["type"]) or _structure(match["type"], texts, depth + 1)
        if inner is None or any(member[0] == match["name"] for member in members):
            return None
        members.append((match["name"], inner, (int(match["count"]),) if match["count"] else ()))
    kind = np.dtype(members) if members else None
    return kind if kind is not None and kind.itemsize < 1 << 16 else None


def _table(
    path: Path, content: bytes, entry: _Entry, structures: dict[str, np.dtype[np.void]]
) -> TimedTable | None:
    """Return the table of an entry; None if it has no records or no numbers."""
    if not entry.times:
        return None
    item = entry.kind.removesuffix("[]")
    is_array = item != entry.kind
    kind = structures.get(item.removeprefix("struct:")) if item.startswith("struct:") else None
    if item in _NUMBERS:
        kind = np.dtype(_NUMBERS[item])
    if kind is None:
        return None
    sizes = np.array(entry.sizes)
    if not is_array and np.any(sizes != kind.itemsize):
        row = int(np.argmax(sizes != kind.itemsize))
        raise InputError(
            f"{path}, {entry.name}, record {row + 1}: has {sizes[row]} bytes, not {kind.itemsize}"
        )
    items = int(sizes.max()) // kind.itemsize if is_array else 1
    if items == 0 or items > MOST_ITEMS:
        return None
    leaves = _leaves(kind)
    ends = [f"[{k}]{leaf}" if is_array else leaf for k in range(items) for leaf, _, _ in leaves]
    if not ends:
        return None

    def read(indices: Sequence[int], progress: Progress | None) -> Rows:
        values = []
        for index in indices:
            number, leaf = divmod(index, len(leaves))
            _, offset, leaf_kind = leaves[leaf]
            values.append(_gather(content, entry, number * kind.itemsize + offset, leaf_kind))
        if progress is not None:
            progress(int(sizes.sum()))
        return np.array(entry.times, np.float64) / 1e6, values, []

    columns = signal_columns([entry.name + end for end in ends])
    if entry.unit and item in _NUMBERS:
        columns = tuple(dataclasses.replace(column, unit=column.unit or entry.unit) for column in columns)
    return TimedTable(entry.name, columns, read)


def _leaves(
    kind: np.dtype[np.void], prefix: str = "", offset: int = 0
) -> list[tuple[str, int, np.dtype[np.generic]]]:
    """Return name's end, offset in bytes and type of each number in a structure, or of a plain number."""
    if kind.subdtype is not None:
        inner, (count,) = kind.subdtype
        if count > MOST_ITEMS:
            return []
        return [
            leaf
            for k in range(count)
            for leaf in _leaves(inner, f"{prefix}[{k}]", offset + k * inner.itemsize)
        ]
    if kind.names is None:
        return [] if kind.kind == "S" else [(prefix, offset, kind)]
    assert kind.fields is not None
    return [
        leaf
        for name in kind.names
        for leaf in _leaves(kind.fields[name][0], f"{prefix}/{name}", offset + kind.fields[name][1])
    ]


def _gather(content: bytes, entry: _Entry, offset: int, kind: np.dtype[np.generic]) -> Array:
    """Return the number at an offset in the payload of each record; NaN in a record too short for it."""
    raw = np.frombuffer(content, np.uint8)
    present = np.array(entry.sizes) >= offset + kind.itemsize
    starts = np.array(entry.starts)[present] + offset
    values = np.full(len(entry.times), np.nan)
    values[present] = np.ascontiguousarray(raw[starts[:, None] + np.arange(kind.itemsize)]).view(kind)[:, 0]
    return values
