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
    shown = [name for name in CONTROLLERS if f"{name}-corrected" in contents]
    scores = {name: plant_scores(content) for name, content in contents.items()}
    entries = {name: [name if step == "declared" else f"{name}-{step}" for step in steps] for name in shown}
    # The same plants for all points, where an entry has not been scored on all of them.
    plants = set.intersection(*(set(scores[e]) for names in entries.values() for e in names if e in scores))
    for offset, (name, names) in zip(np.linspace(-0.08, 0.08, max(len(shown), 2)), entries.items(), strict=False):
        present = [
            (i, [scores[entry][plant] for plant in sorted(plants)]) for i, entry in enumerate(names) if entry in scores
        ]
        at = np.array([i for i, _ in present]) + offset
        moves = [interval([float(s.settling_s.mean()) for s in rows]) for _, rows in present]
        circles = [interval([float(s.circle_mm.mean()) for s in rows]) for _, rows in present]
        for axis, values in zip(axes, (moves, circles), strict=True):
            mean, low, high = 1e3 * np.array(values).T
            error = [mean - low, high - mean]
            axis.errorbar(at, mean, error, fmt="o-", color=COLORS[name], capsize=2, markersize=4, label=name)
    axes[0].set_ylabel("settling time within 0.2 mm, ms")
    axes[1].set_ylabel("distance to the circle, um rms")
    axes[1].set_ylim(bottom=0.0)
    for axis in axes:
        axis.set_xticks(range(len(steps)), steps)
        axis.grid(axis="y", linewidth=0.4)
        axis.spines[["top", "right"]].set_visible(False)
    axes[1].legend(frameon=False)
    axes[0].set_title(f"{len(plants)} plants: moves", fontsize=10)
    axes[1].set_title(f"{len(plants)} plants: circle", fontsize=10)
    figure.tight_layout()
    path = FIGURES / "gap.png"
    save_figure(figure, path)
    return path
