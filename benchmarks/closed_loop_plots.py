"""The closed-loop benchmark in one picture: each controller on each rig, by the machine that it was made from."""

from __future__ import annotations

from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from benchmarks.identification_plots import FIGURES

COLOURS = {"declared": "#c4513d", "refitted": "#e0b04c", "corrected": "#3b7d4f"}
PANELS = {
    "pid": "PID: s to settle within 0.2 mm",
    "adaptive-pid": "PID that adapts: the same",
    "residual": "with PPO's correction: the same",
    "ppo": "PPO: the same",
    "pid, circle": "PID on a circle: mm off it, rms",
    "adaptive-pid, circle": "PID that adapts: the same",
}


def draw(rigs: dict[str, Any], decides: dict[str, str]) -> None:
    """Write docs/figures/closed_loop.png for the rigs of the results: means and 95 % intervals.

    decides: by controller the score that it is judged by.
    """
    FIGURES.mkdir(parents=True, exist_ok=True)
    size = (19, 0.5 * len(rigs) + 1.4)
    figure, axes = plt.subplots(1, len(PANELS), figsize=size, sharey=True, layout="constrained")
    for panel, (kind, label) in zip(axes, PANELS.items(), strict=True):
        for shift, (machine, colour) in zip((-0.2, 0.0, 0.2), COLOURS.items(), strict=True):
            scores = [row[kind]["scores"][machine][decides[kind]] for row in rigs.values()]
            mean = np.array([s["mean"] for s in scores])
            bars = np.abs(np.array([s["ci95"] for s in scores]).T - mean)
            places = np.arange(len(rigs)) + shift
            panel.errorbar(mean, places, xerr=bars, fmt="o", ms=4, lw=1.2, color=colour, label=machine)
        panel.set_xlabel(label, fontsize=8)
        if kind.endswith("circle"):
            panel.set_xscale("log")
        else:
            panel.set_xlim(left=0.0)
        panel.grid(axis="x", color="0.9")
    axes[0].set_yticks(np.arange(len(rigs)), [row["hides"].replace(" + ", "\n") for row in rigs.values()], fontsize=8)
    axes[0].invert_yaxis()
    axes[1].legend(ncols=3, fontsize=8, loc="lower center", bbox_to_anchor=(0.5, 1.0), frameon=False)
    figure.savefig(FIGURES / "closed_loop.png", dpi=150, metadata={"Software": None})
    plt.close(figure)
