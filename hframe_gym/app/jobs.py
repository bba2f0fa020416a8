"""Command lines that run in other processes: output, progress, and how to end them."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from .. import progress_records
from ..operating_system import interrupt, own_group
from .session import Session

_COLUMNS = "110"  # characters of a line of output
_MOST_LINES = 2000  # of output that are kept; identifications print some hundred
_PACKAGES = str(Path(__file__).resolve().parents[2])


@dataclass
class Progress:
    """Progress that a command has reported.

    Attributes:
        doing: What the command does now, in words.
        spent: Processor time so far, s, or work done; None if unknown.
        total: Budget, s, or all the work; None if unknown.
        errors: Processor time, s, and chi-squared per sample of the best machine, each time that it changed.
    """

    doing: str = ""
    spent: float | None = None
    total: float | None = None
    errors: list[tuple[float, float]] = field(default_factory=list)

    def update(self, record: dict[str, Any]) -> None:
        """Take over the values of a progress record that a command has printed.

        Args:
            record: `doing`, `spent` and `budget` (s), or `done` and `total` work, and `error` (chi-squared
                per sample); each may be missing. A changed error is appended to `errors`.
        """
        self.doing = str(record.get("doing") or "")
        self.spent = record.get("spent", record.get("done"))
        self.total = record.get("budget", record.get("total"))
        error = record.get("error")
        if error is not None and (not self.errors or self.errors[-1][1] != error):
            self.errors.append((float(self.spent or 0.0), float(error)))


class Job:
    """Commands of a session that run one after the other, in other threads and processes.

    Attributes:
        commands: Words after "hframe" of each command.
        lines: Output so far.
        progress: Latest progress of the running command.
        exit_code: Exit code of the last command that ran; None while they run.
        began: Time when the job began, s, as `time.monotonic` counts.
        stopped: Whether the user has ended the job.
    """

    def __init__(self, session: Session, commands: Sequence[Sequence[str]]) -> None:
        """Start the commands.

        Args:
            session: Session in whose folder they run, and whose script records them.
            commands: Words after "hframe" of each command; or those of `Session.aside_command`.
        """
        self.commands = [list(words) for words in commands]
        self.lines: list[str] = []
        self.progress = Progress()
        self.exit_code: int | None = None
        self.began = time.monotonic()
        self._ended: float | None = None
        self.stopped = False
        self._session = session
        self._process: subprocess.Popen[str] | None = None
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    @property
    def running(self) -> bool:
        """Whether a command is in progress."""
        return self.exit_code is None

    @property
    def seconds(self) -> float:
        """Time since the job began, until it ended, s."""
        return (self._ended or time.monotonic()) - self.began

    def stop(self) -> None:
        """Interrupt the commands as Ctrl-C does; an identification then keeps the best machine so far."""
        self.stopped = True
        if self._process is not None and self._process.poll() is None:
            interrupt(self._process)

    def wait(self, seconds: float | None = None) -> None:
        """Wait until the commands end, but at most `seconds`, s; None for no limit."""
        self._thread.join(seconds)

    def _run(self) -> None:
        """Run the commands until one fails."""
        code = 0
        try:
            for words in self.commands:
                if words[0] == "mkdir":
                    self._session.set_aside(*words[1:])
                else:
                    code = self._run_command(words)
                self._session.record(words, code)
                if code or self.stopped:
                    break
        except OSError as error:
            self.lines.append(f"hframe: {error}")
            code = 1
        self._ended = time.monotonic()
        self.exit_code = code

    def _run_command(self, words: list[str]) -> int:
        """Run a command and collect its output; return its exit code."""
        paths = [_PACKAGES, *filter(None, [os.environ.get("PYTHONPATH")])]
        environment = os.environ | {
            **progress_records.REQUEST,
            "PYTHONUNBUFFERED": "1",
            "PYTHONIOENCODING": "utf-8",
            "COLUMNS": _COLUMNS,
            "PYTHONPATH": os.pathsep.join(paths),
        }
        with subprocess.Popen(
            [sys.executable, "-m", "hframe_gym", *words],
            cwd=self._session.folder,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            encoding="utf-8",
            errors="replace",
            **own_group(),
        ) as self._process:
            assert self._process.stdout is not None
            for line in self._process.stdout:
                self._take(line.rstrip("\n"))
        return self._process.returncode

    def _take(self, line: str) -> None:
        """Keep a line of output, or the progress that it tells."""
        if (record := progress_records.record_of(line)) is not None:
            self.progress.update(record)
            return
        self.lines.append(line)
        del self.lines[:-_MOST_LINES]


class Jobs(dict[str, Job]):
    """Last job of each stage by the stage's key."""

    @property
    def running(self) -> Job | None:
        """The job in progress; None if there is none."""
        return next((job for job in self.values() if job.running), None)
