"""report.html: one self-contained page a person reads in two minutes, built from the files of an answer."""

from __future__ import annotations

import base64
import json
from pathlib import Path
from typing import Any

import numpy as np

from ..files import InputError, load_machine, write_text
from ..machine import Machine
from .plots import draw_plots

_COLOURS = {"effect_found": "#2a7f62", "no_effect": "#4a6fa5", "unexplained": "#c77d0a"}
_SCALES = {"m": (1e6, "µm"), "rad": (1e3, "mrad")}


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
    with np.load(folder / "evidence.npz") as evidence:
        drawn = draw_plots(report, dict(evidence), channels, folder / "plots")
    page = Environment(loader=PackageLoader("hframe_gym.identify"), autoescape=True).get_template("report.html.j2")
    text = page.render(
        title=f"What {declared.name} lacks",
        report=report,
        sentence=verdict_sentence(report, channels),
        colour=_COLOURS[report["verdict"]],
        channels=[_channel_row(report, c) for c in channels],
        force=_force_row(report),
        parameters=_parameter_rows(machine, declared),
        plots={p.stem: "data:image/png;base64," + base64.b64encode(p.read_bytes()).decode() for p in drawn},
    )
    write_text(folder / "report.html", text)
    return folder / "report.html"


def verdict_sentence(report: dict[str, Any], channels: list[str]) -> str:
    """The verdict as a person would say it."""

    def mean(stage: str) -> float:
        ratios = [report[stage]["held_out"][c]["noise_ratio"] for c in channels]
        return float(np.mean([r for r in ratios if r is not None]))

    before, after = mean("before"), mean("after")
    if report["verdict"] == "effect_found":
        names = " and ".join(f"{e['name'].replace('_', ' ')} at {e['site']}" for e in report["effects"])
        return (
            f"The machine has an effect that its model lacks: {names}. With it, the error on runs never fitted falls "
            f"from {before:.3g} to {after:.3g} times the sensors' noise."
        )
    if report["verdict"] == "no_effect":
        return f"Nothing is missing: refitted, the declared model predicts to {before:.3g} times the sensors' noise."
    return (
        f"The refitted model misses by {before:.3g} times the sensors' noise, and no known effect explains it. "
        "What the residual follows is listed below."
    )


def _channel_row(report: dict[str, Any], channel: str) -> dict[str, str]:
    factor, unit = _SCALES.get(channel.rpartition("_")[2], (1.0, ""))
    errors = {stage: report[stage]["held_out"][channel] for stage in ("declared", "before", "after")}
    if errors["after"]["rmse"] is None:
        return {"name": channel, "ratio": "", **dict.fromkeys(errors, "not measured")}
    row = {stage: f"{factor * e['rmse']:.4g} {unit}" for stage, e in errors.items()}
    return row | {"name": channel, "ratio": f"{errors['after']['noise_ratio']:.2f}"}


def _force_row(report: dict[str, Any]) -> dict[str, str] | None:
    if "force_error" not in report["after"]["held_out"]:
        return None
    return {s: f"{100 * report[s]['held_out']['force_error']:.2f} %" for s in ("declared", "before", "after")}


def _parameter_rows(machine: Machine, declared: Machine) -> list[dict[str, Any]]:
    if machine.uncertainty is None:
        return []
    rows = []
    for name in machine.uncertainty.names:
        value, std = machine.parameters[name], machine.uncertainty.std(name) or 0.0
        given = declared.parameters.get(name)
        rows.append(
            {
                "name": name,
                "declared": "" if given is None else f"{given:.5g}",
                "value": f"{value:.5g}",
                "std": f"{std:.2g}",
                "unit": machine.unit(name),
                "warn": std > 0.2 * abs(value),
            }
        )
    return rows
