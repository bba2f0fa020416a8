"""Run the tasks of this repository on any operating system: `python -m tools.tasks TASK`.

The first task installs the package and its development tools into the folder .venv, with the versions of
constraints.txt; later ones do so again only if pyproject.toml or constraints.txt has changed. The Makefile's
targets `demo`, `test`, `slow` and `check` call these tasks. Only the standard library is needed.
"""

from __future__ import annotations

import os
import subprocess
import venv
from collections.abc import Callable
from pathlib import Path

from tools.command_line import command_line
from tools.repository import ROOT

ENVIRONMENT = ROOT / ".venv"
PROGRAMS, SUFFIX = (ENVIRONMENT / "Scripts", ".exe") if os.name == "nt" else (ENVIRONMENT / "bin", "")
INSTALLED = ENVIRONMENT / ".installed"
# torch comes first and separately: the requirement of another package would install the build with GPU
# libraries.
PACKAGES = (("torch==2.13.0",), ("-e", ".[dev]"))


def run(program: str, *words: str) -> None:
    """Run a program of the environment in the repository's folder; show the command first.

    Args:
        program: Name of the program in .venv, for example "pytest".
        *words: Its arguments.

    Raises:
        SystemExit: With the exit code of the program, if it is not 0.
    """
    print(subprocess.list2cmdline([program, *words]), flush=True)
    # The installation leaves modules uncompiled. With this variable, every process would compile what it
    # imports again: `import torch` takes 4 s instead of 2 s.
    environment = {name: text for name, text in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    command = [f"{PROGRAMS / program}{SUFFIX}", *words]
    code = subprocess.run(command, cwd=ROOT, env=environment).returncode
    if code:
        raise SystemExit(code)


def install() -> None:
    """Install the package and its development tools into .venv, unless they are up to date."""
    link_agents()
    sources = (ROOT / "pyproject.toml", ROOT / "constraints.txt")
    if INSTALLED.exists() and all(INSTALLED.stat().st_mtime >= source.stat().st_mtime for source in sources):
        return
    print(f"installing into {ENVIRONMENT}", flush=True)
    if not PROGRAMS.exists():
        venv.create(ENVIRONMENT, with_pip=True)
    for words in PACKAGES:
        run(
            "python",
            "-m",
            "pip",
            "install",
            "-q",
            "--disable-pip-version-check",
            # pip would compile all 17,000 modules one after the other, 50 s; Python compiles those that are
            # imported.
            "--no-compile",
            "-c",
            "constraints.txt",
            *words,
        )
    INSTALLED.touch()


def link_agents() -> None:
    """Make the folder agents/ visible as hframe_gym/agents, where mypy and import-linter look for it."""
    link = ROOT / "hframe_gym" / "agents"
    if link.exists() or os.path.islink(link):
        return
    if os.name == "nt":  # links to folders need a privilege there, junctions do not
        subprocess.run(["cmd", "/c", "mklink", "/J", str(link), str(ROOT / "agents")], check=True)
    else:
        link.symlink_to(Path("..", "agents"))


def demo() -> None:
    """Identify a recorded rig and control the corrected machine."""
    run("hframe", "identify", "examples/rig_a", "--out", "out/demo")
    machine = ("--machine", "out/demo/machine.json", "--randomize", "none")
    run(
        "hframe",
        "evaluate",
        "pid",
        "ppo",
        *machine,
        "--episodes",
        "32",
        "--html",
        "--out",
        "out/demo/control",
    )
    print("open out/demo/report.html, out/demo/control/scorecard.html, pid.png and ppo.png")


def test() -> None:
    """Run all tests but the slow ones."""
    run("pytest", "-n", "auto", "--dist", "worksteal")


def slow() -> None:
    """Run the slow tests, and say how long the longest ones take."""
    # One after the other: some use all cores, build packages or open browsers themselves.
    run("pytest", "-m", "slow", "--durations=10")


def check() -> None:
    """Check format, lint, docstrings, types, layers, pinned versions and licenses."""
    run("ruff", "format", "--check", ".")
    run("ruff", "check", ".")
    run("mypy")
    run("lint-imports", "--no-logo")
    run("python", "-m", "tools.dependencies", "--check")
    run("python", "-m", "pip", "check")


TASKS: dict[str, Callable[[], None]] = {
    "install": lambda: None,
    "demo": demo,
    "test": test,
    "slow": slow,
    "check": check,
}


def main(arguments: list[str] | None = None) -> None:
    """Install what is missing and run tasks.

    Args:
        arguments: Command line without the program's name. Default: that of the process.
    """
    parser = command_line(__doc__)
    texts = [f"{name}: {task.__doc__ or 'only install.'}" for name, task in TASKS.items()]
    parser.add_argument("task", nargs="+", choices=list(TASKS), metavar="TASK", help=" ".join(texts))
    chosen = parser.parse_args(arguments).task
    install()
    for name in chosen:
        TASKS[name]()


if __name__ == "__main__":
    main()
