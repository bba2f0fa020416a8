"""The report's pictures, from the files of an answer."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..atomic import whole_file

Array = NDArray[np.float64]
_COLOURS = {"declared": "#9aa0a6", "before": "#d1495b", "after": "#2a7f62"}
_SCALES = {"m": (1e3, "mm"), "rad": (1e3, "mrad")}


def draw_plots(
    report: Mapping[str, Any], evidence: Mapping[str, Array], channels: list[str], folder: Path
) -> list[Path]:
    """Draw errors over time, errors by channel, and the residual force; return the files (PNG), whole.

    Raises ImportError naming the extra when matplotlib is missing.
    """
    try:
        import matplotlib
    except ImportError:
        raise ImportError("plots need the extra: pip install 'hframe_gym[report]'") from None
    matplotlib.use("Agg")
    from matplotlib.figure import Figure

    style: Any = {
        "font.size": 9,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.grid": True,
        "grid.alpha": 0.3,
    }
    drawn = []
    with matplotlib.rc_context(style):
        figures: list[tuple[str, Figure]] = [
            ("error_by_channel", _by_channel(report, channels)),
            ("error_over_time", _over_time(report, evidence, channels)),
        ]
        if "force/variable" in evidence:
            figures.append(("residual_force", _residual_force(report, evidence)))
        for name, figure in figures:
            path = folder / f"{name}.png"
            with whole_file(path) as temporary:
                figure.savefig(temporary, dpi=110)
            drawn.append(path)
    return drawn


def _scale(channel: str) -> tuple[float, str]:
    return _SCALES.get(channel.rpartition("_")[2], (1.0, channel.rpartition("_")[2]))


def _by_channel(report: Mapping[str, Any], channels: list[str]) -> Any:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.2, 0.9 + 0.75 * len(channels)), layout="constrained")
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
    axes.legend(frameon=False, loc="lower right")
    return figure


def _over_time(report: Mapping[str, Any], evidence: Mapping[str, Array], channels: list[str]) -> Any:
    from matplotlib.figure import Figure

    runs = report["runs"]["held_out"][:2]
    figure = Figure(figsize=(9.6, 0.8 + 1.5 * len(channels)), layout="constrained")
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
    figure.suptitle("error on runs never fitted")
    return figure


def _residual_force(report: Mapping[str, Any], evidence: Mapping[str, Array]) -> Any:
    from matplotlib.figure import Figure

    lead = report["residual"]["depends_on"][0]
    figure = Figure(figsize=(7.2, 3.2), layout="constrained")
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
            label=stage,
        )
    size = np.percentile(np.abs(evidence["force/before"]), 99.5)
    axes.set(xlabel=lead["variable"], ylabel=f"force missing on {lead['coordinate']}", ylim=(-1.2 * size, 1.2 * size))
    axes.legend(frameon=False)
    return figure
