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

from tools.repository import RESULTS

Formatter = Callable[[dict[str, Any]], str]


class _Table(NamedTuple):
    """How a table is formatted, and from which file of benchmarks/results, by its name without ending."""

    formatter: Formatter
    source: str


_TABLES: dict[str, _Table] = {}


def table(*names: str, source: str | None = None) -> Callable[[Formatter], Formatter]:
    """Register the function that formats tables.

    Args:
        *names: Names of the tables on the pages.
        source: Name of the file in benchmarks/results, without ending. Default: the name of the table.

    Returns:
        Decorator that returns its function.
    """

    def register(formatter: Formatter) -> Formatter:
        _TABLES.update({name: _Table(formatter, source or name) for name in names})
        return formatter

    return register


def markdown(header: Sequence[str], rows: Iterable[Sequence[str]], alignment: str = "---:") -> str:
    """Format a Markdown table.

    Args:
        alignment: Alignment of all columns but the first, which is left. Default: right.
    """
    lines = [header, ["---", *[alignment] * (len(header) - 1)], *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def with_interval(value: float, low: float, high: float, *, decimals: int = 3) -> str:
    """Format a mean or a ratio with its interval or spread, such as "1.05 (1.02 to 1.08)"."""
    return f"{value:.{decimals}f} ({low:.{decimals}f} to {high:.{decimals}f})"


def load_results(name: str) -> dict[str, Any]:
    """Return the content of a file of benchmarks/results."""
    content: dict[str, Any] = json.loads((RESULTS / f"{name}.json").read_text("utf-8"))
    return content


def filled(text: str, *, conditions: bool = True) -> str:
    """Write the tables of a page anew from the result files.

    Args:
        text: The page as it is.
        conditions: Whether a line below each table states versions, cores and seed of the measurement.

    Returns:
        The page; tables without results are left as they are.

    Raises:
        KeyError: If no function formats a table of the page.
    """

    def rewritten(match: re.Match[str]) -> str:
        formatter, source = _TABLES[match[1]]
        if not (RESULTS / f"{source}.json").is_file():
            return match[0]
        results = load_results(source)
        # the rows of a file that is written by hand state where they were measured
        note = f"\n\n{_conditions(results)}" if conditions and "versions" in results else ""
        return f"<!-- table: {match[1]} -->\n{formatter(results)}{note}\n<!-- end -->"

    return re.sub(r"<!-- table: (\w+) -->.*?<!-- end -->", rewritten, text, flags=re.DOTALL)


def _conditions(results: dict[str, Any]) -> str:
    """Return one line with the versions, cores and seed of a measurement."""
    versions = ", ".join(f"{k} {v}" for k, v in results["versions"].items())
    seed = "" if results["seed"] is None else f", seed {results['seed']}"
    return f"Python {results['python']}, {results['machine']['cores']} cores, {versions}{seed}."
