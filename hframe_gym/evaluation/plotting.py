"""Plot of one episode: path of the tool, error over time, voltages."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ..atomic_files import atomic_file
from .metrics import BANDS
from .scenario import Episodes

SMALLEST_ERROR_MM = 1e-3  # mm, lower end of the logarithmic error axis


def plot_episode(episodes: Episodes, episode: int = 0, *, title: str = "") -> Any:
    """Plot one episode in three panels: tool path, distance to the goal (and to the path) over time, and voltages.

    Args:
        episodes: Recorded episodes.
        episode: Index of the episode, from 0 to the number of episodes - 1.
        title: Title of the figure; empty for none.

    Returns:
        A matplotlib figure.

    Raises:
        ImportError: If matplotlib is not installed; the message names the extra.
        IndexError: If `episode` is out of range.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise ImportError("plots need matplotlib: pip install 'hframe_gym[report]'") from error
    if not 0 <= episode < len(episodes.position):
        raise IndexError(f"episode {episode} of {len(episodes.position)}")
    figure = Figure(figsize=(11, 3.6), layout="constrained")
    path_axes, error_axes, voltage_axes = figure.subplots(1, 3)
    _plot_path(path_axes, episodes, episode)
    _plot_error(error_axes, episodes, episode)
    _plot_voltages(voltage_axes, episodes, episode)
    if title:
        figure.suptitle(title)
    return figure


def _plot_path(axes: Any, episodes: Episodes, episode: int) -> None:
    """Plot the path of the tool, with its start and its goal or the goal's path."""
    position, goal = 1e3 * episodes.position[episode], 1e3 * episodes.goal[episode]
    if episodes.contour is not None:
        axes.plot(*goal.T, color="0.6", lw=2.5, label="path")
    axes.plot(*position.T, lw=1.2)
    axes.plot(*position[0], "o", ms=4, label="start")
    if episodes.contour is None:
        axes.plot(*goal[-1], "x", ms=7, label="goal")
    axes.set(xlabel="x (mm)", ylabel="y (mm)", aspect="equal", adjustable="datalim")
    axes.legend(frameon=False)


def _plot_error(axes: Any, episodes: Episodes, episode: int) -> None:
    """Plot the distance to the goal, and to the path if there is one, with the settling bands."""
    time_s, error_mm = episodes.time_s, 1e3 * episodes.goal_error[episode]
    axes.semilogy(time_s, np.maximum(error_mm, SMALLEST_ERROR_MM), lw=1.2, label="to the goal")
    if episodes.contour is not None:
        contour_mm = 1e3 * episodes.contour[episode]
        axes.semilogy(time_s, np.maximum(contour_mm, SMALLEST_ERROR_MM), lw=1.2, label="to the path")
        axes.legend(frameon=False, ncols=2, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    for name, band in BANDS.items():
        axes.axhline(1e3 * band, color="0.6", lw=0.7, ls="--")
        axes.annotate(name, (time_s[-1], 1e3 * band), ha="right", va="bottom", fontsize=7, color="0.4")
    axes.set(xlabel="time (s)", ylabel="distance to the goal (mm)" if episodes.contour is None else "distance (mm)")


def _plot_voltages(axes: Any, episodes: Episodes, episode: int) -> None:
    """Plot the voltages of the drives and their rated values."""
    time_s, volts = episodes.time_s, episodes.volts[episode]
    period = (time_s[-1] - time_s[0]) / len(volts)
    edges = time_s[0] + period * np.arange(len(volts) + 1)
    for j in range(volts.shape[1]):
        axes.stairs(volts[:, j], edges, baseline=None, lw=1.2, label=f"drive {j + 1}")
    for limit in {float(v) for v in episodes.rated}:
        axes.axhline(limit, color="0.6", lw=0.7, ls="--")
        axes.axhline(-limit, color="0.6", lw=0.7, ls="--")
    axes.set(xlabel="time (s)", ylabel="voltage (V)")
    axes.legend(frameon=False)


def save_plot(path: str | Path, episodes: Episodes, episode: int = 0, *, title: str = "") -> None:
    """Write the plot of one episode to a file; if this fails, an existing file stays unchanged.

    Args:
        path: File to write; the suffix is .png, .svg or .pdf.
        episodes: Recorded episodes.
        episode: Index of the episode, from 0 to the number of episodes - 1.
        title: Title of the figure; empty for none.

    Raises:
        ImportError: If matplotlib is not installed; the message names the extra.
        IndexError: If `episode` is out of range.
        OSError: If the file cannot be written.
    """
    figure = plot_episode(episodes, episode, title=title)
    with atomic_file(path) as temporary:
        figure.savefig(temporary, dpi=150)
