"""All pages with generated parts."""

from __future__ import annotations

from pathlib import Path

from tools.repository import ROOT

# The modules of tables register these when they are imported.
from tools.tables import agents, commands, gap, identification, real_recordings, simulator  # noqa: F401
from tools.tables.effects_page import effects_page
from tools.tables.leaderboard import leaderboard_page, results
from tools.tables.machine_page import schema_text, with_field_tables
from tools.tables.result_tables import filled

DOCS = ROOT / "docs"


def pages() -> dict[Path, str]:
    """Return the text of all pages with generated parts by path."""
    readme = ROOT / "README.md"
    with_tables = (ROOT / "RESULTS.md", *sorted(DOCS.glob("*.md")))
    return (
        {readme: filled(readme.read_text("utf-8"), conditions=False)}
        | {page: filled(page.read_text("utf-8")) for page in with_tables}
        | {
            DOCS / "effects.md": effects_page(),
            DOCS / "machine.md": with_field_tables((DOCS / "machine.md").read_text("utf-8")),
            DOCS / "machine.schema.json": schema_text(),
        }
        | {
            page: leaderboard_page(page.read_text("utf-8"), results())
            for page in (DOCS / "leaderboard.md", DOCS / "bound.md")
        }
    )
