"""Draw whether each step of the loop pays: declared, plain fit, corrected, posterior, online, for each controller."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.gap.results import interval, plant_scores
from benchmarks.gap.summary import STEPS
from benchmarks.results_file import FIGURES, save_figure

CONTROLLERS = ("pid", "predictive", "adaptive-pid", "textbook-pid")
COLORS = {"pid": "#1f77b4", "predictive": "#d62728", "adaptive-pid": "#2ca02c", "textbook-pid": "#9467bd"}


def draw(contents: dict[str, dict[str, Any]]) -> Path:
    """Draw the scores of every step, with 95 % intervals over the plants.

    Args:
        contents: Result files by the name of the entry.

    Returns:
        Path of the figure.
    """
    import matplotlib.pyplot as plt

    steps = ("declared", *STEPS)
    figure, axes = plt.subplots(1, 2, figsize=(9.0, 3.6))
    shown = [name for name in CONTROLLERS if name in contents]
    for offset, name in zip(np.linspace(-0.12, 0.12, max(len(shown), 2)), shown, strict=False):
        names = [name if step == "declared" else f"{name}-{step}" for step in steps]
        rows = [(i, plant_scores(contents[entry])) for i, entry in enumerate(names) if entry in contents]
        at = np.array([i for i, _ in rows]) + offset
        moves = [interval([s.over_bound for s in scores.values()]) for _, scores in rows]
        circles = [interval([float(s.circle_mm.mean()) for s in scores.values()]) for _, scores in rows]
        for axis, values, scale in zip(axes, (moves, circles), (1.0, 1e3), strict=True):
            mean, low, high = scale * np.array(values).T
            error = [mean - low, high - mean]
            axis.errorbar(at, mean, error, fmt="o-", color=COLORS[name], capsize=2, markersize=4, label=name)
    axes[0].axhline(1.0, color="0.5", linewidth=0.8)
    axes[0].set_ylabel("settling time over the bound")
    axes[1].set_ylabel("distance to the circle, um rms")
    axes[1].set_ylim(bottom=0.0)
    for axis in axes:
        axis.set_xticks(range(len(steps)), steps)
        axis.grid(axis="y", linewidth=0.4)
        axis.spines[["top", "right"]].set_visible(False)
    axes[1].legend(frameon=False)
    axes[0].set_title("24 plants: moves", fontsize=10)
    axes[1].set_title("24 plants: circle", fontsize=10)
    figure.tight_layout()
    path = FIGURES / "gap.png"
    save_figure(figure, path)
    return path
