"""What commands print: lines without control characters, to readers that may end before the command does."""

from __future__ import annotations

import errno
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

from rich.console import Console

console = Console(soft_wrap=True)


def log(line: str) -> None:
    """Print a line of text at once, even to a pipe, without interpreting the markup of rich."""
    console.print(plain_text(line), markup=False, highlight=False)


def plain_text(text: str) -> str:
    """Return a text with every character that could control the terminal replaced by its escape sequence.

    Names in files may contain such characters. Line feeds and tabs stay.
    """
    return "".join(c if c.isprintable() or c in "\n\t" else repr(c)[1:-1] for c in text)


class _TolerantStream:
    """Text stream that discards what is written after its reader has gone, and passes on everything else."""

    def __init__(self, stream: Any) -> None:
        self._stream = stream

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        """Write a text, or discard it if nobody reads the stream any more."""
        try:
            return int(self._stream.write(text))
        except OSError as error:
            self._discard(error)
            return len(text)

    def flush(self) -> None:
        """Pass on what was written, or discard it if nobody reads the stream any more."""
        try:
            self._stream.flush()
        except OSError as error:
            self._discard(error)

    def _discard(self, error: OSError) -> None:
        """Connect a stream without a reader to the null device, which takes its buffer; raise others."""
        if error.errno != errno.EPIPE and not (os.name == "nt" and error.errno == errno.EINVAL):
            raise error
        with suppress(OSError, ValueError):  # a stream without a file, such as that of a test
            null = os.open(os.devnull, os.O_WRONLY)
            os.dup2(null, self._stream.fileno())
            os.close(null)


@contextmanager
def closed_output_tolerated() -> Iterator[None]:
    """Continue the `with` block if the reader of the output has ended, as in `hframe import LOGS | head`."""
    streams = sys.stdout, sys.stderr
    sys.stdout, sys.stderr = _TolerantStream(sys.stdout), _TolerantStream(sys.stderr)
    try:
        yield
        sys.stdout.flush()
    finally:
        sys.stdout, sys.stderr = streams
