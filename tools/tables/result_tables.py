"""Tables of benchmark results by name: what a page shows between `<!-- table: NAME -->` and `<!-- end -->`.

    @table("her")
    def her(results: dict[str, Any]) -> str: ...

formats the content of benchmarks/results/her.json.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

from benchmarks.results_file import RESULTS

Formatter = Callable[[dict[str, Any]], str]


class _Table(NamedTuple):
    """How a table is formatted, and the name of the results that it shows."""

    formatter: Formatter
    results: str


_TABLES: dict[str, _Table] = {}


def table(*names: str, results: str | None = None) -> Callable[[Formatter], Formatter]:
    """Register the function that formats tables.

    Args:
        *names: Names of the tables on the pages.
        results: Name of the file in benchmarks/results. Default: the name of the table.

    Returns:
        Decorator that returns its function.
    """

    def register(formatter: Formatter) -> Formatter:
        _TABLES.update({name: _Table(formatter, results or name) for name in names})
        return formatter

    return register


def markdown(header: Sequence[str], rows: Iterable[Sequence[str]], others: str = "---:") -> str:
    """Format a Markdown table.

    Args:
        header: Titles of the columns.
        rows: Cells of the rows.
        others: Alignment of all columns but the first. Default: right.

    Returns:
        The table as lines of text.
    """
    lines = [header, ["---", *[others] * (len(header) - 1)], *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def with_interval(value: float, low: float, high: float, *, digits: int = 3) -> str:
    """Format a mean or a ratio with its interval or spread, "1.05 (1.02 to 1.08)".

    Args:
        value: Value.
        low: Lower limit.
        high: Upper limit.
        digits: Decimals of all three.
    """
    return f"{value:.{digits}f} ({low:.{digits}f} to {high:.{digits}f})"


def load_results(name: str) -> dict[str, Any]:
    """Return the content of a file of benchmarks/results."""
    content: dict[str, Any] = json.loads((RESULTS / f"{name}.json").read_text("utf-8"))
    return content


def filled(text: str, *, surroundings: bool = True) -> str:
    """Replace the tables of a page by the present ones.

    Args:
        text: The page as it is.
        surroundings: Whether a line below each table says on what it was measured.

    Returns:
        The page; tables without results are left as they are.

    Raises:
        KeyError: If no function formats a table of the page.
    """

    def content(match: re.Match[str]) -> str:
        formatter, name = _TABLES[match[1]]
        if not (RESULTS / f"{name}.json").is_file():
            return match[0]
        results = load_results(name)
        note = f"\n\n{_surroundings(results)}" if surroundings else ""
        return f"<!-- table: {match[1]} -->\n{formatter(results)}{note}\n<!-- end -->"

    return re.sub(r"<!-- table: (\w+) -->.*?<!-- end -->", content, text, flags=re.DOTALL)


def _surroundings(results: dict[str, Any]) -> str:
    """Return one line with the versions, cores and seed of a measurement."""
    versions = ", ".join(f"{k} {v}" for k, v in results["versions"].items())
    seed = "" if results["seed"] is None else f", seed {results['seed']}"
    return f"Python {results['python']}, {results['machine']['cores']} cores, {versions}{seed}."
