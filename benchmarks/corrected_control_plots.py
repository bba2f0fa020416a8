"""Draw the results of corrected_control: each controller on each rig, by the machine of its design."""

from __future__ import annotations

from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from benchmarks.results_file import save_figure
from tools.repository import FIGURES

COLORS = {"declared": "#c4513d", "refitted": "#e0b04c", "corrected": "#3b7d4f"}
PANELS = {
    "pid": "PID: settling time to 0.2 mm, s",
    "adaptive-pid": "adaptive PID: settling time, s",
    "predictive": "predictive: settling time, s",
    "apg_mix": "weighted laws (apg_mix): settling time, s",
    "residual": "adaptive PID + PPO correction: settling time, s",
    "ppo": "PPO: settling time, s",
    "pid, circle": "PID on a circle: rms contour error, mm",
    "adaptive-pid, circle": "adaptive PID on a circle: rms contour error, mm",
    "predictive, circle": "predictive on a circle: rms contour error, mm",
}


def draw(rigs: dict[str, Any], decides: dict[str, str]) -> None:
    """Write docs/figures/corrected_control.png: means and 95 % intervals.

    Args:
        rigs: Results by rig.
        decides: The decisive score by controller.
    """
    FIGURES.mkdir(parents=True, exist_ok=True)
    size = (10, 3.0 * (0.35 * len(rigs) + 1.0))
    figure, axes = plt.subplots(3, len(PANELS) // 3, figsize=size, sharey=True, layout="constrained")
    for panel, (kind, label) in zip(axes.flat, PANELS.items(), strict=True):
        evaluated = [(index, row[kind]) for index, row in enumerate(rigs.values()) if kind in row]
        for shift, (machine, color) in zip((-0.2, 0.0, 0.2), COLORS.items(), strict=True):
            scores = [result["scores"][machine][decides[kind]] for _, result in evaluated]
            mean = np.array([s["mean"] for s in scores])
            bars = np.abs(np.array([s["ci95"] for s in scores]).reshape(-1, 2).T - mean)
            rows = np.array([index for index, _ in evaluated]) + shift
            panel.errorbar(mean, rows, xerr=bars, fmt="o", ms=4, lw=1.2, color=color, label=machine)
        panel.set_xlabel(label, fontsize=8)
        if kind.endswith("circle"):
            panel.set_xscale("log")
        else:
            panel.set_xlim(left=0.0)
        panel.grid(axis="x", color="0.9")
    names = [row["hides"].replace(" + ", "\n") for row in rigs.values()]
    for first in axes[:, 0]:
        first.set_yticks(np.arange(len(rigs)), names, fontsize=8)
    axes[0, 0].invert_yaxis()
    axes[0, 1].legend(ncols=3, fontsize=8, loc="lower center", bbox_to_anchor=(0.5, 1.0), frameon=False)
    save_figure(figure, FIGURES / "corrected_control.png")
