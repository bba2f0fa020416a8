"""Tables that the `hframe` commands print."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from rich.markup import escape
from rich.table import Table

from .effects import EFFECTS
from .machine import BUILTIN_MACHINES, mode_frequencies

BANDS = ("1mm", "0.2mm", "0.05mm")
BOUND_BAND = "0.2mm"  # band of the time-optimal bound
PATH_ERRORS = {"contour_mm": "contour", "tracking_mm": "tracking"}
LISTED_MODES = 3


def identification_table(report: Mapping[str, Any], channels: Sequence[str]) -> Table:
    """Format the errors of an identification on held-out recordings.

    Args:
        report: Contents of report.json.
        channels: Output channels of the machine.

    Returns:
        One row per channel, with a column each for the declared, refitted and extended machine.
    """
    title = "simulation error on held-out recordings: rmse (multiple of the sensor noise)"
    table = Table(title=title, title_justify="left")
    table.add_column("channel", no_wrap=True)
    for column in ("declared", "before (refitted)", "after (with effects)"):
        table.add_column(column, justify="right")
    errors = [report[stage]["held_out"] for stage in ("declared", "before", "after")]
    for channel in channels:
        if errors[0][channel]["rmse"] is None:
            table.add_row(channel, *["not measured"] * len(errors))
        else:
            cells = (e[channel] for e in errors)
            table.add_row(channel, *(f"{cell['rmse']:.3g} ({cell['noise_ratio']:.3g}x)" for cell in cells))
    if "force_error" in errors[0]:
        table.add_row("force, relative", *(f"{100 * e['force_error']:.2f} %" for e in errors))
    return table


def score_table(scores: Mapping[str, Any]) -> Table:
    """Format the scores of controllers.

    Args:
        scores: Contents of scores.json.

    Returns:
        One row per controller: success in each band, then settling times for a fixed goal, or errors along a path.
    """
    task = scores["task"].partition("(")[0].lower()
    title = (
        f"{task}: {scores['episodes']} episodes, {scores['machine']}, randomize {scores['randomize']}, "
        f"sensors {scores['sensors']}, seed {scores['seed']}"
    )
    controllers = scores["controllers"]
    fixed_goal = all("settling_s" in score for score in controllers.values())
    columns = [f"in {band}, %" for band in BANDS]
    if fixed_goal:
        columns += [*(f"s to {band}" for band in BANDS), "over the bound"]
    else:
        columns += [f"{label}, mm {kind}" for label in PATH_ERRORS.values() for kind in ("rms", "max")]
    table = Table(title=title, title_justify="left")
    table.add_column("controller", no_wrap=True)
    for column in columns:
        table.add_column(column, justify="right")
    for name, score in controllers.items():
        success = (f"{100 * score['success'][band]:.1f}" for band in BANDS)
        table.add_row(escape(name), *success, *(_settling_cells(score) if fixed_goal else _path_cells(score)))
    return table


def _settling_cells(score: Mapping[str, Any]) -> list[str]:
    """Return the mean settling times, s, and the ratio of the mean settling time to the mean time-optimal bound."""
    times = [f"{score['settling_s'][band]['mean']:.3f}" for band in BANDS]
    over_bound = (score.get("over_bound") or {}).get(BOUND_BAND) or {}
    ratio = (over_bound.get("ratio_of_means") or {}).get("mean")
    return [*times, f"{ratio:.3f}" if ratio else "-"]


def _path_cells(score: Mapping[str, Any]) -> list[str]:
    """Return contour and tracking errors, rms and maximum, means over the episodes, mm."""
    return [f"{score[key][kind]['mean']:.3f}" for key in PATH_ERRORS for kind in ("rms", "max")]


def unknown_bound_reasons(scores: Mapping[str, Any]) -> list[str]:
    """Explain why episodes have no time-optimal bound.

    Args:
        scores: Contents of scores.json.

    Returns:
        One sentence per reason, without duplicates.
    """
    reasons = (score.get("over_bound_reason") for score in scores["controllers"].values())
    return list(dict.fromkeys(reason for reason in reasons if reason))


def machine_table() -> Table:
    """List the built-in machines.

    Returns:
        One row per machine.
    """
    table = Table("name", "coordinates", "belts", "belt modes, Hz", "description")
    table.columns[0].no_wrap = True
    for name, make_machine in BUILTIN_MACHINES.items():
        machine = make_machine()
        frequencies = [f for f in mode_frequencies(machine) if f > 0]
        modes = ", ".join(f"{f:.1f}" for f in frequencies[:LISTED_MODES])
        more = ", ..." if len(frequencies) > LISTED_MODES else ""
        counts = (str(len(machine.coordinates)), str(len(machine.belts)))
        table.add_row(name, *counts, modes + more or "-", machine.description)
    return table


def effect_table() -> Table:
    """List the effects of the library.

    Names are never wrapped or cut, so that the output can be searched in a pipe.

    Returns:
        One row per effect.
    """
    table = Table("effect", "site", "parameters", "formula")
    name_column = table.columns[0]
    name_column.no_wrap, name_column.min_width = True, max(map(len, EFFECTS))
    for column in table.columns[1:]:
        column.overflow = "fold"
    for effect in EFFECTS.values():
        parameters = ", ".join(f"{p.name} ({p.unit})" for p in effect.parameters)
        table.add_row(effect.name, effect.site, escape(parameters), escape(effect.formula))
    return table
