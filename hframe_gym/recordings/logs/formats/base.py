"""Interface of a file format of logs, and the registry of all formats."""

from __future__ import annotations

import importlib.util
from abc import ABC, abstractmethod
from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar

from ....errors import InputError
from ....registry import Registry
from ..log import Log

# Bytes at the beginning of a file by which its format is recognized. They contain the header of a table below
# some lines of messages.
START_BYTES = 4096
# Precedence of formats that recognize the same file.
ANY_TEXT = 0
KNOWN_TEXT = 1  # a table in text with names of a known program
CONTAINER = 2  # of tables or arrays with any content
KNOWN_CONTENT = 3  # written by a known program


class LogFormat(ABC):
    """File format of logs: how its files are recognized, and how one is opened.

    Attributes:
        suffixes: Endings of the names of its files, in lower case, by which they are found in a folder; those
            of texts need not be repeated.
        precedence: Of several formats that recognize a file, the one with the highest precedence opens it.
    """

    suffixes: ClassVar[tuple[str, ...]] = ()
    precedence: ClassVar[int] = CONTAINER

    @abstractmethod
    def recognizes(self, path: Path, start: bytes) -> bool:
        """Return whether a file, even a damaged one, has this format, by its content or else by its name.

        Args:
            path: File of a log, or folder that `logs_in` returns.
            start: First `START_BYTES` bytes of the file; empty for a folder.
        """

    @abstractmethod
    def open(self, path: Path) -> list[Log]:
        """Open a file of this format and determine its columns.

        Returns:
            The logs in the file, with columns of the shape (rows,); each becomes one or more runs.

        Raises:
            InputError: If the file is damaged, has no numbers, or an extra is missing. The message names the
                file.
        """

    def logs_in(self, folder: Path) -> list[Path]:
        """Return the files of a folder to open, or the folder itself if it is one data set of this format.

        The result is empty if the folder is no data set of this format.
        """
        return []

    def is_log(self, path: Path) -> bool:
        """Return whether a file with a matching ending is a log, and not a document such as readme.txt.

        By default, every such file is a log.
        """
        return True


def require_extra(path: Path, what: str, extra: str, modules: Sequence[str], advice: str) -> None:
    """Raise an InputError with advice if a module that a file needs is missing.

    Args:
        what: Kind of the file, for the message, such as "Parquet files".
        extra: Extra of this package that installs the modules.
        modules: Names of the modules.
        advice: What the user can do instead of installing them, as the end of the message.
    """
    if any(importlib.util.find_spec(module) is None for module in modules):
        raise InputError(f"{path}: reading {what} needs pip install 'hframe_gym[{extra}]'; or {advice}")


LOG_FORMATS: Registry[type[LogFormat]] = Registry("log format")
