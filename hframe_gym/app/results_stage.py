"""Stage "Results": the verdict, what is left of the error, the report, and what to do next."""

from __future__ import annotations

import json
from typing import Any

from nicegui import ui

from ..identification.report import verdict_sentence
from ..identification.saved_result import next_command
from ..recordings import load_machine
from ..web_page import number
from .session import MACHINE, RESULT
from .window import Stage, State, banner, heading, table

_TITLES = {
    "effect_found": ("good", "Effects found."),
    "no_effect": ("good", "No effect is missing."),
    "unexplained": ("warning", "Unexplained."),
}


class ResultsStage(Stage):
    """Read the result of an identification."""

    key, title, action = "results", "Results", "Build the report again"
    purpose = "What the machine lacks, how much of the error is left, and how sure that is."

    def missing(self) -> tuple[str, str] | None:
        """Return that an identification must come first."""
        if self._report() is None:
            return "identify", "There is no result yet."
        return None

    def state(self) -> State:
        """Return whether there is a result."""
        return "done" if self._report() is not None else ""

    def commands(self) -> list[list[str]]:
        """Return the command that builds the report."""
        return [["report", RESULT]]

    def _report(self) -> dict[str, Any] | None:
        """Return the content of report.json; None if there is none."""
        path = self.session.path(RESULT, "report.json")
        return json.loads(path.read_text(encoding="utf-8")) if path.exists() else None

    def show(self) -> None:
        """Build the stage."""
        report = self._report()
        assert report is not None
        corrected = load_machine(self.session.path(RESULT, MACHINE))
        channels = list(corrected.output_channels)
        tone, title = _TITLES[report["verdict"]]
        banner("good" if tone == "good" else "warning", title, verdict_sentence(report, channels))
        if report["effects"]:
            heading("Effects")
            rows = []
            for effect in report["effects"]:
                values = ", ".join(_value(name, p) for name, p in effect["parameters"].items())
                rivals = ", ".join(effect.get("rivals") or []) or "none"
                rows.append((f"{effect['name'].replace('_', ' ')} at {effect['site']}", values, rivals))
            table(("effect", "parameters", "not told apart from"), rows)
        heading("Error on the held-out runs")
        held_out = ", ".join(report["runs"]["held_out"])
        ui.label(f"Simulated over the whole run from its inputs alone; held out: {held_out}.").classes("hf-muted")
        stages = ("declared", "before", "after")
        rows = []
        for channel in channels:
            rows.append((channel, *(_error(report[stage]["held_out"][channel]) for stage in stages)))
        table(("channel", "as declared", "refitted", "with effects"), rows, numbers=(1, 2, 3))
        heading("Next")
        command = next_command(report["verdict"], corrected, self.session.path(RESULT))
        if command.startswith("hframe evaluate"):
            with ui.element("div").classes("hf-row"):
                ui.label("The corrected machine can be used to compare controllers, and exported.")
                ui.button("Compare controllers", on_click=lambda: self.page.go("control")).props("unelevated")
                ui.button("Export", on_click=lambda: self.page.go("export")).props("outline")
        else:
            ui.label("The report says on what the rest of the error depends and what to record next.")
        heading("Report")
        address = f"/session/{RESULT}/report.html"
        if self.session.path(RESULT, "report.html").exists():
            with ui.element("div").classes("hf-row"):
                ui.link("Open the report in a tab of its own", address, new_tab=True)
                ui.label("One file that opens anywhere; send it to whoever must believe it.").classes("hf-muted")
            stamp = self.session.path(RESULT, "report.html").stat().st_mtime_ns
            frame = ui.element("iframe").classes("hf-report")
            frame.props(f'src="{address}?{stamp}" title="Report of the identification" loading=lazy')
        self.command_box()


def _value(name: str, parameter: dict[str, Any]) -> str:
    """Return a parameter with its deviation and unit."""
    deviation = parameter.get("std")
    spread = f" ± {number(deviation)}" if deviation is not None else ""
    return f"{name} = {number(parameter['value'])}{spread} {parameter.get('unit') or ''}".rstrip()


def _error(entry: dict[str, Any]) -> str:
    """Return an error as a multiple of the noise and in the channel's unit."""
    if entry["rmse"] is None:
        return "diverges"
    return f"{number(entry['rmse'])} ({number(entry['noise_ratio'])} x noise)"
