"""Stage "Check": what is wrong with the runs or doubtful, each finding beside the curve that shows it."""

from __future__ import annotations

import html
import json
from typing import Any

from nicegui import ui

from ..data_validation import Finding, group_findings
from ..errors import InputError
from ..machine import Machine
from ..recordings import run_name
from .charts import curves_chart, height_of
from .log_columns import Curve, run_curves
from .session import FINDINGS, check_command
from .stage import Stage, State, banner, heading, table

_TONES = {"fault": ("warning", "Fault"), "advice": ("neutral", "Advice"), "note": ("good", "Note")}
_MOST_CHARTS = 12  # findings that are drawn at once; the others on request


class CheckStage(Stage):
    """Check the runs before anything is fitted."""

    key, title, action = "check", "Check", "Check the runs"
    purpose = (
        "Before a fit: clock, sensors, wiring, excitation, and which parameters these runs can determine. A fault "
        "makes a fit meaningless; advice is worth a look."
    )

    def __init__(self, page: Any) -> None:
        """Create the stage."""
        super().__init__(page)
        self._run = ""

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
        findings = self._findings()
        machine = self.session.machine
        if findings is None or machine is None:
            return
        groups = group_findings(findings)
        faults = sum(finding.severity == "fault" for finding in groups)
        if faults:
            text = "Correct what they name, in the logs or in the choices of the stage Logs, and check again."
            banner("warning", f"{faults} fault{'s' if faults > 1 else ''}.", text)
        else:
            banner("good", "No faults.", "The runs can be fitted.")
        order = list(_TONES)
        serious = sorted((f for f in groups if f.severity != "note"), key=lambda f: order.index(f.severity))
        for k, finding in enumerate(serious):
            self._show_finding(finding, machine, draw=k < _MOST_CHARTS)
        notes = [finding for finding in groups if finding.severity == "note"]
        if notes:
            heading("Properties of the runs")
            table(("run", "of", "note"), [(note.run or "all", note.channel, note.message) for note in notes])
        heading("The runs")
        self._show_run(machine)

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
                self._chart(run_curves(paths[self._run], machine))

        draw()
        choice.on_value_change(lambda _: draw())

    def _show_finding(self, finding: Finding, machine: Machine, *, draw: bool) -> None:
        """Show a finding and the curves of the run and channel that it names."""
        tone, word = _TONES[finding.severity]
        subject = ", ".join(filter(None, (finding.run, finding.channel)))
        with ui.element("article").classes(f"hf-finding hf-{tone}"):
            title = f"<b>{word}</b> {html.escape(subject)}"
            ui.html(f"{title}<br>{html.escape(finding.message)}", sanitize=False)
            curves = self._curves(finding, machine) if draw else []
            if curves:
                self._chart(curves)

    def _curves(self, finding: Finding, machine: Machine) -> list[Curve]:
        """Return the curves that show a finding: its channel in its run, with the inputs for a wrong wiring."""
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
            return []
        try:
            curves = run_curves(run, machine)
        except InputError:
            return []
        outputs = set(named) & set(machine.output_channels)
        wanted = set(named) | (set(machine.input_channels) if outputs else set())
        return [Curve(c.name, run_name(run), c.time, c.values, c.held) for c in curves if c.name in wanted]

    def _chart(self, curves: list[Curve]) -> None:
        """Draw curves."""
        options: dict[str, Any] = curves_chart(curves, dark=self.page.dark, x_name="time, s", used=[True] * len(curves))
        names = ", ".join(curve.name for curve in curves)
        chart = ui.echart(options).classes("w-full").style(f"height: {height_of(len(curves)) - 24}px")
        chart.props(f'role=img aria-label="Curves of {html.escape(names)}"')
