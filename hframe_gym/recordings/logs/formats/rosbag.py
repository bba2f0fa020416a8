"""Bags of ROS 1 (.bag) and ROS 2 (a folder with metadata.yaml, or .db3), read with rosbags (extra `ros`)."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

from typing_extensions import override

from ....errors import InputError, one_line
from ..log import Log
from .base import KNOWN_CONTENT, LOG_FORMATS, LogFormat, require_extra
from .messages import MessageSource, UnreadableError, log_of_messages
from .ros_messages import RosDecoder, decoded

_METADATA = "metadata.yaml"
_START = 4096  # bytes of it that have the name of its only entry


@LOG_FORMATS.register("rosbag")
class RosBagLogs(LogFormat):
    """Bags of ROS 1 and 2."""

    suffixes = (".bag", ".db3")
    precedence = KNOWN_CONTENT

    @override
    def recognizes(self, path: Path, start: bytes) -> bool:
        """Recognize a bag of ROS 1 or a database by its first bytes, and a folder by its metadata.yaml."""
        return start.startswith((b"#ROSBAG", b"SQLite format 3\0")) or _is_bag(path)

    @override
    def logs_in(self, folder: Path) -> list[Path]:
        """Return the folder itself if it is a bag of ROS 2."""
        return [folder] if _is_bag(folder) else []

    @override
    def open(self, path: Path) -> list[Log]:
        """Open the numbers in the messages of all topics as one log."""
        advice = "export its signals as CSV, for example with PlotJuggler"
        require_extra(path, "bags of ROS", "ros", ["rosbags"], advice)
        version = 1 if path.is_file() and path.suffix.lower() != ".db3" else 2
        return [log_of_messages(path, _Bag(path, version), (f"it is a bag of ROS {version}",))]


def _is_bag(folder: Path) -> bool:
    """Return whether a folder has the description of a bag of ROS 2; other data has such files too."""
    if not (folder / _METADATA).is_file():
        return False
    with open(folder / _METADATA, "rb") as file:
        return b"rosbag2_bagfile_information" in file.read(_START)


class _Bag(MessageSource):
    """Messages of a bag."""

    def __init__(self, path: Path, version: int) -> None:
        self._path, self._version = path, version
        self._decoder = RosDecoder()
        self._faulty: dict[str, str] = {}  # why the messages of a type cannot be read
        self._topics: dict[str, str] = {}
        with self._reader() as reader:
            self._add_types(reader.connections)
            for connection in reader.connections:
                self._topics[connection.topic] = connection.msgtype

    @override
    def topics(self) -> dict[str, str]:
        return self._topics

    @override
    def messages(self, topic: str) -> Iterator[tuple[int, Any]]:
        kind = self._topics[topic]
        if kind in self._faulty:
            raise UnreadableError(self._faulty[kind])
        decode = self._decoder.decoder(kind, ros1=self._version == 1)
        where = f"{self._path}, {topic}"
        with self._reader() as reader:
            connections = [connection for connection in reader.connections if connection.topic == topic]
            contents = self._contents(lambda: reader.messages(connections=connections))
            for number, (time_ns, content) in enumerate(contents, start=1):
                yield time_ns, decoded(where, number, decode, content)

    def _reader(self) -> Any:
        """Open the bag."""
        from rosbags import rosbag1, rosbag2

        reader = rosbag1.Reader(self._path) if self._version == 1 else rosbag2.Reader(self._path)
        try:
            reader.open()
        except Exception as error:  # many types for damaged bags
            raise self._damaged(error) from None
        return closing(reader)

    def _contents(self, messages: Callable[[], Iterator[Any]]) -> Iterator[tuple[int, bytes]]:
        """Yield times and bytes of messages; a damaged bag is refused."""
        iterator = messages()
        while True:
            try:
                _, time_ns, content = next(iterator)
            except StopIteration:
                return
            except Exception as error:  # many types for damaged bags
                raise self._damaged(error) from None
            yield time_ns, content

    def _damaged(self, error: Exception) -> InputError:
        """Return the error for a bag that cannot be read."""
        advice = (
            "repair it by `rosbag reindex`"
            if self._version == 1
            else "repair its description by `ros2 bag reindex`"
        )
        return InputError(f"{self._path}: cannot be read as a bag of ROS: {one_line(error)}; {advice}")

    def _add_types(self, connections: Any) -> None:
        """Make the types of messages known by their definitions, or, if the bag has none, the usual ones."""
        from rosbags.interfaces import MessageDefinitionFormat as Format

        with_definition = [c for c in connections if c.msgdef.format != Format.NONE]
        if not with_definition and self._version == 2:
            self._decoder.add_known_types()
        for connection in with_definition:
            try:
                is_idl = connection.msgdef.format == Format.IDL
                self._decoder.add_definition(connection.msgtype, connection.msgdef.data, idl=is_idl)
            except UnreadableError as error:
                self._faulty[connection.msgtype] = str(error)
