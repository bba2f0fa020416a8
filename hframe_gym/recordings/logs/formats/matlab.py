"""MATLAB and HDF5 files; columns are their vectors and the columns of their matrices, also in structs.

Each experiment in the iddata objects of the System Identification Toolbox is a log, if the file has nothing
else. MATLAB files of version 7.3 are HDF5 files, which need h5py (extra `hdf5`); tables and timeseries need
mat-io (extra `matlab`).
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import zlib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from ....errors import InputError
from ....files import expansion_limit, refuse_expansion
from ..log import Log, vector_log
from .base import LOG_FORMATS, LogFormat, require_extra

_HDF5 = b"\x89HDF\r\n\x1a\n"  # at the beginning of the file, or after 512 bytes that MATLAB writes before it
_MATLAB_BLOCK = 512
_MAT_HEADER = 128  # bytes before the first variable in MATLAB files of version 5 to 7
_MAT_COMPRESSED = 15  # type of a compressed variable
# Compressed bytes per step. A byte expands to 1032 at most, a step to 64 MB; the size is checked after each
# step.
_MAT_BLOCK = 1 << 16


@LOG_FORMATS.register("matlab")
class MatlabLogs(LogFormat):
    """MATLAB files of all versions and other HDF5 files."""

    suffixes = (".mat", ".h5", ".hdf5")

    @override
    def recognizes(self, path: Path, start: bytes) -> bool:
        """Recognize the headers, or the name of files of version 4, which have none."""
        return start.startswith((b"MATLAB", _HDF5)) or (path.suffix.lower() == ".mat" and path.is_file())

    @override
    def open(self, path: Path) -> list[Log]:
        """Read all vectors of numbers in a MATLAB or HDF5 file at once, in a separate process.

        The columns of the log are these vectors; each experiment of an iddata object is a log.

        Raises:
            InputError: If the file is damaged or has no vectors of numbers, or an extra is missing.
        """
        with open(path, "rb") as file:
            start = file.read(_MATLAB_BLOCK + len(_HDF5))
        is_hdf5 = _HDF5 in (start[: len(_HDF5)], start[_MATLAB_BLOCK:])
        if is_hdf5:
            advice = "save it as version 7 in MATLAB: save('log.mat', 't', 'x', '-v7')"
            require_extra(path, "HDF5 files (MATLAB 7.3)", "hdf5", ["h5py"], advice)
        else:
            _refuse_large_variables(path)
        kind = "an HDF5 file" if is_hdf5 else "a MATLAB file"
        parts = _mat_vectors(path, kind)
        if not parts:
            advice = (
                "save plain arrays, a struct of arrays or, as version 7, timeseries: "
                "save('log.mat', 'u', 'x', '-v7')"
            )
            require_extra(path, "tables, timetables and timeseries", "matlab", ["matio"], advice)
            raise InputError(f"{path}: has no arrays of numbers, tables or timeseries; {advice}")
        return [vector_log(path, vectors, kind, part) for part, vectors in parts.items()]


def _mat_vectors(path: Path, kind: str) -> dict[str, list[tuple[str, NDArray[np.float64]]]]:
    """Return the names and values of all vectors of a file by part, "" for all, in a separate process.

    The readers can end the process on damaged files (segmentation fault), which no exception handler sees.
    """
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder, "vectors.npz")
        # -P keeps the script's folder off sys.path, so that its modules cannot shadow others.
        command = [
            sys.executable,
            "-P",
            str(Path(__file__).with_name("matlab_vectors.py")),
            str(path),
            str(target),
        ]
        command.append(str(expansion_limit(path)))
        run = subprocess.run(command, check=False, capture_output=True, text=True)
        if run.returncode:
            reason = run.stderr.strip().rpartition("\n")[2] if run.returncode > 0 else "it is damaged"
            raise InputError(f"{path}: cannot be read as {kind}: {reason}")
        with np.load(target, allow_pickle=False) as content:
            parts: dict[str, list[tuple[str, NDArray[np.float64]]]] = {}
            for k, (part, name) in enumerate(zip(content["parts"], content["names"], strict=True)):
                parts.setdefault(str(part), []).append((str(name), content[f"arr_{k}"]))
            return parts


def _refuse_large_variables(path: Path) -> None:
    """Check the size of the compressed variables of a MATLAB file without keeping their content in memory."""
    size, content = 0, memoryview(path.read_bytes())
    position, order = _MAT_HEADER, ">u4" if bytes(content[126:128]) == b"MI" else "<u4"
    while position + 8 <= len(content):
        kind, length = np.frombuffer(content[position : position + 8], order).tolist()
        if kind == _MAT_COMPRESSED:
            stream, compressed = zlib.decompressobj(), content[position + 8 : position + 8 + length]
            for start in range(0, len(compressed), _MAT_BLOCK):
                try:
                    size += len(stream.decompress(compressed[start : start + _MAT_BLOCK]))
                except zlib.error:
                    break  # which the reader reports
                refuse_expansion(path, size)
        position += 8 + length
