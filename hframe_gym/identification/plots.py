"""Draw the plots of an identification report with matplotlib."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..atomic_files import atomic_file
from ..machine import AppliedEffect, Machine

Array = NDArray[np.float64]
TABLE_FAMILY = "smooth_table"  # Family of the effects that are curves, not formulas.
_COLORS = {"declared": "#9aa0a6", "before": "#d1495b", "after": "#2a7f62"}
_SCALES = {"m": (1e3, "mm"), "rad": (1e3, "mrad")}
_MAX_RUNS = 2  # Held-out runs whose errors are drawn over time.
_MEAN_BINS = 40  # Points of the mean curve through the residual force.
_STYLE: Any = {
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.alpha": 0.3,
}


def draw_plots(report: Mapping[str, Any], curves: Mapping[str, Array], machine: Machine, folder: Path) -> list[Path]:
    """Draw the plots of an identification report and save them as PNG files.

    They show the errors by channel and over time, the force that the model lacks (residual force), the tables (forces
    interpolated over one variable), and the positions, velocities and voltages that the recordings cover.

    Args:
        report: Content of report.json.
        curves: Curves by name, see `result.plot_data` for names, shapes and units.
        machine: Identified machine with the selected effects.
        folder: Folder for the files; created if it does not exist. Old plots that do not apply are deleted.

    Returns:
        Paths of the written files (PNG). Each file appears completely or not at all.

    Raises:
        ImportError: If matplotlib is missing.
        OSError: If a file cannot be written.
    """
    try:
        import matplotlib
    except ImportError:
        raise ImportError("the plots need more packages: pip install 'hframe_gym[report]'") from None
    channels = list(machine.output_channels)
    written = []
    with matplotlib.rc_context(_STYLE):
        figures = {
            "error_by_channel": _error_by_channel(report, channels),
            "error_over_time": _error_over_time(report, curves, channels),
            "residual_force": _residual_force(report, curves, machine) if "force/variable" in curves else None,
            "tables": _tables(machine),
            "coverage": _coverage(curves, machine),
        }
        for name, figure in figures.items():
            path = folder / f"{name}.png"
            if figure is None:
                path.unlink(missing_ok=True)
                continue
            with atomic_file(path) as temporary:
                figure.savefig(temporary, dpi=110)
            written.append(path)
    return written


def _figure(width: float, height: float) -> Any:
    """Return an empty figure of a size in inches, without any window."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def _scale(channel: str) -> tuple[float, str]:
    """Return the factor and the unit in which a channel's error is drawn."""
    unit = channel.rpartition("_")[2]
    return _SCALES.get(unit, (1.0, unit))


def _error_by_channel(report: Mapping[str, Any], channels: list[str]) -> Any:
    """Draw the error of each channel in units of the noise, for each machine."""
    figure = _figure(7.2, 0.9 + 0.62 * len(channels))
    axes = figure.subplots()
    for k, stage in enumerate(_COLORS):
        values = [report[stage]["held_out"][c]["noise_ratio"] or np.nan for c in channels]
        rows = np.arange(len(channels)) + 0.27 * (k - 1)
        bars = axes.barh(rows, values, height=0.25, color=_COLORS[stage], label=stage)
        axes.bar_label(bars, fmt="%.3g", padding=2, fontsize=8)
    axes.axvline(1.0, color="black", lw=1, ls="--")
    axes.set(xscale="log", yticks=range(len(channels)), yticklabels=channels, xlabel="held-out rmse / sensor noise")
    axes.margins(x=0.15)
    axes.invert_yaxis()
    axes.legend(frameon=False, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return figure


def _error_over_time(report: Mapping[str, Any], curves: Mapping[str, Array], channels: list[str]) -> Any:
    """Draw the errors before and after over the time of the first held-out runs."""
    runs = report["runs"]["held_out"][:_MAX_RUNS]
    figure = _figure(9.6, 0.8 + 1.3 * len(channels))
    grid = figure.subplots(len(channels), len(runs), squeeze=False, sharex="col")
    for column, run in enumerate(runs):
        time = curves[f"{run}/time_s"] - curves[f"{run}/time_s"][0]
        for j, channel in enumerate(channels):
            axes = grid[j, column]
            factor, unit = _scale(channel)
            for stage in ("before", "after"):
                error = factor * curves[f"{run}/{stage}"][:, j]
                axes.plot(time, error, color=_COLORS[stage], lw=0.8, label=stage)
            axes.set_ylabel(f"{channel.rpartition('_')[0]}, {unit}")
            if j == 0:
                axes.set_title(run)
            if j == len(channels) - 1:
                axes.set_xlabel("time, s")
    grid[0, 0].legend(frameon=False, ncol=2)
    return figure


def _residual_force(report: Mapping[str, Any], curves: Mapping[str, Array], machine: Machine) -> Any:
    """Draw the residual force before and after against the variable that it depends on most."""
    strongest = report["residual"]["depends_on"][0]
    figure = _figure(7.2, 3.2)
    axes = figure.subplots()
    variable = curves["force/variable"]
    bins = [part for part in np.array_split(np.argsort(variable), _MEAN_BINS) if len(part)]
    for stage in ("before", "after"):
        force = curves[f"force/{stage}"]
        axes.plot(variable, force, ".", ms=2, alpha=0.15, color=_COLORS[stage])
        axes.plot(
            [variable[rows].mean() for rows in bins],
            [force[rows].mean() for rows in bins],
            color=_COLORS[stage],
            lw=2,
            label=f"{stage} (line: mean)",
        )
    size = float(np.percentile(np.abs(curves["force/before"]), 99.5)) or 1.0
    unit = machine.coordinate(strongest["coordinate"]).unit("force")
    axes.set(
        xlabel=_with_unit(strongest["variable"], machine),
        ylabel=f"missing force on {strongest['coordinate']}, {unit}",
        ylim=(-1.2 * size, 1.2 * size),
    )
    axes.legend(frameon=False)
    return figure


def _with_unit(variable: str, machine: Machine) -> str:
    """Return a variable's name with its unit: `velocity of x, m/s`, `time, s`, `v1_V`."""
    what, _, coordinate = variable.partition(" of ")
    if not coordinate:
        return "time, s" if what == "time" else what
    quantity = {"velocity": "speed", "path": "position"}.get(what, what)
    return f"{variable}, {machine.coordinate(coordinate).unit(quantity)}"


def _tables(machine: Machine) -> Any | None:
    """Draw each table of the machine with two standard deviations; None where there is none."""
    tables = [e for e in machine.effects if e.definition.family == TABLE_FAMILY]
    if not tables:
        return None
    figure = _figure(7.2, 2.9 * len(tables))
    for axes, effect in zip(figure.subplots(len(tables), squeeze=False)[:, 0], tables, strict=True):
        _draw_table(axes, effect, machine)
    return figure


def _draw_table(axes: Any, effect: AppliedEffect, machine: Machine) -> None:
    """Draw one table."""
    knots, values = (np.array([v for k, v in effect.parameters.items() if k[0] == letter]) for letter in "kf")
    names = [f"{effect.label}.{key}" for key in effect.parameters if key[0] == "f"]
    std = [machine.uncertainty.std(name) if machine.uncertainty else None for name in names]
    spread = 2.0 * np.array([s or 0.0 for s in std])
    axes.fill_between(knots, values - spread, values + spread, color=_COLORS["after"], alpha=0.2, lw=0)
    axes.plot(knots, values, "o-", ms=3, color=_COLORS["after"])
    coordinate = machine.coordinate(machine.coordinate_of_site(effect.site) or effect.site)
    what = "force" if effect.definition.force else "additional friction"
    margin = 0.15 * max(float(np.ptp(values)), 1e-12)
    axes.set(
        xlabel=_with_unit(effect.definition.against, machine),
        ylabel=f"{what}\non {coordinate.name}, {coordinate.unit('force')}",
        title=effect.label,
        ylim=(values.min() - margin, values.max() + margin),
    )


def _coverage(curves: Mapping[str, Array], machine: Machine) -> Any:
    """Draw histograms of the positions, velocities and inputs of the fitted runs."""
    histograms = {n.removeprefix("coverage/"): v for n, v in curves.items() if n.startswith("coverage/")}
    positions = sum(n.startswith("position") for n in histograms)
    columns = positions if positions > 1 else 3
    rows = max(1, -(-len(histograms) // columns))
    figure = _figure(3.2 * columns, 1.35 * rows)
    grid = figure.subplots(rows, columns, squeeze=False).ravel()
    for axes, (name, values) in zip(grid, histograms.items(), strict=False):
        axes.hist(values, bins=60, color="#4a6fa5", weights=np.full(len(values), 100.0 / len(values)))
        axes.set(xlabel=_with_unit(name, machine), ylabel="% of time", yscale="log")
        axes.minorticks_off()
    for axes in grid[len(histograms) :]:
        axes.set_visible(False)
    return figure
