"""List the benchmarks, or run all or some of them.

python -m benchmarks            # run all that RESULTS.md needs, one after the other, then fill in its tables
python -m benchmarks --list     # list the benchmarks and their questions
python -m benchmarks NAME ...   # run these with their default options
"""

from __future__ import annotations

import argparse
import ast
import subprocess
import sys
from pathlib import Path

FOLDER = Path(__file__).parent
# Benchmarks whose results RESULTS.md contains, in the order of running, with their options.
IN_RESULTS: dict[str, tuple[str, ...]] = {
    "paper": (),
    "accuracy": (),
    "throughput": (),
    "env_speed": (),
    "differentiable": (),
    "env_bits": (),
    "env_soak": (),
    "identification": ("examples", "all"),
    "formulas": (),
    "other_simulator_rigs": (),
    "outside_library": ("--seed", "3"),
    "coverage": (),
    "real_machines": ("all",),
    "controllers": (),
    "bound": (),
    "her": (),
    "agents": ("score",),
    "ray_scaling": (),
    "closed_loop": (),
}


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


def run(module: str, *options: str) -> None:
    """Run a module in a new process; stop if it fails."""
    print(f"\n== {module} {' '.join(options)}", flush=True)
    subprocess.run([sys.executable, "-m", module, *options], check=True)


def main() -> None:
    """List or run the benchmarks."""
    every = benchmarks()
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"any of {', '.join(every)}")
    parser.add_argument("--list", action="store_true", help="list the benchmarks and their questions")
    arguments = parser.parse_args()
    if unknown := [name for name in arguments.names if name not in every]:
        parser.error(f"unknown benchmark {', '.join(unknown)}; choose from {', '.join(every)}")
    if arguments.list:
        for name, question in every.items():
            print(f"{name:18} {question}")
        return
    for name in arguments.names or IN_RESULTS:
        run(f"benchmarks.{name}", *IN_RESULTS.get(name, ()))
    if not arguments.names:
        run("tools.tables")


if __name__ == "__main__":
    main()
