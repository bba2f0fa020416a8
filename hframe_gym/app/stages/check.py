"""Stage "Check": what is wrong with the runs or doubtful, each finding beside the curve that shows it."""

from __future__ import annotations

import dataclasses
import html
import json
from pathlib import Path
from typing import Any, NamedTuple

from nicegui import run, ui
from typing_extensions import override

from ...data_validation import Finding, group_findings
from ...errors import InputError
from ...machine import Machine
from ...recordings import run_name
from ..charts import curves_chart
from ..elements import banner, heading, redraw, show_curves, table
from ..log_columns import Curve, run_curves, simulated_outputs
from ..page import Page, Stage, State
from ..session import FINDINGS, check_command

_TONES = {"fault": ("warning", "Fault"), "advice": ("neutral", "Advice"), "note": ("good", "Note")}
_LEGEND = "Blue: measured. Orange: simulated from the inputs with the machine as declared."
_MOST_CHARTS = 12  # findings that are drawn at once; the others on request


class _Wanted(NamedTuple):
    """Curves that are to be drawn: where, of which run, and which channels."""

    place: Any
    path: Path
    channels: set[str]


class CheckStage(Stage):
    """Check the runs before anything is fitted."""

    key, title, action = "check", "Check", "Check the runs"
    expected_codes = (0, 1)  # 1: there are faults, which the stage shows
    purpose = (
        "Before a fit: clock, sensors, wiring, excitation, and which parameters these runs can determine. "
        "A fault makes a fit meaningless; advice is worth a look."
    )

    def __init__(self, page: Page) -> None:
        super().__init__(page)
        self._run = ""
        self._wanted: list[_Wanted] = []

    @override
    def missing(self) -> tuple[str, str] | None:
        """Ask for the stage "logs" if the session has no runs; else return None."""
        return None if self.session.runs else ("logs", "There are no runs yet.")

    @override
    def state(self) -> State:
        """Return "problem" if the last check has found a fault, "done" if it has not, "" without a check."""
        findings = self._findings()
        if findings is None:
            return ""
        return "problem" if any(finding.severity == "fault" for finding in findings) else "done"

    @override
    def commands(self) -> list[list[str]]:
        """Return the command that checks the runs."""
        return [check_command()]

    def _findings(self) -> list[Finding] | None:
        """Return the findings of the last check; None before the first one."""
        path = self.session.path(FINDINGS)
        if not path.exists():
            return None
        return [Finding(**entry) for entry in json.loads(path.read_text(encoding="utf-8"))["findings"]]

    @override
    def show(self) -> None:
        """Show the findings of the last check and the curves of one run."""
        self.command_box()
        self._wanted = []
        findings = self._findings()
        machine = self.session.machine
        if findings is None or machine is None:
            return
        groups = group_findings(findings)
        faults = sum(finding.severity == "fault" for finding in groups)
        if faults:
            text = (
                "Correct what they name, in the logs or in the stage Logs (a wrong sign by the factor -1); "
                "check again."
            )
            banner("warning", f"{faults} fault{'s' if faults > 1 else ''}.", text)
        else:
            banner("good", "No faults.", "The runs can be fitted.")
        order = list(_TONES)
        serious = sorted((f for f in groups if f.severity != "note"), key=lambda f: order.index(f.severity))
        if serious:
            ui.label(_LEGEND).classes("hf-muted")
        for k, finding in enumerate(serious):
            self._show_finding(finding, machine, draw=k < _MOST_CHARTS)
        notes = [finding for finding in groups if finding.severity == "note"]
        if notes:
            heading("Properties of the runs")
            named = any(note.run for note in notes)  # otherwise all are about all runs
            rows = [(*([note.run or "all"] if named else []), note.channel, note.message) for note in notes]
            table((*(["run"] if named else []), "of", "note"), rows)
        heading("The runs")
        ui.label(_LEGEND).classes("hf-muted")
        self._show_run(machine)
        ui.timer(0.1, self._draw, once=True)

    def _show_run(self, machine: Machine) -> None:
        """Show all channels of a run that the user chooses."""
        paths = {run_name(path): path for path in self.session.runs}
        self._run = self._run if self._run in paths else next(iter(paths))
        choice = ui.select(list(paths), value=self._run, label="run")
        choice.props("dense outlined options-dense").style("max-width: 22rem; width: 100%")
        place = ui.element("div").classes("hf-chart")
        channels = {*machine.input_channels, *machine.output_channels}
        self._wanted.append(_Wanted(place, paths[self._run], channels))

        async def choose() -> None:
            self._run = choice.value
            place.clear()
            self._wanted.append(_Wanted(place, paths[self._run], channels))
            await self._draw()

        choice.on_value_change(choose)

    def _show_finding(self, finding: Finding, machine: Machine, *, draw: bool) -> None:
        """Show a finding and, below it, the curves of the run and channel that it names."""
        tone, word = _TONES[finding.severity]
        subject = ", ".join(filter(None, (finding.run, finding.channel)))
        with ui.element("article").classes(f"hf-finding hf-{tone}"):
            title = f"<b>{word}</b> {html.escape(subject)}"
            ui.html(f"{title}<br>{html.escape(finding.message)}", sanitize=False)
            shown_by = self._shown_by(finding, machine) if draw else None
            if shown_by is not None:
                self._wanted.append(_Wanted(ui.element("div").classes("hf-chart"), *shown_by))

    def _shown_by(self, finding: Finding, machine: Machine) -> tuple[Path, set[str]] | None:
        """Return the run and channels that show a finding, an output together with the inputs, or None."""
        by_name = {run_name(path): path for path in self.session.runs}
        path = by_name.get(finding.run.split(" and ")[0].split(",")[0].strip())
        coordinate = {sensor.channel: sensor.coordinate for sensor in machine.sensors}
        coordinate |= {c: d.coordinate for c, d in zip(machine.input_channels, machine.drives, strict=True)}
        words = {word.strip(".,:;()") for word in finding.message.split()}
        named = {c for c in coordinate if c == finding.channel or c in words}
        named = named or {c for c, name in coordinate.items() if name == finding.channel}
        if not named or not by_name:
            return None
        inputs = set(machine.input_channels) if named & set(machine.output_channels) else set()
        return path or next(iter(by_name.values())), named | inputs

    async def _draw(self) -> None:
        """Draw the curves that are wanted, then add to them what the declared machine would have measured."""
        machine = self.session.machine
        wanted, self._wanted = self._wanted, []
        if machine is None:
            return
        drawn: list[tuple[Any, Path, list[Curve]]] = []
        for place, path, channels in wanted:
            try:
                all_curves = await run.io_bound(run_curves, path, machine) if path.exists() else None
            except InputError as error:
                all_curves = None
                self._warn(place, str(error))
            if all_curves is not None and not place.is_deleted:
                curves = [curve for curve in all_curves if curve.name in channels]
                with place:
                    words = f"Curves of {', '.join(curve.name for curve in curves)}"
                    drawn.append((show_curves(curves, words, self.page.dark), path, curves))
        for chart, path, curves in drawn:
            simulated = await run.io_bound(simulated_outputs, path, machine) if path.exists() else None
            if not simulated or chart.is_deleted:
                continue
            both = [
                dataclasses.replace(c, others={"declared machine": simulated[c.name]})
                if c.name in simulated
                else c
                for c in curves
            ]
            redraw(chart, curves_chart(both, dark=self.page.dark))

    @staticmethod
    def _warn(place: Any, text: str) -> None:
        """Say in a place why there are no curves."""
        if not place.is_deleted:
            with place:
                banner("warning", "", text)
