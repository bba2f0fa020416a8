"""The report's pictures, from the files of an answer."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..atomic_files import whole_file
from ..machine import AppliedEffect, Machine

Array = NDArray[np.float64]
_COLOURS = {"declared": "#9aa0a6", "before": "#d1495b", "after": "#2a7f62"}
TABLE = "smooth_table"  # the family of effects that are curves, not formulas
_SCALES = {"m": (1e3, "mm"), "rad": (1e3, "mrad")}
_STYLE: Any = {
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.alpha": 0.3,
}


def draw_plots(report: Mapping[str, Any], evidence: Mapping[str, Array], machine: Machine, folder: Path) -> list[Path]:
    """Draw errors by channel and over time, the residual force, tables found and the data's coverage; return the
    files (PNG), whole.

    machine: the corrected one.  Raises ImportError naming the extra when matplotlib is missing.
    """
    try:
        import matplotlib
    except ImportError:
        raise ImportError("plots need the extra: pip install 'hframe_gym[report]'") from None
    matplotlib.use("Agg")
    channels = list(machine.output_channels)
    drawn = []
    with matplotlib.rc_context(_STYLE):
        figures = {
            "error_by_channel": _by_channel(report, channels),
            "error_over_time": _over_time(report, evidence, channels),
            "residual_force": _residual_force(report, evidence, machine) if "force/variable" in evidence else None,
            "tables": _tables(machine),
            "coverage": _coverage(evidence, machine),
        }
        for name, figure in figures.items():
            path = folder / f"{name}.png"
            if figure is None:
                path.unlink(missing_ok=True)
                continue
            with whole_file(path) as temporary:
                figure.savefig(temporary, dpi=110)
            drawn.append(path)
    return drawn


def _figure(width: float, height: float) -> Any:
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def _scale(channel: str) -> tuple[float, str]:
    unit = channel.rpartition("_")[2]
    return _SCALES.get(unit, (1.0, unit))


def _by_channel(report: Mapping[str, Any], channels: list[str]) -> Any:
    figure = _figure(7.2, 0.9 + 0.62 * len(channels))
    axes = figure.subplots()
    for k, stage in enumerate(_COLOURS):
        values = [report[stage]["held_out"][c]["noise_ratio"] or np.nan for c in channels]
        at = np.arange(len(channels)) + 0.27 * (k - 1)
        bars = axes.barh(at, values, height=0.25, color=_COLOURS[stage], label=stage)
        axes.bar_label(bars, fmt="%.3g", padding=2, fontsize=8)
    axes.axvline(1.0, color="black", lw=1, ls="--")
    axes.set(xscale="log", yticks=range(len(channels)), yticklabels=channels, xlabel="held-out rmse / sensor noise")
    axes.margins(x=0.15)
    axes.invert_yaxis()
    axes.legend(frameon=False, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return figure


def _over_time(report: Mapping[str, Any], evidence: Mapping[str, Array], channels: list[str]) -> Any:
    runs = report["runs"]["held_out"][:2]
    figure = _figure(9.6, 0.8 + 1.3 * len(channels))
    grid = figure.subplots(len(channels), len(runs), squeeze=False, sharex="col")
    for column, run in enumerate(runs):
        time = evidence[f"{run}/time_s"] - evidence[f"{run}/time_s"][0]
        for j, channel in enumerate(channels):
            axes = grid[j, column]
            factor, unit = _scale(channel)
            for stage in ("before", "after"):
                error = factor * evidence[f"{run}/{stage}"][:, j]
                axes.plot(time, error, color=_COLOURS[stage], lw=0.8, label=stage)
            axes.set_ylabel(f"{channel.rpartition('_')[0]}, {unit}")
            if j == 0:
                axes.set_title(run)
            if j == len(channels) - 1:
                axes.set_xlabel("time, s")
    grid[0, 0].legend(frameon=False, ncol=2)
    return figure


def _residual_force(report: Mapping[str, Any], evidence: Mapping[str, Array], machine: Machine) -> Any:
    lead = report["residual"]["depends_on"][0]
    figure = _figure(7.2, 3.2)
    axes = figure.subplots()
    variable = evidence["force/variable"]
    order = np.argsort(variable)
    for stage in ("before", "after"):
        force = evidence[f"force/{stage}"]
        axes.plot(variable, force, ".", ms=2, alpha=0.15, color=_COLOURS[stage])
        parts = np.array_split(order, 40)
        axes.plot(
            [variable[p].mean() for p in parts],
            [force[p].mean() for p in parts],
            color=_COLOURS[stage],
            lw=2,
            label=f"{stage} (line: mean)",
        )
    size = np.percentile(np.abs(evidence["force/before"]), 99.5)
    unit = machine.coordinate(lead["coordinate"]).unit("force")
    axes.set(
        xlabel=_with_unit(lead["variable"], machine),
        ylabel=f"force missing on {lead['coordinate']}, {unit}",
        ylim=(-1.2 * size, 1.2 * size),
    )
    axes.legend(frameon=False)
    return figure


def _with_unit(variable: str, machine: Machine) -> str:
    """A variable's name with its unit: `velocity of x, m/s`, `time, s`, `v1_V`."""
    what, _, coordinate = variable.partition(" of ")
    if not coordinate:
        return "time, s" if what == "time" else what
    quantity = {"velocity": "speed", "path": "position"}.get(what, what)
    return f"{variable}, {machine.coordinate(coordinate).unit(quantity)}"


def _tables(machine: Machine) -> Any | None:
    """The shape of each table that was found, with two standard deviations."""
    tables = [e for e in machine.effects if e.definition.family == TABLE]
    if not tables:
        return None
    figure = _figure(7.2, 2.9 * len(tables))
    for axes, e in zip(figure.subplots(len(tables), squeeze=False)[:, 0], tables, strict=True):
        _table(axes, e, machine)
    return figure


def _table(axes: Any, e: AppliedEffect, machine: Machine) -> None:
    knots, values = (np.array([v for k, v in e.parameters.items() if k[0] == letter]) for letter in "kf")
    std = [
        machine.uncertainty.std(f"{e.label}.{k}") if machine.uncertainty else None for k in e.parameters if k[0] == "f"
    ]
    spread = 2.0 * np.array([s or 0.0 for s in std])
    axes.fill_between(knots, values - spread, values + spread, color=_COLOURS["after"], alpha=0.2, lw=0)
    axes.plot(knots, values, "o-", ms=3, color=_COLOURS["after"])
    coordinate = machine.coordinate(machine.site_coordinate(e.site) or e.site)
    what = "force" if e.definition.force else "dry friction added"
    room = 0.15 * max(float(np.ptp(values)), 1e-12)
    axes.set(
        xlabel=_with_unit(e.definition.against, machine),
        ylabel=f"{what}\non {coordinate.name}, {coordinate.unit('force')}",
        title=e.label,
        ylim=(values.min() - room, values.max() + room),
    )


def _coverage(evidence: Mapping[str, Array], machine: Machine) -> Any:
    """How long the fitted runs were where: positions, velocities, inputs, a histogram each."""
    found = {n.removeprefix("coverage/"): v for n, v in evidence.items() if n.startswith("coverage/")}
    positions = sum(n.startswith("position") for n in found)
    columns = positions if positions > 1 else 3
    rows = -(-len(found) // columns)
    figure = _figure(3.2 * columns, 1.35 * rows)
    grid = figure.subplots(rows, columns, squeeze=False).ravel()
    for axes, (name, values) in zip(grid, found.items(), strict=False):
        axes.hist(values, bins=60, color="#4a6fa5", weights=np.full(len(values), 100.0 / len(values)))
        axes.set(xlabel=_with_unit(name, machine), ylabel="% of time", yscale="log")
        axes.minorticks_off()
    for axes in grid[len(found) :]:
        axes.set_visible(False)
    return figure
