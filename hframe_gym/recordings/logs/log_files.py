"""Find the logs of a folder and open them with the reader of their file format."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

from ...errors import InputError
from ...registry import load_plugins
from .foreign_files import FOREIGN_SUFFIXES, refuse_foreign_file
from .formats import LOG_FORMATS, START_BYTES, LogFormat
from .formats.base import ANY_TEXT
from .log import Log


def open_logs(path: Path) -> list[Log]:
    """Open a file's logs, in any registered format, and determine the names, units and rows of their columns.

    Args:
        path: File of the log, or a folder that is one log, such as a bag of ROS 2.

    Raises:
        InputError: If the file is empty, has no columns of numbers, or is of a kind that cannot be read. The
            message says how to export it.
    """
    start = start_of(path)
    found = max((k for k in _formats() if k.recognizes(path, start)), key=lambda kind: kind.precedence)
    if found.precedence == ANY_TEXT:
        refuse_foreign_file(path, start)
    return found.open(path)


def start_of(path: Path) -> bytes:
    """Return the first bytes of a file, from which its format is recognized; none of a folder."""
    if not path.is_file():
        return b""
    with open(path, "rb") as file:
        return file.read(START_BYTES)


def find_logs(path: str | Path) -> tuple[list[Path], list[Path]]:
    """List the logs of a folder, which are recognized by the endings of their names.

    Args:
        path: A log, whatever its ending, or a folder of logs.

    Returns:
        logs: Files of the folder, in alphabetical order, with the endings of the registered formats (.csv,
            .txt, .mat, ...), except documents such as readme.txt, and folders in it that are one log, such as
            bags of ROS 2; or the one log.
        others: The remaining files of the folder, and folders in it that have logs, except hidden ones.

    Raises:
        InputError: If the path does not exist, the folder has no logs, or two of them would become runs of
            the same name.
    """
    path = Path(path)
    if path.is_file():
        return [path], []
    if not path.is_dir():
        raise InputError(f"{path}: no such file or folder")
    formats = _formats()
    as_whole = _data_set(path, formats)
    if as_whole:
        return as_whole, []
    entries = sorted(p for p in path.iterdir() if not p.name.startswith("."))
    files = [p for p in entries if p.is_file()]
    logs = [p for p in files if _is_log(p, formats)]
    logs = sorted([*logs, *(log for p in entries if p.is_dir() for log in _data_set(p, formats))])
    if not logs:
        for file in files:
            if file.name.lower().endswith(FOREIGN_SUFFIXES):
                open_logs(file)  # which says why it is not read
        endings = sorted(
            {suffix for kind in formats for suffix in kind.suffixes if not suffix.endswith(".gz")}
        )
        raise InputError(f"{path}: no logs ({', '.join(endings)}) in this folder")
    for first, second in pairwise(sorted((p for p in logs if p.parent == path), key=log_name)):
        if log_name(first) == log_name(second):
            raise InputError(
                f"{second}: would be the same run {log_name(first)!r} as {first.name}; rename one"
            )
    folders = [p for p in entries if p.is_dir() and not any(p in (log, *log.parents) for log in logs)]
    with_logs = [p for p in folders if any(f.is_file() and _is_log(f, formats) for f in p.iterdir())]
    return logs, sorted([*(p for p in files if p not in logs), *with_logs])


def log_name(path: Path) -> str:
    """Return the name of the run of a log, or of a folder that is one: "test_3" for test_3.csv.gz."""
    if path.is_dir():
        return path.name
    return Path(path.stem if path.suffix.lower() == ".gz" else path.name).stem


def run_of(log: Log) -> str:
    """Return the name of the run into which a log is converted.

    It is the one that the log states, else the name of its file and part, such as "test_3_slow-forward". If
    the log is cut into several runs, they add a number to it.
    """
    return log.run or "_".join(filter(None, (log_name(log.path), log.part)))


def log_size(path: Path) -> int:
    """Return the size of a log, or of a folder that is one log, in bytes, to display the progress."""
    return (
        sum(p.stat().st_size for p in path.iterdir() if p.is_file()) if path.is_dir() else path.stat().st_size
    )


def _formats() -> list[LogFormat]:
    """Return a reader of each format, those of plugins included."""
    load_plugins()
    return [LOG_FORMATS.get(name)() for name in LOG_FORMATS]


def _data_set(folder: Path, formats: Sequence[LogFormat]) -> list[Path]:
    """Return the logs of a folder that is as a whole a data set of some format; empty for other folders."""
    return next((logs for logs in (kind.logs_in(folder) for kind in formats) if logs), [])


def _is_log(path: Path, formats: Sequence[LogFormat]) -> bool:
    """Return whether a folder's file is a log by its name or, if its ending leaves that open, its content."""
    name = path.name.lower()
    return any(name.endswith(kind.suffixes) and kind.is_log(path) for kind in formats)
