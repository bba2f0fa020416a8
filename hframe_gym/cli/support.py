"""Support for the `hframe` commands: one-line error messages, checks of arguments, progress, and steps of a fit."""

from __future__ import annotations

import errno
import json
import math
import os
import re
import signal
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import fields, is_dataclass
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any

from ..errors import InputError
from ..operating_system import quoted
from .app import plain_text

if TYPE_CHECKING:
    from ..data_validation import Finding
    from ..identification import IdentificationResult
    from ..identification.budget import Budget
    from ..identification.report.formulas import TableComparison
    from ..machine import AxisUnit, Machine
    from ..recordings import Recording

_PACKAGE = Path(__file__).parents[1]
_SECONDS_BETWEEN_LINES = 10.0  # of processor time, where progress is no line at the bottom of a terminal
FULL_DISK = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
INPUT_AT_FAULT, INTERNAL_ERROR = 2, 1
FAULT_FOUND = 1  # exit code of `hframe check` where the recordings have a fault
DEBUG_VARIABLE = "HFRAME_DEBUG"  # if set, errors keep their traceback
# If "json", progress is printed as JSON for a program that started the command: one object a line, after PROGRESS_MARK.
PROGRESS_VARIABLE = "HFRAME_PROGRESS"
PROGRESS_MARK = "\x1e"  # the record separator of JSON text sequences (RFC 7464)
_SECONDS_BETWEEN_RECORDS = 0.2  # s; a person does not see changes that are faster
# What the user's Ctrl-C sends, and what another program sends in its place on Windows.
_INTERRUPTS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGBREAK") if hasattr(signal, name))


def require_folder(path: Path) -> Path:
    """Return the value of the option --out, a folder that need not exist yet; an InputError refuses a file."""
    if path.exists() and not path.is_dir():
        raise InputError(f"--out {path}: is a file, but must be a folder")
    return path


def rig_folders(folder: Path) -> list[Path]:
    """List the subfolders of a folder that contain recordings, one per rig; none if the folder itself contains some."""
    from ..recordings import recording_files

    if not folder.is_dir() or recording_files(folder):
        return []
    return sorted(path for path in folder.iterdir() if path.is_dir() and recording_files(path))


def require_several_runs(recordings: Sequence[Recording], folder: Path) -> None:
    """Raise an InputError if a folder has only one run; the message says how to cut it into several.

    An identification needs at least two: one is not fitted, but used to verify the result.
    """
    if len(recordings) != 1:
        return
    run = recordings[0]
    file = next(path for path in sorted(folder.iterdir()) if path.name.startswith(f"{run.name}."))
    seconds = run.time_s[-1] - run.time_s[0]
    options = "--split-at-rests (--split-every 5 if it has none; and the --machine of this command)"
    raise InputError(
        f"{folder}: has the single run {run.name!r} of {seconds:.4g} s; at least two are needed, because one is held "
        f"out. Record more runs, or cut it at its rests: hframe import {file} --out RUNS {options}"
    )


def task_with_path(name: str, path: str | None, unit: AxisUnit) -> Any:
    """Return the task that the options --task and --path select: a task object with the path, or the name of the task.

    Args:
        name: Registered name of the task.
        path: Shape or file that the goal follows; None: that of the task.
        unit: Unit of the machine's axes.

    Raises:
        InputError: If the task is unknown, or if a path is given for a task that does not follow one.
    """
    from ..envs import TASKS, as_task

    task_class: Any = TASKS.get(name)
    follows_path = is_dataclass(task_class) and "path" in {field.name for field in fields(task_class)}
    if path is not None and not follows_path:
        raise InputError(f"--path {path}: the task {name} follows no path")
    return name if path is None else as_task(name, unit, path=path)


def option_words(**values: str | None) -> str:
    """Format options as the end of a command line that a message proposes, quoted: " --machine axis --task reach".

    An option whose value is None is left out.
    """
    return "".join(f" --{name} {quoted(value)}" for name, value in values.items() if value is not None)


def training_proposal(machine: str, task: str, randomize: str, period: float) -> str:
    """Write the line that proposes, after an evaluation of controllers, to train an agent with the same settings.

    It names the control period of the recipe if it differs from `period`, s, that of the evaluation. It is empty if the
    package has no recipe "ppo" for the task.
    """
    from ..agents import load_recipe

    try:
        recipe = load_recipe("ppo", task)
    except InputError:
        return ""
    words = option_words(
        machine=machine, task=task, randomize=None if randomize == recipe.randomize else randomize
    )
    note = (
        ""
        if period == recipe.period
        else f" with --period {recipe.period:g}, the control period of the recipe"
    )
    return f"Next: hframe train ppo{words} --out FOLDER, then evaluate FOLDER too{note}"


@contextmanager
def value_errors_as_input_errors() -> Iterator[None]:
    """Convert each ValueError raised inside a `with` block to an InputError with the same message."""
    try:
        yield
    except ValueError as error:
        raise InputError(str(error)) from error


@contextmanager
def progress_bar(description: str) -> Iterator[Callable[[int, int], None]]:
    """Show a progress bar during the `with` block, if the output is a terminal.

    Yields:
        Function that updates the bar. Call it with the work done and the total work, for example in bytes.
    """
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

    from .app import console

    if os.environ.get(PROGRESS_VARIABLE) == "json":
        record = _progress_records()
        yield lambda done, total: record(doing=description, done=done, total=total)
        return
    columns = TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeRemainingColumn()
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task(description, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)


def _progress_records() -> Callable[..., None]:
    """Return a function that prints its keyword arguments as a record of progress, at most five in a second."""
    last = -math.inf

    def record(**values: float | str | None) -> None:
        nonlocal last
        now = time.monotonic()
        if now - last >= _SECONDS_BETWEEN_RECORDS or values.get("done") == values.get("total", math.nan):
            last = now
            print(f"{PROGRESS_MARK}{json.dumps(values)}", flush=True)

    return record


def describe_failure(error: Exception) -> tuple[int, str]:
    """Convert an exception to an exit code (`INPUT_AT_FAULT` or `INTERNAL_ERROR`) and a message of one line."""
    from ..dynamics import NotFiniteError

    usage = getattr(error, "format_message", None)  # of Typer's errors about options
    text = plain_text(" ".join((usage() if usage else str(error)).split()))
    if usage:
        text = text or "Missing command"  # Typer prints the help of a group without a message
        return INPUT_AT_FAULT, f"{text} ({_example(error)}see --help)"
    if isinstance(error, InputError | ImportError):
        return INPUT_AT_FAULT, text
    if isinstance(error, NotFiniteError):
        return INPUT_AT_FAULT, f"{text.rstrip('.')}: check the inputs and the machine's parameters"
    if isinstance(error, OSError) and (error.filename is not None or error.errno in FULL_DISK):
        place = "writing" if error.filename is None else str(error.filename)
        advice = (
            "; make room or write to another disk (nothing was replaced)" if error.errno in FULL_DISK else ""
        )
        return INPUT_AT_FAULT, plain_text(f"{place}: {error.strerror}{advice}")
    hint = f"set {DEBUG_VARIABLE}=1 to see the traceback"
    return INTERNAL_ERROR, f"internal error, please report it ({hint}): {type(error).__name__}: {text}"


def _example(error: Exception) -> str:
    """Return the example of the command in whose words something is missing, empty if nothing is or it has none."""
    command = getattr(getattr(error, "ctx", None), "command", None)
    found = re.search(r"Examples?:\s+(hframe .+)", getattr(command, "help", None) or "")
    return (
        f"for example: {found[1].strip()}; " if found and type(error).__name__ == "MissingParameter" else ""
    )


def print_warning(
    message: Warning | str, category: type[Warning], filename: str = "", *_args: Any, **_keywords: Any
) -> None:
    """Print a warning as one line on standard error (assigned to `warnings.showwarning`).

    Those of other libraries are left out: they speak of calls that the user did not write. So are warnings of NumPy
    about numbers that overflow: a search tries machines that diverge, and tells so where it matters.
    """
    path = Path(filename)
    foreign = "site-packages" in path.parts and not path.is_relative_to(_PACKAGE)
    if (foreign or issubclass(category, RuntimeWarning)) and not os.environ.get(DEBUG_VARIABLE):
        return
    print(f"hframe: warning: {plain_text(' '.join(str(message).split()))}", file=sys.stderr)


@contextmanager
def collect_warnings() -> Iterator[list[str]]:
    """Collect the texts of warnings (UserWarning) during the `with` block, for a report; they are still printed."""
    texts: list[str] = []
    show = warnings.showwarning

    def collect(message: Warning | str, category: type[Warning], *arguments: Any, **keywords: Any) -> None:
        if issubclass(category, UserWarning):
            texts.append(str(message))
        show(message, category, *arguments, **keywords)

    warnings.showwarning = collect
    try:
        yield texts
    finally:
        warnings.showwarning = show


def check_recordings_before_fit(
    recordings: Sequence[Recording], machine: Machine, refuse: Path | None, log: Callable[[str], None]
) -> list[Finding]:
    """Check recordings before an identification, print the faults, and stop if there is one.

    A fault is a finding that is certainly an error in the data, for example a stuck sensor or a wrong sign.

    Args:
        recordings: Runs to fit.
        machine: Machine as declared.
        refuse: Folder of the recordings, which the error names. None: faults are only printed.
        log: Called with a line of text for every group of similar faults, and for the number of other findings.

    Raises:
        InputError: If there is a fault and `refuse` is given.
    """
    from ..data_validation import check_before_fit, group_findings, refuse_faults

    findings = check_before_fit(recordings, machine)
    groups = group_findings(findings)
    others = [finding for finding in groups if finding.severity != "fault"]
    for finding in groups:
        if finding.severity == "fault":
            log(str(finding))
    if others:
        log(
            f"{len(others)} note{'s' if len(others) > 1 else ''} about the recordings; they follow the result"
        )
    if refuse is not None:
        refuse_faults(findings, refuse)
    return findings


@contextmanager
def search_progress(log: Callable[[str], None]) -> Iterator[Callable[[str, float, float], None]]:
    """Show what a search does during the `with` block: a line at the bottom of a terminal, plain lines elsewhere.

    Args:
        log: Called with a line of text, where the output is no terminal, at most once in ten seconds of processor time.

    Yields:
        Function of what the search does, the processor time spent and the budget, s.
    """
    from ..identification.budget import error_so_far
    from .app import console

    if os.environ.get(PROGRESS_VARIABLE) == "json":
        record = _progress_records()
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
    printed = 0.0

    def print_line(doing: str, spent: float, seconds: float) -> None:
        nonlocal printed
        if spent - printed >= _SECONDS_BETWEEN_LINES:
            printed = spent
            log(f"  {line(doing, spent, seconds)}")

    yield print_line


@contextmanager
def finishing_on_interrupt(budget: Budget) -> Iterator[None]:
    """Let the first Ctrl-C during the `with` block end a search with what it found so far; the second one ends all.

    While no search is in progress, Ctrl-C ends the command as everywhere.
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
        os.write(2, b"hframe: interrupted; testing what was found so far (Ctrl-C again: end at once)\n")

    earlier = {number: signal.getsignal(number) for number in _INTERRUPTS}
    for number in _INTERRUPTS:
        signal.signal(number, finish)
    try:
        yield
    finally:
        for number, handler in earlier.items():
            signal.signal(number, handler)


def proposed_formulas(
    result: IdentificationResult, log: Callable[[str], None]
) -> tuple[TableComparison, ...]:
    """Propose formulas for the forces that an identification could only describe by tables of values.

    Such a table stands for a force that no known effect explains. Without scikit-learn, nothing is proposed,
    and the log gets the reason.
    """
    from ..identification.report.formulas import compare_formulas

    try:
        return compare_formulas(result, log)
    except ImportError as error:
        log(f"no formulas proposed for the tables: {error}")
        return ()
