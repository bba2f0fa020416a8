"""Readers of JSON, text and .npz files with limits on size, compression ratio and nesting.

The limits keep a damaged or hostile file from filling the memory. Every reader of the package uses these
functions. Nothing in a file is executed.
"""

from __future__ import annotations

import codecs
import json
import math
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError

# Bytes of a JSON or TOML file; a machine with the covariance of 500 parameters has 4 MB.
MAX_DOCUMENT = 16 << 20
# A compressed table may have this many times the bytes of its file. Times increase from row to row, so that
# tables of a rig at rest reach about 25; archives that are made to fill the memory reach 1000.
MAX_EXPANSION = 100
FREE_EXPANSION = 64 << 20  # bytes that any compressed file may expand to
# Characters of a line of a table, as many as are read at once to recognize its format: 3000 columns of 20
# characters.
MAX_LINE = 1 << 16
MAX_VALUES = 1_000_000_000  # numbers of a table: 8 GB, two hours at 10 kHz with 13 columns


def expansion_limit(path: Path) -> int:
    """Return the largest accepted size, bytes, of the content of a compressed file.

    A small compressed file can expand to more than the memory holds. The limit is 100 times the size of the
    file (`MAX_EXPANSION`), but at least 64 MB (`FREE_EXPANSION`).
    """
    return max(FREE_EXPANSION, MAX_EXPANSION * path.stat().st_size)


def refuse_expansion(path: Path, size: int) -> None:
    """Raise an InputError if decompressed content of `size` bytes exceeds the file's `expansion_limit`."""
    if size > expansion_limit(path):
        raise InputError(
            f"{path}: expands to more than {MAX_EXPANSION} times its size and {FREE_EXPANSION >> 20} MB, "
            "which no recording does; it is refused because it would fill the memory"
        )


def refuse_long_line(path: Path, length: int) -> None:
    """Raise an InputError if a line has too many characters (`MAX_LINE`) to be a row of numbers."""
    if length >= MAX_LINE:
        raise InputError(
            f"{path}: has a line of more than {MAX_LINE - 1} characters; a table has a row for each time. "
            "If each of its lines is one quantity, transpose it; otherwise save fewer columns"
        )


def refuse_many_values(path: Path, rows: int, columns: int) -> None:
    """Raise an InputError if a table has more than `MAX_VALUES` numbers (8 GB)."""
    if rows * columns > MAX_VALUES:
        raise InputError(
            f"{path}: has more than {MAX_VALUES:.0e} numbers; cut the recording into several runs"
        )


def read_document(path: Path) -> str:
    """Read a text file such as JSON or TOML, UTF-8 or UTF-16 with a byte order mark, of at most 16 MB.

    Raises:
        InputError: If the file cannot be read, is larger, or is not a text in such an encoding.
    """
    try:
        with open(path, "rb") as file:
            content = file.read(MAX_DOCUMENT + 1)
        if len(content) > MAX_DOCUMENT:
            raise InputError(
                f"{path}: is larger than {MAX_DOCUMENT >> 20} MB, which is not a file of this kind"
            )
        # `>` in Windows PowerShell writes it
        utf_16 = content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
        return content.decode("utf-16" if utf_16 else "utf-8-sig")
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: is not a text file in UTF-8 ({error.reason})") from None


def read_json(path: Path) -> Any:
    """Read a JSON file in an encoding of `read_document`.

    Raises:
        InputError: If the file cannot be read, is larger than 16 MB or nested too deeply, or is not valid
            JSON. NaN, infinity and integers of thousands of digits are not accepted.
    """
    try:
        return json.loads(read_document(path), parse_constant=_refuse_constant)
    except InputError:
        raise
    except ValueError as error:
        raise InputError(f"{path}: is not valid JSON: {error}") from None
    except RecursionError:
        raise InputError(f"{path}: is not valid JSON: it is nested too deeply") from None


# What zipfile and NumPy raise on damaged archives and arrays.
_DAMAGED = (
    OSError, EOFError, ValueError, TypeError, KeyError, RuntimeError, SyntaxError, MemoryError,
    zipfile.BadZipFile, zlib.error,
)  # fmt: skip


def read_arrays(path: Path) -> dict[str, NDArray[Any]]:
    """Read the arrays of an .npz file, of any shape, without executing code from the file.

    Arrays of Python objects, which NumPy stores as pickles, are refused, because reading a pickle can execute
    code.

    Raises:
        InputError: If the file cannot be read, an array is damaged or holds Python objects, or the arrays
            together are larger than both 64 MB and 100 times the file.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            members = archive.infolist()
            refuse_expansion(path, sum(member.file_size for member in members))
            return {member.filename.removesuffix(".npy"): _array(archive.open(member)) for member in members}
    except InputError:
        raise
    except _DAMAGED as error:
        raise InputError(f"{path}: is not a readable .npz file ({error})") from None


def _array(stream: Any) -> NDArray[Any]:
    """Read one array; the size in its header must be that of its data, so that no header reserves memory."""
    with stream:
        version = np.lib.format.read_magic(stream)
        read_header = {
            (1, 0): np.lib.format.read_array_header_1_0,
            (2, 0): np.lib.format.read_array_header_2_0,
        }
        if version not in read_header:
            raise ValueError(f"version {version} of the format .npy")
        shape, fortran_order, dtype = read_header[version](stream)
        if dtype.hasobject:
            raise ValueError("an array holds Python objects")
        data = stream.read()
        if len(data) != dtype.itemsize * math.prod(shape):
            raise ValueError(f"an array of the shape {shape} has {len(data)} bytes")
        values = np.frombuffer(data, dtype)
        return values.reshape(shape[::-1]).T if fortran_order else values.reshape(shape)


def _refuse_constant(name: str) -> Any:
    """Refuse NaN and Infinity, which Python's reader accepts and JSON does not have."""
    raise ValueError(f"{name} is not a number")
