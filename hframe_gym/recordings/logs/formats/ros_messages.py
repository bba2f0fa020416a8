"""Decode messages of ROS 1 and 2 by their definitions, with rosbags (extra `ros`)."""

from __future__ import annotations

import keyword
import re
from collections.abc import Callable
from typing import Any

from ....errors import InputError, one_line
from .messages import UnreadableError

_LONGEST_LIST = 10_000_000  # items of a list in a message; an image has fewer
_IDL = "=" * 80 + "\n"  # between the definitions of types in IDL
_TYPE = re.compile(r"[A-Za-z]\w*(?:/[A-Za-z]\w*)+")
_FIELD = re.compile(r"[A-Za-z_]\w*")


class RosDecoder:
    """Decoder of the messages of a file."""

    def __init__(self) -> None:
        """Create a decoder that knows no types yet."""
        from rosbags.typesys import Stores, get_typestore

        self._store = get_typestore(Stores.EMPTY)
        self._store.max_sequence_length = _LONGEST_LIST

    def add_definition(self, name: str, text: str, *, idl: bool) -> None:
        """Register the definition of a message type.

        Args:
            name: Name of the type, such as "sensor_msgs/msg/JointState".
            idl: Whether the definition is in IDL, which few recorders write, rather than in the form of .msg
                files.

        Raises:
            UnreadableError: If the definition is faulty or differs from an earlier one of the same name.
        """
        from rosbags.typesys import get_types_from_idl, get_types_from_msg

        try:
            if idl:
                parts = [
                    part.partition("\n")[2] for part in text.split(_IDL) if part.startswith("IDL: ")
                ] or [text]
                types = {key: entry for part in parts for key, entry in get_types_from_idl(part).items()}
            else:
                types = get_types_from_msg(text, name)
            _refuse_other_names(types)
            self._store.register(types)
        except UnreadableError:
            raise
        except Exception as error:  # the parser raises many types
            raise UnreadableError(f"faulty definition: {one_line(error)}") from None

    def add_known_types(self) -> None:
        """Register the usual types of ROS 2, for bags of older versions, which contain no definitions.

        They replace all definitions that were registered before.
        """
        from rosbags.typesys import Stores, get_typestore

        self._store = get_typestore(Stores.ROS2_HUMBLE)
        self._store.max_sequence_length = _LONGEST_LIST

    def decoder(self, name: str, *, ros1: bool) -> Callable[[bytes], Any]:
        """Return the function that decodes the bytes of a message of a type.

        Args:
            name: Name of the type as ROS 2 writes it, see `ros2_name`.
            ros1: Whether the messages are serialized as in ROS 1, not as in ROS 2 (CDR).

        Raises:
            UnreadableError: If neither `add_definition` nor `add_known_types` has registered the type.
        """
        if name not in self._store.fielddefs:
            raise UnreadableError("its definition is not in the file")
        decode = self._store.deserialize_ros1 if ros1 else self._store.deserialize_cdr
        return lambda content: decode(content, name)


def ros2_name(name: str) -> str:
    """Return the name of a type as ROS 2 writes it: "std_msgs/msg/Float64" for "std_msgs/Float64"."""
    return name if name.count("/") != 1 else name.replace("/", "/msg/")


def decoded(where: str, number: int, decode: Callable[[bytes], Any], content: bytes) -> Any:
    """Decode one message.

    Args:
        where: File and topic, for the error.
        number: Number of the message in its topic, from 1, for the error.
        decode: Function that decodes it, see `RosDecoder.decoder`.
        content: Bytes of the message.

    Raises:
        InputError: If the message is damaged.
    """
    try:
        return decode(content)
    except Exception as error:  # decoders raise many types for damaged messages
        raise InputError(f"{where}, message {number}: is damaged ({one_line(error)})") from None


def _refuse_other_names(types: dict[str, Any]) -> None:
    """Refuse definitions with anything but plain names and values, as rosbags generates code from them."""
    for name, (constants, fields) in types.items():
        parts = [(part, _FIELD) for part, *_ in (*constants, *fields)] + [(name, _TYPE)]
        for part, pattern in parts:
            if pattern.fullmatch(part) is None or keyword.iskeyword(part):
                raise UnreadableError(f"faulty definition: {part!r} is no name")
        for part, _, value in constants:
            if not isinstance(value, (bool, int, float, str)):
                raise UnreadableError(f"faulty definition: the constant {part!r} has no plain value")
        for _, description in fields:
            for reference in re.findall(r"'([^']*)'", str(description[1])):
                if re.fullmatch(r"[A-Za-z][\w/]*", reference) is None:
                    raise UnreadableError(f"faulty definition: {reference!r} is no name of a type")
