"""Frame of the page: the stages as tabs, marked by their state, and their jobs."""

from __future__ import annotations

import html
from pathlib import Path
from typing import Any

from nicegui import ui

from ..web_page import COLORS
from .check_stage import CheckStage
from .control_stage import ControlStage
from .export_stage import ExportStage
from .identify_stage import IdentifyStage
from .jobs import Job
from .logs_stage import LogsStage
from .machine_stage import MachineStage
from .results_stage import ResultsStage
from .session import Session
from .stage import Stage, State

_STAGES: tuple[type[Stage], ...] = (
    MachineStage,
    LogsStage,
    CheckStage,
    IdentifyStage,
    ResultsStage,
    ControlStage,
    ExportStage,
)
_POLL_S = 0.3  # s between two looks at a job
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
        self.jobs: dict[str, Job] = {}

    async def page(self) -> None:
        """Build the page for one browser tab."""
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
        Page(self, dark=dark).build()

    @property
    def running(self) -> Job | None:
        """The job in progress; None if there is none."""
        return next((job for job in self.jobs.values() if job.running), None)


class Page:
    """The stages in one browser tab."""

    def __init__(self, window: Window, *, dark: bool) -> None:
        self.window, self.session, self.dark = window, window.session, dark
        self.stages: dict[str, Stage] = {kind.key: kind(self) for kind in _STAGES}
        self._tabs: dict[str, Any] = {}
        self._seen: dict[str, tuple[int, bool]] = {}
        self._bar: Any = None

    def build(self) -> None:
        """Build tabs and stages, and keep updating them from the jobs."""
        with ui.element("nav").classes("hf-tabs"), ui.tabs() as self._bar:
            self._bar.props("no-caps inline-label mobile-arrows outside-arrows align=left")
            for number, stage in enumerate(self.stages.values(), start=1):
                self._tabs[stage.key] = ui.tab(stage.key, label=f"{number} {stage.title}")
        panels = ui.tab_panels(self._bar, value=self._first_open()).props("keep-alive").classes("w-full")
        with panels:
            for stage in self.stages.values():
                with ui.tab_panel(stage.key):
                    stage.container = (
                        ui.element("main").classes("hf-stage").props(f'data-stage="{stage.key}"')
                    )
        for stage in self.stages.values():
            stage.refresh()
        self._bar.on_value_change(lambda event: self.stages[event.value].opened())
        self._mark()
        ui.timer(_POLL_S, self._look)

    def _first_open(self) -> str:
        """Return the first stage that is not done."""
        return next((key for key, stage in self.stages.items() if stage.state() != "done"), "machine")

    def go(self, key: str) -> None:
        """Show the stage with a key."""
        self._bar.set_value(key)

    def changed(self) -> None:
        """Show all stages anew after something in the session has changed."""
        for stage in self.stages.values():
            stage.refresh()
        self._mark()

    def _look(self) -> None:
        """Show what the jobs have done since the last look."""
        for key, job in self.window.jobs.items():
            seen = id(job), job.running
            before = self._seen.get(key)
            if before != seen or job.running:
                self._seen[key] = seen
                if before == (id(job), True) and not job.running:
                    self.changed()
                    self.stages[key].finished(job)
                else:
                    self.stages[key].progressed(job)
                    self._mark()

    def _mark(self) -> None:
        """Mark the tabs by the state of their stages."""
        for key, stage in self.stages.items():
            job = self.window.jobs.get(key)
            state: State = "running" if job is not None and job.running else stage.state()
            self._tabs[key].classes(
                remove="hf-done hf-running hf-problem", add=f"hf-{state}" if state else ""
            )
