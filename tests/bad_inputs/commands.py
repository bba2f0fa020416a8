"""Run a command in this process on files in a folder, and check how it ends."""

from __future__ import annotations

import contextlib
import io
import sys
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from html.parser import HTMLParser
from pathlib import Path

from hframe_gym import cli
from hframe_gym.cli.messages import DEBUG_VARIABLE

from .mutations import MARK

REFUSED, FAULT_FOUND = 2, 1
PREFIX = "hframe: "
WARNING = f"{PREFIX}warning: "


@dataclass(frozen=True)
class Outcome:
    """How a command ended.

    Attributes:
        words: Words of the command line.
        code: Exit code.
        out: Standard output.
        errors: Lines on standard error without warnings.
        written: Files that appeared or changed, relative to the folder.
        traceback: Traceback of an exception that the command did not handle; empty if there was none.
    """

    words: tuple[str, ...]
    code: int
    out: str
    errors: tuple[str, ...]
    written: tuple[str, ...]
    traceback: str

    @property
    def problem(self) -> str:
        """What is wrong with this end, for any input; empty if nothing is."""
        if self.traceback:
            return self.traceback
        if self.code not in (0, REFUSED) and not (self.code == FAULT_FOUND and self.words[0] == "check"):
            return f"exit code {self.code}: {' | '.join(self.errors)}"
        if self.code == REFUSED and (len(self.errors) != 1 or not self.errors[0].startswith(PREFIX)):
            return f"not one line: {' | '.join(self.errors)}"
        if self.code == REFUSED and self.written:
            return f"refused, but wrote {', '.join(self.written)}"
        if any(Path(name).name == MARK for name in self.written):
            return "code in a file was executed"
        return ""


class _PartsOfPage(HTMLParser):
    """Collect the scripts, and the attributes that are scripts, of a page."""

    def __init__(self) -> None:
        super().__init__()
        self.hostile: list[str] = []
        self._in_script = self._is_data = False

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self._in_script = tag == "script"
        self._is_data = ("type", "application/json") in attrs
        self.hostile += [
            f"{key}={value}" for key, value in attrs if key.startswith("on") and MARK in (value or "")
        ]

    def handle_endtag(self, tag: str) -> None:
        self._in_script = False

    def handle_data(self, data: str) -> None:
        if self._in_script and MARK in data and not (self._is_data and "<" not in data):
            # no element can begin in a block of data without "<", which executes nothing
            self.hostile.append(data)


def hostile_parts(page: Path) -> list[str]:
    """Return the parts of a page that would execute a text from `mutations.TEXTS`.

    Args:
        page: HTML file.

    Returns:
        Texts of such scripts and attributes; empty if every text of the page is escaped.
    """
    parser = _PartsOfPage()
    parser.feed(page.read_text())
    return parser.hostile


def run_command(words: Sequence[str], folder: Path) -> Outcome:
    """Run `hframe` in this process with a folder as the working folder.

    Args:
        words: Words of the command line without `hframe`.
        folder: Working folder.

    Returns:
        How the command ended.
    """
    before = _contents(folder)
    out, err, trace = io.StringIO(), io.StringIO(), ""
    with _arguments(words), contextlib.chdir(folder), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            try:
                cli.main()
                code = 0
            except SystemExit as stop:
                code = stop.code if isinstance(stop.code, int) else 0
                trace = _internal_error(stop)
    after = _contents(folder)
    errors = [line for line in err.getvalue().splitlines() if line.strip() and not line.startswith(WARNING)]
    written = sorted(name for name in after if after[name] != before.get(name))
    pages = [folder / name for name in written if name.endswith(".html")]
    if any(hostile_parts(page) for page in pages):
        trace = "a page contains a text that is not escaped"
    return Outcome(tuple(words), code, out.getvalue(), tuple(errors), tuple(written), trace)


def _internal_error(stop: SystemExit) -> str:
    """Return the traceback of the exception that ended the command, if it is an internal error."""
    import traceback

    error = stop.__context__
    if (
        stop.code != 1
        or error is None
        or isinstance(error, SystemExit)
        or DEBUG_VARIABLE not in _last_line(error)
    ):
        return ""
    return "".join(traceback.format_exception(error))


def _last_line(error: BaseException) -> str:
    """Return the message that the command prints for an exception."""
    from hframe_gym.cli.messages import describe_failure

    return describe_failure(error)[1] if isinstance(error, Exception) else DEBUG_VARIABLE


def _contents(folder: Path) -> dict[str, tuple[int, int]]:
    """Return time of change and size of every file in a folder by its path, without compiled modules."""
    files = [path for path in folder.rglob("*") if path.is_file() and path.parent.name != "__pycache__"]
    return {str(path.relative_to(folder)): (path.stat().st_mtime_ns, path.stat().st_size) for path in files}


@contextlib.contextmanager
def _arguments(words: Sequence[str]) -> Iterator[None]:
    """Set the command line of this process."""
    before, sys.argv = sys.argv, ["hframe", *words]
    try:
        yield
    finally:
        sys.argv = before
