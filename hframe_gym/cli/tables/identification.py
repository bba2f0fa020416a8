"""Tables and lines of an identification: errors on held-out runs, and effects."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich import box
from rich.markup import escape
from rich.table import Table

from ...effects.smooth_table import TABLE_FAMILY
from ...machine import written_unit
from ...web_page import number

if TYPE_CHECKING:
    from ...identification.report.content.document import ChannelErrors, ParameterValue, Report

_MACHINE_COLUMNS = {
    "declared": "declared",
    "before": "before\n(refitted)",
    "after": "after\n(with effects)",
    "plain": "plain fit",
}


def identification_table(report: Report) -> Table:
    """Format the simulation errors of an identification on held-out recordings (not used to fit) as a table.

    Returns:
        Table (rich) with one row per channel and a column for each machine: as declared, with refitted
        parameters, with the identified effects as well, and, if there is one, the plain fit of inertia and
        friction. An error is the root mean square and, below it, a multiple of the sensor noise and a
        percentage of the motion; or the words "diverges" or "not measured". If the report contains it, a last
        row has the root mean square error of the drives' force divided by the root mean square of this force,
        %. Below the table: the force that the machines lack.
    """
    from ...identification.report.words.remainder import missing_forces

    title = "simulation error on held-out recordings: rms, x: multiple of the sensor noise, % of the motion"
    machines = report.machines
    forces = missing_forces([evaluation for key, evaluation in machines.items() if key != "plain"])
    of_drives = ", of that of the drives" * any(force.endswith("%") for force in forces)
    listed = ", ".join(force or "unknown" for force in forces)
    caption = f"missing force (below 10 Hz){of_drives}: {listed}" if any(forces) else None
    table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False)
    table.caption, table.caption_justify = caption, "left"
    table.add_column("channel", overflow="fold")
    for key in machines:
        table.add_column(_MACHINE_COLUMNS[key], justify="right")
    for channel in report.declared.channels:
        errors = [evaluation.channels[channel] for evaluation in machines.values()]
        absent = "diverges" if any(error.rmse is not None for error in errors) else "not measured"
        table.add_row(escape(channel), *(_error_cell(channel, error) or absent for error in errors))
    if report.declared.force_error is not None:
        ratios = [evaluation.force_error for evaluation in machines.values()]
        table.add_row("force, relative", *("" if r is None else f"{100 * r:.2f} %" for r in ratios))
    return table


def effect_lines(report: Report) -> list[str]:
    """Describe the identified effects with their parameters, one line each.

    The effect that reduces the error on the held-out runs most comes first (`held_out_gain`).

    Returns:
        Lines such as "stribeck friction at x: dF = 2.8393 +- 0.0004 N, vs = 0.040011 +- 9.7e-06 m/s". Of a
        table, only the number of its points.
    """
    lines = []
    for effect in sorted(report.effects, key=lambda e: -e.held_out_gain):
        values = [_parameter_text(name, p) for name, p in effect.parameters.items()]
        text = f"a table of {len(values) // 2} points" if effect.family == TABLE_FAMILY else ", ".join(values)
        lines.append(f"{effect.name.replace('_', ' ')} at {effect.site}: {text}")
    return lines


def _parameter_text(name: str, parameter: ParameterValue) -> str:
    """Return a parameter of report.json with its standard deviation, or its least value, and its unit."""
    if parameter.at_least is not None:
        return f"{name} at least {parameter.at_least:.3g} {written_unit(parameter.unit)}".rstrip()
    spread = "" if parameter.std is None else f" +- {parameter.std:.2g}"
    return f"{name} = {parameter.value:.5g}{spread} {written_unit(parameter.unit)}".rstrip()


def _error_cell(channel: str, error: ChannelErrors) -> str:
    """Return an rms error, its multiple of the noise and percentage of the motion, one a line, or ""."""
    from ...identification.report.units import readable_unit

    if error.rmse is None:
        return ""
    factor, unit = readable_unit(channel, error.rmse)
    percent = "" if error.percent_of_motion is None else f"\n{number(error.percent_of_motion)} %"
    return f"{number(factor * error.rmse)} {unit}\n{number(error.noise_ratio)} x{percent}"
