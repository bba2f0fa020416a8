"""Stage "Identify": fit the machine and search for the effects that its model lacks, with live progress."""

from __future__ import annotations

from typing import Any

from nicegui import ui
from typing_extensions import override

from ...recordings import run_name
from ...web_page import number
from ..charts import error_chart
from ..elements import banner, redraw
from ..jobs import Job
from ..page import Page, Stage, State
from ..session import CONTROL, EXPORTS, RESULT, identify_command

_CHECKED_FIRST = (
    "The check found a fault, which makes a fit meaningless. Correct it, or identify nevertheless."
)


class IdentifyStage(Stage):
    """Identify the machine."""

    key, title, action = "identify", "Identify", "Identify"
    purpose = (
        "Fit the machine to the runs, then search for what its model lacks: "
        "friction, delays, play and others. Some runs are held out and only judge the result. "
        "You may stop at any time; the best machine so far is tested and kept."
    )

    def __init__(self, page: Page) -> None:
        super().__init__(page)
        self._hold_out: list[str] = []
        self._budget = ""
        self._force = False
        self._live: Any = None
        self._words: Any = None
        self._bar: Any = None
        self._error: Any = None
        self._chart: Any = None
        self._drawn = 0

    @override
    def missing(self) -> tuple[str, str] | None:
        """Ask for the stage "logs" if the session has fewer than two runs; else return None."""
        if len(self.session.runs) < 2:
            return "logs", "Identification needs at least two runs, because one is held out."
        return None

    @override
    def state(self) -> State:
        """Return "done" if the session has the result of an identification, else ""."""
        return "done" if self.session.path(RESULT, "report.json").exists() else ""

    @override
    def commands(self) -> list[list[str]]:
        """Return the commands that move earlier results aside and identify the machine."""
        aside = self.session.aside_command(RESULT, CONTROL, EXPORTS)
        return [*aside, identify_command(self._hold_out, self._budget, self._force)]

    @override
    def show(self) -> None:
        """Show the choices, and the progress and error of the running or last search."""
        if self.page.stages["check"].state() == "problem":
            banner("warning", "Faults in the runs.", _CHECKED_FIRST)
        with ui.element("div").classes("hf-fields"):
            names = [run_name(path) for path in self.session.runs]
            self._hold_out = [name for name in self._hold_out if name in names]
            held = ui.select(names, value=self._hold_out, multiple=True, label="held-out runs")
            held.props('hint="default: one of four"')
            held.props("dense outlined options-dense use-chips").classes("w-full")
            self.keep(held, "_hold_out", lambda names: list(names or []))
            label = "budget, s of processor time"
            budget = ui.input(label, value=self._budget, placeholder="120")
            budget.props("dense outlined stack-label data-budget").classes("w-full")
            self.keep(budget, "_budget", lambda text: text or "")
            force = ui.checkbox("fit although the check finds faults", value=self._force)
            self.keep(force, "_force", bool)
        self.command_box()
        if self._stop is not None:
            self._stop.set_text("Stop and keep the best")
        self._live = ui.element("section").classes("w-full").props('aria-label="Progress"')
        with self._live:
            self._words = ui.label("").props("aria-live=polite")
            self._bar = ui.linear_progress(value=0.0, show_value=False).props(
                'aria-label="Part of the budget"'
            )
            self._error = ui.label("").classes("hf-muted")
            chart = ui.echart(error_chart([], 0.0, self.page.dark)).classes("w-full").style("height: 200px")
            self._chart = chart.props(
                'role=img aria-label="Error of the best machine so far over the processor time"'
            )
        self._drawn = 0
        self._show_live()

    @override
    def progressed(self, job: Job) -> None:
        """Show the output of the job, what its search does, and the error so far."""
        super().progressed(job)
        self._show_live()

    @override
    def finished(self, job: Job) -> None:
        """Point to the results if the job has ended without error and was not stopped."""
        if self.state() == "done" and not job.stopped and job.exit_code == 0:
            ui.notify("Identified; see Results", type="positive")

    def _show_live(self) -> None:
        """Show what the search does, the part of the budget that is used, and the error so far."""
        job = self.job
        if self._live is None or self._live.is_deleted:
            return
        self._live.set_visibility(job is not None and (job.running or bool(job.progress.errors)))
        if job is None:
            return
        progress = job.progress
        spent = progress.spent or 0.0
        if job.running:
            doing = progress.doing or "preparing the runs"
            words = f"{doing}; ending with what was found so far" if job.stopped else doing
            budget = f" of at most {progress.total:.0f}" if progress.total else ""
            self._words.set_text(f"{words} ({spent:.0f} s{budget})")
        else:
            self._words.set_text("")
        self._bar.set_visibility(job.running)
        self._bar.set_value(min(1.0, spent / progress.total) if progress.total else 0.0)
        if progress.errors:
            ratio = progress.errors[-1][1] ** 0.5
            self._error.set_text(
                f"Error of the best machine so far: {number(ratio)} times the sensors' noise, "
                "rms of its short predictions; the dashed line is the noise."
            )
        self._chart.set_visibility(bool(progress.errors))
        if progress.errors and (job.running or self._drawn != len(progress.errors)):
            self._drawn = len(progress.errors)
            redraw(self._chart, error_chart(progress.errors, spent, self.page.dark))
