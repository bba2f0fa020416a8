"""Run the `hframe` command; SIGINT (Ctrl-C) and SIGTERM end it with one line and exit code 130 or 143."""

from __future__ import annotations

import os
import signal
import sys
import threading
from io import TextIOWrapper
from types import FrameType

_SECONDS_TO_CLEAN_UP = 5.0  # threads of a computation may need some time until they can stop
_LINES = {signal.SIGINT: "interrupted", signal.SIGTERM: "terminated"}


_received: list[int] = []


class _Stopped(BaseException):
    """A signal asked this process to end; not an Exception, so that few libraries handle it."""


def _leave(number: int) -> None:
    """Print the line of a signal and end the process without waiting for its threads."""
    sys.stdout.flush()
    os.write(2, f"hframe: {_LINES[signal.Signals(number)]}; files are unchanged or complete\n".encode())
    os._exit(128 + number)


def _stop(number: int, frame: FrameType | None) -> None:
    """Handle a signal: unwind, so that terminal and temporary folders are restored; a second one exits."""
    _received.append(number)
    for other in _LINES:
        signal.signal(other, lambda again, _: _leave(again))
    watchdog = threading.Timer(_SECONDS_TO_CLEAN_UP, _leave, (number,))
    watchdog.daemon = True
    watchdog.start()
    raise _Stopped(number)


def main() -> None:
    """Run the `hframe` command; let SIGINT (Ctrl-C) and SIGTERM end it with one line of text.

    Raises:
        SystemExit: With the exit code of `hframe_gym.cli.main`: 0, 1 or 2. After a signal, the process ends
            with the exit code 130 (SIGINT) or 143 (SIGTERM) instead, without an exception.
    """
    for number in _LINES:
        # Ignored by nohup, or in the background of a script.
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, _stop)
    if isinstance(sys.stdout, TextIOWrapper):  # the encoding of a Windows console has no Chinese, for example
        sys.stdout.reconfigure(errors="backslashreplace")
    try:
        from .cli import main as run

        run(interrupted=lambda: bool(_received))
    except BaseException:
        if _received:
            _leave(_received[0])
        raise
    finally:  # the work is done: a signal that comes now changes nothing
        for number in _LINES:
            signal.signal(number, signal.SIG_IGN)


if __name__ == "__main__":
    main()
