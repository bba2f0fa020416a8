"""Progress that a command prints for the program that started it: marked lines, each with a JSON object."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from typing import Any

# Environment variable, and its value, of a command that is to print records in place of a bar.
REQUEST = {"HFRAME_PROGRESS": "json"}
_MARK = "\x1e"  # the record separator of JSON text sequences (RFC 7464)


def requested() -> bool:
    """Return whether the program that started this process has asked it to print progress records.

    It asks by the environment variable HFRAME_PROGRESS=json (`REQUEST`).
    """
    return REQUEST.items() <= os.environ.items()


def line_of(record: Mapping[str, Any]) -> str:
    """Format a progress record as a line of output, without a line end.

    Args:
        record: What JSON can represent, by any names.
    """
    return f"{_MARK}{json.dumps(record)}"


def record_of(line: str) -> dict[str, Any] | None:
    """Read the progress record from a line of output without its line end; None if the line holds none."""
    return json.loads(line.removeprefix(_MARK)) if line.startswith(_MARK) else None
