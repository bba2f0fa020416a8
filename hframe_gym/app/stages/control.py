"""Stage "Control": compare controllers and agents on the corrected machine, and watch the stage move."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

import numpy as np
from nicegui import events, ui
from typing_extensions import override

from ...agents import shipped_agent_names
from ...controllers import CONTROLLERS, period_concern, shorter_period, suited_controllers
from ...envs import TASKS, EnvConfig
from ...evaluation import file_labels
from ...recordings import load_machine
from ...web_page import number
from ..charts import curves_chart
from ..elements import banner, heading, redraw, show_curves, table
from ..log_columns import Curve
from ..page import Page, Stage, State
from ..session import MACHINE, evaluate_command
from ..stage_drawing import drawing_of, read_motions
from .machine import StageView

# Of the curves, in the order of `hframe_gym.web_page.SERIES`.
_COLOR_NAMES = ("blue", "orange", "green", "purple", "ocher", "red")


class ControlStage(Stage):
    """Compare controllers."""

    key, title, action = "control", "Control", "Compare"
    purpose = (
        "All controllers get the same starts, goals and machine parameters. With the randomization "
        "identified, the parameters vary as far as the identification leaves them open."
    )

    def __init__(self, page: Page) -> None:
        super().__init__(page)
        self._controllers = ["pid", "textbook-pid"]
        self._task = "reach"
        self._period = ""
        self._episodes = 64
        self._episode = 0
        self._motions = 4

    @override
    def missing(self) -> tuple[str, str] | None:
        """Ask for the stage "machine" if the session has no machine; else return None."""
        machine = self.session.machine
        if machine is None:
            return "machine", "There is no machine yet."
        return None

    @override
    def state(self) -> State:
        """Return "done" if controllers were compared on the session's machine, else ""."""
        return "done" if self.session.path(self.session.control, "scores.json").exists() else ""

    @property
    def _randomize(self) -> str:
        """Name of the randomization: that of the identification if there is one."""
        machine = load_machine(self.session.path(self.session.corrected))
        return "identified" if machine.uncertainty is not None else "none"

    @override
    def commands(self) -> list[list[str]]:
        """Return the command that compares the chosen controllers."""
        command = evaluate_command(
            self._controllers,
            self.session.corrected,
            task=self._task,
            randomize=self._randomize,
            period=self._period,
            episodes=self._episodes,
            motions=min(self._motions, self._episodes),
        )
        return [command]

    @override
    def show(self) -> None:
        """Show the choices, the scores of the last comparison and the motion of an episode."""
        machine = load_machine(self.session.path(self.session.corrected))
        if len(machine.tool_axes) == 0:
            banner(
                "neutral",
                "",
                f"{machine.name} has no axis for each of its drives, so there are no controllers for it.",
            )
            return
        if self.session.corrected == MACHINE:
            banner("neutral", "", "No identification yet: controllers run on the machine as declared.")
        shorter = shorter_period(machine, EnvConfig.period)
        if shorter is not None and not self._period:
            self._period = f"{shorter:g}"
        with ui.element("div").classes("hf-fields"):
            agents = [name for name in shipped_agent_names() if name not in CONTROLLERS]
            suited = suited_controllers(machine)
            names = [*suited, *agents]
            self._controllers = [name for name in self._controllers if name in names] or [suited[0]]
            chosen = ui.select(names, value=self._controllers, multiple=True, label="controllers and agents")
            chosen.props("dense outlined options-dense use-chips data-controllers").classes("w-full")
            self.keep(chosen, "_controllers", lambda names: list(names or []))
            task = ui.select(list(TASKS), value=self._task, label="task")
            self.keep(task.props("dense outlined options-dense"), "_task", str)
            default = f"{EnvConfig.period:g}"
            period = ui.input("control period, s", value=self._period, placeholder=default)
            self.keep(period.props("dense outlined stack-label"), "_period", lambda text: text or "")
            episodes = ui.number("episodes", value=self._episodes, min=1, max=4096, step=1, format="%d")
            self.keep(episodes.props("dense outlined"), "_episodes", lambda count: int(count or 1))
        if concern := period_concern(machine, EnvConfig.period):
            ui.label(f"{concern[0].upper()}{concern[1:]}.").classes("hf-muted")
        self.command_box()
        if self.state() == "done":
            self._show_scores()
            self._show_motions()

    def _scores(self) -> dict[str, Any]:
        """Return the content of scores.json."""
        path = self.session.path(self.session.control, "scores.json")
        content: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        return content

    def _show_scores(self) -> None:
        """Show the scores of the controllers."""
        scores = self._scores()
        heading(f"Scores, {scores['task']}, {scores['episodes']} episodes")
        unit = load_machine(self.session.path(self.session.corrected)).axis_unit
        bands, bound = unit.bands, unit.bound_band
        head = [
            "controller",
            *(f"within {1e3 * band:g} {unit.small}" for band in bands.values()),
            f"until {1e3 * bands[bound]:g} {unit.small}, s",
            f"at the end, {unit.small}",
        ]
        rows = []
        for name, score in scores["controllers"].items():
            success = [
                f"{100 * score['success'][band]:.0f} %" if "success" in score else "" for band in bands
            ]
            settling = score.get("settling_s", {}).get(bound, {}).get("mean")
            left = score.get(f"final_error_{unit.small}", {}).get("mean")
            error = "-" if left is None else "< 0.001" if left < 1e-3 else number(left)
            rows.append([name, *success, number(settling, "-"), error])
        table(head, rows, numbers=range(1, len(head)))
        scorecard = f"{self.session.control}/scorecard.html"
        if self.session.path(scorecard).exists():
            ui.link("Open the scorecard", f"/session/{scorecard}", new_tab=True)

    def _show_motions(self) -> None:
        """Show the stage in motion, with one view for each controller."""
        machine = load_machine(self.session.path(self.session.corrected))
        drawing = drawing_of(machine)
        labels = file_labels(self._scores()["controllers"])
        paths = [self.session.path(self.session.control, f"{label}.csv") for label in labels]
        files = [path for path in paths if path.exists()]
        if drawing is None or not files:
            return
        motions = {path.stem: read_motions(path, machine) for path in files}
        count = min(len(episodes) for episodes in motions.values())
        self._episode = min(self._episode, count - 1)
        heading("The stage in motion")
        choice = ui.toggle({k: f"episode {k + 1}" for k in range(count)}, value=self._episode)
        choice.props("no-caps unelevated")
        view = StageView(drawing, _of_episode(motions, self._episode))
        inputs, small = machine.input_channels, machine.axis_unit.small
        curves = _curves(_of_episode(motions, self._episode), inputs, small)
        chart = show_curves(curves, "Distance to the goal and voltages over time", self.page.dark)

        def select(event: events.ValueChangeEventArguments[Any]) -> None:
            self._episode = int(event.value)
            view.props["motions"] = _of_episode(motions, self._episode)
            view.update()
            shown = _curves(_of_episode(motions, self._episode), inputs, small)
            redraw(chart, curves_chart(shown, dark=self.page.dark))

        choice.on_value_change(select)


def _of_episode(motions: dict[str, list[dict[str, Any]]], episode: int) -> list[dict[str, Any]]:
    """Return name and motion of each controller in an episode."""
    return [{"name": name, "motion": episodes[episode]} for name, episodes in motions.items()]


def _curves(motions: list[dict[str, Any]], inputs: Sequence[str], small: str) -> list[Curve]:
    """Return distance to the goal, mm or mrad, and voltages of the controllers of an episode, over time."""
    names = [motion["name"] for motion in motions]
    colors = ", ".join(f"{name} ({color})" for name, color in zip(names, _COLOR_NAMES, strict=False))
    longest = max(len(motion["motion"]["tool"]) for motion in motions)
    time = motions[0]["motion"]["frame_s"] * np.arange(longest)

    def padded(values: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
        return np.pad(values, (0, longest - len(values)), constant_values=np.nan)

    distances = [padded(np.array(m["motion"]["distance"])) for m in motions]
    curves = [_together(f"distance to the goal, {small}", colors, time, names, distances)]
    for k, channel in enumerate(inputs):
        volts = [padded(np.array(m["motion"]["volts"])[:, k]) for m in motions]
        curves.append(_together(channel, "", time, names, volts, held=True))
    return curves


def _together(
    name: str,
    note: str,
    time: np.ndarray[Any, Any],
    names: list[str],
    values: list[np.ndarray[Any, Any]],
    held: bool = False,
) -> Curve:
    """Return a curve with the values of all controllers."""
    return Curve(name, note, time, values[0], held, others=dict(zip(names[1:], values[1:], strict=True)))
