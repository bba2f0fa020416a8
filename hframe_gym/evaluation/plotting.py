"""A picture of one episode: the way of the tool, the error over time, the voltages."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ..atomic_files import whole_file
from .episodes import Episodes
from .metrics import BANDS

FLOOR = 1e-3  # mm, least error that is drawn


def draw(run: Episodes, episode: int = 0, *, title: str = "") -> Any:
    """A matplotlib figure of one episode: the tool's way, its distance to the goal and to the path (log), voltages.

    Raises ImportError naming the extra where matplotlib is not installed, IndexError for an episode that is not there.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise ImportError("pictures need matplotlib: pip install 'hframe_gym[report]'") from error
    if not 0 <= episode < len(run.position):
        raise IndexError(f"episode {episode} of {len(run.position)}")
    position, goal, volts = 1e3 * run.position[episode], 1e3 * run.goal[episode], run.volts[episode]
    figure = Figure(figsize=(11, 3.6), layout="constrained")
    path, distance, voltage = figure.subplots(1, 3)
    moves = run.contour is not None
    if moves:
        path.plot(*goal.T, color="0.6", lw=2.5, label="path")
    path.plot(*position.T, lw=1.2)
    path.plot(*position[0], "o", ms=4, label="start")
    if not moves:
        path.plot(*goal[-1], "x", ms=7, label="goal")
    path.set(xlabel="x (mm)", ylabel="y (mm)", aspect="equal", adjustable="datalim")
    path.legend(frameon=False)
    off = np.linalg.norm(position - goal, axis=1)
    distance.semilogy(run.time_s, np.maximum(off, FLOOR), lw=1.2, label="to the goal")
    if run.contour is not None:
        distance.semilogy(run.time_s, np.maximum(1e3 * run.contour[episode], FLOOR), lw=1.2, label="to the path")
        distance.legend(frameon=False, ncols=2, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    for name, band in BANDS.items():
        distance.axhline(1e3 * band, color="0.6", lw=0.7, ls="--")
        distance.annotate(name, (run.time_s[-1], 1e3 * band), ha="right", va="bottom", fontsize=7, color="0.4")
    distance.set(xlabel="time (s)", ylabel="distance (mm)" if moves else "distance to the goal (mm)")
    period = (run.time_s[-1] - run.time_s[0]) / len(volts)
    edges = run.time_s[0] + period * np.arange(len(volts) + 1)
    for j in range(volts.shape[1]):
        voltage.stairs(volts[:, j], edges, baseline=None, lw=1.2, label=f"drive {j + 1}")
    for limit in {float(v) for v in run.rated}:
        voltage.axhline(limit, color="0.6", lw=0.7, ls="--")
        voltage.axhline(-limit, color="0.6", lw=0.7, ls="--")
    voltage.set(xlabel="time (s)", ylabel="voltage (V)")
    voltage.legend(frameon=False)
    if title:
        figure.suptitle(title)
    return figure


def save(path: str | Path, run: Episodes, episode: int = 0, *, title: str = "") -> None:
    """Write the picture of one episode to a file (.png, .svg or .pdf), whole or not at all.

    Raises as `draw` does.
    """
    figure = draw(run, episode, title=title)
    with whole_file(path) as temporary:
        figure.savefig(temporary, dpi=150)
