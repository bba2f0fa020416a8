"""Means of the simulation error over position and speed, with the region of 99 % of white noise."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import signal

from ....arrays import Array
from ....machine import Machine
from ....recordings import split_unit
from ....web_page import Panel, color, number
from ..content.document import Report
from ..content.result_curves import ResultCurves
from ..units import readable_unit
from .correlations import CONFIDENCE

_BINS = 40  # intervals of position or speed, of equal width
_MIN_ROWS = 20  # of an interval, so that its mean has a normal distribution whatever the noise is
# s, over which a position is averaged before its speed is computed: noise of 20 um becomes about 1 mm/s at
# 1 kHz.
_SMOOTHED_S = 0.02


def error_panels(report: Report, curves: ResultCurves, machine: Machine) -> list[Panel]:
    """Prepare plots of each channel's simulation error over its measurement, and of positions over speed.

    They show means of the errors of the delivered machine in intervals of this variable, over all held-out
    runs, with the band in which 99 % of those of white noise lie. The measurements, not the simulated values,
    are used, so that the axes do not depend on the machine.

    Args:
        report: Content of report.json.
        curves: Curves of the same result.
        machine: Identified machine, with its sensors.

    Returns:
        The panels; a channel that does not move has none.
    """
    panels = []
    of_position = {sensor.channel: sensor.of_position for sensor in machine.sensors}
    for j, channel in enumerate(report.channels):
        held_out = [curves.runs[name] for name in report.runs.held_out]
        runs = [(run.time_s, run.measured[:, j], run.errors["after"][:, j]) for run in held_out]
        errors = np.concatenate([error for _, _, error in runs])
        values = {"": np.concatenate([measured for _, measured, _ in runs])}
        if of_position[channel]:
            values["speed of "] = np.concatenate([_speed(time_s, measured) for time_s, measured, _ in runs])
        noise = report.noise_of(channel)
        for prefix, against in values.items():
            if panel := _panel(channel, prefix, against, errors, noise):
                panels.append(panel)
    return panels


def _speed(time_s: Array, measured: Array) -> Array:
    """Return the speed of a smoothed position; NaN where it was not measured."""
    known = np.isfinite(measured)
    period = float(np.median(np.diff(time_s)))
    width = max(5, 2 * round(0.5 * _SMOOTHED_S / period) + 1)
    if known.sum() < width:
        return np.full(len(measured), np.nan)
    filled = np.interp(time_s, time_s[known], measured[known])
    speed = signal.savgol_filter(filled, width, 2, deriv=1, delta=period)
    return np.where(known, speed, np.nan)


def _panel(channel: str, prefix: str, against: Array, errors: Array, noise: float | None) -> Panel | None:
    """Return the plot of an error over a variable, None if the variable does not change."""
    known = np.isfinite(errors) & np.isfinite(against)
    if known.sum() < _MIN_ROWS or np.ptp(against[known]) == 0.0:
        return None
    counts, edges = np.histogram(against[known], _BINS)
    sums, _ = np.histogram(against[known], edges, weights=errors[known])
    used = counts >= _MIN_ROWS
    if not used.any():
        return None
    means = np.where(used, sums / np.maximum(counts, 1), np.nan)
    limits = np.where(used, CONFIDENCE * (noise or 0.0) / np.sqrt(np.maximum(counts, 1)), np.nan)
    largest = float(np.nanmax(np.abs(means)))
    factor, unit = readable_unit(channel, largest)
    name, base = split_unit(channel)
    variable = f"{prefix}{name}"

    def draw(axes: Any) -> None:
        centers, widths = 0.5 * (edges[1:] + edges[:-1]), np.diff(edges)
        if noise:
            bands = 2.0 * factor * limits[used]
            axes.bar(centers[used], bands, widths[used], -0.5 * bands, color=color("muted"), alpha=0.3, lw=0)
        axes.plot(centers, factor * means, "o-", ms=3, lw=1.1, color=color("after"))
        axes.set(xlabel=f"{variable}, {base}{'/s' if prefix else ''}", ylabel=f"mean error of {name}, {unit}")
        axes.margins(x=0.02)

    size = f"at most {number(factor * largest)} {unit}"
    if noise:
        outside = float(np.mean(np.abs(means[used]) > limits[used]))
        size += f"; outside the band: {number(100.0 * outside)} %"
    description = f"Mean error of {channel} over the {variable or 'value'}: {size}."
    return Panel(f"Error of {name} over {variable}: {size}", description, draw, 2.3)
