"""The card of an agent: card.json, how it was trained and how well it performs, and README.md made from it."""

from __future__ import annotations

import json
import platform
from collections.abc import Mapping, Sequence
from importlib import metadata
from pathlib import Path
from typing import Any

from ..atomic_files import write_text
from ..evaluation import BANDS

PACKAGES = ("hframe_gym", "stable-baselines3", "torch", "numpy", "numba", "gymnasium")


def versions() -> dict[str, str]:
    """List the installed versions of Python and of the packages that determine a training run.

    Returns:
        Version strings by "python" and by package name.

    Raises:
        PackageNotFoundError: If one of the packages is not installed.
    """
    return {"python": platform.python_version(), **{name: metadata.version(name) for name in PACKAGES}}


def write_card(folder: str | Path, card: Mapping[str, Any]) -> None:
    """Write card.json and README.md (see `render_card`); a file that cannot be completed stays unchanged.

    Args:
        folder: Folder of the agent.
        card: Contents of card.json: recipe, versions, learning curve and, if known, scores and failures.

    Raises:
        ValueError: If a number in the card is not finite.
    """
    write_text(Path(folder) / "card.json", json.dumps(card, indent=1, allow_nan=False) + "\n")
    write_text(Path(folder) / "README.md", render_card(card))


def render_card(card: Mapping[str, Any]) -> str:
    """Format the card of an agent (its training and its scores) as a Markdown page.

    Args:
        card: Contents of card.json; `scores` and `failures` are optional.

    Returns:
        Text of the page.
    """
    last = card["curve"][-1]
    settings = card["settings"]
    sections = [
        f"# {card['name']} on {card['task']}, seed {card['seed']}",
        f"Trained by `hframe train {card['name']} --task {card['task']} --seed {card['seed']} --steps {last['steps']}` "
        f"in {last['seconds']:.0f} s ({last['cpu_s']:.0f} s of processor time).",
        f"Machine: `{card['machine']}` (machine.json). Randomization: `{settings['env']['randomize']}`. "
        f"Versions: {', '.join(f'{name} {version}' for name, version in card['versions'].items())}.",
    ]
    if "scores" in card:
        sections += ["## Scores", _score_tables(card["scores"]), "## Known failures", _failure_list(card)]
    kept = f" The folder holds the agent after {card['kept']} steps." if "kept" in card else ""
    sections += [
        "## Learning curve",
        f"Scores on 256 evaluation episodes that no training run uses.{kept}",
        _curve_table(card["curve"]),
        "## Recipe",
        "```json\n" + json.dumps(settings, indent=1) + "\n```",
    ]
    return "\n\n".join(sections) + "\n"


def _score_tables(scores_by_scenario: Mapping[str, Mapping[str, Any]]) -> str:
    """Format scores: settling times for a fixed goal, errors for a moving one."""
    sections = []
    for name, scores in scores_by_scenario.items():
        sections.append(f"`{name}`, {scores['episodes']} episodes of seed {scores['seed']}, none used in training:")
        sections.append(_settling_table(scores) if "settling_s" in scores else _error_table(scores))
    return "\n\n".join(sections)


def _error_table(scores: Mapping[str, Any]) -> str:
    """Format contour and tracking errors, means over the episodes."""
    rows = ["| error, mm | rms | maximum |", "| --- | ---: | ---: |"]
    for name in ("contour_mm", "tracking_mm"):
        rms, maximum = scores[name]["rms"]["mean"], scores[name]["max"]["mean"]
        rows.append(f"| {name.removesuffix('_mm')} | {rms:.3f} | {maximum:.3f} |")
    return "\n".join(rows)


def _settling_table(scores: Mapping[str, Any]) -> str:
    """Format success and settling times by band."""
    rows = ["| band | success | mean settling, s | median | 95 % |", "| --- | ---: | ---: | ---: | ---: |"]
    for band in BANDS:
        settling_s = scores["settling_s"][band]
        times = " | ".join(f"{settling_s[key]:.3f}" for key in ("mean", "median", "p95"))
        rows.append(f"| {band} | {100 * scores['success'][band]:.1f} % | {times} |")
    return "\n".join(rows)


def _failure_list(card: Mapping[str, Any]) -> str:
    """List how many episodes fail in each band, with the environment seeds of the first ones."""
    lines = []
    for name, failures_by_band in card["failures"].items():
        for band, failures in failures_by_band.items():
            seeds = f", environment seeds {', '.join(map(str, failures['seeds']))}" if failures["seeds"] else ""
            more = ", ..." if failures["episodes"] > len(failures["seeds"]) else ""
            total = card["scores"][name]["episodes"]
            lines.append(f"- `{name}`, {band}: {failures['episodes']} of {total} episodes{seeds}{more}")
    return "\n".join(lines)


def _curve_table(curve: Sequence[Mapping[str, Any]]) -> str:
    """Format the learning curve, one row per evaluation."""
    columns = [key for key in curve[0] if key != "cpu_s"]
    rows = ["| " + " | ".join(columns) + " |", "|" + " ---: |" * len(columns)]
    for row in curve:
        rows.append("| " + " | ".join(f"{row[key]:.4g}" if key != "steps" else str(row[key]) for key in columns) + " |")
    return "\n".join(rows)
