"""Progress that a command prints for the program that started it: a JSON object a line, behind a mark."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from typing import Any

# Environment variable, and its value, of a command that is to print records in place of a bar.
REQUEST = {"HFRAME_PROGRESS": "json"}
_MARK = "\x1e"  # the record separator of JSON text sequences (RFC 7464)


def requested() -> bool:
    """Return whether the program that started this one asks for records of progress."""
    return REQUEST.items() <= os.environ.items()


def line_of(record: Mapping[str, Any]) -> str:
    """Return a record of progress as a line of output, without its end."""
    return f"{_MARK}{json.dumps(record)}"


def record_of(line: str) -> dict[str, Any] | None:
    """Return the record of progress of a line of output, without its end; None if it is another line."""
    return json.loads(line.removeprefix(_MARK)) if line.startswith(_MARK) else None
