"""Draw the results of the closed-loop benchmark: each controller on each rig, by the machine of its design."""

from __future__ import annotations

from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from benchmarks.results_file import FIGURES, save_figure

COLORS = {"declared": "#c4513d", "refitted": "#e0b04c", "corrected": "#3b7d4f"}
PANELS = {
    "pid": "PID: settling time to 0.2 mm, s",
    "adaptive-pid": "adaptive PID: settling time, s",
    "residual": "adaptive PID + PPO correction: settling time, s",
    "ppo": "PPO: settling time, s",
    "pid, circle": "PID on a circle: rms contour error, mm",
    "adaptive-pid, circle": "adaptive PID on a circle: rms contour error, mm",
}


def draw(rigs: dict[str, Any], decides: dict[str, str]) -> None:
    """Write docs/figures/closed_loop.png: means and 95 % intervals.

    Args:
        rigs: Results by rig.
        decides: The decisive score by controller.
    """
    FIGURES.mkdir(parents=True, exist_ok=True)
    size = (19, 0.5 * len(rigs) + 1.4)
    figure, axes = plt.subplots(1, len(PANELS), figsize=size, sharey=True, layout="constrained")
    for panel, (kind, label) in zip(axes, PANELS.items(), strict=True):
        for shift, (machine, color) in zip((-0.2, 0.0, 0.2), COLORS.items(), strict=True):
            scores = [row[kind]["scores"][machine][decides[kind]] for row in rigs.values()]
            mean = np.array([s["mean"] for s in scores])
            bars = np.abs(np.array([s["ci95"] for s in scores]).T - mean)
            rows = np.arange(len(rigs)) + shift
            panel.errorbar(mean, rows, xerr=bars, fmt="o", ms=4, lw=1.2, color=color, label=machine)
        panel.set_xlabel(label, fontsize=8)
        if kind.endswith("circle"):
            panel.set_xscale("log")
        else:
            panel.set_xlim(left=0.0)
        panel.grid(axis="x", color="0.9")
    axes[0].set_yticks(np.arange(len(rigs)), [row["hides"].replace(" + ", "\n") for row in rigs.values()], fontsize=8)
    axes[0].invert_yaxis()
    axes[1].legend(ncols=3, fontsize=8, loc="lower center", bbox_to_anchor=(0.5, 1.0), frameon=False)
    save_figure(figure, FIGURES / "closed_loop.png")
