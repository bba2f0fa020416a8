"""Stage "Check": what is wrong with the runs or doubtful, each finding beside the curve that shows it."""

from __future__ import annotations

import dataclasses
import html
import json
from pathlib import Path
from typing import Any

from nicegui import run, ui

from ..data_validation import Finding, group_findings
from ..errors import InputError
from ..machine import Machine
from ..recordings import run_name
from .charts import curves_chart, height_of
from .log_columns import Curve, run_curves, simulated_outputs
from .session import FINDINGS, check_command
from .stage import Stage, State, banner, heading, table

_TONES = {"fault": ("warning", "Fault"), "advice": ("neutral", "Advice"), "note": ("good", "Note")}
_LEGEND = "Blue: measured. Orange: simulated from the inputs with the machine as declared."
_MOST_CHARTS = 12  # findings that are drawn at once; the others on request


class CheckStage(Stage):
    """Check the runs before anything is fitted."""

    key, title, action = "check", "Check", "Check the runs"
    expected_codes = (0, 1)  # 1: there are faults, which the stage shows
    purpose = (
        "Before a fit: clock, sensors, wiring, excitation, and which parameters these runs can determine. A fault "
        "makes a fit meaningless; advice is worth a look."
    )

    def __init__(self, page: Any) -> None:
        """Create the stage."""
        super().__init__(page)
        self._run = ""
        self._charts: list[tuple[Any, Path, list[Curve]]] = []

    def missing(self) -> tuple[str, str] | None:
        """Return that runs must come first."""
        return None if self.session.runs else ("logs", "There are no runs yet.")

    def state(self) -> State:
        """Return whether the runs were checked, and whether there is a fault."""
        findings = self._findings()
        if findings is None:
            return ""
        return "problem" if any(finding.severity == "fault" for finding in findings) else "done"

    def commands(self) -> list[list[str]]:
        """Return the command that checks."""
        return [check_command()]

    def _findings(self) -> list[Finding] | None:
        """Return the findings of the last check; None before the first one."""
        path = self.session.path(FINDINGS)
        if not path.exists():
            return None
        return [Finding(**entry) for entry in json.loads(path.read_text(encoding="utf-8"))["findings"]]

    def show(self) -> None:
        """Build the stage."""
        self.command_box()
        self._charts = []
        findings = self._findings()
        machine = self.session.machine
        if findings is None or machine is None:
            return
        groups = group_findings(findings)
        faults = sum(finding.severity == "fault" for finding in groups)
        if faults:
            text = (
                "Correct what they name, in the logs or in the stage Logs (a wrong sign by the factor -1); check again."
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
        ui.timer(0.1, self._simulate, once=True)

    def _show_run(self, machine: Machine) -> None:
        """Show all channels of a run that the user chooses."""
        paths = {run_name(path): path for path in self.session.runs}
        self._run = self._run if self._run in paths else next(iter(paths))
        choice = ui.select(list(paths), value=self._run, label="run")
        choice.props("dense outlined options-dense").style("max-width: 22rem; width: 100%")
        place = ui.element("div").classes("hf-chart")

        def draw() -> None:
            self._run = choice.value
            place.clear()
            with place:
                self._chart(run_curves(paths[self._run], machine), paths[self._run])

        async def choose() -> None:
            draw()
            await self._simulate()

        draw()
        choice.on_value_change(choose)

    def _show_finding(self, finding: Finding, machine: Machine, *, draw: bool) -> None:
        """Show a finding and the curves of the run and channel that it names."""
        tone, word = _TONES[finding.severity]
        subject = ", ".join(filter(None, (finding.run, finding.channel)))
        with ui.element("article").classes(f"hf-finding hf-{tone}"):
            title = f"<b>{word}</b> {html.escape(subject)}"
            ui.html(f"{title}<br>{html.escape(finding.message)}", sanitize=False)
            curves, path = self._curves(finding, machine) if draw else ([], None)
            if curves and path is not None:
                self._chart(curves, path)

    def _curves(self, finding: Finding, machine: Machine) -> tuple[list[Curve], Path | None]:
        """Return the curves that show a finding, its channel with the inputs, and the file of the run."""
        by_name = {run_name(path): path for path in self.session.runs}
        name = finding.run.split(" and ")[0].split(",")[0].strip()
        run = by_name.get(name)
        coordinate = {sensor.channel: sensor.coordinate for sensor in machine.sensors}
        coordinate |= {c: d.coordinate for c, d in zip(machine.input_channels, machine.drives, strict=True)}
        words = {word.strip(".,:;()") for word in finding.message.split()}
        named = [c for c in coordinate if c == finding.channel or c in words]
        named = named or [c for c, name in coordinate.items() if name == finding.channel]
        if run is None and named:
            run = next(iter(by_name.values()), None)
        if run is None or not named:
            return [], None
        try:
            curves = run_curves(run, machine)
        except InputError:
            return [], None
        outputs = set(named) & set(machine.output_channels)
        wanted = set(named) | (set(machine.input_channels) if outputs else set())
        return [dataclasses.replace(c, note=run_name(run)) for c in curves if c.name in wanted], run

    def _chart(self, curves: list[Curve], path: Path) -> None:
        """Draw curves of a run; `_simulate` adds what the declared machine would have measured."""
        options = curves_chart(curves, dark=self.page.dark, x_name="time, s")
        names = ", ".join(curve.name for curve in curves)
        chart = ui.echart(options).classes("w-full").style(f"height: {height_of(len(curves)) - 24}px")
        chart.props(f'role=img aria-label="Curves of {html.escape(names)}"')
        self._charts.append((chart, path, curves))

    async def _simulate(self) -> None:
        """Add to the charts what the declared machine would have measured."""
        machine = self.session.machine
        charts, self._charts = self._charts, []
        for chart, path, curves in charts:
            if machine is None or chart.is_deleted or not path.exists():
                continue
            simulated = await run.io_bound(simulated_outputs, path, machine)
            if not simulated or chart.is_deleted:
                continue
            both = [
                dataclasses.replace(c, others={"declared machine": simulated[c.name]}) if c.name in simulated else c
                for c in curves
            ]
            chart.options.clear()
            chart.options.update(curves_chart(both, dark=self.page.dark, x_name="time, s"))
            chart.update()
