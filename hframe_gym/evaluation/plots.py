"""Plots of recorded episodes and of scores, as picture files and as panels of the scorecard page."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import naming_extra
from ..files import atomic_file
from ..machine import AxisUnit
from ..web_page import SERIES, Panel, color, legend_above, number, plot_style
from .episodes import Episodes
from .metrics import settling_times
from .reported_scores import unit_of_scores

SMALLEST_ERROR_MM = 1e-3  # mm or mrad, lower end of the logarithmic error axis of a plot


def plot_episode(episodes: Episodes, episode: int = 0, *, title: str = "") -> Any:
    """Plot an episode as a matplotlib figure: tool path, distance to the goal (and path) over time, commands.

    For a machine with one axis, the first panel shows the position over time.

    Args:
        episode: Index of the episode, from 0.
        title: Title above the plots. Default: none.

    Raises:
        ImportError: If matplotlib is not installed; the message names the extra.
        IndexError: If `episode` is out of range.
    """
    with naming_extra("report", "plots need matplotlib"):
        import matplotlib
        from matplotlib.figure import Figure
    if not 0 <= episode < len(episodes.position):
        raise IndexError(f"episode {episode} of {len(episodes.position)}")
    with matplotlib.rc_context(plot_style()):
        figure = Figure(figsize=(11, 3.6), layout="constrained")
        path_axes, error_axes, command_axes = figure.subplots(1, 3)
        _plot_path(path_axes, episodes, episode)
        _plot_error(error_axes, episodes, episode)
        _plot_commands(command_axes, episodes, episode)
        if title:
            figure.suptitle(title)
    return figure


def save_plot(path: str | Path, episodes: Episodes, episode: int = 0, *, title: str = "") -> None:
    """Save the plot of one episode (`plot_episode`) as a .png, .svg or .pdf file.

    Args:
        path: File to write; its suffix selects the format. Its folder is created if necessary. An existing
            file is replaced, or unchanged if writing fails.
        episode: Index of the episode, from 0.
        title: Title above the plots. Default: none.

    Raises:
        ImportError: If matplotlib is not installed; the message names the extra.
        IndexError: If `episode` is out of range.
        ValueError: If matplotlib does not know the format of the suffix.
        OSError: If the file cannot be written.
    """
    figure = plot_episode(episodes, episode, title=title)
    with atomic_file(path) as file:
        figure.savefig(file, dpi=150, format=Path(path).suffix[1:])


def _plot_path(axes: Any, episodes: Episodes, episode: int) -> None:
    """Plot the path of the tool, with its start and its goal or the goal's path; one axis over time."""
    position, goal = 1e3 * episodes.position[episode], 1e3 * episodes.goal[episode]
    if position.shape[1] == 1:
        axes.plot(episodes.time_s, position[:, 0], lw=1.2, label="tool")
        axes.plot(episodes.time_s, goal[:, 0], color=color("muted"), lw=0.7, ls="--", label="goal")
        axes.set(xlabel="time, s", ylabel=f"position, {episodes.unit.small}")
        legend_above(axes)
        return
    if episodes.contour is not None:
        axes.plot(*goal.T, color=color("declared"), lw=2.5, label="path")
    axes.plot(*position.T, lw=1.2)
    axes.plot(*position[0], "o", ms=4, label="start")
    if episodes.contour is None:
        axes.plot(*goal[-1], "x", ms=7, label="goal")
    small = episodes.unit.small
    axes.set(xlabel=f"x, {small}", ylabel=f"y, {small}", aspect="equal", adjustable="datalim")
    legend_above(axes)


def _plot_error(axes: Any, episodes: Episodes, episode: int) -> None:
    """Plot the distance to the goal, and to the path if there is one, with the settling bands."""
    time_s, error_mm = episodes.time_s, 1e3 * episodes.goal_error[episode]
    axes.semilogy(time_s, np.maximum(error_mm, SMALLEST_ERROR_MM), lw=1.2, label="to the goal")
    if episodes.contour is not None:
        contour_mm = 1e3 * episodes.contour[episode]
        axes.semilogy(time_s, np.maximum(contour_mm, SMALLEST_ERROR_MM), lw=1.2, label="to the path")
        legend_above(axes)
    _mark_bands(axes, episodes.unit)
    to_goal = " to the goal" if episodes.contour is None else ""
    axes.set(xlabel="time, s", ylabel=f"distance{to_goal}, {episodes.unit.small}")


def _mark_bands(axes: Any, unit: AxisUnit) -> None:
    """Draw the settling bands as horizontal lines named beside the plot, and label the axis in mm."""
    for name, text in unit.band_texts.items():
        height = 1e3 * unit.bands[name]
        axes.axhline(height, color=color("muted"), lw=0.7, ls="--")
        place = {"xycoords": ("axes fraction", "data"), "xytext": (3, 0), "textcoords": "offset points"}
        axes.annotate(text, (1.0, height), va="center", fontsize=7, color=color("muted"), **place)
    axes.yaxis.set_major_formatter(lambda value, _: number(value))
    axes.minorticks_off()


def _plot_commands(axes: Any, episodes: Episodes, episode: int) -> None:
    """Plot the commands of the drives and their rated values."""
    time_s, volts = episodes.time_s, episodes.volts[episode]
    period = (time_s[-1] - time_s[0]) / len(volts)
    edges = time_s[0] + period * np.arange(len(volts) + 1)
    for j in range(volts.shape[1]):
        axes.stairs(volts[:, j], edges, baseline=None, lw=1.2, label=f"drive {j + 1}")
    for limit in {float(v) for v in episodes.rated}:
        axes.axhline(limit, color=color("muted"), lw=0.7, ls="--")
        axes.axhline(-limit, color=color("muted"), lw=0.7, ls="--")
    axes.set(xlabel="time, s", ylabel=f"{episodes.command.label} (dashed: rated)")
    legend_above(axes)


def _point(position: NDArray[np.float64]) -> str:
    """Format a position, one or two coordinates in mm: "12" or "(12, -3)"."""
    texts = [f"{value:.0f}" for value in position]
    return texts[0] if len(texts) == 1 else f"({', '.join(texts)})"


def episode_panels(name: str, episodes: Episodes, episode: int) -> list[Panel]:
    """Prepare the plots of an episode for the scorecard: tool path, distance over time, commands.

    Args:
        name: Name of the controller, for the captions.
        episodes: Episodes of this controller.
        episode: Index of the episode, from 0.
    """
    start, goal = 1e3 * episodes.position[episode, 0], 1e3 * episodes.goal[episode, -1]
    final_mm = 1e3 * float(episodes.goal_error[episode, -1])
    small = episodes.unit.small
    route = f"from {_point(start)} {small}"
    route += f" to the goal at {_point(goal)} {small}" if episodes.contour is None else " along the path"
    command, largest = episodes.command, float(np.abs(episodes.volts[episode]).max())
    return [
        Panel(
            f"{name}: tool path",
            f"Path of the tool under {name}, {route}.",
            lambda a: _plot_path(a, episodes, episode),
            2.6,
        ),
        Panel(
            f"{name}: distance to the goal",
            f"Distance of the tool to its goal over time under {name}, "
            f"{number(final_mm)} {small} at the end.",
            lambda a: _plot_error(a, episodes, episode),
            2.6,
        ),
        Panel(
            f"{name}: {command.name}s",
            f"Commands of the drives ({command.label}) over time under {name}, at most {number(largest)}.",
            lambda a: _plot_commands(a, episodes, episode),
            2.6,
        ),
    ]


def distance_panel(recorded: Mapping[str, Episodes]) -> Panel:
    """Prepare a plot for the scorecard: distance to the goal over time in the first episode, mm or mrad.

    Args:
        recorded: Episodes by name of the controller, at least one; each is a curve.
    """
    unit = next(iter(recorded.values())).unit

    def draw(axes: Any) -> None:
        for name, episodes in recorded.items():
            error_mm = np.maximum(1e3 * episodes.goal_error[0], SMALLEST_ERROR_MM)
            axes.semilogy(episodes.time_s, error_mm, lw=1.2, label=name)
        _mark_bands(axes, unit)
        axes.set(xlabel="time, s", ylabel=f"distance to the goal, {unit.small}")
        legend_above(axes)

    errors = {name: 1e3 * float(episodes.goal_error[0, -1]) for name, episodes in recorded.items()}
    ends = ", ".join(f"{name} {number(error)} {unit.small}" for name, error in errors.items())
    return Panel(
        "Distance to the goal in the first episode", f"Distance over time; at the end: {ends}.", draw, 2.6
    )


def distribution_panel(recorded: Mapping[str, Episodes]) -> Panel:
    """Prepare a plot for the scorecard: distribution of settling times, or of contour errors on a path.

    A curve shows the fraction of the episodes that have settled until a time, or whose error is at most a
    value. It ends below 100 % if some episodes do not settle.

    Args:
        recorded: Episodes by name of the controller, at least one; each is a curve.
    """
    first = next(iter(recorded.values()))
    path, unit = first.contour is not None, first.unit
    curves, texts = {}, []
    for name, episodes in recorded.items():
        if episodes.contour is not None:
            values = np.sort(1e3 * np.sqrt(np.mean(episodes.contour**2, axis=1)))
        else:
            times, success = settling_times(episodes.goal_error, episodes.time_s, unit.bound_size)
            values = np.sort(times[success])
        curves[name] = values, 100.0 * np.arange(1, len(values) + 1) / len(episodes.position)
        if len(values):
            spread = "to".join(f" {number(float(q))} " for q in np.quantile(values, (0.05, 0.5, 0.95)))
            texts.append(f"{name}{spread}".rstrip())
    what = (
        f"rms contour error, {unit.small}"
        if path
        else f"settling time to {unit.band_texts[unit.bound_band]}, s"
    )

    def draw(axes: Any) -> None:
        for name, (values, fractions) in curves.items():
            axes.step(values, fractions, where="post", lw=1.4, label=name)
        axes.set(xlabel=what, ylabel="% of the episodes", ylim=(0, 102))
        legend_above(axes)

    title = "Distribution of the contour errors" if path else "Distribution of the settling times"
    quantiles = f"5, 50 and 95 % quantiles: {'; '.join(texts) or 'none'}"
    return Panel(title, f"{title}: {what}, over the episodes. {quantiles}.", draw, 2.6)


def interval_panel(title: str, unit: str, scores: Mapping[str, Mapping[str, Any] | None]) -> Panel:
    """Prepare a plot for the scorecard: mean of a metric by controller, with 95 % confidence intervals.

    Args:
        title: Caption, the name of the metric.
        unit: Unit of the values; empty for a ratio.
        scores: By name of the controller, `mean` and `ci95` (lower and upper limit), in `unit`; None if the
            controller has no value.
    """
    known = {name: score for name, score in scores.items() if score}

    def draw(axes: Any) -> None:
        for row, (name, score) in enumerate(known.items()):
            tone = color(SERIES[list(scores).index(name) % len(SERIES)])
            axes.plot(score["ci95"], [row, row], color=tone, lw=3, solid_capstyle="butt", alpha=0.6)
            axes.plot(score["mean"], row, "o", ms=6, color=tone)
            axes.annotate(
                number(score["mean"]), (score["mean"], row), (0, 7), textcoords="offset points", ha="center"
            )
        axes.set(
            yticks=range(len(known)), yticklabels=list(known), xlabel=f"mean, {unit}" if unit else "mean"
        )
        axes.set_ylim(len(known) - 0.5, -0.7)
        axes.margins(x=0.15)
        axes.grid(False, axis="y")

    values = "; ".join(
        f"{name} {number(s['mean'])} {unit} (95 % interval {number(s['ci95'][0])} to {number(s['ci95'][1])})"
        for name, s in known.items()
    )
    return Panel(title, f"{title}, mean over the episodes: {values}.", draw, 0.75 + 0.42 * max(1, len(known)))


def success_panel(title: str, success: Mapping[str, Mapping[str, float]]) -> Panel:
    """Prepare a bar chart for the scorecard: fraction of successful episodes by controller and band.

    Args:
        title: Caption.
        success: Fractions, 0 to 1, by name of the controller, at least one, and of the band, such as "0.2mm".
    """
    texts = unit_of_scores(next(iter(success.values()))).band_texts
    bands = list(texts)

    def draw(axes: Any) -> None:
        height = 0.8 / len(success)
        for k, (name, by_band) in enumerate(success.items()):
            rows = np.arange(len(bands)) + height * (k - (len(success) - 1) / 2)
            values = [100 * by_band[band] for band in bands]
            bars = axes.barh(rows, values, 0.9 * height, color=color(SERIES[k % len(SERIES)]), label=name)
            axes.bar_label(bars, fmt="%.0f", padding=2, fontsize=7)
        axes.set(
            yticks=range(len(bands)),
            yticklabels=list(texts.values()),
            xlim=(0, 112),
            xlabel="% of the episodes",
        )
        axes.invert_yaxis()
        axes.grid(False, axis="y")
        legend_above(axes)

    values = "; ".join(
        f"{name}: " + ", ".join(f"{100 * by_band[band]:.1f} % within {text}" for band, text in texts.items())
        for name, by_band in success.items()
    )
    return Panel(title, f"{title}. {values}.", draw, 1.3 + 0.4 * len(success))
