"""report.html: one self-contained page a person reads in two minutes, built from the files of an answer."""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..atomic_files import write_text
from ..errors import InputError
from ..machine import Machine
from ..recordings import load_machine
from .parameter_diagnostics import parameter_doubts
from .plots import TABLE, draw_plots

Array = NDArray[np.float64]
_COLOURS = {"effect_found": "#2a7f62", "no_effect": "#4a6fa5", "unexplained": "#c77d0a"}
_SCALES = {"m": ((1e6, "µm"), (1e3, "mm")), "rad": ((1e3, "mrad"),)}
_STAGES = ("declared", "before", "after")
# Of a coordinate's top speed: below it friction shows what it does at low speed.
_SLOW = 0.05
# Over the sensors' noise: a free run this far off, of a machine judged by its force, has drifted.
_DRIFTED = 50.0


def build_report(folder: Path) -> Path:
    """Draw the plots of an answer's folder and write report.html into it; returns the page's path.

    Raises InputError where the folder holds no answer, ImportError naming the extra where a library is missing.
    """
    try:
        from jinja2 import Environment, PackageLoader
    except ImportError:
        raise ImportError("the report needs the extra: pip install 'hframe_gym[report]'") from None
    if not (folder / "report.json").is_file():
        raise InputError(f"{folder}: no report.json here; run `hframe identify` first")
    report = json.loads((folder / "report.json").read_text())
    machine, declared = load_machine(folder / "machine.json"), load_machine(folder / "declared.json")
    channels = list(machine.output_channels)
    with np.load(folder / "evidence.npz") as file:
        evidence = dict(file)
    drawn = draw_plots(report, evidence, machine, folder / "plots")
    page = Environment(loader=PackageLoader("hframe_gym.identification"), autoescape=True).get_template(
        "report.html.j2"
    )
    text = page.render(
        title=f"What {declared.name} lacks",
        report=report,
        sentence=verdict_sentence(report, channels),
        colour=_COLOURS[report["verdict"]],
        channels=[_channel_row(report, c) for c in channels],
        force=_force_row(report),
        runs=[_run_row(report, evidence, channels, run) for run in report["runs"]["held_out"]],
        effects=_effect_rows(report, machine),
        parameters=_parameter_rows(machine, declared),
        slow=_slow_shares(evidence),
        plots={p.stem: "data:image/png;base64," + base64.b64encode(p.read_bytes()).decode() for p in drawn},
    )
    write_text(folder / "report.html", text)
    return folder / "report.html"


def verdict_sentence(report: Mapping[str, Any], channels: list[str]) -> str:
    """The verdict as a person would say it."""

    def noise_ratio(stage: str) -> float:
        ratios = [report[stage]["held_out"][c]["noise_ratio"] for c in channels]
        return float(np.mean([r for r in ratios if r is not None]))

    drifts = "force_error" in report["after"]["held_out"] and noise_ratio("after") > _DRIFTED

    unit = "% of the drives' force" if drifts else "times the sensors' noise"

    def size(stage: str) -> str:
        return f"{100 * report[stage]['held_out']['force_error'] if drifts else noise_ratio(stage):.3g}"

    if report["verdict"] == "effect_found":
        names = " and ".join(f"{e['name'].replace('_', ' ')} at {e['site']}" for e in report["effects"])
        found = "an effect that its model lacks" if len(report["effects"]) == 1 else "effects that its model lacks"
        return (
            f"The machine has {found}: {names}. The error on runs never fitted falls from {size('before')} to "
            f"{size('after')} {unit}."
        )
    if report["verdict"] == "no_effect":
        return f"Nothing is missing: refitted, the declared model predicts to {size('before')} {unit}."
    return (
        f"The refitted model misses by {size('before')} {unit}, and no known effect explains it. "
        "What the residual follows is listed below."
    )


def _measured(channel: str, rmse: float | None) -> str:
    """An error in a unit that keeps it readable: `19.7 µm`, `3.66 mm`, `0.15 mrad`."""
    if rmse is None:
        return "not measured"
    base = channel.rpartition("_")[2]
    factor, unit = next((s for s in _SCALES.get(base, ()) if s[0] * rmse < 1000.0), (1.0, base))
    return f"{factor * rmse:.3g} {unit}"


def _channel_row(report: Mapping[str, Any], channel: str) -> dict[str, str]:
    errors = {stage: report[stage]["held_out"][channel] for stage in _STAGES}
    row = {stage: _measured(channel, e["rmse"]) for stage, e in errors.items()}
    ratio = errors["after"]["noise_ratio"]
    return row | {"name": channel, "ratio": "" if ratio is None else f"{ratio:.2f}"}


def _force_row(report: Mapping[str, Any]) -> dict[str, str] | None:
    if "force_error" not in report["after"]["held_out"]:
        return None
    return {s: f"{100 * report[s]['held_out']['force_error']:.2f} %" for s in _STAGES}


def _run_row(
    report: Mapping[str, Any], evidence: Mapping[str, Array], channels: list[str], run: str
) -> dict[str, str | list[str]]:
    """Error of one held-out run before and after, by channel in units of the noise."""

    def ratio(stage: str, j: int) -> str:
        errors = report["after"]["held_out"][channels[j]]
        known = evidence[f"{run}/{stage}"][:, j]
        known = known[np.isfinite(known)]
        if not errors["rmse"] or len(known) == 0:
            return ""
        noise = errors["rmse"] / errors["noise_ratio"]
        return f"{float(np.sqrt(np.mean(known**2))) / noise:.3g}"

    return {"name": run, "errors": [f"{ratio('before', j)} → {ratio('after', j)}" for j in range(len(channels))]}


def _effect_rows(report: Mapping[str, Any], machine: Machine) -> list[dict[str, Any]]:
    """The effects, most useful first, with what they are and their numbers (a table's values are drawn instead)."""
    definitions = {e.label: e.definition for e in machine.effects}
    rows = []
    for e in sorted(report["effects"], key=lambda e: -e["held_out_gain"]):
        definition = definitions[f"{e['name']}@{e['site']}"]
        table = definition.family == TABLE
        numbers = [
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
                "numbers": [] if table else numbers,
                "gain": f"{100 * e['held_out_gain']:.3g} %",
                "rivals": [r for r in e["rivals"] if r not in definition.equivalent],
                "equivalent": [r for r in e["rivals"] if r in definition.equivalent],
            }
        )
    return rows


def _parameter_rows(machine: Machine, declared: Machine) -> list[dict[str, str]]:
    """Every identified number but a table's, with its standard deviation and what is doubtful about it."""
    if machine.uncertainty is None:
        return []
    why = parameter_doubts(machine, declared)
    drawn = tuple(f"{e.label}." for e in machine.effects if e.definition.family == TABLE)
    rows = []
    for name in machine.uncertainty.names:
        if name.startswith(drawn):
            continue
        given = declared.parameters.get(name)
        rows.append(
            {
                "name": name,
                "declared": "" if given is None else f"{given:.4g}",
                "value": f"{machine.parameters[name]:.5g}",
                "std": f"{machine.uncertainty.std(name):.2g}",
                "unit": machine.unit(name),
                "doubt": "; ".join(why[name]),
            }
        )
    return rows


def _slow_shares(evidence: Mapping[str, Array]) -> dict[str, str]:
    """By coordinate: the share of the moving time that it spent below a twentieth of its top speed."""
    shares = {}
    for name, values in evidence.items():
        _, found, coordinate = name.partition("coverage/velocity of ")
        top = float(np.percentile(np.abs(values), 99)) if found else 0.0
        moving = np.abs(values[np.abs(values) > 1e-3 * top]) if top else values[:0]
        if len(moving):
            shares[coordinate] = f"{100 * float(np.mean(moving < _SLOW * top)):.0f} %"
    return shares
