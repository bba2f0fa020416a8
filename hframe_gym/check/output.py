"""Findings as a table on a terminal, a line each elsewhere, or as JSON."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from ..files import write_text
from .finding import Finding

SCHEMA = 1
_STYLES = {"fault": "bold red", "advice": "yellow", "note": "dim"}


def show(found: Sequence[Finding], console: Console) -> None:
    """Print findings, faults first, and how many there are of each kind."""
    if console.is_terminal:
        table = Table("", "run", "channel", "finding", box=None)
        for f in found:
            table.add_row(f"[{_STYLES[f.severity]}]{f.severity}[/]", f.run, f.channel, escape(f.message))
        console.print(table, soft_wrap=False)
    else:
        for f in found:
            console.print(str(f), markup=False, highlight=False)
    counts = (f"{sum(f.severity == s for f in found)} {s}" for s in _STYLES)
    console.print(", ".join(counts), markup=False, highlight=False)


def write_json(found: Sequence[Finding], path: Path) -> None:
    """Write `{"schema": 1, "findings": [{"severity", "run", "channel", "message"}, ...]}`, whole."""
    content = {"schema": SCHEMA, "findings": [asdict(f) for f in found]}
    write_text(path, json.dumps(content, indent=1) + "\n")
