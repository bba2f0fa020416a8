"""Stage "Results": the verdict, what to do next, and the report."""

from __future__ import annotations

from nicegui import ui
from typing_extensions import override

from ...identification.report.content.saved_result import read_report
from ...identification.report.words.instructions import next_command
from ...identification.report.words.remainder import tone_of_remainder
from ...identification.report.words.verdict import verdict_in_words
from ...recordings import load_machine
from ..elements import banner, heading
from ..page import Stage, State
from ..session import MACHINE, RESULT

_TITLES = {
    "effect_found": "Effects found.",
    "no_effect": "No missing effect found.",
    "unexplained": "Unexplained.",
}
# The report is a page; its frame grows with it, so that there is one bar for scrolling.
_FRAME = """<iframe class="hf-report" src="{address}" title="Report of the identification" onload="
  const page = this.contentDocument.documentElement;
  const grow = () => {{ this.style.height = page.scrollHeight + 8 + 'px' }};
  grow(); new ResizeObserver(grow).observe(this.contentDocument.body);"></iframe>"""


class ResultsStage(Stage):
    """Read the result of an identification."""

    key, title, action = "results", "Results", "Build the report again"
    purpose = "What the machine lacks, how much of the error is left, and how sure that is."

    @override
    def missing(self) -> tuple[str, str] | None:
        """Ask for the stage "identify" if there is no result yet; else return None."""
        return None if self.state() else ("identify", "There is no result yet.")

    @override
    def state(self) -> State:
        """Return "done" if the session has the result of an identification, else ""."""
        return "done" if self.session.path(RESULT, "report.json").exists() else ""

    @override
    def commands(self) -> list[list[str]]:
        """Return the command that builds the report of the result again."""
        return [["report", RESULT]]

    @override
    def show(self) -> None:
        """Show the report of the identification, or the verdict if it was not built, and the next steps."""
        report = read_report(self.session.path(RESULT))
        corrected = load_machine(self.session.path(RESULT, MACHINE))
        page = self.session.path(RESULT, "report.html")
        if not page.exists():
            banner(tone_of_remainder(report), _TITLES[report.verdict], verdict_in_words(report))
        with ui.element("div").classes("hf-row"):
            command = next_command(report.verdict, corrected, self.session.path(RESULT))
            if command.startswith("hframe evaluate"):
                ui.button("Compare controllers", on_click=lambda: self.page.go("control")).props(
                    "unelevated color=accent"
                )
                ui.button("Export the machine", on_click=lambda: self.page.go("export")).props("outline")
            if page.exists():
                ui.link("Open the report in another tab", f"/session/{RESULT}/report.html", new_tab=True)
        if page.exists():
            ui.label(
                "The report is one file that opens anywhere: result/report.html in the session."
            ).classes("hf-muted")
            address = f"/session/{RESULT}/report.html?{page.stat().st_mtime_ns}"
            ui.html(_FRAME.format(address=address), sanitize=False).classes("w-full")
        heading("Command")
        self.command_box()

    @override
    def _next(self) -> None:
        """Show no second way to the next stage."""
