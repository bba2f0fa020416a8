"""Progress of long commands: a terminal's bottom line, plain lines, or records for another program."""

from __future__ import annotations

import math
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import TYPE_CHECKING

from .. import progress_records
from ..line_log import LineLog
from .output import console, plain_text

if TYPE_CHECKING:
    from ..identification.budget import Budget

_SECONDS_BETWEEN_RECORDS = 0.2  # s; a person does not see changes that are faster
_SECONDS_BETWEEN_LINES = 10.0  # s of processor time, where the output is a file or a pipe
# What the user's Ctrl-C sends, and what another program sends in its place on Windows.
_INTERRUPTS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGBREAK") if hasattr(signal, name))


@contextmanager
def progress_bar(description: str) -> Iterator[Callable[[int, int], None]]:
    """Show a progress bar during the `with` block, if the output is a terminal.

    A program that started this one and asked for progress records gets these instead of a bar.

    Args:
        description: What the command does, in words before the bar.

    Yields:
        Function that updates the bar. Call it with the work done and the total work, for example in bytes.
    """
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

    if progress_records.requested():
        record = _record_printer()
        yield lambda done, total: record(doing=description, done=done, total=total)
        return
    columns = TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeRemainingColumn()
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task(description, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)


def _record_printer() -> Callable[..., None]:
    """Return a function that prints its keyword arguments as a record, at most five a second and the last."""
    last = -math.inf

    def record(**values: float | str | None) -> None:
        nonlocal last
        now = time.monotonic()
        if now - last >= _SECONDS_BETWEEN_RECORDS or values.get("done") == values.get("total", math.nan):
            last = now
            print(progress_records.line_of(values), flush=True)

    return record


@contextmanager
def search_progress(log: LineLog) -> Iterator[Callable[[str, float, float], None]]:
    """Show the progress of a search in the `with` block: at the bottom of a terminal, else as plain lines.

    Args:
        log: Called with a line of text, where the output is no terminal, at most once in ten seconds of
            processor time.

    Yields:
        Function to call with the current activity, the processor time spent, s, and the budget, s.
    """
    from ..identification.budget import error_so_far

    if progress_records.requested():
        record = _record_printer()
        yield lambda doing, spent, seconds: record(
            doing=doing, spent=spent, budget=seconds if math.isfinite(seconds) else None, error=error_so_far()
        )
        return

    def line(doing: str, spent: float, seconds: float) -> str:
        return f"{doing} ({spent:.0f} s{f' of at most {seconds:.0f}' if math.isfinite(seconds) else ''})"

    if console.is_terminal:
        with console.status("preparing the recordings") as status:
            yield lambda *step: status.update(plain_text(line(*step)).replace("[", "\\["))
        return
    printed = 0.0  # processor time at the last line, s

    def print_line(doing: str, spent: float, seconds: float) -> None:
        nonlocal printed
        if spent - printed >= _SECONDS_BETWEEN_LINES:
            printed = spent
            log(f"  {line(doing, spent, seconds)}")

    yield print_line


@contextmanager
def finishing_on_interrupt(budget: Budget) -> Iterator[None]:
    """Let the first Ctrl-C in the `with` block finish a search with its result so far.

    A second one ends the command, and so does the first while no search is running. The block changes nothing
    outside the main thread.

    Args:
        budget: Budget of the search, which is stopped.
    """
    previous = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or not callable(previous):
        yield
        return

    def finish(number: int, frame: FrameType | None) -> None:
        if not budget.searching or budget.interrupted:
            previous(number, frame)
            return
        budget.stop()
        # Directly to standard error: the signal may arrive while Python's streams print.
        os.write(2, b"hframe: interrupted; testing what was found so far (Ctrl-C again: end at once)\n")

    earlier = {number: signal.getsignal(number) for number in _INTERRUPTS}
    for number in _INTERRUPTS:
        signal.signal(number, finish)
    try:
        yield
    finally:
        for number, handler in earlier.items():
            signal.signal(number, handler)
