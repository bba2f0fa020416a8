"""Stage "Export": take the machine or a controller to other tools."""

from __future__ import annotations

import dataclasses
import html
import inspect
from pathlib import Path
from typing import Any
from urllib.parse import quote

from nicegui import ui
from typing_extensions import override

from ...exporters import EXPORTERS
from ...exporters.base import ARGUMENT, HELP
from ...help_texts import with_choices
from ..elements import heading
from ..page import Page, Stage, State
from ..session import EXPORTS, export_command


class ExportStage(Stage):
    """Write the machine, corrected where it was identified, or a controller, in another tool's format."""

    key, title, action = "export", "Export", "Export"
    purpose = (
        "Files for other tools. Each file states the machine, the version of this program and the units."
    )

    def __init__(self, page: Page) -> None:
        super().__init__(page)
        self._kind = "c"
        self._options: dict[str, str] = {}
        self._arguments = ""

    @override
    def missing(self) -> tuple[str, str] | None:
        """Ask for the stage "machine" if the session has no machine; else return None."""
        return None if self.session.machine is not None else ("machine", "There is no machine yet.")

    @override
    def state(self) -> State:
        """Return "done" if the session has exported files, else ""."""
        return "done" if self._files() else ""

    def _files(self) -> list[Path]:
        """Return the exported files."""
        folder = self.session.path(EXPORTS)
        return sorted(path for path in folder.rglob("*") if path.is_file()) if folder.is_dir() else []

    @override
    def commands(self) -> list[list[str]]:
        """Return the command that exports, without a machine for kinds that take none, such as a policy."""
        exporter = EXPORTERS.get(self._kind)
        takes_machine = "machine" in {f.name for f in dataclasses.fields(exporter)}
        machine = self.session.corrected if takes_machine else None
        return [export_command(self._kind, machine, self._options, self._arguments.split())]

    @override
    def show(self) -> None:
        """Show the kinds of export with their options, and the exported files."""
        kinds = {name: f"{name}: {_summary(EXPORTERS.get(name))}" for name in EXPORTERS}
        kind = ui.select(kinds, value=self._kind, label="kind", on_change=lambda e: self._choose(e.value))
        kind.props("dense outlined options-dense data-kind").classes("w-full")
        exporter = EXPORTERS.get(self._kind)
        with ui.element("div").classes("hf-fields"):
            for field in dataclasses.fields(exporter):
                if field.name == "machine":
                    continue
                text = html.escape(with_choices(field.metadata[HELP]))
                if field.metadata[ARGUMENT]:
                    argument = ui.input(field.name, value=self._arguments)
                    argument.props(f'dense outlined stack-label hint="{text}"')
                    self.keep(argument, "_arguments", lambda typed: typed or "")
                elif isinstance(field.default, bool):
                    switch = ui.checkbox(field.name, value=field.name in self._options)
                    switch.props(f'title="{text}"')
                    switch.on_value_change(
                        lambda e, name=field.name: self._set_option(name, "" if e.value else None)
                    )
                else:
                    default = "" if field.default is None else str(field.default)
                    value = self._options.get(field.name, "")
                    entry = ui.input(field.name, value=value, placeholder=default)
                    entry.props(f'dense outlined stack-label hint="{text}"')
                    entry.on_value_change(
                        lambda e, name=field.name: self._set_option(name, (e.value or "").strip() or None)
                    )
        self.command_box()
        with ui.expansion("What this export writes").classes("w-full"):
            ui.html(
                f"<pre class='hf-output'>{html.escape(inspect.getdoc(exporter) or '')}</pre>", sanitize=False
            )
        files = self._files()
        if files:
            heading("Exported")
            with ui.element("ul").classes("hf-list"):
                for path in files:
                    name = path.relative_to(self.session.folder).as_posix()
                    with ui.element("li"):
                        ui.link(name, f"/session/{quote(name)}").props(f'download="{path.name}"')
                        ui.label(f"{path.stat().st_size / 1000:.1f} kB").classes("hf-muted")

    def _choose(self, kind: str) -> None:
        """Choose the kind of export, which has other options."""
        self._kind, self._options, self._arguments = kind, {}, ""
        self.refresh()

    def _set_option(self, name: str, value: str | None) -> None:
        """Set an option of the command: "" if it takes no value, None to remove it."""
        self._options.pop(name, None)
        if value is not None:
            self._options[name] = value
        self.update_command()


def _summary(exporter: Any) -> str:
    """Return the first line of an exporter's description."""
    return (inspect.getdoc(exporter) or "").partition("\n")[0].rstrip(".")
