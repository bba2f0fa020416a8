"""A page, one browser tab with all stages, and what the stages share: commands, button and output."""

from __future__ import annotations

import html
import logging
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from typing import Any, ClassVar, Literal

from nicegui import ui

from ..errors import InputError
from .elements import banner
from .jobs import Job, Jobs
from .session import Session, command_text

State = Literal["", "done", "running", "problem"]
_POLL_S = 0.3  # s between two looks at a job


class Stage(ABC):
    """One step of the work, such as "Check", in one browser tab.

    Attributes:
        key: Key by which the page finds the stage.
        title: Title on its tab.
        purpose: What it is for, in sentences, shown below the title.
        action: Text of the button that runs its commands; "" without a button.
        expected_codes: Exit codes of its commands after which the output need not be read.
        container: Element that holds the stage.
    """

    key: ClassVar[str]
    title: ClassVar[str]
    purpose: ClassVar[str]
    action: ClassVar[str] = ""  # text of the button that runs the commands
    expected_codes: ClassVar[tuple[int, ...]] = (0,)  # exit codes after which the output need not be read

    container: Any

    def __init__(self, page: Page) -> None:
        self.page, self.session = page, page.session
        self._code: Any = None
        self._output: Any = None
        self._button: Any = None
        self._stop: Any = None
        self._details: Any = None
        self._summary: Any = None

    @abstractmethod
    def show(self) -> None:
        """Build the content of the stage, between its title and its commands."""

    @abstractmethod
    def state(self) -> State:
        """Return the state that marks the tab of the stage.

        Returns:
            "done" if its result exists, "problem" if this is faulty, "" if there is none yet.
        """

    def commands(self) -> list[list[str]]:
        """Return the words after "hframe" of each command of the stage; none if it only shows something."""
        return []

    def missing(self) -> tuple[str, str] | None:
        """Return the key of a stage that must come first and a sentence why; None if nothing is missing."""
        return None

    def opened(self) -> None:  # noqa: B027
        """Update the stage when the user opens it; this default does nothing."""

    def finished(self, job: Job) -> None:  # noqa: B027
        """Update the stage when a job of it has ended; this default does nothing."""

    @property
    def job(self) -> Job | None:
        """The last job of this stage; None if it has had none."""
        return self.page.jobs.get(self.key)

    def refresh(self) -> None:
        """Build the stage anew: title, purpose, and its content or what is missing."""
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
            self._next()

    def _next(self) -> None:
        """Show the way to the next stage, if this one is done."""
        keys = list(self.page.stages)
        following = keys[keys.index(self.key) + 1 :][:1]
        if following and self.state() == "done":
            title = self.page.stages[following[0]].title
            with ui.element("div").classes("hf-row hf-next"):
                ui.button(f"Next: {title}", on_click=lambda: self.page.go(following[0])).props("outline")

    def command_box(self) -> None:
        """Build the box with the commands of the stage, the button that runs them, and their output."""
        with ui.element("section").classes("hf-command").props('aria-label="Command"'):
            self._code = ui.html("", sanitize=False)
            with ui.element("div").classes("hf-row"):
                self._button = ui.button(self.action, on_click=self.run).props(
                    f'unelevated color=accent data-run="{self.key}"'
                )
                self._stop = ui.button("Stop", on_click=self.stop).props("outline")
                ui.button("Copy", on_click=self._copy).props('flat dense title="Copy the command"')
            self.update_command()
        with ui.element("details").classes("hf-details") as self._details:
            with ui.element("summary"):
                self._summary = ui.label("Output")
            self._output = (
                ui.html("", sanitize=False).classes("hf-output").props('tabindex=0 aria-label="Output"')
            )
        self._show_output()

    def update_command(self) -> None:
        """Show the commands that follow from the user's present choices, or why they are not possible."""
        if self._code is None:
            return
        try:
            text = "\n".join(command_text(words) for words in self.commands())
        except (InputError, ValueError) as error:
            text = str(error)
        self._code.set_content(f"<pre>{html.escape(text)}</pre>")

    def keep(self, field: Any, attribute: str, read: Callable[[Any], Any]) -> None:
        """Store the value of a form field in an attribute of the stage, and update the commands shown.

        Args:
            field: Element with a value.
            attribute: Name of the attribute.
            read: Function from the element's value, which may be None, to that of the attribute.
        """
        field.bind_value_to(self, attribute, read).on_value_change(self.update_command)

    def _copy(self) -> None:
        """Copy the commands to the clipboard."""
        ui.clipboard.write("\n".join(command_text(words) for words in self.commands()))
        ui.notify("Copied", timeout=1000)

    def run(self) -> None:
        """Run the commands of this stage as a new job, unless a job of any stage is running."""
        if self.page.jobs.running is not None:
            ui.notify("Another command is running; wait for it, or stop it", type="warning")
            return
        try:
            commands = self.commands()
        except InputError as error:
            ui.notify(str(error), type="negative")
            return
        self.page.jobs[self.key] = Job(self.session, commands)
        self.progressed(self.page.jobs[self.key])

    def stop(self) -> None:
        """Stop the last job of this stage, if it runs."""
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
        self._details.set_visibility(bool(lines) or running)
        if job is None:
            return
        last = f"… {job.progress.doing} ({job.seconds:.0f} s)" if running else self._ending(job)
        self._output.set_content(html.escape("\n".join(lines)))
        self._summary.set_text(f"Output: {last}")
        # An output is of interest while it appears, and if something went wrong.
        if job.exit_code in self.expected_codes:
            self._details.props(remove="open")
        else:
            self._details.props("open")
        if running:
            ui.run_javascript(
                f"{{const e = getHtmlElement({self._output.id}); if (e) e.scrollTop = e.scrollHeight}}"
            )

    def _ending(self, job: Job) -> str:
        """Return a line about the end of a job."""
        if job.exit_code == 0:
            return f"done in {job.seconds:.1f} s"
        return (
            f"{'stopped' if job.stopped else 'ended'} with exit code "
            f"{job.exit_code} after {job.seconds:.1f} s"
        )


class Page:
    """The stages in one browser tab, as tabs marked by their state.

    Attributes:
        jobs: Jobs of all browser tabs.
        dark: Whether the display is dark.
        stages: Stages by their keys, in the order of the work.
    """

    def __init__(self, session: Session, jobs: Jobs, kinds: Iterable[type[Stage]], *, dark: bool) -> None:
        self.session, self.jobs, self.dark = session, jobs, dark
        self.stages: dict[str, Stage] = {kind.key: kind(self) for kind in kinds}
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
        """Open the stage of the work with this `Stage.key`."""
        self._bar.set_value(key)

    def changed(self) -> None:
        """Show all stages anew after something in the session has changed."""
        for stage in self.stages.values():
            stage.refresh()
        self._mark()

    def _look(self) -> None:
        """Show what the jobs have done since the last look."""
        for key, job in self.jobs.items():
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
            job = self.jobs.get(key)
            state: State = "running" if job is not None and job.running else stage.state()
            self._tabs[key].classes(
                remove="hf-done hf-running hf-problem", add=f"hf-{state}" if state else ""
            )
