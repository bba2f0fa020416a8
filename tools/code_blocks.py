"""Execute the code blocks of a page of the documentation, so that no page shows code that does not run.

    python -m tools.code_blocks docs/environment.md           # without the slow blocks
    python -m tools.code_blocks docs/environment.md --slow    # all blocks

Blocks of the languages `python` and `sh` are executed in the order of the page. Python blocks of a page share
their variables. All pages share two interpreters, so that the package is imported twice, not once a command:
one executes Python, the other one the lines `hframe ...`, which find nothing that Python has registered. The
working directory is a temporary folder that contains the repository as links, so `examples/rig_a` exists and
`out/` is discarded. Blocks are slow if they call a command of `SLOW_COMMANDS`, or if the line `<!-- slow -->`
precedes them. A block whose first line is `# Not executed in the tests: REASON` is skipped. Lines that
install something are skipped as well.
"""

from __future__ import annotations

import multiprocessing
import os
import re
import shlex
import subprocess
import sys
import tempfile
import traceback
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from markdown_it import MarkdownIt

from tools.command_line import command_line
from tools.repository import ROOT

EXECUTED = ("python", "sh")
SHOWN = ("csv", "json", "math", "text", "toml")  # languages of blocks that are only shown
SLOW_COMMANDS = ("hframe identify", "hframe train", "hframe evaluate", "python -m benchmarks")
_SLOW_MARK = "<!-- slow -->"
_NOT_EXECUTED = re.compile(r"^# Not executed in the tests: \S.*")
_SIMPLE_COMMAND = re.compile(r"hframe [^|&;<>$`(){}*?!~\n]*")  # without what a shell would replace
_INSTALLATION = re.compile(
    r"^\s*(make|pip|git|cd|pre-commit|sudo|apt(-get)?|source|python3? -m (venv|pip))\b"
)


@dataclass(frozen=True)
class Block:
    """A fenced code block of a page.

    Attributes:
        language: Language after the fence, for example "python"; "" if it has none.
        code: Text of the block.
        line: Line of the page on which the code starts, counted from 1.
        slow: Whether only the slow tests execute it.
    """

    language: str
    code: str
    line: int
    slow: bool

    @property
    def executed(self) -> bool:
        """Whether the tests execute the block."""
        return self.language in EXECUTED and not _NOT_EXECUTED.match(self.code)


def read_blocks(text: str) -> list[Block]:
    """Find the code blocks of a page, also those in lists and quotations.

    Args:
        text: Page in Markdown.

    Returns:
        Blocks in the order of the page; an indented block counts as one without a language.
    """
    blocks, previous = [], ""
    for token in MarkdownIt("commonmark").parse(text):
        if token.type in ("fence", "code_block"):
            language = token.info.split()[0] if token.info.split() else ""
            slow = previous == _SLOW_MARK or any(command in token.content for command in SLOW_COMMANDS)
            first_line = (token.map or [0])[0] + (2 if token.type == "fence" else 1)
            blocks.append(Block(language, token.content, first_line, slow))
        previous = token.content.strip()
    return blocks


class BlockError(Exception):
    """A block failed; the message is its traceback."""


_variables: dict[str, Any] = {}  # of the Python blocks of a page, in the interpreter that executes them


def _run_python(block: Block, page: Path) -> None:
    """Execute a Python block in this process."""
    # Empty lines before the code make the line numbers of a traceback those of the page.
    exec(compile("\n" * (block.line - 1) + block.code, page, "exec"), _variables)


def _run_shell(block: Block, page: Path) -> None:
    """Execute a block of the shell: commands of this package in this process, if all are such, or by bash."""
    code = "\n".join(line for line in block.code.splitlines() if not _INSTALLATION.match(line))
    lines = [line for line in code.replace("\\\n", "").splitlines() if line.strip()]
    if not all(_SIMPLE_COMMAND.fullmatch(line) for line in lines):
        subprocess.run(["bash", "-euo", "pipefail", "-c", code], check=True)
        return
    from hframe_gym import cli

    for line in lines:
        sys.argv = shlex.split(line, comments=True)
        try:
            cli.main()
        except SystemExit as end:
            if end.code:
                raise RuntimeError(f"{page.name}, line {block.line}: {line}: exit code {end.code}") from None


def _run(block: Block, page: Path, first: bool) -> None:
    """Execute a block in this process; the first one of a page finds no variables."""
    if first:
        _variables.clear()
        _variables["__name__"] = "__main__"
    print(f"--- {page.name}, line {block.line}", flush=True)
    try:
        (_run_python if block.language == "python" else _run_shell)(block, page)
    except Exception:  # some exceptions cannot be sent to another process
        raise BlockError(traceback.format_exc()) from None
    finally:
        sys.stdout.flush()


def _prepare() -> None:
    """Set the environment variables of an interpreter of blocks."""
    os.environ["PATH"] = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    os.environ["PYTHONPATH"] = str(ROOT)
    os.environ.setdefault("MPLBACKEND", "agg")
    os.environ["BROWSER"] = "true"  # `hframe report --open` opens no window


class Interpreters:
    """Two interpreters that execute the blocks of pages: one for Python, one for commands."""

    def __init__(self) -> None:
        context = multiprocessing.get_context("spawn")
        self._by_language = {
            language: ProcessPoolExecutor(1, context, initializer=_prepare) for language in EXECUTED
        }

    def __enter__(self) -> Interpreters:
        return self

    def __exit__(self, *_: object) -> None:
        for interpreter in self._by_language.values():
            interpreter.shutdown()

    def run_page(self, page: Path, slow: bool) -> int:
        """Execute the blocks of a page in a temporary folder with links to the files of the repository.

        Args:
            page: Page in Markdown.
            slow: Whether slow blocks are executed as well.

        Returns:
            Number of executed blocks.

        Raises:
            BlockError: If a block fails.
        """
        blocks = [
            block
            for block in read_blocks(page.read_text("utf-8"))
            if block.executed and (slow or not block.slow)
        ]
        with tempfile.TemporaryDirectory() as folder:
            for path in ROOT.iterdir():
                if not path.name.startswith(".") and path.name not in ("out", "build", "dist"):
                    Path(folder, path.name).symlink_to(path)
            used = {block.language for block in blocks}
            self._call_in(used, os.chdir, folder)
            try:
                for number, block in enumerate(blocks):
                    first = not any(earlier.language == block.language for earlier in blocks[:number])
                    self._call_in({block.language}, _run, block, page, first)
            finally:
                self._call_in(used, os.chdir, ROOT)
        return len(blocks)

    def _call_in(self, languages: set[str], function: Callable[..., None], *arguments: object) -> None:
        """Call a function in the interpreters of languages."""
        for language in languages:
            self._by_language[language].submit(function, *arguments).result()


def main() -> None:
    """Execute the blocks of the pages that the command line names."""
    parser = command_line(__doc__)
    parser.add_argument("pages", nargs="+", type=Path, help="pages in Markdown")
    parser.add_argument("--slow", action="store_true", help="execute the slow blocks as well")
    arguments = parser.parse_args()
    with Interpreters() as interpreters:
        for page in arguments.pages:
            executed = interpreters.run_page(page.resolve(), arguments.slow)
            print(f"{page.name}: executed {executed} blocks")


if __name__ == "__main__":
    main()
