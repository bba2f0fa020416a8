"""NumPy's .npz files; columns are their vectors and the columns of their matrices, as in MATLAB files."""

from __future__ import annotations

from pathlib import Path

from typing_extensions import override

from ....errors import InputError
from ....files import read_arrays
from ..log import Log, vector_log
from .base import LOG_FORMATS, LogFormat
from .matlab_vectors import vectors

_ARCHIVE = b"PK\x03\x04"


@LOG_FORMATS.register("numpy")
class NumpyLogs(LogFormat):
    """Archives of arrays, as numpy.savez writes them."""

    suffixes = (".npz",)

    @override
    def recognizes(self, path: Path, start: bytes) -> bool:
        """Recognize an archive by its name, because spreadsheets are archives, too."""
        return start.startswith(_ARCHIVE) and path.suffix.lower() == ".npz"

    @override
    def open(self, path: Path) -> list[Log]:
        """Read all arrays of one or two dimensions, whose vectors are the columns of one log.

        Raises:
            InputError: If the file is damaged, or has no such arrays of numbers.
        """
        found = [pair for name, values in read_arrays(path).items() for pair in vectors(name, values)]
        if not found:
            raise InputError(
                f"{path}: has no arrays of numbers of one or two dimensions; save them with numpy.savez"
            )
        return [vector_log(path, found, "an archive of NumPy")]
