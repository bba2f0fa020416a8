"""Tables that the command line prints."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from rich import box
from rich.markup import escape
from rich.table import Table

from ..dynamics import belt_modes
from ..effects import EFFECTS
from ..effects.smooth_table import TABLE_FAMILY
from ..machine import (
    BUILTIN_MACHINES,
    DRIVE_KINDS,
    METERS,
    AxisUnit,
    Machine,
    Row,
    motion_limits,
    rigid_motions,
    written_unit,
)
from ..registry import load_plugins
from ..web_page import number

if TYPE_CHECKING:
    from ..identification.report.document import ChannelErrors, ParameterValue, Report

_SHORT = {"contour": "contour", "tracking": "track"}  # headings of narrow columns
BANDS, BOUND_BAND = tuple(METERS.bands), METERS.bound_band  # of protocols, whose machines have linear axes
LISTED_MODES = 3
_MACHINE_COLUMNS = {
    "declared": "declared",
    "before": "before\n(refitted)",
    "after": "after\n(with effects)",
    "plain": "plain fit",
}


def identification_table(report: Report) -> Table:
    """Format the simulation errors of an identification on held-out recordings (those not used for fitting) as a table.

    Returns:
        Table (rich) with one row per channel and a column for each machine: as declared, with refitted parameters, with
        the identified effects as well, and, if there is one, the plain fit of inertia and friction. An error is the
        root mean square and, below it, a multiple of the sensor noise and a percentage of the motion; or the
        words "diverges" or "not measured". If the report contains it, a last row has the root mean square error of the
        drives' force divided by the root mean square of this force, %. Below the table: the force that the machines
        lack.
    """
    from ..identification.report.answers import missing_forces

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
    """Describe the identified effects with their parameters, one line each, those with the largest gain first.

    Returns:
        Lines such as "stribeck friction at x: dF = 2.8393 +- 0.0004 N, vs = 0.040011 +- 9.7e-06 m/s". Of a table, only
        the number of its points.
    """
    lines = []
    for effect in sorted(report.effects, key=lambda e: -e.held_out_gain):
        values = [_parameter_text(name, p) for name, p in effect.parameters.items()]
        text = f"a table of {len(values) // 2} points" if effect.family == TABLE_FAMILY else ", ".join(values)
        lines.append(f"{effect.name.replace('_', ' ')} at {effect.site}: {text}")
    return lines


def _parameter_text(name: str, parameter: ParameterValue) -> str:
    """Return a parameter of report.json with its standard deviation and unit."""
    spread = "" if parameter.std is None else f" +- {parameter.std:.2g}"
    return f"{name} = {parameter.value:.5g}{spread} {written_unit(parameter.unit)}".rstrip()


def _error_cell(channel: str, error: ChannelErrors) -> str:
    """Return an rms error, its multiple of the noise and its percentage of the motion, one a line; "" if unknown."""
    from ..identification.report.units import readable_unit

    if error.rmse is None:
        return ""
    factor, unit = readable_unit(channel, error.rmse)
    percent = "" if error.percent_of_motion is None else f"\n{number(error.percent_of_motion)} %"
    return f"{number(factor * error.rmse)} {unit}\n{number(error.noise_ratio)} x{percent}"


def score_table(scores: Mapping[str, Any]) -> Table:
    """Format the scores of controllers as a table.

    Numbers are never truncated; a name that is too long for the terminal continues on the next line.

    Returns:
        Table (rich) with one row per controller. The first columns are the fractions of episodes, %, that end within 1,
        0.2 and 0.05 mm of the goal. For a fixed goal, the mean settling times to these bands, s, follow, and the mean
        settling time to 0.2 mm divided by the mean of the shortest possible ones (time-optimal bound), and the mean
        distance to the goal at the end, mm; "-" means that the value is unknown or nothing settles. For a path, root
        mean square and largest contour and tracking error, mm, follow instead.
        Rotary axes have bands of 10, 2 and 0.5 mrad, and errors in mrad.
    """
    from ..evaluation import PATH_ERRORS, task_name, unit_of_scores

    title = (
        f"{task_name(scores)}: {scores['episodes']} episodes, {scores['machine']}, randomize {scores['randomize']}, "
        f"sensors {scores['sensors']}, seed {scores['seed']}"
    )
    controllers = scores["controllers"]
    fixed_goal = all("settling_s" in score for score in controllers.values())
    unit = unit_of_scores(next(iter(controllers.values())).get("success", ()))
    bands = [band.replace(unit.small, f"\n{unit.small}") for band in unit.bands]
    columns = [f"in\n{band}\n%" for band in bands]
    if fixed_goal:
        columns += [
            *(f"until\n{band}\ns" for band in bands),
            "over\nthe\nbound",
            f"error\nat end\n{unit.small}",
        ]
    else:
        columns += [
            f"{_SHORT[error]}\nerror\n{kind}\n{unit.small}"
            for error in PATH_ERRORS
            for kind in ("rms", "max")
        ]
    table = Table(
        title=escape(title), title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False, collapse_padding=True
    )
    table.add_column("name", overflow="fold")
    for column in columns:
        table.add_column(column, justify="right", no_wrap=True, min_width=max(map(len, column.split("\n"))))
    for name, score in controllers.items():
        success = (f"{100 * score['success'][band]:.1f}" for band in unit.bands)
        cells = _settling_cells(score, unit) if fixed_goal else _path_cells(score, unit)
        table.add_row(escape(name), *success, *cells)
    return table


def _settling_cells(score: Mapping[str, Any], unit: AxisUnit) -> list[str]:
    """Return the mean settling times, s, their ratio to the mean time-optimal bound, and the mean error at the end."""
    from ..evaluation import ratio_to_bounds, settling_in

    values = (*(settling_in(score, band) for band in unit.bands), ratio_to_bounds(score))
    left = score[f"final_error_{unit.small}"]["mean"]
    return [*(f"{value['mean']:.3f}" if value else "-" for value in values), number(left)]


def _path_cells(score: Mapping[str, Any], unit: AxisUnit) -> list[str]:
    """Return contour and tracking errors, rms and maximum, means over the episodes, mm or mrad."""
    from ..evaluation import PATH_ERRORS

    keys = [f"{error}_{unit.small}" for error in PATH_ERRORS]
    return [f"{score[key][kind]['mean']:.3f}" for key in keys for kind in ("rms", "max")]


def protocol_tables(results: Sequence[Mapping[str, Any]]) -> list[Table]:
    """Format the results of controllers in a protocol, one of the fixed benchmarks of the leaderboard.

    Returns:
        One table (rich) per task of the protocol, with one row per controller. For moves to a goal: the fractions
        of episodes, %, that settle within 1, 0.2 and 0.05 mm, the mean settling time to 0.2 mm, s, and its ratio to
        the mean bound (where bounds are stored), with 95 % intervals, and the median distance at the end, mm. For
        paths: root mean square and largest contour error, mm, with their intervals.
    """
    from ..evaluation import get_protocol, protocol_bounds, settling_or_none

    tables = []
    for part, first in results[0]["scores"].items():
        moves = "final_error_mm" in first
        columns = [f"in {band}, %" for band in BANDS] + [f"until {BOUND_BAND}, s"] if moves else list(first)
        protocol = get_protocol(results[0]["protocol"])
        bound = protocol_bounds(protocol.name)["free"] if moves else np.zeros(0)
        known_bounds = int(np.isfinite(bound).sum())
        if known_bounds:
            columns.append(f"over the bound ({known_bounds} draws)")
        if moves:
            columns.append("error at the end, mm")
        table = Table(title=f"{results[0]['protocol']}, {part}", title_justify="left", box=box.SIMPLE_HEAD)
        table.add_column("name", overflow="fold")
        for column in columns:
            table.add_column(column, justify="right")
        for result in results:
            scores = result["scores"][part]
            settling = [scores[f"settling_s.{band}"] for band in BANDS] if moves else []
            means = [scores[f"settling_s.{BOUND_BAND}"]] if moves else scores.values()
            cells = [f"{100 * score['success']:.1f}" for score in settling]
            known = (settling_or_none(score.get("success", 1.0), score) for score in means)
            cells += [
                "{mean:.4f} ({0:.4f} to {1:.4f})".format(*score["ci95"], mean=score["mean"]) if score else "-"
                for score in known
            ]
            if known_bounds:
                cells.append(_over_bound(result, part, bound, protocol.duration_s))
            if moves:
                cells.append(number(scores["final_error_mm"]["median"]))
            table.add_row(escape(result["entry"]["name"]), *cells)
        tables.append(table)
    return tables


def _over_bound(result: Mapping[str, Any], part: str, bound: NDArray[np.float64], duration_s: float) -> str:
    """Return the ratio of settling times to their bounds with its interval; "-" if nothing settles."""
    from ..evaluation import fill_unsettled, paired_ratio

    if not result["scores"][part][f"settling_s.{BOUND_BAND}"]["success"]:
        return "-"
    ratio = paired_ratio(fill_unsettled(result["draws"][part][f"settling_s.{BOUND_BAND}"], duration_s), bound)
    return "{mean:.3f} ({0:.3f} to {1:.3f})".format(*ratio["ci95"], mean=ratio["mean"]) if ratio else "-"


def machine_table() -> Table:
    """Format the built-in machines as a table.

    Returns:
        Table (rich) with one row per machine: name, description, numbers of coordinates and belts, and the lowest three
        natural frequencies of the masses on the belts (belt modes), Hz.
    """
    table = _table("machine", "description")
    for name, make_machine in BUILTIN_MACHINES.items():
        machine = make_machine()
        facts = [_count(len(machine.coordinates), "coordinate"), _count(len(machine.belts), "belt")]
        if modes := _lowest_modes(machine):
            facts.append(f"belt modes {modes}")
        table.add_row(name, f"{escape(machine.description)}\n[dim]{', '.join(facts)}[/dim]")
    return table


def effect_table() -> Table:
    """Format the library of effects (additional physical terms that identification can select) as a table.

    Plugins are loaded first. Names are never wrapped or truncated, so that a pipe can search them.

    Returns:
        Table (rich) with one row per effect and two columns: its name; its formula, the kind of component it acts on
        (site) and its parameters with units.
    """
    load_plugins()
    table = _table("effect", "formula, site, parameters")
    for effect in EFFECTS.values():
        parameters = ", ".join(f"{p.name} ({p.unit})" for p in effect.parameters)
        details = f"at {effect.site}; {parameters}" if parameters else f"at {effect.site}"
        table.add_row(effect.name, f"{escape(effect.formula)}\n[dim]{escape(details)}[/dim]")
    return table


def _table(first: str, second: str) -> Table:
    """Return a table of two columns: names, which are never cut or wrapped, and texts, which wrap between words."""
    table = Table(box=box.SIMPLE_HEAD, show_lines=False, pad_edge=False, padding=(0, 1))
    table.add_column(first, no_wrap=True)
    table.add_column(second, overflow="fold")
    return table


def _count(count: int, noun: str) -> str:
    """Return a number with its noun: "1 belt", "3 belts"."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def machine_tables(machine: Machine) -> list[Table]:
    """Format a machine as tables with units: coordinates, belts, drives, sensors, effects, and limits of the motion.

    Returns:
        Tables (rich), without those that would be empty. The last one has moved mass, stall force (force at rest),
        acceleration and top speed along each axis at rated voltage; implausible values there show wrong units.
    """
    tables = [_coordinate_table(machine), _belt_table(machine), _drive_table(machine), _sensor_table(machine)]
    effects = _titled("effects", "effect@site", "parameters")
    for effect in machine.effects:
        values = (f"{k} = {_cell(machine, f'{effect.label}.{k}', v)}" for k, v in effect.parameters.items())
        effects.add_row(escape(effect.label), escape(", ".join(values)))
    return [table for table in (*tables, effects, _limits_table(machine)) if table.row_count]


def _titled(title: str, *columns: str) -> Table:
    """Return an empty table with a title at the left, whose first column is never wrapped."""
    table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False)
    for column in columns:
        table.add_column(column, overflow="fold", no_wrap=column == columns[0])
    return table


def _cell(machine: Machine, parameter: str, value: float) -> str:
    """Format a value with its unit, and with its standard deviation if it was identified."""
    std = machine.uncertainty.std(parameter) if machine.uncertainty else None
    spread = "" if std is None else f" +- {std:.2g}"
    return f"{value:.4g}{spread} {written_unit(machine.unit(parameter))}".rstrip()


def _sum(row: Row) -> str:
    """Format a row of factors as a sum, for example "x + y - phi1"."""
    text = ""
    for name, factor in row.items():
        if factor:
            sign = (" - " if factor < 0 else " + ") if text else ("-" if factor < 0 else "")
            text += sign + ("" if abs(factor) == 1 else f"{abs(factor):.4g} ") + name
    return text or "-"


def _coordinate_table(machine: Machine) -> Table:
    """Format the coordinates."""
    table = _titled("coordinates", "name", "mass or inertia", "viscous", "Coulomb", "radius", "range")
    for c in machine.coordinates:
        cells = [_cell(machine, f"{c.name}.{key}", getattr(c, key)) for key in ("mass", "viscous", "coulomb")]
        radius = _cell(machine, f"{c.name}.radius", c.radius) if c.kind == "rotary" else "-"
        limits = f"{c.range[0]:g} to {c.range[1]:g} {c.unit('position')}" if c.range else "-"
        table.add_row(*map(escape, (c.name, *cells, radius, limits)))
    return table


def _belt_table(machine: Machine) -> Table:
    """Format the belts; the stiffness is that at position 0."""
    title = "belt sections (sums of travel in m; that of a pulley is radius * angle)"
    table = _titled(title, "name", "EA", "rest length", "stiffness at 0", "stretch", "longer by")
    for b in machine.belts:
        length = _cell(machine, f"{b.name}.rest_length", b.rest_length)
        stiffness = f"{b.EA / b.rest_length:.4g} N/m"
        table.add_row(
            b.name, _cell(machine, f"{b.name}.EA", b.EA), length, stiffness, _sum(b.extension), _sum(b.length)
        )
    return table


def _drive_table(machine: Machine) -> Table:
    """Format the drives; the parameters of laws have one column, because each kind has others."""
    others = any(d.kind != "voltage" for d in machine.drives)
    of_motors = [key for d in machine.drives for key in d.parameter_names if key not in d.law_parameters]
    titles = {key: "R" if key == "resistance" else key.replace("_", " ") for key in of_motors}
    columns = [*(["kind"] if others else []), "channel", "moves", *titles.values()]
    columns += ["law"] if machine.drive_laws else []
    table = _titled("drives", "name", *columns, "rated")
    for d in machine.drives:
        cells = [d.kind] if others else []
        cells += [d.channel, d.coordinate]
        for key in titles:
            has = key in d.parameter_names
            cells.append(_cell(machine, f"{d.name}.{key}", getattr(d, key)) if has else "")
        if machine.drive_laws:
            defaults = DRIVE_KINDS.get(d.kind).defaults
            stated = {key: value for key, value in d.law_parameters.items() if defaults.get(key) != value}
            lines = [f"{key} {_cell(machine, f'{d.name}.{key}', value)}" for key, value in stated.items()]
            cells.append("\n".join(lines))
        table.add_row(*map(escape, (d.name, *cells, f"{d.rated_voltage:g} {machine.command_unit(d)}")))
    return table


def _sensor_table(machine: Machine) -> Table:
    """Format the sensors."""
    table = _titled("sensors", "channel", "kind", "measures", "noise", "resolution")
    for s in machine.sensors:
        cells = [_cell(machine, f"{s.channel}.{key}", value) for key, value in s.device_parameters.items()]
        table.add_row(*map(escape, (s.channel, s.kind, _sum(s.row), *cells)))
    return table


def _limits_table(machine: Machine) -> Table:
    """Format what the drives can do along each rigid motion; wrong units in a file show here."""
    title = "motion at rated voltage, belts not stretched: are these values plausible?"
    table = _titled(
        title, "along", "moved mass", "force at rest", "acceleration", "top speed", "other coordinates"
    )
    motions = rigid_motions(machine)
    for name, limit in motion_limits(machine).items():
        leading = machine.coordinate(name)
        turns = [
            f"{other}: {rate:.4g} {machine.coordinate(other).unit('position')}/{leading.unit('position')}"
            for other, rate in zip(machine.coordinate_names, motions[name].tolist(), strict=True)
            if rate and other != name
        ]
        cells = [
            f"{limit.inertia:.3g} {leading.unit('mass')}",
            f"{limit.force:.3g} {leading.unit('force')}",
            f"{limit.force / limit.inertia:.3g} {leading.unit('speed')}^2",
            f"{limit.speed:.3g} {leading.unit('speed')}",
        ]
        table.add_row(name, *cells, "\n".join(turns) or "-")
    return table


def belt_mode_line(machine: Machine) -> str:
    """Describe in one line the lowest three natural frequencies, Hz, of the masses on the belts."""
    return f"belt modes: {_lowest_modes(machine) or 'none (no elastic belt)'}"


def _lowest_modes(machine: Machine) -> str:
    """Return the lowest belt modes with their unit, such as "18.6, 33.1, 40.0, ... Hz"; "" without elastic belts."""
    modes = [f"{frequency:.1f}" for frequency in belt_modes(machine)]
    listed = [*modes[:LISTED_MODES], "..."] if len(modes) > LISTED_MODES else modes
    return f"{', '.join(listed)} Hz" if listed else ""
