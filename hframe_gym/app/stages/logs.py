"""Stage "Logs": drop logs, see what each column is taken for, choose columns and units, cut runs, import."""

from __future__ import annotations

import dataclasses
import html
from pathlib import Path
from typing import Any

from nicegui import events, run, ui
from typing_extensions import override

from ...errors import InputError
from ...machine import Machine
from ...recordings import (
    NOT_MEASURED,
    TIME,
    Interval,
    MappingOptions,
    ProposedColumns,
    accepted_units,
    parse_factor,
    propose_columns,
    run_of,
)
from ..elements import banner, heading, table
from ..log_chart import LogChart
from ..log_columns import LogView, open_log, run_size, view_log
from ..page import Page, Stage, State
from ..session import CONTROL, EXPORTS, FINDINGS, RESULT, RUNS, ImportChoices, import_command

_RATE = "rate"
_AS_LOGGED = ""
_MOST_RUNS = 200  # rows of the table of runs
_SPLITS = {
    "": "one run per log",
    "rests": "cut where the machine rests",
    "every": "cut into equal parts",
    "cuts": "keep the intervals that I select",
}


class LogsStage(Stage):
    """Take in logs and import them as runs."""

    key, title, action = "logs", "Logs", "Import these runs"
    purpose = (
        "Drop the logs of the controller or data logger as they are: any separator, decimal mark and unit. "
        "Each column is drawn with what it is taken for; correct what is wrong, then import."
    )

    def __init__(self, page: Page) -> None:
        super().__init__(page)
        self._choices = ImportChoices()
        self._split = ""
        self._seconds = {"rests": 0.5, "every": 10.0}
        self._rate = "1000Hz"
        self._chosen: set[str] = set()  # channels that the user has set
        self._shown = ""  # name of the log that is drawn
        self._view: LogView | None = None
        self._chart: LogChart | None = None
        self._notes: dict[str, Any] = {}
        self._units: dict[str, Any] = {}
        self._problem: Any = None
        self._cuts: Any = None
        self._span: tuple[Any, Any] | None = None

    @override
    def missing(self) -> tuple[str, str] | None:
        """Ask for the stage "machine" if the session has no machine; else return None."""
        if self.session.machine is None:
            return "machine", "Logs are read for a machine: its channels say what the columns can be."
        return None

    @override
    def state(self) -> State:
        """Return "done" if the session has runs, else ""."""
        return "done" if self.session.runs else ""

    @override
    def commands(self) -> list[list[str]]:
        """Return the commands that move earlier runs and results aside and import the logs."""
        aside = self.session.aside_command(RUNS, FINDINGS, RESULT, CONTROL, EXPORTS)
        chosen = dataclasses.replace(
            self._choices,
            split="" if self._split == "cuts" else self._split,
            seconds=self._seconds.get(self._split, 0.5),
            intervals=self._choices.intervals if self._split == "cuts" else [],
        )
        return [*aside, import_command(chosen)]

    @override
    def show(self) -> None:
        """Show the logs, the columns of one of them with what they are taken for, and how they are cut."""
        upload = ui.upload(
            label="Drop logs here, or choose them with +",
            multiple=True,
            auto_upload=True,
            on_multi_upload=self._uploaded,
        )
        upload.props("flat")
        logs = self.session.logs
        if not logs:
            return
        self._list(logs)
        if self._shown not in [path.name for path in logs]:
            self._shown = logs[0].name
        machine = self.session.machine
        assert machine is not None
        try:
            first = open_log(self._path())
            proposals = propose_columns(first, machine)
        except (InputError, OSError) as error:
            banner("warning", self._shown, str(error))
            return
        self._propose(proposals)
        heading("What the columns are")
        self._mapping(machine, [column.header for column in first.columns], proposals)
        self._problem = ui.element("div").classes("w-full")
        heading("The columns of the log")
        if len(logs) > 1:
            names = [path.name for path in logs]
            choice = ui.select(names, value=self._shown, label="log", on_change=lambda e: self._draw(e.value))
            choice.props("dense outlined options-dense").style("max-width: 22rem")
        self._chart = LogChart(self.page.dark, self._selected)
        heading("Runs")
        self._cutting()
        self.command_box()
        self._runs_table(machine)
        ui.timer(0.05, self._update, once=True)

    def _path(self) -> Path:
        """Return the file of the log that is drawn."""
        return next(path for path in self.session.logs if path.name == self._shown)

    def _run_name(self) -> str:
        """Return the name of the run that the log which is drawn becomes, before it is cut."""
        return "" if self._view is None else run_of(self._view.log)

    def _list(self, logs: list[Path]) -> None:
        """List the logs, each with a button that removes it."""
        with ui.element("ul").classes("hf-list"):
            for path in logs:
                with ui.element("li"):
                    ui.label(path.name)
                    ui.label(f"{path.stat().st_size / 1e6:.2f} MB").classes("hf-muted")
                    remove = ui.button("Remove", on_click=lambda path=path: self._remove(path))
                    remove.props(f'flat dense aria-label="Remove {html.escape(path.name)}"')

    def _remove(self, path: Path) -> None:
        """Remove a log."""
        self.session.remove_log(path)
        self.page.changed()

    async def _uploaded(self, event: events.MultiUploadEventArguments) -> None:
        """Store logs."""
        for file in event.files:
            try:
                await file.save(self.session.log_path(file.name))
            except InputError as error:
                ui.notify(str(error), type="negative")
        self.page.changed()

    def _propose(self, proposals: ProposedColumns) -> None:
        """Choose the columns that are likely, for the channels that the user has not set."""
        for channel, header in proposals.proposed.items():
            if channel not in self._chosen:
                self._choices.columns[channel] = header

    def _mapping(self, machine: Machine, headers: list[str], proposals: ProposedColumns) -> None:
        """Build the menus of each channel: column, unit, factor."""
        self._notes, self._units = {}, {}
        with ui.element("div").classes("hf-map"):
            for channel in (TIME, *machine.input_channels, *machine.output_channels):
                chosen = self._choices.columns.get(channel) or proposals.named.get(channel)
                menu = {header: header for header in headers}
                if channel in machine.output_channels:
                    menu[NOT_MEASURED] = "not measured"
                if channel == TIME:
                    menu[_RATE] = "no column: constant rate"
                    chosen = _RATE if chosen is not None and chosen not in headers else chosen
                ui.html(f"<b>{html.escape(channel)}</b>", sanitize=False)
                column = ui.select(menu, value=chosen, label="column", with_input=len(menu) > 12)
                column.props(f'dense outlined options-dense data-channel="{channel}"').classes("hf-column")
                column.on_value_change(lambda e, c=channel: self._set_column(c, e.value))
                units = {
                    _AS_LOGGED: "as in the log",
                    **{unit: unit for unit in accepted_units(machine, channel)},
                }
                unit = ui.select(units, value=self._choices.units.get(channel, _AS_LOGGED), label="unit")
                unit.props(f'dense outlined options-dense data-unit="{channel}"')
                unit.on_value_change(lambda e, c=channel: self._set_unit(c, e.value))
                self._units[channel] = unit
                if channel == TIME:
                    rate = ui.input("rate", value=self._rate).props("dense outlined")
                    rate.on_value_change(lambda e: self._set_rate(e.value or ""))
                    rate.bind_visibility_from(column, "value", lambda value: value == _RATE)
                    spare = ui.element("span")
                    spare.bind_visibility_from(column, "value", lambda value: value != _RATE)
                else:
                    factor = ui.input("factor", value=self._choices.scales.get(channel, ""), placeholder="1")
                    factor.props("dense outlined stack-label")
                    factor.on_value_change(lambda e, c=channel: self._set_factor(c, e.value or ""))
                self._notes[channel] = ui.label("").classes("hf-taken")

    def _set_column(self, channel: str, header: str) -> None:
        """Choose the column of a channel."""
        self._chosen.add(channel)
        self._choices.columns[channel] = self._rate if header == _RATE else header
        ui.timer(0.01, self._update, once=True)

    def _set_rate(self, rate: str) -> None:
        """Choose the sampling rate of a log without times."""
        self._rate = rate
        self._choices.columns[TIME] = rate
        ui.timer(0.01, self._update, once=True)

    def _set_unit(self, channel: str, unit: str) -> None:
        """Choose the unit of a channel."""
        self._choices.units.pop(channel, None)
        if unit:
            self._choices.units[channel] = unit
        ui.timer(0.01, self._update, once=True)

    def _set_factor(self, channel: str, factor: str) -> None:
        """Choose the factor of a channel.

        A factor alone would replace the unit of the log, so that unit is stated as well.
        """
        self._choices.scales.pop(channel, None)
        if factor.strip():
            self._choices.scales[channel] = factor.strip()
            source = next(
                (s for s in (self._view.sources if self._view else ()) if s.channel == channel), None
            )
            stated = source.column.unit if source is not None and source.column is not None else ""
            if stated in self._units[channel].options and not self._choices.units.get(channel):
                self._units[channel].set_value(stated)
        ui.timer(0.01, self._update, once=True)

    def _draw(self, name: str) -> None:
        """Draw another log."""
        self._shown = name
        ui.timer(0.01, self._update, once=True)

    async def _update(self) -> None:
        """Read the log with the present choices, and show what each column becomes."""
        self.update_command()
        machine = self.session.machine
        if machine is None or self._chart is None:
            return
        try:
            scales = {c: parse_factor(f"factor of {c}", value) for c, value in self._choices.scales.items()}
            options = MappingOptions(self._choices.columns, self._choices.units, scales)
            self._view = await run.io_bound(view_log, self._path(), machine, options)
        except (InputError, OSError) as error:
            self._view = None
            self._say(str(error))
            return
        if self._view is None or self._chart.is_deleted:
            return
        for channel, label in self._notes.items():
            source = next((s for s in self._view.sources if s.channel == channel), None)
            label.set_text(source.remark if source is not None else "")
        self._say(self._view.problem)
        self._show_chart()

    def _say(self, problem: str) -> None:
        """Show why the import would be refused, or nothing."""
        if self._problem is None or self._problem.is_deleted:
            return
        self._problem.clear()
        with self._problem:
            if problem:
                banner("warning", "Not yet complete.", problem)

    def _show_chart(self) -> None:
        """Draw the columns, and the intervals of this log that are kept."""
        if self._view is None or self._chart is None:
            return
        cutting, names = self._split == "cuts", ("", self._run_name())
        intervals = [i for i in self._choices.intervals if cutting and i.log in names]
        self._chart.draw(self._view, intervals, selectable=cutting)

    def _selected(self, begin: float, end: float) -> None:
        """Take over an interval, s, that the mouse selected."""
        if self._span is not None:
            for field, value in zip(self._span, (begin, end), strict=True):
                field.set_value(round(value, 4))
            self._add_interval()

    def _cutting(self) -> None:
        """Build the choice of how logs become runs."""
        choice = ui.radio(_SPLITS, value=self._split, on_change=lambda e: self._set_split(e.value))
        choice.props('aria-label="How logs become runs" data-split')
        if self._split in self._seconds:
            label = "shortest rest, s" if self._split == "rests" else "duration of a run, s"
            seconds = ui.number(label, value=self._seconds[self._split], min=0.01, step=0.1).props(
                "dense outlined"
            )

            def store(event: events.ValueChangeEventArguments[Any]) -> None:
                self._seconds[self._split] = float(event.value or 0.5)
                self.update_command()

            seconds.on_value_change(store)
        self._span = None
        if self._split == "cuts":
            ui.label("Drag over the curves above, or enter the times.").classes("hf-muted")
            with ui.element("div").classes("hf-row"):
                first = ui.number("from, s").props("dense outlined data-cut=from")
                last = ui.number("to, s").props("dense outlined data-cut=to")
                self._span = first, last
                ui.button("Keep this interval", on_click=self._add_interval).props("outline data-cut=add")
            self._cuts = ui.element("ul").classes("hf-list")
            self._list_cuts()

    def _set_split(self, split: str) -> None:
        """Choose how logs become runs."""
        self._split = split
        self.refresh()

    def _add_interval(self) -> None:
        """Keep an interval of the log that is drawn."""
        if self._span is None or any(field.value is None for field in self._span):
            return
        begin, end = float(self._span[0].value), float(self._span[1].value)
        if not begin < end:
            ui.notify("The end must be after the beginning", type="warning")
            return
        self._choices.intervals.append(Interval(self._run_name(), begin, end))
        self._list_cuts()
        self._show_chart()
        self.update_command()

    def _list_cuts(self) -> None:
        """List the intervals."""
        self._cuts.clear()
        with self._cuts:
            for interval in self._choices.intervals:
                with ui.element("li"):
                    ui.label(f"{interval.log}: {interval.begin:g} to {interval.end:g} s")
                    ui.button("Remove", on_click=lambda i=interval: self._drop_interval(i)).props(
                        "flat dense"
                    )

    def _drop_interval(self, interval: Interval) -> None:
        """Forget an interval."""
        self._choices.intervals.remove(interval)
        self._list_cuts()
        self._show_chart()
        self.update_command()

    def _runs_table(self, machine: Machine) -> None:
        """List the imported runs."""
        paths = self.session.runs
        if not paths:
            return
        heading("Imported")
        place = ui.element("div").classes("w-full")

        async def fill() -> None:
            rows = []
            for path in paths[:_MOST_RUNS]:
                size = await run.io_bound(run_size, path, machine) if path.exists() else None
                if size is not None:
                    count, seconds = size
                    rate = (count - 1) / max(seconds, 1e-9)
                    rows.append((path.name, f"{count}", f"{seconds:.3g}", f"{rate:.4g}"))
            if not place.is_deleted:
                with place:
                    table(("run", "rows", "duration, s", "rate, Hz"), rows, numbers=(1, 2, 3))

        ui.timer(0.1, fill, once=True)
        if len(paths) > _MOST_RUNS:
            ui.label(f"and {len(paths) - _MOST_RUNS} more").classes("hf-muted")
        if len(paths) == 1:
            banner(
                "warning",
                "One run only.",
                "Identification needs at least two, because one is held out: cut it.",
            )
