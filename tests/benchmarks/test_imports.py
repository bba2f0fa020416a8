"""Benchmarks, most of which no test runs, import names that exist. They are read, as imports take long."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from graphlib import TopologicalSorter
from pathlib import Path

ROOT = Path(__file__).parents[2]


def imported(file: Path) -> Iterator[tuple[str, str]]:
    """Yield what a benchmark imports of this repository: modules, and names in them, also in functions."""
    for node in ast.walk(ast.parse(file.read_text("utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module:
            yield from ((node.module, alias.name) for alias in node.names)


def has_name(module: str, name: str) -> bool:
    """Return whether a module has a name, or a package a module of this name; True for other packages."""
    path = ROOT / module.replace(".", "/")
    if module.partition(".")[0] not in ("hframe_gym", "benchmarks", "tests", "tools"):
        return True
    if (path / f"{name}.py").is_file() or (path / name / "__init__.py").is_file():
        return True
    sources = [file for file in (path.with_suffix(".py"), path / "__init__.py") if file.is_file()]
    return any(re.search(rf"\b{name}\b", source.read_text("utf-8")) for source in sources)


def test_benchmarks_import_names_that_exist() -> None:
    missing = [
        f"{file.relative_to(ROOT)}: {module} has no {name}"
        for file in (ROOT / "benchmarks").rglob("*.py")
        for module, name in imported(file)
        if not has_name(module, name)
    ]
    assert missing == []


def module_of(file: Path) -> str:
    """Return the name of a file's module, or of its package."""
    return ".".join(file.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")


def test_no_benchmark_imports_itself_by_way_of_others() -> None:
    """Imports in functions count: they hide a circle."""
    files = {module_of(file): file for file in (ROOT / "benchmarks").rglob("*.py")}
    needs = {
        name: {
            f"{module}.{part}" if f"{module}.{part}" in files else module
            for module, part in imported(file)
            if module.startswith("benchmarks")
        }
        for name, file in files.items()
    }
    TopologicalSorter(needs).prepare()  # raises CycleError, which names a circle
