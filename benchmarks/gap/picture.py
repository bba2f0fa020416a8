"""Draw whether each step of the loop pays: errors with each model of the plant over those with the declared one.

Points are geometric means over the plants of the ratio to the declared model, with 95 % intervals by a bootstrap.
"""

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
    """Draw the ratios of every step.

    Args:
        contents: Result files by the name of the entry.

    Returns:
        Path of the figure.
    """
    import matplotlib.pyplot as plt

    steps = ("declared", *STEPS)
    figure, axes = plt.subplots(1, 2, figsize=(9.0, 3.6))
    shown = [name for name in CONTROLLERS if f"{name}-corrected" in contents]
    scores = {name: plant_scores(content) for name, content in contents.items()}
    entries = {name: [name if step == "declared" else f"{name}-{step}" for step in steps] for name in shown}
    # The same plants for all points, where an entry has not been scored on all of them.
    plants = sorted(
        set.intersection(*(set(scores[e]) for names in entries.values() for e in names if e in scores))
    )
    last = max(i for names in entries.values() for i, entry in enumerate(names) if entry in scores)
    for offset, (name, names) in zip(
        np.linspace(-0.05, 0.05, max(len(shown), 2)), entries.items(), strict=False
    ):
        present = [i for i, entry in enumerate(names) if entry in scores]
        for axis, field in zip(axes, ("settling_s", "circle_mm"), strict=True):
            means = np.array([[getattr(scores[names[i]][p], field).mean() for p in plants] for i in present])
            mean, low, high = np.exp([interval(row) for row in np.log(means / means[0])]).T
            at, error = np.array(present) + offset, [mean - low, high - mean]
            axis.errorbar(at, mean, error, fmt="o-", color=COLORS[name], capsize=2, markersize=4, label=name)
    axes[0].set_ylabel("settling time over declared model's")
    axes[1].set_ylabel("path error over declared model's")
    for axis in axes:
        axis.set_xticks(range(last + 1), steps[: last + 1])
        axis.grid(axis="y", linewidth=0.4)
        axis.spines[["top", "right"]].set_visible(False)
    axes[0].legend(frameon=False)
    axes[0].set_title(f"{len(plants)} plants: moves", fontsize=10)
    axes[1].set_title(f"{len(plants)} plants: circle", fontsize=10)
    figure.tight_layout()
    path = FIGURES / "gap.png"
    save_figure(figure, path)
    return path
