"""Frame of the page: stages as tabs, the commands of a stage, and the output of its job."""

from __future__ import annotations

import html
import logging
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, ClassVar, Literal

from nicegui import ui

from ..errors import InputError
from ..web_page import COLORS
from .jobs import Job
from .session import Session, command_text

State = Literal["", "done", "running", "problem"]
_POLL_S = 0.3  # s between two looks at a job
_ON_PRIMARY = ("#ffffff", "#0d1219")  # color of text on the primary color, light and dark


def style_sheet() -> str:
    """Return the style sheet of the page, with the colors of reports."""
    light, dark = (
        "".join(f"--{role}: {pair[k]};" for role, pair in COLORS.items())
        + f"--on-primary: {_ON_PRIMARY[k]}; --q-primary: {COLORS['after'][k]} !important;"
        for k in (0, 1)
    )
    text = (Path(__file__).parent / "style.css").read_text(encoding="utf-8")
    colors = f":root {{ color-scheme: light dark; {light} }}"
    return f"{colors} @media (prefers-color-scheme: dark) {{ :root {{ {dark} }} }} {text}"


class Window:
    """The window of a session; every browser tab shows the same session and jobs.

    Attributes:
        session: The session.
        jobs: The last job of each stage, by its key.
    """

    def __init__(self, session: Session) -> None:
        """Create the window.

        Args:
            session: The session.
        """
        self.session = session
        self.jobs: dict[str, Job] = {}

    async def page(self) -> None:
        """Build the page for one browser tab."""
        ui.add_css(style_sheet())
        ui.add_head_html('<meta name="color-scheme" content="light dark">')
        with ui.element("div").classes("hf-head"):
            ui.html("<b>hframe</b>", sanitize=False)
            ui.label(str(self.session.folder))
        await ui.context.client.connected(timeout=20.0)
        dark, narrow = await ui.run_javascript(
            "[matchMedia('(prefers-color-scheme: dark)').matches, innerWidth < 700]", timeout=10.0
        )
        ui.run_javascript(
            "matchMedia('(prefers-color-scheme: dark)').addEventListener('change', () => location.reload())"
        )
        Page(self, dark=bool(dark), narrow=bool(narrow)).build()

    @property
    def running(self) -> Job | None:
        """The job in progress; None if there is none."""
        return next((job for job in self.jobs.values() if job.running), None)


class Page:
    """The stages in one browser tab.

    Attributes:
        window: The window.
        session: The session.
        dark: Whether the display is dark.
        narrow: Whether the display is that of a phone.
        stages: The stages by their keys.
    """

    def __init__(self, window: Window, *, dark: bool, narrow: bool) -> None:
        """Create the stages.

        Args:
            window: The window.
            dark: Whether the display is dark.
            narrow: Whether the display is that of a phone.
        """
        from .check_stage import CheckStage
        from .control_stage import ControlStage
        from .export_stage import ExportStage
        from .identify_stage import IdentifyStage
        from .logs_stage import LogsStage
        from .machine_stage import MachineStage
        from .results_stage import ResultsStage

        self.window, self.session, self.dark, self.narrow = window, window.session, dark, narrow
        kinds = (MachineStage, LogsStage, CheckStage, IdentifyStage, ResultsStage, ControlStage, ExportStage)
        self.stages: dict[str, Stage] = {kind.key: kind(self) for kind in kinds}
        self._tabs: dict[str, Any] = {}
        self._seen: dict[str, tuple[int, bool]] = {}
        self._bar: Any = None

    def build(self) -> None:
        """Build tabs and stages, and look at the jobs from then on."""
        with ui.element("nav").classes("hf-tabs"), ui.tabs() as self._bar:
            self._bar.props("no-caps inline-label mobile-arrows outside-arrows align=left")
            for number, stage in enumerate(self.stages.values(), start=1):
                self._tabs[stage.key] = ui.tab(stage.key, label=f"{number} {stage.title}")
        panels = ui.tab_panels(self._bar, value=self._first_open()).props("keep-alive").classes("w-full")
        with panels:
            for stage in self.stages.values():
                with ui.tab_panel(stage.key):
                    stage.container = ui.element("main").classes("hf-stage").props(f'data-stage="{stage.key}"')
        for stage in self.stages.values():
            stage.refresh()
        self._bar.on_value_change(lambda event: self.stages[event.value].opened())
        self._mark()
        ui.timer(_POLL_S, self._look)

    def _first_open(self) -> str:
        """Return the first stage that is not done."""
        return next((key for key, stage in self.stages.items() if stage.state() != "done"), "machine")

    def go(self, key: str) -> None:
        """Show a stage."""
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
            self._tabs[key].classes(remove="hf-done hf-running hf-problem", add=f"hf-{state}" if state else "")


class Stage(ABC):
    """One stage of the loop in one browser tab.

    Attributes:
        page: The page.
        session: The session.
        container: Element that holds the stage.
    """

    key: ClassVar[str]
    title: ClassVar[str]
    purpose: ClassVar[str]
    action: ClassVar[str] = ""  # text of the button that runs the commands

    container: Any

    def __init__(self, page: Page) -> None:
        """Create a stage.

        Args:
            page: The page that shows it.
        """
        self.page, self.session = page, page.session
        self._code: Any = None
        self._output: Any = None
        self._button: Any = None
        self._stop: Any = None

    @abstractmethod
    def show(self) -> None:
        """Build what the stage shows between its title and its commands."""

    @abstractmethod
    def state(self) -> State:
        """Return whether the stage is done."""

    def commands(self) -> list[list[str]]:
        """Return the commands of the stage, words after "hframe"."""
        return []

    def before(self) -> None:  # noqa: B027
        """Do what must be done before the commands run."""

    def missing(self) -> tuple[str, str] | None:
        """Return what must come first: the key of a stage and a sentence; None if nothing is missing."""
        return None

    def opened(self) -> None:  # noqa: B027
        """React to the user opening the stage."""

    def finished(self, job: Job) -> None:  # noqa: B027
        """React to the end of a job of this stage."""

    @property
    def job(self) -> Job | None:
        """The last job of this stage."""
        return self.page.window.jobs.get(self.key)

    def refresh(self) -> None:
        """Build the stage anew."""
        self._code = self._output = self._button = self._stop = None
        self.container.clear()
        with self.container:
            ui.html(f"<h1>{self.title}</h1>", sanitize=False)
            ui.html(f'<p class="hf-lead">{self.purpose}</p>', sanitize=False)
            missing = self.missing()
            if missing is not None:
                key, sentence = missing
                with ui.element("div").classes("hf-banner hf-neutral"), ui.element("div").classes("hf-row"):
                    ui.label(sentence)
                    title = self.page.stages[key].title
                    ui.button(f"Go to {title}", on_click=lambda: self.page.go(key)).props("flat dense")
                return
            try:
                self.show()
            except (InputError, OSError) as error:
                banner("warning", "", str(error))
            except Exception as error:  # the other stages must stay usable
                logging.getLogger(__name__).exception("stage %s", self.key)
                banner("warning", "Internal error, please report it.", f"{type(error).__name__}: {error}")

    def command_box(self) -> None:
        """Build the box with the commands of the stage, the button that runs them, and their output."""
        with ui.element("section").classes("hf-command").props('aria-label="Command"'):
            self._code = ui.html("", sanitize=False)
            with ui.element("div").classes("hf-row"):
                self._button = ui.button(self.action, on_click=self.run).props(f'unelevated data-run="{self.key}"')
                self._stop = ui.button("Stop", on_click=self.stop).props("outline")
                ui.button("Copy", on_click=self._copy).props("flat dense").tooltip("Copy the command")
            self.update_command()
        self._output = ui.html("", sanitize=False).classes("hf-output").props('tabindex=0 aria-label="Output"')
        self._show_output()

    def update_command(self) -> None:
        """Show the commands that the present choices mean."""
        if self._code is None:
            return
        try:
            text = "\n".join(command_text(words) for words in self.commands())
        except (InputError, ValueError) as error:
            text = str(error)
        self._code.set_content(f"<pre>{html.escape(text)}</pre>")

    def _copy(self) -> None:
        """Copy the commands to the clipboard."""
        ui.clipboard.write("\n".join(command_text(words) for words in self.commands()))
        ui.notify("Copied", timeout=1000)

    def run(self) -> None:
        """Run the commands of the stage."""
        if self.page.window.running is not None:
            ui.notify("Another command is running; wait for it, or stop it", type="warning")
            return
        try:
            commands = self.commands()
        except InputError as error:
            ui.notify(str(error), type="negative")
            return
        self.page.window.jobs[self.key] = Job(self.session, commands, self.before)
        self.progressed(self.page.window.jobs[self.key])

    def stop(self) -> None:
        """Stop the commands of the stage."""
        if self.job is not None:
            self.job.stop()
            self.progressed(self.job)

    def progressed(self, job: Job) -> None:
        """Show the output and the progress of a job of this stage."""
        self._show_output()

    def _show_output(self) -> None:
        """Show the output of the last job, and the button that fits its state."""
        if self._output is None:
            return
        job = self.job
        running = job is not None and job.running
        self._button.set_visibility(not running)
        self._stop.set_visibility(running)
        lines = job.lines if job is not None else []
        self._output.set_visibility(bool(lines) or running)
        if job is None:
            return
        last = f"… {job.progress.doing} ({job.seconds:.0f} s)" if running else self._ending(job)
        self._output.set_content(html.escape("\n".join([*lines, last])))

    def _ending(self, job: Job) -> str:
        """Return a line about the end of a job."""
        if job.exit_code == 0:
            return f"done in {job.seconds:.1f} s"
        return f"{'stopped' if job.stopped else 'ended'} with exit code {job.exit_code} after {job.seconds:.1f} s"


def banner(tone: Literal["good", "neutral", "warning"], title: str, text: str) -> None:
    """Show a sentence with a colored edge.

    Args:
        tone: Color.
        title: First words, in this color; may be empty.
        text: The sentence.
    """
    strong = f"<b>{html.escape(title)}</b> " if title else ""
    ui.html(strong + html.escape(text), sanitize=False).classes(f"hf-banner hf-{tone}").props("role=status")


def heading(text: str) -> None:
    """Show the heading of a part of a stage."""
    ui.html(f"<h2>{html.escape(text)}</h2>", sanitize=False)


def table(head: Sequence[str], rows: Sequence[Sequence[str]], numbers: Sequence[int] = ()) -> None:
    """Show a table of texts.

    Args:
        head: Titles of the columns.
        rows: Cells of each row.
        numbers: Indices of the columns whose cells are aligned at the right.
    """

    def cells(tag: str, texts: Sequence[str]) -> str:
        parts = (
            f"<{tag}{' class=num' if k in numbers else ''}>{html.escape(text)}</{tag}>" for k, text in enumerate(texts)
        )
        return f"<tr>{''.join(parts)}</tr>"

    body = "".join(cells("td", row) for row in rows)
    with ui.element("div").classes("hf-scroll"):
        content = f'<table class="hf-table"><thead>{cells("th", head)}</thead><tbody>{body}</tbody></table>'
        ui.html(content, sanitize=False)


def when_changed(update: Callable[[], None]) -> Callable[[Any], None]:
    """Return a handler of an element's event that ignores what the event says."""
    return lambda event: update()
