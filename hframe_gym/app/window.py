"""The window of a session: its style, its jobs and a page for each browser tab."""

from __future__ import annotations

import html
from pathlib import Path

from nicegui import ui

from ..web_page import COLORS
from .jobs import Jobs
from .page import Page
from .session import Session
from .stages import STAGES

# Color of filled buttons, light and dark; white text has a contrast of 5 or more.
_FILLED = ("#0b69c7", "#1f6fc4")


def style_sheet() -> str:
    """Return the text of the page's style sheet, whose colors are those of the reports."""
    light, dark = (
        "".join(f"--{role}: {pair[k]};" for role, pair in COLORS.items()) + f"--filled: {_FILLED[k]};"
        for k in (0, 1)
    )
    text = (Path(__file__).parent / "style.css").read_text(encoding="utf-8")
    colors = f":root {{ color-scheme: light dark; {light} }}"
    return f"{colors} @media (prefers-color-scheme: dark) {{ :root {{ {dark} }} }} {text}"


class Window:
    """The window of a session; all browser tabs show the same session and the last job of each stage."""

    def __init__(self, session: Session) -> None:
        self.session = session
        self.jobs = Jobs()

    async def page(self) -> None:
        """Build the page of the session for one browser tab: all stages of the work as tabs."""
        ui.add_css(style_sheet())
        ui.add_head_html('<meta name="color-scheme" content="light dark">')
        with ui.element("div").classes("hf-head"):
            ui.html("<b>hframe</b>", sanitize=False)
            ui.label(self.session.folder.name).props(f'title="{html.escape(str(self.session.folder))}"')
        await ui.context.client.connected(timeout=20.0)
        dark = bool(
            await ui.run_javascript("matchMedia('(prefers-color-scheme: dark)').matches", timeout=10.0)
        )
        ui.run_javascript(
            "matchMedia('(prefers-color-scheme: dark)').addEventListener('change', () => location.reload())"
        )
        ui.colors(primary=COLORS["after"][dark], accent=_FILLED[dark])
        Page(self.session, self.jobs, STAGES, dark=dark).build()
