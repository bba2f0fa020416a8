"""Plots of an identification report, as panels for its page and for picture files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ....arrays import Array
from ....effects.smooth_table import TABLE_FAMILY
from ....files import remove_file
from ....machine import AppliedEffect, Machine
from ....web_page import Panel, color, extreme_rows, legend_above, number, save_panels
from ...forces.motion_variables import motor_variable
from ..content.document import Report, compared_machines
from ..content.result_curves import MissingForce, ResultCurves, RunCurves
from ..units import readable_unit
from .correlations import error_correlations
from .effect_curves import effect_curve
from .error_dependence import error_panels

Panels = dict[str, list[Panel]]
_SLOW = 0.05  # Fraction of a coordinate's top speed below which friction shows its behavior at low speed.
_MAX_RUNS = 2  # Held-out runs whose errors are drawn over time.
_MEAN_BINS = 40  # Points of the mean curve through the residual force.
_MAX_DOTS = 1000  # Points of the residual force that a panel shows of each machine.
# Intervals of a curve over time, of which a panel shows the smallest and the largest value.
_MAX_BUCKETS = 350
_UNITS_ANYWHERE = {"current": "A", "torque": "Nm", "power": "W", "dwell": "s"}
_QUANTITIES = {  # of a variable: quantity of the coordinate, and what follows its unit
    "velocity": ("speed", ""),
    "path": ("position", ""),
    "acceleration": ("position", "/s^2"),
    "load": ("force", ""),
    "impulse": ("force", " s"),
    "tension rate": ("force", "/s"),
}


def report_panels(
    report: Report, curves: ResultCurves, machine: Machine, declared: Machine, runs: Sequence[str] = ()
) -> Panels:
    """Prepare an identification report's plots as panels: axes with title, description and drawing function.

    They show the errors by channel and over time, the force that the model lacks (residual force), the tables
    (forces interpolated over one variable), and the positions, velocities and voltages that the recordings
    cover.

    Args:
        machine: Identified machine.
        declared: Machine as given. Effects that only the identified machine has are drawn, named as causes or
            not.
        runs: Names of the held-out runs, those first whose errors are drawn over time. Default: as in the
            report.

    Returns:
        Panels by name of the plot: error_by_channel, error_over_time (one panel per channel for each of the
        first two held-out runs), error_over_motion, correlations (of the errors of the first run),
        residual_force, effects (each over its own variable), tables, coverage. The list of a plot without
        data, such as tables of a machine without tables, is empty.
    """
    present = {effect.label for effect in declared.effects}
    gains = {f"{effect.name}@{effect.site}": effect.held_out_gain for effect in report.effects}
    added = [effect for effect in machine.effects if effect.label not in present]
    added.sort(key=lambda effect: -gains.get(effect.label, 0.0))  # as the page lists them
    effect_curves = (effect_curve(effect, machine, curves) for effect in added)
    worst = (list(runs) or report.runs.held_out)[0]
    return {
        "error_by_channel": [_error_by_channel(report)],
        "error_over_time": [
            _error_over_time(curves.runs[run], run, channel, j, _compared_stages(report))
            for run in list(runs or report.runs.held_out)[:_MAX_RUNS]
            for j, channel in enumerate(report.channels)
            if np.isfinite(curves.runs[run].measured[:, j]).any()
        ],
        "residual_force": [_residual_force(report, force, machine)]
        if (force := curves.missing_force)
        else [],
        "error_over_motion": error_panels(report, curves, machine),
        "correlations": [
            correlations.panel()
            for correlations in error_correlations(curves, worst, report.channels, machine.input_channels)
        ],
        "effects": [curve.panel() for curve in effect_curves if curve],
        "tables": [_table(e, machine) for e in added if e.definition.family == TABLE_FAMILY],
        "coverage": [
            _coverage(_with_unit(name, machine), values) for name, values in curves.coverage.items()
        ],
    }


def save_plots(panels: Panels, folder: Path) -> list[Path]:
    """Save the plots of a report as PNG files NAME.png, one per plot.

    The file of a plot without panels is deleted, so that no plot of an earlier result remains.

    Args:
        panels: Panels (axes with a drawing function) by name of the plot, such as "error_over_time".
        folder: Folder for the files; created if it does not exist.

    Returns:
        Paths of the written files. Each file appears completely or not at all.

    Raises:
        ImportError: If matplotlib is missing; the message names the extra.
        OSError: If a file cannot be written.
    """
    written = []
    for name, plot in panels.items():
        path = folder / f"{name}.png"
        if plot:
            save_panels(plot, path)
            written.append(path)
        else:
            remove_file(path)
    return written


def _error_by_channel(report: Report) -> Panel:
    """Draw the error of each channel in multiples of the noise, for each machine."""
    channels = report.channels
    stages = {key: label for key, label in compared_machines(report).items() if key != "plain"}
    ratios = {
        stage: [report.machines[stage].channels[c].noise_ratio or np.nan for c in channels]
        for stage in stages
    }

    def draw(axes: Any) -> None:
        for k, (stage, label) in enumerate(stages.items()):
            rows = np.arange(len(channels)) + 0.27 * (k - (len(stages) - 1) / 2)
            axes.barh(rows, ratios[stage], height=0.25, color=color(stage), label=label)
            for row, ratio in zip(rows, ratios[stage], strict=True):
                if np.isfinite(ratio):
                    # At the right of the dashed line also where the bar ends before it.
                    place = (max(ratio, 1.0), row)
                    axes.annotate(
                        number(ratio), place, (4, 0), textcoords="offset points", va="center", fontsize=8
                    )
        axes.axvline(1.0, color=color("ink"), lw=1, ls="--")
        axes.set(xscale="log", yticks=range(len(channels)), yticklabels=channels)
        axes.set_xlabel("rms error / sensor noise (dashed: 1)")
        axes.xaxis.get_major_locator().set_params(numticks=5)
        axes.xaxis.set_major_formatter(lambda value, _: number(value))
        axes.minorticks_off()
        axes.margins(x=0.18)
        axes.invert_yaxis()
        axes.grid(False, axis="y")
        legend_above(axes)

    values = "; ".join(
        f"{channel}: " + ", ".join(f"{number(ratios[stage][j])} {label}" for stage, label in stages.items())
        for j, channel in enumerate(channels)
    )
    description = f"Bar chart of the error on the held-out runs in multiples of the sensor noise. {values}."
    return Panel(
        "Error on the held-out runs, in multiples of the sensor noise",
        description,
        draw,
        1.0 + 0.5 * len(channels),
    )


def _compared_stages(report: Report) -> dict[str, str]:
    """Return the machines that the curves compare, with their labels: the refitted and the delivered one."""
    labels = compared_machines(report)
    return {key: labels[key] for key in ("before", "after") if key in labels}


def _error_over_time(run: RunCurves, name: str, channel: str, j: int, stages: dict[str, str]) -> Panel:
    """Draw the errors of a channel, for each machine, over the time of a held-out run."""
    time_s = run.time_s - run.time_s[0]
    errors = {stage: run.errors[stage][:, j] for stage in stages}
    largest = {stage: float(np.nanmax(np.abs(e), initial=0.0)) for stage, e in errors.items()}
    factor, unit = readable_unit(channel, max(largest.values()))

    def draw(axes: Any) -> None:
        for stage, error in errors.items():
            axes.plot(*_envelope(time_s, factor * error), color=color(stage), lw=0.9, label=stages[stage])
        axes.set(xlabel="time, s", ylabel=f"error of {channel.rpartition('_')[0]}, {unit}")
        axes.margins(x=0.01)
        legend_above(axes)

    sizes = ", ".join(f"{number(factor * value)} {unit} {stages[stage]}" for stage, value in largest.items())
    description = f"Error of {channel} over the time of {name}. Largest error: {sizes}."
    return Panel(f"{name}: {channel}", description, draw)


def _envelope(time_s: Array, values: Array) -> tuple[Array, Array]:
    """Return a long curve (n,) without its gaps, thinned to each interval's smallest and largest value."""
    measured = np.isfinite(values)
    time_s, values = time_s[measured], values[measured]
    if len(values) <= 2 * _MAX_BUCKETS:
        return time_s, values
    rows = extreme_rows([values], _MAX_BUCKETS)
    return time_s[rows], values[rows]


def _residual_force(report: Report, missing: MissingForce, machine: Machine) -> Panel:
    """Draw the residual force before and after against the variable that it depends on most."""
    strongest = report.residual.depends_on[0]
    variable = missing.variable
    coordinate, label = strongest.coordinate, _with_unit(strongest.variable, machine)
    unit = machine.coordinate(coordinate).unit("force")
    stages = _compared_stages(report)
    forces = {stage: missing.by_machine[stage] for stage in stages}
    size = float(np.percentile(np.abs(forces["before"]), 99.5)) or 1.0
    if size < 0.1:
        forces, size, unit = {stage: 1e3 * force for stage, force in forces.items()}, 1e3 * size, f"m{unit}"
    bins = [part for part in np.array_split(np.argsort(variable), _MEAN_BINS) if len(part)]
    thin = max(1, len(variable) // _MAX_DOTS)

    def draw(axes: Any) -> None:
        for stage, force in forces.items():
            axes.plot(variable[::thin], force[::thin], ".", ms=2, alpha=0.25, color=color(stage))
            means = [[values[rows].mean() for rows in bins] for values in (variable, force)]
            axes.plot(*means, color=color(stage), lw=2, label=f"{stages[stage]} (line: mean)")
        axes.set(
            xlabel=label, ylabel=f"missing force on {coordinate}, {unit}", ylim=(-1.2 * size, 1.2 * size)
        )
        legend_above(axes)

    rms = {stage: float(np.sqrt(np.mean(force**2))) for stage, force in forces.items()}
    values = ", ".join(f"{number(value)} {unit} {stages[stage]}" for stage, value in rms.items())
    description = f"Residual force on {coordinate} against {label}. Root mean square: {values}."
    title = f"Force that the model lacks on {coordinate}, against {strongest.variable}"
    return Panel(title, description, draw, 2.8)


def _with_unit(variable: str, machine: Machine) -> str:
    """Return a variable's name and unit: `velocity of x, m/s`, `current of motor1, A`, `time, s`, `v1_V`."""
    what, _, name = variable.partition(" of ")
    if not name:
        return f"{what}, s" if what in ("time", "time in the run") else what
    if what in _UNITS_ANYWHERE:
        return f"{variable}, {_UNITS_ANYWHERE[what]}"
    if what == "heat":
        return f"{variable}, {'A^2' if motor_variable(machine.drive(name)) == 'current' else '(Nm)^2'}"
    of_drive = {drive.name: drive.coordinate for drive in machine.drives}
    first = machine.drives[0].coordinate if machine.drives else machine.coordinate_names[0]
    coordinate = machine.coordinate(name if name in machine.coordinate_names else of_drive.get(name, first))
    quantity, factor = _QUANTITIES.get(what, (what, ""))
    return f"{variable}, {coordinate.unit(quantity)}{factor}"


def _table(effect: AppliedEffect, machine: Machine) -> Panel:
    """Draw one table with two standard deviations."""
    knots, values = (np.array([v for k, v in effect.parameters.items() if k[0] == letter]) for letter in "kf")
    names = [f"{effect.label}.{key}" for key in effect.parameters if key[0] == "f"]
    std = [machine.uncertainty.std(name) if machine.uncertainty else None for name in names]
    spread = 2.0 * np.array([s or 0.0 for s in std])
    coordinate = machine.coordinate(effect.site)
    what = "force" if effect.definition.force else "additional friction"
    unit, against = coordinate.unit("force"), _with_unit(effect.definition.against, machine)

    def draw(axes: Any) -> None:
        axes.fill_between(knots, values - spread, values + spread, color=color("after"), alpha=0.2, lw=0)
        axes.plot(knots, values, "o-", ms=3, color=color("after"))
        margin = 0.15 * max(float(np.ptp(values)), 1e-12)
        axes.set(xlabel=against, ylabel=f"{what} on {coordinate.name}, {unit}")
        axes.set_ylim(values.min() - margin, values.max() + margin)

    description = (
        f"Identified {what} on {coordinate.name} against {against}: from {number(values.min())} to "
        f"{number(values.max())} {unit}; the band is two standard deviations."
    )
    return Panel(f"{effect.label}, band: two standard deviations", description, draw, 2.8)


def _coverage(label: str, values: Array) -> Panel:
    """Draw the histogram of a position, velocity or input of the fitted runs."""

    def draw(axes: Any) -> None:
        counts, edges = np.histogram(values, bins=40)
        axes.stairs(100.0 * counts / len(values), edges, fill=True, color=color("neutral"))
        axes.set(xlabel=label, ylabel="% of time", yscale="log")
        axes.yaxis.set_major_formatter(lambda value, _: number(value))
        axes.minorticks_off()

    description = (
        f"Histogram of {label} in the fitted runs, from {number(values.min())} to {number(values.max())}."
    )
    return Panel(label, description, draw, 1.7)


def slow_fractions(coverage: Mapping[str, Array]) -> dict[str, str]:
    """Compute the fraction of its moving time that each coordinate spends below 5 % of its top speed.

    The report states it because only motion at low speed shows how friction depends on low speeds. The top
    speed is the 99th percentile of the speed. A coordinate moves while its speed is above 0.1 % of the top
    speed.

    Args:
        coverage: Where the runs have been by name, shape (m,). Those named "velocity of C" are velocities of
            the coordinate C, m/s or rad/s; all others are ignored.

    Returns:
        Fraction as text, such as "23 %", by name of each coordinate that moves.
    """
    fractions = {}
    for name, velocity in coverage.items():
        _, is_velocity, coordinate = name.partition("velocity of ")
        if not is_velocity:
            continue
        top = float(np.percentile(np.abs(velocity), 99))
        moving = np.abs(velocity[np.abs(velocity) > 1e-3 * top]) if top else velocity[:0]
        if len(moving):
            fractions[coordinate] = f"{100 * float(np.mean(moving < _SLOW * top)):.0f} %"
    return fractions
