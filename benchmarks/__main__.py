"""List the benchmarks, or run all or some of them.

python -m benchmarks            # run all that RESULTS.md needs, one after the other, then fill in its tables
python -m benchmarks --list     # list the benchmarks and their questions
python -m benchmarks NAME ...   # run these, with the options that RESULTS.md states
"""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from tools.command_line import command_line

FOLDER = Path(__file__).parent
# Commands whose results RESULTS.md contains, in the order of running. gap-v1 has a command for each entry.
IN_RESULTS = (
    "paper",
    "accuracy",
    "first_step",
    "throughput",
    "env_speed",
    "env_bits",
    "env_soak",
    "identification examples all",
    "random_rigs --seed 20271168 --count 30",
    "random_rigs --closed-loop --seed 20271167 --count 60",
    "public_axes",
    "closed_loop_rigs",
    "outside_library --seed 3",
    "other_simulator_rigs",
    "coverage",
    "real_machines all",
    "her",
    "bound",
    "controllers",
    "agents score",
    "ray_scaling",
    "corrected_control",
)


def benchmarks() -> dict[str, str]:
    """Return the questions of all benchmarks by name: the first lines of modules that can be executed."""
    modules = {
        path.stem: path for path in sorted(FOLDER.glob("*.py")) if "def main()" in path.read_text("utf-8")
    }
    modules |= {
        path.parent.name: path.parent / "__init__.py" for path in sorted(FOLDER.glob("*/__main__.py"))
    }
    del modules["__main__"]
    docstrings = {
        name: ast.get_docstring(ast.parse(path.read_text("utf-8"))) for name, path in modules.items()
    }
    return {name: (docstring or "").splitlines()[0] for name, docstring in docstrings.items()}


def commands(names: Sequence[str]) -> list[str]:
    """Return the commands for RESULTS.md of some benchmarks, or their bare names; all for no names."""
    for_results = [command for command in IN_RESULTS if not names or command.split()[0] in names]
    return for_results + [name for name in names if not any(c.split()[0] == name for c in for_results)]


def run(module: str, *options: str) -> None:
    """Run a module in a new process; stop if it fails."""
    print(f"\n== {module} {' '.join(options)}", flush=True)
    subprocess.run([sys.executable, "-m", module, *options], check=True)


def main() -> None:
    """List or run the benchmarks."""
    every = benchmarks()
    parser = command_line(__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"any of {', '.join(every)}")
    parser.add_argument("--list", action="store_true", help="list the benchmarks and their questions")
    arguments = parser.parse_args()
    if unknown := [name for name in arguments.names if name not in every]:
        parser.error(f"unknown benchmark {', '.join(unknown)}; choose from {', '.join(every)}")
    if arguments.list:
        for name, question in every.items():
            print(f"{name:18} {question}")
        return
    for command in commands(arguments.names):
        name, *options = command.split()
        run(f"benchmarks.{name}", *options)
    if not arguments.names:
        run("tools.tables")


if __name__ == "__main__":
    main()
