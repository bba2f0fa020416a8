"""Recognize files of other programs that are no tables, and say how their data are exported to one."""

from __future__ import annotations

import re
from pathlib import Path

from ...errors import InputError

_AS_CSV = "export its signals as CSV"
_UNPACK = "unpack it, and import the folder of its files"
# By the bytes with which a file begins: what it is, and what to do.
_BY_START: tuple[tuple[bytes, str, str], ...] = (
    (b"ULog\x01\x12\x35", "is a PX4 log", f"{_AS_CSV}: ulog2csv FILE"),
    (b"TDSm", "is a TDMS file of LabVIEW", f"{_AS_CSV}, with DIAdem or the Excel add-in"),
    (b"MDF     ", "is an MDF file (ASAM)", f"{_AS_CSV}, with asammdf"),
    (b"7z\xbc\xaf\x27\x1c", "is an archive", _UNPACK),
    (b"Rar!\x1a\x07", "is an archive", _UNPACK),
    (b"PK\x03\x04", "is a spreadsheet or an archive, not a table in text", "save the sheet as CSV"),
    (b"\xd0\xcf\x11\xe0", "is a spreadsheet or an archive, not a table in text", "save the sheet as CSV"),
)
# Endings of files in a folder that are probably logs but are not read, by the same kinds.
FOREIGN_SUFFIXES = (
    *(".xlsx", ".xls", ".xlsm", ".ods", ".ulg", ".tdms", ".mf4", ".mdf"),
    *(".json", ".jsonl", ".zip", ".7z", ".rar"),
)
# An object, or a list of texts, lists, objects or numbers; a row of units begins with "[-]" or "[1]".
_JSON_START = re.compile(rb"(?:\xef\xbb\xbf)?\s*(?:\{\s*[\"}]|\[\s*(?:[\"\[{]|-?\d[\d.eE+-]*\s*,))")


def refuse_foreign_file(path: Path, start: bytes) -> None:
    """Raise an InputError for a file of a kind that is not read; the message says how to export the data.

    Args:
        start: First bytes of the file (`start_of`).
    """
    if path.suffix.lower() == ".zip" and start.startswith(b"PK"):
        raise InputError(f"{path}: is an archive; {_UNPACK}")
    for beginning, problem, advice in _BY_START:
        if start.startswith(beginning):
            raise InputError(f"{path}: {problem}; {advice}")


def is_json(path: Path, start: bytes) -> bool:
    """Return whether a file is JSON: its name ends in .json, or `start` begins an object or a list.

    Args:
        start: First bytes of the file (`start_of`).
    """
    return path.suffix.lower() == ".json" or _JSON_START.match(start) is not None
