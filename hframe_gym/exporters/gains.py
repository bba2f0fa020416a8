"""Gains of the textbook PID and of the model-based controller `pid`, as they are typed into a drive."""

from __future__ import annotations

import csv
import io
import warnings
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from typing_extensions import override

from .. import option_texts
from ..controllers import ModelBasedController, TextbookPID
from ..machine import Machine
from .base import (
    EXPORTERS,
    Files,
    MachineExporter,
    commented,
    json_text,
    operating_point,
    option,
    plain,
    require_linear_axes,
)


class Gain(NamedTuple):
    """One number of a controller.

    Attributes:
        controller: Name of the controller.
        output: Output of the gain: the force along an axis, or the voltage of a drive.
        input: Input of the gain, such as a position error.
        gain: Name of the gain.
        value: Its value, in the unit `unit`.
        unit: Unit as text.
    """

    controller: str
    output: str
    input: str
    gain: str
    value: float
    unit: str


@EXPORTERS.register("gains")
@dataclass(frozen=True, kw_only=True)
class GainsExporter(MachineExporter):
    """Write the gains of the controllers textbook-pid and pid for a control period, with their units.

    The textbook PID acts along each axis of the tool. Its gains are given as forces (parallel form), as gain,
    integral and derivative time (standard form), and in volts for each drive. For `pid` they are the constant
    state feedback that acts near the goal; far from it, `pid` plans with the saturation of the drives, which
    no table contains. The files are gains.csv and gains.json.

    Example:  hframe export gains --machine hframe --period 0.002 --out out/gains
    """

    period: float = option(0.01, option_texts.PERIOD)
    at: list[str] | None = option(None, "Goal for which the state feedback is designed, as AXIS=POSITION.")

    @override
    def files(self, machine: Machine) -> Files:
        """Write gains.csv and gains.json; warn if the textbook PID is unstable.

        Raises:
            InputError: If a tool axis is rotary, or a controller refuses the machine or the period.
        """
        require_linear_axes(machine, "the table of gains")
        textbook, feedback = TextbookPID(machine, self.period), ModelBasedController(machine, self.period)
        concern = textbook.concern()
        if concern is not None:
            warnings.warn(concern, stacklevel=2)
        rows = [*_textbook_rows(textbook), *self._feedback_rows(feedback)]
        laws = {
            "textbook-pid": "force along an axis = P e + I integral(e) - D v; e: goal minus position, v: "
            "measured velocity (for a moving goal: minus the goal's velocity); voltages = (V/N of each drive "
            "and axis) times the forces; the integrators hold while a voltage exceeds its limit",
            "pid": "voltage = sum of gain times (goal - state) over positions and velocities of all "
            "coordinates, plus the feedforward of friction (hframe export c); goal: the position at rest "
            "with unstretched belts",
        }
        header = self.header(
            machine,
            f"Control period: {self.period!r} s. Units are in the column unit; e and v refer to m and m/s",
            *(f"{name}: {law}" for name, law in laws.items()),
            *([f"Warning: {concern}"] if concern else []),
        )
        text = io.StringIO()
        table = csv.writer(text, lineterminator="\n")
        table.writerow([*Gain._fields, "period_s"])
        table.writerows(
            [*(plain(str(v)) for v in row[:4]), repr(row.value), row.unit, self.period] for row in rows
        )
        content: dict[str, Any] = {
            "provenance": self.provenance(machine),
            "period_s": self.period,
            "laws": laws,
            "warning": concern,
            "rated_voltages_V": {d.name: d.rated_voltage for d in machine.drives},
            "gains": [row._asdict() for row in rows],
        }
        return {"gains.csv": commented(header, "#") + text.getvalue(), "gains.json": json_text(content)}

    def _feedback_rows(self, controller: ModelBasedController) -> list[Gain]:
        """Return the state feedback of the shortest transfer at the operating point nearest to the goal."""
        machine, transfers = controller.machine, controller.transfers
        goal = operating_point(machine, self.at)[controller.model.tool]
        point = int(transfers.grid.nearest(goal[None])[0])
        scale = np.tile(machine.travel_per_unit, 2)
        gains = -transfers.gains[point, 0, 0] * scale  # (drives, 2 n), V per m, rad, m/s or rad/s
        rows = []
        for drive, of_drive in zip(machine.drives, gains.tolist(), strict=True):
            names = [(c.name, c.unit("position"), "position") for c in machine.coordinates]
            names += [(c.name, c.unit("speed"), "velocity") for c in machine.coordinates]
            for (name, unit, quantity), value in zip(names, of_drive, strict=True):
                unit = f"V/{unit}" if "/" not in unit else f"V/({unit})"
                rows.append(
                    Gain("pid", f"voltage of {drive.name}", f"{quantity} of {name}", "K", value, unit)
                )
        return rows


def _textbook_rows(controller: TextbookPID) -> list[Gain]:
    """Return the gains of the textbook PID in its usual forms."""
    rows = []
    model, name = controller.model, "textbook-pid"
    volts = model.voltage(np.eye(len(model.axes))).T  # V/N, (drives, axes)
    for i, axis in enumerate(model.axes):
        P, I, D = (float(g[i]) for g in (controller.proportional, controller.integral, controller.derivative))  # noqa: E741
        forms = [("P", P, "N/m"), ("I", I, "N/(m s)"), ("D", D, "Ns/m")]
        forms += [
            ("Ti = P/I", P / I, "s"),
            ("Td = D/P", D / P, "s"),
            ("I times period", I * controller.period, "N/m"),
        ]
        rows += [
            Gain(name, f"force along {axis}", f"error of {axis}", key, value, unit)
            for key, value, unit in forms
        ]
        for drive, per_force in zip(controller.machine.drives, volts[:, i].tolist(), strict=True):
            output = f"voltage of {drive.name}"
            rows.append(Gain(name, output, f"force along {axis}", "V/N", per_force, "V/N"))
            for key, value, unit in (("P", P, "V/m"), ("I", I, "V/(m s)"), ("D", D, "V/(m/s)")):
                rows.append(Gain(name, output, f"error of {axis}", key, per_force * value, unit))
    return rows
