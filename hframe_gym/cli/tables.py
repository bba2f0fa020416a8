"""Tables that the command line prints."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from rich import box
from rich.markup import escape
from rich.table import Table

from ..dynamics import mode_frequencies
from ..effects import EFFECTS
from ..machine import BUILTIN_MACHINES
from ..registry import load_plugins
from ..web_page import number

BANDS = ("1mm", "0.2mm", "0.05mm")
BOUND_BAND = "0.2mm"  # band of the time-optimal bound
PATH_ERRORS = {"contour_mm": "contour", "tracking_mm": "track"}
LISTED_MODES = 3


def identification_table(report: Mapping[str, Any], channels: Sequence[str]) -> Table:
    """Format the simulation errors of an identification on held-out recordings as a table.

    Args:
        report: Contents of report.json.
        channels: Names of the machine's output channels (sensors).

    Returns:
        Table (rich) with one row per channel: root-mean-square error in the channel's unit, and in parentheses as a
        multiple of the sensor noise, for the declared machine, the refitted machine, and the machine with added
        effects. A further row has the relative error of the drives' forces, %, where the report contains it.
    """
    title = "simulation error on held-out recordings: rmse (x: multiple of the sensor noise)"
    table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column("channel", overflow="fold")
    for column in ("declared", "before\n(refitted)", "after\n(with effects)"):
        table.add_column(column, justify="right")  # a narrow terminal shows the multiple on a second line
    errors = [report[stage]["held_out"] for stage in ("declared", "before", "after")]
    for channel in channels:
        if errors[0][channel]["rmse"] is None:
            table.add_row(channel, *["not measured"] * len(errors))
        else:
            cells = (e[channel] for e in errors)
            table.add_row(channel, *(f"{cell['rmse']:.3g} ({number(cell['noise_ratio'])}x)" for cell in cells))
    if "force_error" in errors[0]:
        table.add_row("force, relative", *(f"{100 * e['force_error']:.2f} %" for e in errors))
    return table


def score_table(scores: Mapping[str, Any]) -> Table:
    """Format the scores of controllers as a table.

    Numbers are never truncated; a name that is too long for the terminal continues on the next line.

    Args:
        scores: Contents of scores.json.

    Returns:
        Table (rich) with one row per controller: episodes that end within each settling band around the goal, %; then
        for a fixed goal mean settling times, s, and their ratio to the shortest possible time (time-optimal bound); for
        a path the root mean square and largest contour and tracking errors, mm.
    """
    task = scores["task"].partition("(")[0].lower()
    title = (
        f"{task}: {scores['episodes']} episodes, {scores['machine']}, randomize {scores['randomize']}, "
        f"sensors {scores['sensors']}, seed {scores['seed']}"
    )
    controllers = scores["controllers"]
    fixed_goal = all("settling_s" in score for score in controllers.values())
    bands = [band.replace("mm", "\nmm") for band in BANDS]
    columns = [f"in\n{band}\n%" for band in bands]
    if fixed_goal:
        columns += [*(f"until\n{band}\ns" for band in bands), "over\nthe\nbound"]
    else:
        columns += [f"{label}\nerror\n{kind}\nmm" for label in PATH_ERRORS.values() for kind in ("rms", "max")]
    table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False, collapse_padding=True)
    table.add_column("name", overflow="fold")
    for column in columns:
        table.add_column(column, justify="right", no_wrap=True, min_width=max(map(len, column.split("\n"))))
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
    """List the reasons why the time-optimal bound (shortest possible settling time) of episodes is unknown.

    Args:
        scores: Contents of scores.json.

    Returns:
        Distinct reasons as text, in the order of the controllers; empty if all bounds are known.
    """
    reasons = (score.get("over_bound_reason") for score in scores["controllers"].values())
    return list(dict.fromkeys(reason for reason in reasons if reason))


def machine_table() -> Table:
    """Format the built-in machines as a table.

    Returns:
        Table (rich) with one row per machine: name, and description with numbers of coordinates and belts and the
        lowest natural frequencies of the masses on the belts (belt modes), Hz.
    """
    table = _table("machine", "description")
    for name, make_machine in BUILTIN_MACHINES.items():
        machine = make_machine()
        frequencies = [f for f in mode_frequencies(machine) if f > 0]
        facts = [_count(len(machine.coordinates), "coordinate"), _count(len(machine.belts), "belt")]
        if frequencies:
            modes = ", ".join(f"{f:.1f}" for f in frequencies[:LISTED_MODES])
            facts.append(f"belt modes {modes}{', ...' if len(frequencies) > LISTED_MODES else ''} Hz")
        table.add_row(name, f"{escape(machine.description)}\n[dim]{', '.join(facts)}[/dim]")
    return table


def effect_table() -> Table:
    """Format the library's effects (additional physical terms that identification can select) as a table.

    Names are never wrapped or truncated, so that the output can be searched in a pipe.

    Returns:
        Table (rich) with one row per effect: name; below each other formula, site (the kind of component it acts on)
        and parameters with units. Plugins are loaded first.
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
