"""Logs of messages by topic: find the numbers in messages of any structure, and read those that are needed.

A number is named by its path, "/joint_states/elbow/position". Where a message has a list of names, such as
that of its joints, lists of the same length are named by them, else by number: "/imu/data[0]".
"""

from __future__ import annotations

import dataclasses
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....errors import InputError, first_of
from ....files import refuse_many_values
from ...tables.text_reader import Progress
from ..log import Log
from .tables import MOST_ITEMS, Rows, TimedTable, log_of_tables, signal_columns

_SAMPLE = 10  # first messages of a topic, from which its numbers follow
_MOST_NUMBERS = 500  # of a topic
_DEEPEST = 16  # messages in messages
_NAME_LISTS = ("name", "names", "joint_names", "interface_names")
_SECONDS = (("sec", "nanosec"), ("secs", "nsecs"), ("seconds", "nanos"))
# s; the time in a header differs from that of the recorder by more if it is that of another clock, or of a
# simulation.
_SAME_CLOCK = 1.0


class MessageSource(ABC):
    """File of messages by topic."""

    @abstractmethod
    def topics(self) -> dict[str, str]:
        """Return the type of the messages, such as "sensor_msgs/msg/JointState", by topic."""

    @abstractmethod
    def messages(self, topic: str) -> Iterator[tuple[int, Any]]:
        """Read the messages of a topic.

        Yields:
            Time of the recorder, ns since 1970, and message: dictionaries, objects with fields, lists, arrays
            of any shape, numbers and texts.

        Raises:
            UnreadableError: If messages of this kind cannot be read.
            InputError: If a message is damaged. The text names the file, the topic and the number of the
                message.
        """


class UnreadableError(Exception):
    """Messages of some kind cannot be read; the text says why."""


def log_of_messages(path: Path, source: MessageSource, remarks: tuple[str, ...]) -> Log:
    """Open the numbers in the messages of a file as a log.

    Args:
        remarks: Sentences for the user about the file; one about the topics that are left out is added.

    Returns:
        Log whose columns have the shape (rows,); the time of a row is that in the header of its message, if
        it has one of the same clock, else that of the recorder.

    Raises:
        InputError: If no topic has numbers, or the first messages of a topic are damaged.
    """
    tables, left_out = [], []
    for topic, kind in sorted(source.topics().items()):
        try:
            first = list(islice(source.messages(topic), _SAMPLE))
        except UnreadableError as error:
            left_out.append(f"{topic} ({kind}: {error})")
            continue
        names = list(dict.fromkeys(name for _, message in first for name in numbers_of(message, topic)))
        if not names:
            left_out.append(f"{topic} ({kind})")
            continue
        tables.append(_table(path, source, topic, names[:_MOST_NUMBERS]))
    if not tables:
        listed = ", ".join(left_out[:20]) or "none"
        raise InputError(f"{path}: has no topics with numbers that can be read; topics: {listed}")
    if left_out:
        remarks = (*remarks, f"topics that are left out: {first_of(left_out)}")
    return log_of_tables(path, tables, remarks)


def numbers_of(message: Any, name: str) -> dict[str, float]:
    """Find all numbers in a message; its header, texts and long lists are left out.

    Args:
        message: Message as `MessageSource.messages` yields it.
        name: Name of the message, usually its topic, with which the names of its numbers begin.

    Returns:
        Numbers, in the units of the message, by name, such as "/joint_states/elbow/position".
    """
    found: dict[str, float] = {}
    members = _members(message)
    if members is not None:
        message = {key: value for key, value in members.items() if key != "header"}
    _collect(message, name, found, 0)
    return found


def _table(path: Path, source: MessageSource, topic: str, names: Sequence[str]) -> TimedTable:
    """Return the table of a topic."""

    def read(indices: Sequence[int], progress: Progress | None) -> Rows:
        wanted = [names[index] for index in indices]
        recorded, stamps, rows = [], [], []
        for time_ns, message in source.messages(topic):
            numbers = numbers_of(message, topic)
            rows.append([numbers.get(name, np.nan) for name in wanted])
            recorded.append(time_ns)
            stamps.append(_stamp(message))
            if len(rows) % 10_000 == 0:
                refuse_many_values(path, len(rows), len(wanted) + 2)
        if progress is not None:
            progress(0)
        values = np.array(rows, np.float64).reshape(len(rows), len(wanted))
        time, remarks = _times(topic, np.array(recorded, np.int64), stamps)
        return time.astype("datetime64[ns]"), list(np.ascontiguousarray(values.T)), remarks

    return TimedTable(topic, signal_columns(names), read, "stamp")


def _times(
    topic: str, recorded: NDArray[np.int64], stamps: Sequence[int]
) -> tuple[NDArray[np.int64], list[str]]:
    """Return the times of messages, ns: those of their headers if they are of the recorder's clock."""
    headers = np.array(stamps, np.int64)
    if len(headers) == 0 or np.any(headers <= 0):
        return recorded, []
    difference = float(np.median(headers - recorded)) / 1e9
    if abs(difference) > _SAME_CLOCK:
        return recorded, [
            f"{topic}: the times of its headers are {abs(difference):.3g} "
            f"s {'after' if difference > 0 else 'before'} those of the recorder, which are used"
        ]
    return headers, [f"{topic}: the times are those of its headers"]


def _stamp(message: Any) -> int:
    """Return the time in the header of a message, ns; 0 if there is none."""
    header = (_members(message) or {}).get("header")
    stamp = (_members(header) or {}).get("stamp")
    parts = _members(stamp) or {}
    for seconds, fraction in _SECONDS:
        if seconds in parts and fraction in parts:
            try:
                return int(parts[seconds]) * 1_000_000_000 + int(parts[fraction])
            except (TypeError, ValueError, OverflowError):
                return 0
    return 0


def _members(value: Any) -> Mapping[str, Any] | None:
    """Return the fields of a message by name; None for a value that is no message."""
    if isinstance(value, Mapping):
        return value
    descriptor = getattr(value, "DESCRIPTOR", None)  # of Protobuf
    if descriptor is not None:
        return {field.name: getattr(value, field.name) for field in descriptor.fields}
    if dataclasses.is_dataclass(value):
        return {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
    return None


def _collect(value: Any, name: str, found: dict[str, float], depth: int) -> None:
    """Add the numbers in a value to `found`."""
    if depth > _DEEPEST or len(found) >= _MOST_NUMBERS:
        return
    if isinstance(value, (bool, int, float, np.number, np.bool_)):
        try:
            found[name] = float(value)
        except OverflowError:
            found[name] = np.nan
        return
    if isinstance(value, (str, bytes, bytearray)) or value is None:
        return
    members = _members(value)
    if members is not None:
        _collect_members(members, name, found, depth)
        return
    items = _length(value)
    if items is not None and items <= MOST_ITEMS:
        for index, item in enumerate(value):
            _collect(item, f"{name}[{index}]", found, depth + 1)


def _collect_members(members: Mapping[str, Any], name: str, found: dict[str, float], depth: int) -> None:
    """Add the numbers in the fields of a message to `found`; a time becomes one number, s."""
    for seconds, fraction in _SECONDS:
        if set(members) == {seconds, fraction}:
            _collect(members[seconds], name, found, depth + 1)
            if name in found:
                rest: dict[str, float] = {}
                _collect(members[fraction], name, rest, depth + 1)
                found[name] += 1e-9 * rest.get(name, 0.0)
            return
    labels = _labels(members)
    for key, item in members.items():
        if not isinstance(key, str):
            continue
        if labels and key not in _NAME_LISTS and _length(item) == len(labels):
            for label, element in zip(labels, item, strict=True):
                _collect(element, f"{name}/{label}/{key}", found, depth + 1)
        else:
            _collect(item, f"{name}/{key}", found, depth + 1)


def _labels(members: Mapping[str, Any]) -> list[str]:
    """Return the names of the items of the lists in a message; empty if it has none."""
    for key in _NAME_LISTS:
        names = members.get(key)
        if _length(names) is not None:
            listed = list(names)  # type: ignore[arg-type]
            is_unique = len(set(map(str, listed))) == len(listed) <= MOST_ITEMS
            if listed and is_unique and all(isinstance(label, str) and label for label in listed):
                return listed
    return []


def _length(value: Any) -> int | None:
    """Return the number of items of a list or array; None for anything else."""
    if isinstance(value, (str, bytes, bytearray, Mapping)) or not hasattr(value, "__getitem__"):
        return None
    try:
        return len(value)
    except TypeError:  # an array without axes
        return None
