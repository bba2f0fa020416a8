"""What all stages share: title, purpose, commands with the button that runs them, and the job's output."""

from __future__ import annotations

import html
import logging
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar, Literal, Protocol

from nicegui import ui

from ..errors import InputError
from .jobs import Job
from .session import Session, command_text

State = Literal["", "done", "running", "problem"]


class Jobs(Protocol):
    """The part of the window that a stage needs: the jobs of all tabs.

    Attributes:
        jobs: Last job of each stage by the stage's key.
    """

    jobs: dict[str, Job]

    @property
    def running(self) -> Job | None:
        """The job in progress; None if there is none."""


class Tab(Protocol):
    """The part of a page (`window.Page`) that a stage needs."""

    session: Session
    dark: bool

    @property
    def window(self) -> Jobs:
        """The window."""

    @property
    def stages(self) -> Mapping[str, Stage]:
        """All stages by their keys."""

    def go(self, key: str) -> None:
        """Show a stage."""

    def changed(self) -> None:
        """Show all stages anew, after the session has changed."""


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

    def __init__(self, page: Tab) -> None:
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
        """Return "done", "problem", or "" if the stage has not been done yet."""

    def commands(self) -> list[list[str]]:
        """Return the words after "hframe" of each command of the stage; none if it only shows something."""
        return []

    def missing(self) -> tuple[str, str] | None:
        """Return the key of a stage that must come first and a sentence why; None if nothing is missing."""
        return None

    def opened(self) -> None:  # noqa: B027
        """Update the stage when the user opens it; stages override this method."""

    def finished(self, job: Job) -> None:  # noqa: B027
        """Update the stage when a job of it has ended; stages override this method."""

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
        """Show the commands that follow from the user's present choices."""
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
        """Run the commands of this step of the work, unless those of a stage are running."""
        if self.page.window.running is not None:
            ui.notify("Another command is running; wait for it, or stop it", type="warning")
            return
        try:
            commands = self.commands()
        except InputError as error:
            ui.notify(str(error), type="negative")
            return
        self.page.window.jobs[self.key] = Job(self.session, commands)
        self.progressed(self.page.window.jobs[self.key])

    def stop(self) -> None:
        """Stop the commands of this step of the work, if they run."""
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


def banner(tone: Literal["good", "neutral", "warning"], title: str, text: str) -> None:
    """Show a sentence with a colored edge, after a title in the same color, which may be empty."""
    strong = f"<b>{html.escape(title)}</b> " if title else ""
    ui.html(strong + html.escape(text), sanitize=False).classes(f"hf-banner hf-{tone}").props("role=status")


def heading(text: str) -> None:
    """Show the heading of a part of a stage."""
    ui.html(f"<h2>{html.escape(text)}</h2>", sanitize=False)


def table(head: Sequence[str], rows: Sequence[Sequence[str]], numbers: Sequence[int] = ()) -> None:
    """Show a table of texts; `numbers` are indices of the columns whose cells are aligned at the right."""

    def cells(tag: str, texts: Sequence[str]) -> str:
        parts = (
            f"<{tag}{' class=num' if k in numbers else ''}>{html.escape(text)}</{tag}>"
            for k, text in enumerate(texts)
        )
        return f"<tr>{''.join(parts)}</tr>"

    body = "".join(cells("td", row) for row in rows)
    with ui.element("div").classes("hf-scroll"):
        content = f'<table class="hf-table"><thead>{cells("th", head)}</thead><tbody>{body}</tbody></table>'
        ui.html(content, sanitize=False)
