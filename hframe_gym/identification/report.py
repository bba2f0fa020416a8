"""Build report.html, one self-contained page about an identification result, from the files of its folder."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..atomic_files import write_text
from ..errors import InputError
from ..machine import Machine
from .parameter_diagnostics import parameter_doubts, sum_text
from .plots import TABLE_FAMILY, draw_plots
from .saved_result import load_result

Array = NDArray[np.float64]
_COLORS = {"effect_found": "#2a7f62", "no_effect": "#4a6fa5", "unexplained": "#c77d0a"}
_SCALES = {"m": ((1e6, "µm"), (1e3, "mm")), "rad": ((1e3, "mrad"),)}
_STAGES = ("declared", "before", "after")
_NOTICEABLE_ERROR = 1.3  # Remaining error over noise from which the report says that something is unexplained.
_SLOW = 0.05  # Fraction of a coordinate's top speed below which friction shows its behavior at low speed.
_MAX_NOISE_RATIO = 50.0  # Simulation error over noise beyond which the simulation drifted, if a force error exists.


def build_report(folder: Path) -> Path:
    """Draw the plots of an identification result and write report.html.

    Args:
        folder: Folder that `hframe identify` wrote; the plots are written to its folder plots/.

    Returns:
        Path of report.html.

    Raises:
        InputError: If the folder holds no result, or a file of it is damaged or cannot be written; the message names
            the file.
        ImportError: If a library of the extra ``report`` is missing.
    """
    try:
        from jinja2 import Environment, PackageLoader
    except ImportError:
        raise ImportError("the report needs more packages: pip install 'hframe_gym[report]'") from None
    saved = load_result(folder)
    report, machine, curves = saved.report, saved.machine, saved.curves
    channels = list(machine.output_channels)
    environment = Environment(loader=PackageLoader("hframe_gym.identification"), autoescape=True)
    try:
        plots = draw_plots(report, curves, machine, folder / "plots")
        text = environment.get_template("report.html.j2").render(
            title=f"Identification of {saved.declared.name}",
            report=report,
            sentence=verdict_sentence(report, channels),
            color=_COLORS[report["verdict"]],
            channels=[_channel_row(report, c) for c in channels],
            force=_force_row(report),
            runs=[_run_row(report, curves, channels, run) for run in report["runs"]["held_out"]],
            effects=_effect_rows(report, machine),
            parameters=_parameter_rows(machine, saved.declared),
            determined=_determined_sums(report, machine),
            slow=_slow_fractions(curves),
            plots={p.stem: "data:image/png;base64," + base64.b64encode(p.read_bytes()).decode() for p in plots},
        )
        write_text(folder / "report.html", text)
    except OSError as error:
        raise InputError(f"{error.filename or folder}: cannot be written ({error.strerror})") from None
    return folder / "report.html"


def verdict_sentence(report: Mapping[str, Any], channels: Sequence[str]) -> str:
    """Describe the verdict and the error on the held-out runs in words.

    The error is the mean simulation error in units of the noise, or the relative force error if the simulation drifts.

    Args:
        report: Content of report.json.
        channels: Names of the machine's output channels.

    Returns:
        One or more English sentences.
    """

    def noise_ratio(stage: str) -> float:
        ratios = [report[stage]["held_out"][c]["noise_ratio"] for c in channels]
        measured = [ratio for ratio in ratios if ratio is not None]
        return float(np.mean(measured)) if measured else float("nan")

    by_force = "force_error" in report["after"]["held_out"] and noise_ratio("after") > _MAX_NOISE_RATIO
    unit = "% of the drives' force" if by_force else "times the sensors' noise"

    def error(stage: str) -> str:
        return f"{100 * report[stage]['held_out']['force_error'] if by_force else noise_ratio(stage):.3g}"

    if report["verdict"] == "effect_found":
        names = ", ".join(f"{e['name'].replace('_', ' ')} at {e['site']}" for e in report["effects"])
        single = len(report["effects"]) == 1
        subject, pronoun = ("an effect", "it") if single else (f"{len(report['effects'])} effects", "them")
        return (
            f"The machine has {subject} that its model lacks: {names}. With {pronoun}, the error on the held-out runs "
            f"falls from {error('before')} to {error('after')} {unit}." + ("" if by_force else _remainder(report))
        )
    if report["verdict"] == "no_effect":
        return (
            "No effect is missing: with refitted parameters, the error of the declared model on the held-out runs is "
            f"{error('before')} {unit}." + ("" if by_force else _remainder(report))
        )
    return (
        f"The error of the refitted model on the held-out runs is {error('before')} {unit}, and no known effect "
        "explains it. The variables that the residual depends on are listed below."
    )


def _remainder(report: Mapping[str, Any]) -> str:
    """Return a sentence about the error that the machine of the verdict leaves, "" if it is the sensors' noise."""
    left = report.get("left")
    if left is None or left < _NOTICEABLE_ERROR:
        return ""
    return (
        f" An error of {left:.3g} times the sensors' noise is left (root mean square over all channels), which no "
        "effect of the library explains."
    )


def _with_unit(channel: str, rmse: float | None) -> str:
    """Return an error in a readable unit: `19.7 µm`, `3.66 mm`, `0.15 mrad`."""
    if rmse is None:
        return "not measured"
    base = channel.rpartition("_")[2]
    factor, unit = next((s for s in _SCALES.get(base, ()) if s[0] * rmse < 1000.0), (1.0, base))
    return f"{factor * rmse:.3g} {unit}"


def _channel_row(report: Mapping[str, Any], channel: str) -> dict[str, str]:
    """Return the errors of one channel for each machine."""
    errors = {stage: report[stage]["held_out"][channel] for stage in _STAGES}
    row = {stage: _with_unit(channel, e["rmse"]) for stage, e in errors.items()}
    ratio = errors["after"]["noise_ratio"]
    return row | {"name": channel, "ratio": "" if ratio is None else f"{ratio:.2f}"}


def _force_row(report: Mapping[str, Any]) -> dict[str, str] | None:
    """Return the relative force error of each machine, None where there is none."""
    if "force_error" not in report["after"]["held_out"]:
        return None
    return {s: f"{100 * report[s]['held_out']['force_error']:.2f} %" for s in _STAGES}


def _run_row(
    report: Mapping[str, Any], curves: Mapping[str, Array], channels: list[str], run: str
) -> dict[str, str | list[str]]:
    """Return the errors of one held-out run before and after, by channel in units of the noise."""

    def ratio(stage: str, j: int) -> str:
        errors = report["after"]["held_out"][channels[j]]
        residual = curves[f"{run}/{stage}"][:, j]
        residual = residual[np.isfinite(residual)]
        if not errors["rmse"] or not errors["noise_ratio"] or len(residual) == 0:
            return ""
        noise = errors["rmse"] / errors["noise_ratio"]
        return f"{float(np.sqrt(np.mean(residual**2))) / noise:.3g}"

    return {"name": run, "errors": [f"{ratio('before', j)} → {ratio('after', j)}" for j in range(len(channels))]}


def _effect_rows(report: Mapping[str, Any], machine: Machine) -> list[dict[str, Any]]:
    """Return the effects, largest held-out gain first, with formula and parameters; a table is drawn instead."""
    definitions = {e.label: e.definition for e in machine.effects}
    rows = []
    for e in sorted(report["effects"], key=lambda e: -e["held_out_gain"]):
        definition = definitions[f"{e['name']}@{e['site']}"]
        table = definition.family == TABLE_FAMILY
        parameters = [
            {
                "name": key,
                "value": f"{p['value']:.5g}",
                "std": "" if p["std"] is None else f"± {p['std']:.2g}",
                "unit": "" if p["unit"] == "1" else p["unit"],
            }
            for key, p in e["parameters"].items()
        ]
        rows.append(
            {
                "name": e["name"].replace("_", " "),
                "site": e["site"],
                "formula": definition.formula,
                "table": table,
                "parameters": [] if table else parameters,
                "gain": _gain_sentence(e["held_out_gain"]),
                "rivals": [r for r in e["rivals"] if r not in definition.equivalent],
                "equivalent": [r for r in e["rivals"] if r in definition.equivalent],
            }
        )
    return rows


def _gain_sentence(gain: float) -> str:
    """Return what an effect does to the squared error of the held-out runs; a negative gain makes it larger."""
    if gain < 0.0:
        return f"It increases the squared error of the held-out runs by {-100 * gain:.3g} %."
    return f"It removes {100 * gain:.3g} % of the squared error of the held-out runs."


def _parameter_rows(machine: Machine, declared: Machine) -> list[dict[str, str]]:
    """Return every identified parameter except a table's, with its standard deviation and the reasons to doubt it."""
    if machine.uncertainty is None:
        return []
    doubts = parameter_doubts(machine, declared)
    tables = tuple(f"{e.label}." for e in machine.effects if e.definition.family == TABLE_FAMILY)
    rows = []
    for name in machine.uncertainty.names:
        if name.startswith(tables):
            continue
        declared_value = declared.parameters.get(name)
        rows.append(
            {
                "name": name,
                "declared": "" if declared_value is None else f"{declared_value:.4g}",
                "value": f"{machine.parameters[name]:.5g}",
                "std": f"{machine.uncertainty.std(name):.2g}",
                "unit": machine.unit(name),
                "doubt": "; ".join(doubts[name]),
            }
        )
    return rows


def _determined_sums(report: Mapping[str, Any], machine: Machine) -> list[dict[str, str]]:
    """Return the parameters that the data do not separate, with what they determine of each set."""
    rows = []
    for group in report["not_separable"]:
        sums = [
            f"{sum_text(entry['weights'])} = {entry['value']:.5g} ± {entry['std']:.2g} "
            f"{machine.unit(next(iter(entry['weights'])))}"
            for entry in group["determined"]
        ]
        rows.append({"names": ", ".join(group["parameters"]), "sums": "; ".join(sums) or "no combination"})
    return rows


def _slow_fractions(curves: Mapping[str, Array]) -> dict[str, str]:
    """Return by coordinate the fraction of the moving time that it spent below a twentieth of its top speed."""
    fractions = {}
    for name, velocity in curves.items():
        _, is_velocity, coordinate = name.partition("coverage/velocity of ")
        if not is_velocity:
            continue
        top = float(np.percentile(np.abs(velocity), 99))
        moving = np.abs(velocity[np.abs(velocity) > 1e-3 * top]) if top else velocity[:0]
        if len(moving):
            fractions[coordinate] = f"{100 * float(np.mean(moving < _SLOW * top)):.0f} %"
    return fractions
