"""Draw whether each step of the loop pays: errors with each model of the plant over the declared one's.

Points are geometric means over the plants of the ratio to the declared model, with 95 % intervals by a
bootstrap over the plants and, of agents, the seeds that both have.
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.gap.entries import MODELS
from benchmarks.gap.results import interval, plant_scores
from benchmarks.gap.summary import by_entry, of_same_seeds
from benchmarks.results_file import save_figure
from tests.reference_simulator import Array
from tools.repository import FIGURES

COLORS = {
    "pid": "#1f77b4",
    "predictive": "#d62728",
    "adaptive-pid": "#2ca02c",
    "ppo_mix": "#9467bd",
    "apg_mix": "#ff7f0e",
}
LARGEST_OFFSET = 0.12  # of the points of a step, so that intervals do not cover each other


def draw(contents: dict[str, dict[str, Any]]) -> Path:
    """Draw the ratios of every step.

    Args:
        contents: Result files by name.

    Returns:
        Path of the figure.
    """
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 2, figsize=(9.0, 3.8), layout="constrained")
    files = by_entry(contents)
    scores = {name: [plant_scores(content) for content in of_seeds] for name, of_seeds in files.items()}
    shown = [name for name in COLORS if name in files and f"{name}-corrected" in files]
    # The same plants for all points; entries that have not been scored on all of them are left out.
    plants = sorted(set.intersection(*(set(s) for name in shown for s in scores[f"{name}-corrected"])))
    scores = {name: of for name, of in scores.items() if all(set(plants) <= set(s) for s in of)}
    models = (*MODELS, "online")
    steps = ["declared", *(model for model in models if any(f"{name}-{model}" in scores for name in shown))]
    entries = {name: [name if step == "declared" else f"{name}-{step}" for step in steps] for name in shown}
    offsets = np.linspace(-LARGEST_OFFSET, LARGEST_OFFSET, max(len(shown), 2))
    for offset, (name, names) in zip(offsets, entries.items(), strict=False):
        present = [i for i, entry in enumerate(names) if entry in scores]
        for axis, field in zip(axes, ("settling_s", "circle_mm"), strict=True):
            points = []
            for i in present:
                pairs = zip(*of_same_seeds(files[names[i]], files[name]), strict=True)
                means = [[_means(content, plants, field) for content in pair] for pair in pairs]
                points.append(interval([np.log(model / declared) for model, declared in means]))
            mean, low, high = np.exp(points).T
            at, error = np.array(present) + offset, [mean - low, high - mean]
            axis.errorbar(at, mean, error, fmt="o", color=COLORS[name], capsize=2, markersize=4, label=name)
            for k, (first, second) in enumerate(pairwise(present)):
                # Each model adds to the one before it, but the online one, which replaces the recordings.
                if second == first + 1 and steps[second] != "online":
                    axis.plot(at[k : k + 2], mean[k : k + 2], color=COLORS[name])
    axes[0].set_ylabel("settling time over declared model's")
    axes[1].set_ylabel("path error over declared model's")
    for axis in axes:
        axis.set_xticks(range(len(steps)), steps)
        axis.grid(axis="y", linewidth=0.4)
        axis.spines[["top", "right"]].set_visible(False)
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=4, frameon=False)
    axes[0].set_title(f"{len(plants)} plants: moves", fontsize=10)
    axes[1].set_title(f"{len(plants)} plants: circle", fontsize=10)
    path = FIGURES / "gap.png"
    save_figure(figure, path)
    return path


def _means(content: dict[str, Any], plants: list[int], field: str) -> Array:
    """Return the means over the episodes of each plant of a field of its scores, shape (plants,)."""
    scores = plant_scores(content)
    return np.array([getattr(scores[plant], field).mean() for plant in plants])
