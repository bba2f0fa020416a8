"""Stage "Machine": choose a template or machine.json, see it drawn, and judge if its values are plausible."""

from __future__ import annotations

from typing import Any

from nicegui import events, ui
from nicegui.element import Element
from typing_extensions import override

from ...dynamics import belt_modes
from ...errors import InputError
from ...identification.report.units import readable_unit
from ...machine import Machine, motion_limits, written_unit
from ...recordings import TEMPLATES, TemplateQuestion, implausible_values, template_questions
from ...web_page import number
from ..elements import banner, heading, table
from ..page import Page, Stage, State
from ..session import CONTROL, EXPORTS, FINDINGS, MACHINE, RESULT, RUNS, new_machine_command
from ..stage_drawing import drawing_of

_MODES = 3  # natural frequencies that the table lists
_OF_MACHINE = (RUNS, FINDINGS, RESULT, CONTROL, EXPORTS)  # what belongs to one machine


class StageView(Element, component="stage_view.js"):
    """Plan view of a machine; with motions, it shows them."""

    def __init__(self, drawing: dict[str, Any], motions: list[dict[str, Any]] | None = None) -> None:
        """Create the view of shapes, from `drawing_of`, and of the motions of named controllers."""
        super().__init__()
        self._props["drawing"], self._props["motions"] = drawing, motions or []


class MachineStage(Stage):
    """Choose and judge the machine."""

    key, title, action = "machine", "Machine", "Create this machine"
    purpose = (
        "Describe the machine as its data sheets do. Identification corrects the values; "
        "it needs the right structure and the right order of magnitude."
    )

    def __init__(self, page: Page) -> None:
        super().__init__(page)
        self._like = "hframe"
        self._values: dict[str, str | bool | list[str]] = {}

    @override
    def state(self) -> State:
        """Return "done" if the session has a machine, "problem" if its file is faulty, else ""."""
        try:
            return "done" if self.session.machine is not None else ""
        except InputError:
            return "problem"

    @override
    def commands(self) -> list[list[str]]:
        """Return the commands that move what belongs to the machine aside and write a new one."""
        return [*self.session.aside_command(*_OF_MACHINE), new_machine_command(self._like, self._values)]

    @override
    def show(self) -> None:
        """Show the questions about a new machine, and the present one with what it can do."""
        try:
            machine = self.session.machine
        except InputError as error:
            banner("warning", "machine.json is faulty.", str(error))
            machine = None
        if machine is not None:
            _show_machine(machine)
        heading("Another machine" if machine is not None else "Your machine")
        kinds = {name: template.title for name, template in TEMPLATES.items()}
        with ui.element("div").classes("hf-row"):
            kind = ui.radio(kinds, value=self._like, on_change=lambda event: self._choose(event.value))
            kind.props('inline aria-label="Kind of machine"')
        with ui.element("div").classes("hf-fields"):
            for question in template_questions(self._like):
                self._field(question)
        self.command_box()
        with ui.expansion("Use a machine.json that you have").classes("w-full"):
            upload = ui.upload(label="Drop a machine.json here, or choose it with +", auto_upload=True)
            upload.on_upload(self._uploaded).props('accept=".json" flat')

    def _field(self, question: TemplateQuestion) -> None:
        """Build the field of an option of `hframe machines new`; the template's value is no option."""
        option, text = question.option.replace("_", "-"), question.text
        default: Any = [] if question.several else question.default
        value: Any = self._values.get(option, default)
        field: Any
        if question.choices:
            field = ui.select(dict(question.choices), value=value, multiple=question.several, label=text)
            field.props("dense outlined options-dense stack-label" + " use-chips" * question.several)
        elif isinstance(default, bool):
            field = ui.checkbox(text, value=value)
        else:
            given = value if option in self._values else ""
            field = ui.input(text, value=given, placeholder=str(default))
            field.props("dense outlined stack-label")
        field.props(f'data-option="{option}"').classes("w-full")

        def store(event: events.ValueChangeEventArguments[Any]) -> None:
            if event.value in (None, "", default):
                self._values.pop(option, None)
            else:
                self._values[option] = event.value
            self.update_command()

        field.on_value_change(store)

    def _choose(self, like: str) -> None:
        """Choose a template."""
        self._like, self._values = like, {}
        self.refresh()

    async def _uploaded(self, event: events.UploadEventArguments) -> None:
        """Take over a machine.json."""
        content = await event.file.read()
        aside = self.session.aside_command(*_OF_MACHINE)
        try:
            machine = self.session.use_machine(content)
        except InputError as error:
            ui.notify(str(error), type="negative", multi_line=True, timeout=15000)
            return
        for words in aside:
            self.session.set_aside(*words[1:])
        ui.notify(f"{machine.name} is the machine of this session", type="positive")
        self.page.changed()


def _show_machine(machine: Machine) -> None:
    """Show a machine: its plan view, what it can do, and what is doubtful."""
    doubts = implausible_values(machine)
    with ui.element("div").classes("hf-two"):
        drawing = drawing_of(machine)
        with ui.element("div"):
            if drawing is not None:
                StageView(drawing)
            else:
                ui.label("This machine has no tool that moves in a plane, so it is not drawn.").classes(
                    "hf-muted"
                )
        with ui.element("div"):
            ui.html(f"<b>{machine.name}</b>", sanitize=True)
            ui.label(
                "Compare with what you know. A value ten or a thousand times off shows a wrong unit."
            ).classes("hf-muted")
            limits, others = plausibility(machine)
            if limits:
                axes = list(motion_limits(machine))
                head = ["at rated voltage", *(f"along {name}" for name in axes), "unit"]
                table(head, limits, numbers=range(1, len(axes) + 1))
            table(("", "value", "unit"), others, numbers=(1,))
    for field, doubt in doubts:
        banner("warning", field, doubt)
    with ui.expansion(f"All values ({MACHINE})").classes("w-full"):
        table(("parameter", "value", "unit"), parameter_rows(machine), numbers=(1,))


def plausibility(machine: Machine) -> tuple[list[list[str]], list[tuple[str, str, str]]]:
    """Compute what a machine can do, for comparison with what the user knows of it.

    Returns:
        Limits of the motion, one row for each with the values along each axis and the unit; then rows of
        quantity, value and unit: vibrations on the belts, noise and resolution of the sensors.
    """
    moves = [(machine.coordinate(name), limit) for name, limit in motion_limits(machine).items()]
    limits = []
    if moves:
        units = {c.unit("speed") for c, _ in moves}
        speed = "/".join(sorted(units))
        limits = [
            ["moved mass, with the rotors", *(number(m.inertia) for _, m in moves), moves[0][0].unit("mass")],
            ["force at rest", *(number(m.force) for _, m in moves), moves[0][0].unit("force")],
            ["acceleration", *(number(m.force / m.inertia) for _, m in moves), speed.replace("/s", "/s²")],
            ["top speed", *(number(m.speed) for _, m in moves), speed],
        ]
    modes = belt_modes(machine)[:_MODES]
    others = [(f"vibration {k} on the belts", number(f), "Hz") for k, f in enumerate(modes, start=1)]
    for sensor in machine.sensors:
        for name in ("noise", "resolution"):
            if value := getattr(sensor, name, 0.0):
                factor, unit = readable_unit(sensor.channel, value)
                others.append((f"{name} of {sensor.channel}", number(factor * value), unit))
    return limits, others


def parameter_rows(machine: Machine) -> list[tuple[str, str, str]]:
    """List the parameters of a machine: name, value (with standard deviation if identified) and unit."""
    known = machine.uncertainty
    deviations = (
        {} if known is None else dict(zip(known.names, known.covariance.diagonal() ** 0.5, strict=True))
    )
    rows = []
    for name, value in machine.parameters.items():
        deviation = f" ± {number(float(deviations[name]))}" if name in deviations else ""
        rows.append((name, f"{value:.6g}{deviation}", written_unit(machine.unit(name))))
    return rows
