"""Execute the code blocks of a page of the documentation, so that no page shows code that does not run.

    python -m tools.code_blocks docs/environment.md           # without the slow blocks
    python -m tools.code_blocks docs/environment.md --slow    # all blocks

Blocks of the languages `python` and `sh` are executed in the order of the page. Python blocks of a page share their
variables. The working directory is a temporary folder that contains the repository as links, so `examples/rig_a` exists
and `out/` is discarded. Blocks are slow if they call a command of `SLOW_COMMANDS`, or if the line `<!-- slow -->`
precedes them. A block whose first line is `# Not executed in the tests: REASON` is skipped. Lines that install
something are skipped as well.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
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


def run_page(page: Path, slow: bool) -> int:
    """Execute the blocks of a page in the present working directory.

    Args:
        page: Page in Markdown.
        slow: Whether slow blocks are executed as well.

    Returns:
        Number of executed blocks.

    Raises:
        subprocess.CalledProcessError: If a command fails; exceptions of Python blocks are not caught.
    """
    variables: dict[str, Any] = {"__name__": "__main__"}
    blocks = [
        block for block in read_blocks(page.read_text("utf-8")) if block.executed and (slow or not block.slow)
    ]
    for block in blocks:
        print(f"--- {page.name}, line {block.line}", flush=True)
        if block.language == "python":
            # Empty lines before the code make the line numbers of a traceback those of the page.
            exec(compile("\n" * (block.line - 1) + block.code, page, "exec"), variables)
        else:
            lines = [line for line in block.code.splitlines() if not _INSTALLATION.match(line)]
            subprocess.run(["bash", "-euo", "pipefail", "-c", "\n".join(lines)], check=True)
    return len(blocks)


def enter_workspace(folder: Path) -> None:
    """Make a folder with links to the files of the repository the working directory of blocks.

    Args:
        folder: Empty folder.
    """
    for path in ROOT.iterdir():
        if not path.name.startswith(".") and path.name not in ("out", "build", "dist"):
            (folder / path.name).symlink_to(path)
    os.chdir(folder)
    os.environ["PATH"] = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    os.environ["PYTHONPATH"] = str(ROOT)
    os.environ.setdefault("MPLBACKEND", "agg")
    os.environ["BROWSER"] = "true"  # `hframe report --open` opens no window


def main() -> None:
    """Execute the blocks of the pages that the command line names."""
    parser = command_line(__doc__)
    parser.add_argument("pages", nargs="+", type=Path, help="pages in Markdown")
    parser.add_argument("--slow", action="store_true", help="execute the slow blocks as well")
    arguments = parser.parse_args()
    for page in [page.resolve() for page in arguments.pages]:
        with tempfile.TemporaryDirectory() as folder:
            enter_workspace(Path(folder))
            print(f"{page.name}: executed {run_page(page, arguments.slow)} blocks")
            os.chdir(ROOT)


if __name__ == "__main__":
    main()
