"""Findings as a table on a terminal, a line each elsewhere, or as JSON."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from ..atomic_files import write_text
from .findings import Finding

SCHEMA = 1
_STYLES = {"fault": "bold red", "advice": "yellow", "note": "dim"}


def gathered(found: Sequence[Finding]) -> list[Finding]:
    """Findings that differ only by run and numbers as one, that of the first run, with how many more there are."""
    groups: dict[tuple[str, str, str], list[Finding]] = {}
    for f in found:
        groups.setdefault(
            (f.severity, f.channel, re.sub(r"\d[\d.e+-]*", "#", f.message) if f.run else f.message), []
        ).append(f)
    return [
        group[0] if len(group) == 1 else replace(group[0], run=f"{group[0].run} and {len(group) - 1} more runs")
        for group in groups.values()
    ]


def show(found: Sequence[Finding], console: Console) -> None:
    """Print findings, faults first, and how many there are of each kind."""
    lines = gathered(found)
    if console.is_terminal:
        table = Table("", "run", "channel", "finding", box=None)
        for f in lines:
            table.add_row(f"[{_STYLES[f.severity]}]{f.severity}[/]", f.run, f.channel, escape(f.message))
        console.print(table, soft_wrap=False)
    else:
        for f in lines:
            console.print(str(f), markup=False, highlight=False)
    counts = (f"{sum(f.severity == s for f in found)} {s}" for s in _STYLES)
    console.print(", ".join(counts), markup=False, highlight=False)


def write_json(found: Sequence[Finding], path: Path) -> None:
    """Write `{"schema": 1, "findings": [{"severity", "run", "channel", "message"}, ...]}`, whole."""
    content = {"schema": SCHEMA, "findings": [asdict(f) for f in found]}
    write_text(path, json.dumps(content, indent=1) + "\n")
