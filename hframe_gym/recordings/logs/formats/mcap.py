"""MCAP files with messages of ROS 1 and 2, JSON or Protobuf, read with mcap (extra `ros`)."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from typing_extensions import override

from ....errors import InputError, one_line
from ....files import refuse_expansion
from ..log import Log
from .base import KNOWN_CONTENT, LOG_FORMATS, LogFormat, require_extra
from .messages import MessageSource, UnreadableError, log_of_messages
from .ros_messages import RosDecoder, decoded, ros2_name

_LARGEST_RECORD = 1 << 28  # bytes; a damaged file may state any size


@LOG_FORMATS.register("mcap")
class McapLogs(LogFormat):
    """MCAP files of Foxglove, ROS 2 and others."""

    suffixes = (".mcap",)
    precedence = KNOWN_CONTENT

    @override
    def recognizes(self, path: Path, start: bytes) -> bool:
        """Recognize the first bytes of an MCAP file."""
        return start.startswith(b"\x89MCAP0\r\n")

    @override
    def open(self, path: Path) -> list[Log]:
        """Open the numbers in the messages of all topics as one log.

        A file that ends early is read up to there.
        """
        advice = "export its signals as CSV, with PlotJuggler or Foxglove"
        require_extra(path, "MCAP files", "ros", ["mcap", "mcap_protobuf", "rosbags"], advice)
        file = _McapFile(path)
        remarks = ["it is an MCAP file"]
        if file.ends_early:
            remarks.append("it ends early; the messages up to there are read")
        return [log_of_messages(path, file, tuple(remarks))]


class _McapFile(MessageSource):
    """Messages of an MCAP file; one that ends early, as after a loss of power, is read up to there."""

    def __init__(self, path: Path) -> None:
        self._path = path
        # Function that decodes messages, or why there is none, by encoding and number of the schema.
        self._decode: dict[tuple[str, int], Callable[[bytes], Any] | str] = {}
        self._topics: dict[str, str] = {}
        self._ros: RosDecoder | None = None
        self._protobuf: Any = None
        self.ends_early = False
        self._has_index = self._read_index()
        if not self._has_index:
            for schema, channel, _ in self._records(None):
                self._topics[channel.topic] = _kind(schema, channel)
            if not self._topics:
                raise _damaged(path, "it has no messages")

    @override
    def topics(self) -> dict[str, str]:
        return self._topics

    @override
    def messages(self, topic: str) -> Iterator[tuple[int, Any]]:
        where = f"{self._path}, {topic}"
        for number, (schema, channel, message) in enumerate(self._records(topic), start=1):
            yield message.log_time, decoded(where, number, self._decoder(schema, channel), message.data)

    def _read_index(self) -> bool:
        """Read the topics from the index at the end of the file; return whether there is one."""
        from mcap.reader import SeekingReader

        with open(self._path, "rb") as stream:
            try:
                summary = SeekingReader(stream, record_size_limit=_LARGEST_RECORD).get_summary()
            except Exception:  # of many types; the file ends early or is damaged
                return False
        if summary is None or not summary.chunk_indexes:
            return False
        refuse_expansion(self._path, sum(index.uncompressed_size for index in summary.chunk_indexes))
        for channel in summary.channels.values():
            self._topics[channel.topic] = _kind(summary.schemas.get(channel.schema_id), channel)
        return True

    def _records(self, topic: str | None) -> Iterator[tuple[Any, Any, Any]]:
        """Yield schema, channel and message of all messages, or of those of a topic."""
        from mcap.exceptions import EndOfFile
        from mcap.reader import NonSeekingReader, SeekingReader

        topics = None if topic is None else [topic]
        with open(self._path, "rb") as stream:
            try:
                if self._has_index:
                    seeking = SeekingReader(stream, record_size_limit=_LARGEST_RECORD)
                    yield from seeking.iter_messages(topics=topics)
                else:
                    plain = NonSeekingReader(stream, record_size_limit=_LARGEST_RECORD)
                    yield from plain.iter_messages(topics=topics, log_time_order=False)
            except (EndOfFile, struct.error):  # in the middle of a record
                self.ends_early = True
            except Exception as error:  # of many types for damaged files
                raise _damaged(self._path, one_line(error)) from None

    def _decoder(self, schema: Any, channel: Any) -> Callable[[bytes], Any]:
        """Return the function that decodes the messages of a channel."""
        key = (channel.message_encoding, channel.schema_id)
        if key not in self._decode:
            try:
                self._decode[key] = self._new_decoder(schema, channel.message_encoding)
            except UnreadableError as error:
                self._decode[key] = str(error)
        decode = self._decode[key]
        if isinstance(decode, str):
            raise UnreadableError(decode)
        return decode

    def _new_decoder(self, schema: Any, encoding: str) -> Callable[[bytes], Any]:
        """Create the function that decodes messages of a schema."""
        if encoding == "json":
            return json.loads
        if schema is not None and encoding == "protobuf" and schema.encoding == "protobuf":
            from mcap_protobuf.decoder import DecoderFactory

            self._protobuf = self._protobuf or DecoderFactory()
            try:
                decode = self._protobuf.decoder_for(encoding, schema)
            except Exception as error:  # of many types for faulty definitions
                raise UnreadableError(f"faulty definition: {one_line(error)}") from None
            if decode is not None:
                return decode
        forms = {"cdr": ("ros2msg", "ros2idl"), "ros1": ("ros1msg",)}
        if schema is not None and schema.encoding in forms.get(encoding, ()):
            self._ros = self._ros or RosDecoder()
            name = ros2_name(schema.name)
            text = schema.data.decode("utf-8", errors="replace")
            self._ros.add_definition(name, text, idl=schema.encoding == "ros2idl")
            return self._ros.decoder(name, ros1=encoding == "ros1")
        raise UnreadableError(f"messages in {encoding or 'an unknown form'} are not read")


def _damaged(path: Path, reason: str) -> InputError:
    """Return the error for a file that cannot be read."""
    advice = "`mcap recover FILE -o REPAIRED` saves what is left"
    return InputError(f"{path}: cannot be read as an MCAP file: {reason}; {advice}")


def _kind(schema: Any, channel: Any) -> str:
    """Return the kind of a channel's messages, in words."""
    return schema.name if schema is not None and schema.name else channel.message_encoding or "unknown"
