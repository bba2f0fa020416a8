"""Draw the results of the identification benchmark: counts by set, error before and after, computing time."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from benchmarks.results_file import save_figure
from benchmarks.scoring import SCORES
from tools.repository import FIGURES

COLORS = dict(zip(SCORES, ("#3b7d4f", "#c9c9c9", "#9fc2a8", "#e0b04c", "#c4513d", "#7a1f12"), strict=True))
_MIN_UM = 0.05  # lower errors are drawn at this value


def draw(rows: list[dict[str, Any]]) -> None:
    """Write the figures to docs/figures/.

    Args:
        rows: Results, one row per rig.
    """
    FIGURES.mkdir(parents=True, exist_ok=True)
    _counts(rows, FIGURES / "identification_hits.png")
    _errors(rows, FIGURES / "identification_errors.png")
    _time(rows, FIGURES / "identification_time.png")


def _counts(rows: list[dict[str, Any]], path: Path) -> None:
    """Draw the number of rigs by set and score."""
    groups = list(dict.fromkeys(r["group"] for r in rows))
    figure, axes = plt.subplots(figsize=(7, 0.45 * len(groups) + 1.2), layout="constrained")
    start = np.zeros(len(groups))
    for score in SCORES:
        counts = np.array([sum(r["group"] == g and r["score"] == score for r in rows) for g in groups])
        axes.barh(groups, counts, left=start, color=COLORS[score], label=score)
        start += counts
    axes.invert_yaxis()
    axes.set_xlabel("rigs")
    axes.legend(ncols=len(SCORES), fontsize=7, loc="lower center", bbox_to_anchor=(0.5, 1.0), frameon=False)
    save_figure(figure, path)


def _errors(rows: list[dict[str, Any]], path: Path) -> None:
    """Draw the tool error with the identified effects over that without."""
    figure, axes = plt.subplots(figsize=(5, 4.5), layout="constrained")
    for score in SCORES:
        some = [r["truth_um"] for r in rows if r["score"] == score]
        if some:
            before, after = (np.maximum([e[k] for e in some], _MIN_UM) for k in ("before", "after"))
            axes.loglog(before, after, "o", ms=4, color=COLORS[score], label=score)
    ends = np.array([_MIN_UM, 1e4])
    axes.loglog(ends, ends, color="0.7", lw=0.8)
    axes.axhline(20.0, color="0.7", lw=0.8, ls="--")
    axes.text(_MIN_UM, 22.0, " laser noise", fontsize=7, color="0.4")
    axes.set_xlabel("tool error of the refitted declared machine, \u00b5m rms")
    axes.set_ylabel("with the identified effects, \u00b5m rms")
    axes.legend(fontsize=7)
    save_figure(figure, path)


def _time(rows: list[dict[str, Any]], path: Path) -> None:
    """Draw the histogram of the computing times."""
    figure, axes = plt.subplots(figsize=(5, 3), layout="constrained")
    axes.hist([r["cpu_seconds"] for r in rows], bins=30, color="#3b7d4f")
    axes.set_xlabel("identification of one rig, processor seconds")
    axes.set_ylabel("rigs")
    save_figure(figure, path)
