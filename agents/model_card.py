"""An agent's card: card.json, everything known about how it was made and how well it does, and README.md from it."""

from __future__ import annotations

import json
import platform
from importlib import metadata
from pathlib import Path
from typing import Any

from ..atomic_files import write_text
from ..evaluation import BANDS

PACKAGES = ("hframe_gym", "stable-baselines3", "torch", "numpy", "numba", "gymnasium")


def versions() -> dict[str, str]:
    """What an agent was trained with."""
    return {"python": platform.python_version(), **{name: metadata.version(name) for name in PACKAGES}}


def write_card(folder: str | Path, card: dict[str, Any]) -> None:
    """Write card.json and README.md, each whole."""
    write_text(Path(folder) / "card.json", json.dumps(card, indent=1, allow_nan=False) + "\n")
    write_text(Path(folder) / "README.md", render(card))


def render(card: dict[str, Any]) -> str:
    """The card as a page."""
    last = card["curve"][-1]
    settings = card["settings"]
    parts = [
        f"# {card['name']} on {card['task']}, seed {card['seed']}",
        f"Made by `hframe train {card['name']} --task {card['task']} --seed {card['seed']} --steps {last['steps']}` "
        f"in {last['seconds']:.0f} s ({last['cpu_s']:.0f} s of processor time).",
        f"Trained on the machine `{card['machine']}` (machine.json), randomisation `{settings['env']['randomize']}`, "
        f"with {', '.join(f'{name} {version}' for name, version in card['versions'].items())}.",
    ]
    if "scores" in card:
        parts += ["## Scores", _scores(card["scores"]), "## Known failures", _failures(card)]
    kept = f" Kept: the agent after {card['kept']} steps." if "kept" in card else ""
    parts += ["## While training", f"On 256 draws that no training sees.{kept}", _curve(card["curve"])]
    parts += ["## Recipe", "```json\n" + json.dumps(settings, indent=1) + "\n```"]
    return "\n\n".join(parts) + "\n"


def _scores(by_trial: dict[str, dict[str, Any]]) -> str:
    """Scorecards as tables: settling where the goal stands, errors where it moves."""
    parts = []
    for name, scores in by_trial.items():
        parts.append(f"`{name}`, {scores['episodes']} draws of seed {scores['seed']}, none seen in training:")
        parts.append(_settling(scores) if "settling_s" in scores else _errors(scores))
    return "\n\n".join(parts)


def _errors(scores: dict[str, Any]) -> str:
    rows = ["| mm | rms | largest |", "| --- | ---: | ---: |"]
    for name in ("contour_mm", "tracking_mm"):
        rms, most = scores[name]["rms"]["mean"], scores[name]["max"]["mean"]
        rows.append(f"| {name.removesuffix('_mm')} | {rms:.3f} | {most:.3f} |")
    return "\n".join(rows)


def _settling(scores: dict[str, Any]) -> str:
    rows = ["| band | success | mean settling, s | median | 95 % |", "| --- | ---: | ---: | ---: | ---: |"]
    for band in BANDS:
        s = scores["settling_s"][band]
        times = " | ".join(f"{s[key]:.3f}" for key in ("mean", "median", "p95"))
        rows.append(f"| {band} | {100 * scores['success'][band]:.1f} % | {times} |")
    return "\n".join(rows)


def _failures(card: dict[str, Any]) -> str:
    """How many episodes miss each band, and which."""
    lines = []
    for name, by_band in card["failures"].items():
        for band, found in by_band.items():
            seeds = f", environment seeds {', '.join(map(str, found['seeds']))}" if found["seeds"] else ""
            more = ", ..." if found["episodes"] > len(found["seeds"]) else ""
            of = card["scores"][name]["episodes"]
            lines.append(f"- `{name}`, {band}: {found['episodes']} of {of} episodes{seeds}{more}")
    return "\n".join(lines)


def _curve(curve: list[dict[str, Any]]) -> str:
    columns = [key for key in curve[0] if key != "cpu_s"]
    rows = ["| " + " | ".join(columns) + " |", "|" + " ---: |" * len(columns)]
    for row in curve:
        rows.append("| " + " | ".join(f"{row[key]:.4g}" if key != "steps" else str(row[key]) for key in columns) + " |")
    return "\n".join(rows)
