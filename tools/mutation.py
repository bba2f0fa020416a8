"""Mutation testing: change one operator, number or condition at a time, and count those that a test notices.

    python -m tools.mutation [--count 150] [--seed 0] [--file PART_OF_A_PATH] [--list]

The mutants are a random sample of all mutants of `TARGETS`: the equations, the formulas of the effects, the
selection of effects and the verdict. Each is tested with tests that take a second, in a copy of the
repository, so that the working tree stays as it is. The result goes to out/mutation/report.json; a table is
printed.

Neither mutmut nor cosmic-ray fits this package. mutmut 3 replaces functions by wrappers, but the formulas are
called by the names of their arguments, traced, and compiled by Numba. cosmic-ray starts an interpreter per
mutant, and importing Numba and SciPy takes longer than the tests; here a process that has imported them forks
for each mutant.

Mutants that change no result are listed with the reason in `EQUIVALENT`; they do not count.
"""

from __future__ import annotations

import argparse
import ast
import importlib
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import NoReturn

from hframe_gym.files import write_text
from tools.posix import require_posix
from tools.repository import ROOT

OUTPUT = ROOT / "out" / "mutation" / "report.json"
TIMEOUT_S = 900.0  # CPU time of one test process, s; a mutant that runs longer is noticed
_EQUATIONS = ("tests/effects/test_point_by_point.py",)
_FRICTION = "tests/dynamics/test_friction.py"
_EVALUATION = "tests/identification/validate/test_evaluation.py"
_DECISIONS = (
    "tests/identification/judge",
    _EVALUATION,
    # This one simulates.
    f"--deselect={_EVALUATION}::test_a_fit_that_explains_everything_does_not_lead_to_no_effect",
)
# Files, relative to hframe_gym/, and the tests of each, which neither compile nor simulate; a pattern matches
# several.
TARGETS: dict[str, tuple[str, ...]] = {
    "dynamics/physics/equations.py": _EQUATIONS,
    "dynamics/physics/belts.py": _EQUATIONS,
    "dynamics/physics/friction.py": (
        f"{_FRICTION}::test_directions_and_static_friction",
        f"{_FRICTION}::test_flow_without_compilation",
        f"{_FRICTION}::test_weights_without_compilation",
    ),
    "effects/*.py": (
        *_EQUATIONS,
        "tests/effects/test_library.py",
        "--deselect=tests/effects/test_library.py::test_zero_amplitude_changes_nothing",
    ),
    "identification/judge/*.py": _DECISIONS,
}
# Mutants by "file: source line -> change" that no test can notice, with the reason.
EQUIVALENT: dict[str, str] = {
    "hframe_gym/dynamics/physics/belts.py: "
    "first = values[i] if factor == 1.0 else -values[i] if factor == -1.0 else factor * values[i] "
    "-> -1.0 -> 1.0": "-1.0 * v is -v to the bit; only the instruction differs"
}

_OPERATORS: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.Pow: ast.Mult,
    ast.FloorDiv: ast.Mult,
    ast.BitOr: ast.BitAnd,
    ast.BitAnd: ast.BitOr,
}
_COMPARISONS: dict[type[ast.cmpop], type[ast.cmpop]] = {
    ast.Lt: ast.GtE,
    ast.GtE: ast.Lt,
    ast.Gt: ast.LtE,
    ast.LtE: ast.Gt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.In: ast.NotIn,
    ast.NotIn: ast.In,
    ast.Is: ast.IsNot,
    ast.IsNot: ast.Is,
}
_FUNCTIONS = {
    "min": "max",
    "max": "min",
    "minimum": "maximum",
    "maximum": "minimum",
    "sin": "cos",
    "cos": "sin",
}
_FUNCTIONS |= {"any": "all", "all": "any"}


@dataclass(frozen=True)
class Mutant:
    """A changed file.

    Attributes:
        file: Path relative to the repository.
        line: Number of the changed line.
        source: Text of that line.
        change: What is changed, for example "a + b -> a - b".
        text: Text of the whole changed file.
    """

    file: str
    line: int
    source: str
    change: str
    text: str

    @property
    def key(self) -> str:
        """Name of the mutant that does not depend on the line number."""
        return f"{self.file}: {self.source} -> {self.change}"


def mutants_of(file: str, text: str, functions_only: bool) -> list[Mutant]:
    """List all mutants of a file.

    Args:
        file: Path relative to the repository.
        functions_only: Whether to leave out what is outside functions (the declaration of an effect's
            parameters).

    Returns:
        Mutants in the order of the lines. Texts (messages, docstrings), annotations, decorators and `strict`
        of zip are not changed.
    """
    tree, lines = ast.parse(text), text.splitlines()
    mutants = []
    for node, replacement in _changes(tree, functions_only):
        before, after = ast.get_source_segment(text, node), ast.unparse(replacement)
        assert before is not None
        assert node.end_lineno is not None
        assert node.end_col_offset is not None
        # Offsets count bytes.
        first, last = lines[node.lineno - 1].encode(), lines[node.end_lineno - 1].encode()
        changed = [
            *lines[: node.lineno - 1],
            f"{first[: node.col_offset].decode()}({after}){last[node.end_col_offset :].decode()}",
            *lines[node.end_lineno :],
        ]
        change = f"{' '.join(before.split())} -> {after}"
        mutants.append(
            Mutant(file, node.lineno, lines[node.lineno - 1].strip(), change, "\n".join(changed) + "\n")
        )
    return sorted(mutants, key=lambda mutant: mutant.line)


def _changes(tree: ast.Module, functions_only: bool) -> Iterator[tuple[ast.expr, ast.expr]]:
    """Yield an expression and what replaces it, for every possible change."""
    pending: list[tuple[ast.AST, bool]] = [(tree, not functions_only)]
    while pending:
        node, counts = pending.pop()
        inside = counts or isinstance(node, ast.FunctionDef)
        if isinstance(node, ast.expr) and counts:
            yield from ((node, replacement) for replacement in _replacements(node))
        for name, value in ast.iter_fields(node):
            if name in ("annotation", "returns", "decorator_list", "type_params"):
                continue
            if isinstance(node, ast.keyword) and node.arg == "strict":
                continue
            children = value if isinstance(value, list) else [value]
            pending += [(child, inside) for child in children if isinstance(child, ast.AST)]


def _replacements(node: ast.expr) -> Iterator[ast.expr]:
    """Yield the expressions that replace an expression."""
    if (
        isinstance(node, ast.BinOp)
        and type(node.op) in _OPERATORS
        and not isinstance(node.left, ast.JoinedStr)
    ):
        yield ast.BinOp(node.left, _OPERATORS[type(node.op)](), node.right)
    elif isinstance(node, ast.Compare) and len(node.ops) == 1:
        yield ast.Compare(node.left, [_COMPARISONS[type(node.ops[0])]()], node.comparators)
    elif isinstance(node, ast.BoolOp):
        yield ast.BoolOp(ast.Or() if isinstance(node.op, ast.And) else ast.And(), node.values)
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not | ast.USub):
        yield node.operand
    elif isinstance(node, ast.IfExp):
        yield ast.IfExp(node.test, node.orelse, node.body)
    elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in _FUNCTIONS:
        yield ast.Call(ast.Name(_FUNCTIONS[node.func.id], ast.Load()), node.args, node.keywords)
    elif isinstance(node, ast.Constant) and isinstance(node.value, bool):
        yield ast.Constant(not node.value)
    elif isinstance(node, ast.Constant) and isinstance(node.value, int):
        yield ast.Constant(node.value + 1)
    elif isinstance(node, ast.Constant) and isinstance(node.value, float):
        yield ast.Constant(2.0 * node.value if node.value else 1.0)


def sample(count: int, seed: int, part: str = "") -> list[tuple[Mutant, tuple[str, ...]]]:
    """Draw mutants at random, from each file in proportion to its number of mutants, at least one.

    Args:
        count: Number of mutants in all, about.
        seed: Seed of the random numbers.
        part: Only files whose path contains this text.

    Returns:
        Mutants with the tests of their files.
    """
    groups = []
    for pattern, tests in TARGETS.items():
        for path in sorted((ROOT / "hframe_gym").glob(pattern)):
            file = path.relative_to(ROOT).as_posix()
            found = mutants_of(file, path.read_text("utf-8"), functions_only="effects/" in file)
            if part in file and found:
                groups.append((found, tests))
    total = sum(len(found) for found, _ in groups)
    rng = random.Random(seed)
    chosen = []
    for found, tests in groups:
        size = min(len(found), max(1, round(count * len(found) / max(total, 1))))
        chosen += [(mutant, tests) for mutant in rng.sample(found, size)]
    return chosen


def copy_repository(folder: Path) -> None:
    """Copy the files of the repository, with changes that are not committed, to a folder.

    Args:
        folder: Empty folder.
    """
    listed = subprocess.run(
        ["git", "ls-files", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT,
        capture_output=True,
        check=True,
    )
    # With what Numba has compiled; it compiles again what a mutant changes.
    compiled = [path.relative_to(ROOT).as_posix() for path in (ROOT / "tests").rglob("__pycache__/*.nb[ic]")]
    for name in (*listed.stdout.decode().splitlines(), *compiled):
        source = ROOT / name
        if source.is_file() and not name.startswith(("docs/", "benchmarks/")):
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(source, folder / name)
    (folder / "hframe_gym" / "agents").symlink_to("../agents")


def run_tests(folder: Path, tests: Sequence[str], *, cached: bool = True) -> bool:
    """Run tests in a forked process.

    Args:
        folder: Copy of the repository.
        cached: Whether the compiled Python files of the tree exist already; otherwise they are written.

    Returns:
        Whether all pass.
    """
    child = os.fork()
    if child == 0:
        sys.dont_write_bytecode = cached
        _test(folder, tests)
    _, status = os.waitpid(child, 0)
    return status == 0


def _test(folder: Path, tests: Sequence[str]) -> NoReturn:
    """Run tests in this process and end it; exit code 0 if all pass."""
    import resource

    import pytest

    code = 1
    try:
        signal.signal(signal.SIGXCPU, signal.SIG_DFL)
        resource.setrlimit(resource.RLIMIT_CPU, (int(TIMEOUT_S), int(TIMEOUT_S) + 5))
        silent = os.open(os.devnull, os.O_WRONLY)
        os.dup2(silent, 1)
        os.dup2(silent, 2)
        os.chdir(folder)
        # What the parent has imported of this package, for this module, belongs to the unchanged tree.
        for name in [m for m in sys.modules if m.partition(".")[0] in ("hframe_gym", "tests", "tools")]:
            del sys.modules[name]
        sys.path[:] = [str(folder), *(p for p in sys.path if Path(p or ".").resolve() != ROOT)]
        code = int(pytest.main(["-x", "-q", "-p", "no:cacheprovider", "-p", "no:xdist", *tests]))
    finally:
        os._exit(code)


def main(arguments: list[str] | None = None) -> int:
    """Test a sample of mutants and print the score.

    Args:
        arguments: Command line without the program's name. Default: that of the process.

    Returns:
        Exit code: 1 if a test fails without any change.
    """
    require_posix("tools.mutation")
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--count", type=int, default=150, help="number of mutants, about")
    parser.add_argument("--seed", type=int, default=0, help="seed of the sample")
    parser.add_argument("--file", default="", help="only files whose path contains this text")
    parser.add_argument("--list", action="store_true", help="print the sample without testing it")
    options = parser.parse_args(arguments)
    chosen = sample(options.count, options.seed, options.file)
    if options.list:
        for mutant, _ in chosen:
            print(f"{mutant.file}:{mutant.line}: {mutant.change}")
        return 0
    for name in (
        "numpy",
        "scipy.optimize",
        "scipy.signal",
        "scipy.stats",
        "scipy.interpolate",
        "numba",
        "pydantic",
    ):
        importlib.import_module(name)
    importlib.import_module("pytest")
    with tempfile.TemporaryDirectory(prefix="mutation-") as name:
        folder = Path(name)
        copy_repository(folder)
        for tests in dict.fromkeys(tests for _, tests in chosen):
            print(f"without a change: {' '.join(tests)}", flush=True)
            if not run_tests(folder, tests, cached=False):
                print(f"fails without any change: pytest -x {' '.join(tests)}", file=sys.stderr)
                return 1
        results = _test_mutants(folder, chosen)
    write_text(OUTPUT, json.dumps({"seed": options.seed, "mutants": results}, indent=1) + "\n")
    _print_table(results)
    return 0


def _test_mutants(folder: Path, chosen: Sequence[tuple[Mutant, tuple[str, ...]]]) -> list[dict[str, object]]:
    """Test mutants one after the other; print those that survive."""
    results: list[dict[str, object]] = []
    for number, (mutant, tests) in enumerate(chosen, 1):
        path = folder / mutant.file
        original = path.read_text("utf-8")
        started, stamp = time.monotonic(), path.stat().st_mtime_ns
        path.write_text(mutant.text, "utf-8")
        equivalent = EQUIVALENT.get(mutant.key)
        outcome = "equivalent" if equivalent else "survived" if run_tests(folder, tests) else "noticed"
        path.write_text(original, "utf-8")
        os.utime(path, ns=(stamp, stamp))  # its compiled file remains valid
        entry = asdict(mutant) | {"outcome": outcome, "seconds": round(time.monotonic() - started, 1)}
        del entry["text"]
        results.append(entry)
        print(f"{number}/{len(chosen)} {outcome}: {mutant.file}:{mutant.line}: {mutant.change}", flush=True)
    return results


def _print_table(results: Sequence[dict[str, object]]) -> None:
    """Print mutants, equivalent, noticed and score by file, and for all files."""
    counts = Counter((str(r["file"]), str(r["outcome"])) for r in results)
    files = sorted({file for file, _ in counts})
    print("| file | mutants | equivalent | noticed | score |\n| --- | ---: | ---: | ---: | ---: |")
    for file in (*files, "all"):
        of_file = [file] if file != "all" else files
        noticed, survived, equivalent = (
            sum(counts[f, outcome] for f in of_file) for outcome in ("noticed", "survived", "equivalent")
        )
        score = f"{100.0 * noticed / (noticed + survived):.0f} %" if noticed + survived else "-"
        print(f"| {file} | {noticed + survived + equivalent} | {equivalent} | {noticed} | {score} |")


if __name__ == "__main__":
    raise SystemExit(main())
