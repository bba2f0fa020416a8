"""Summarize the result files of `gap-v1`: a table of all entries, and whether each step of the loop pays."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from benchmarks.gap.entries import MODELS
from benchmarks.gap.plants import draw_plant
from benchmarks.gap.protocol import DIGEST, EPISODES, PARTS
from benchmarks.gap.results import compare, interval, plant_scores, read

RESULTS = Path(__file__).parent / "results"
STEPS = (*MODELS, "online")


def read_all(folder: Path) -> dict[str, dict[str, Any]]:
    """Read all result files of a folder.

    Args:
        folder: The folder.

    Returns:
        Contents by the name of the entry.
    """
    contents = [read(path) for path in sorted(folder.glob("*.json"))]
    return {content["entry"]["name"]: content for content in contents if content["plants"]}


def summarize(contents: dict[str, dict[str, Any]]) -> dict[str, Any]:
    """Compute the scores of all entries, with 95 % intervals over the plants, and the comparisons between them.

    Args:
        contents: Result files by the name of the entry, all of one set of plants.

    Returns:
        By key, as plain data: "entries" with the scores, "steps" with the comparison of each model with the declared
        one (by controller and part), and "plants" with what they hide and what was identified.
    """
    entries = {name: _scores(content) for name, content in contents.items()}
    steps: dict[str, Any] = {}
    for name, content in contents.items():
        base, _, step = name.rpartition("-")
        if step in STEPS and base in contents:
            steps[name] = {part: compare(content, contents[base], part)._asdict() for part in PARTS}
    return {
        "digest": DIGEST,
        "episodes": EPISODES,
        "entries": dict(sorted(entries.items(), key=lambda item: item[1]["over_bound"][0])),
        "steps": steps,
        "plants": _plants(contents),
    }


def _scores(content: dict[str, Any]) -> dict[str, Any]:
    """Return the scores of an entry."""
    scores = list(plant_scores(content).values())
    rows = content["plants"]
    return {
        "track": content["entry"]["track"],
        "knowledge": content["entry"]["knowledge"],
        "plants": len(scores),
        "over_bound": interval([s.over_bound for s in scores if s.over_bound == s.over_bound]),
        "settling_s": interval([float(s.settling_s.mean()) for s in scores]),
        "success": interval([s.success for s in scores]),
        "circle_mm": interval([float(s.circle_mm.mean()) for s in scores]),
        "square_mm": interval([float(s.square_mm.mean()) for s in scores]),
        "belt_force_N": max(s.belt_force_N for s in scores),
        "saturated": interval([s.saturated for s in scores]),
        "left": interval([s.left for s in scores]),
        "prepare_cpu_s": interval([row["about"].get("cpu_s", row["prepare_cpu_s"]) for row in rows]),
        "control_us": interval([row["control_us"] for row in rows]),
    }


def _plants(contents: dict[str, dict[str, Any]]) -> list[dict[str, Any]]:
    """Return what each plant hides, what was identified, and the scores by entry."""
    scores = {name: plant_scores(content) for name, content in contents.items()}
    about: dict[int, dict[str, Any]] = {}
    for content in contents.values():
        for row in content["plants"]:
            about[row["plant"]] = about.get(row["plant"], {}) | row["about"]
    seed = next(iter(contents.values()))["seed"] if contents else 0
    return [
        {
            "plant": index,
            "hides": draw_plant(seed, index).describe(),
            **about[index],
            "settling_s": {n: float(s[index].settling_s.mean()) for n, s in scores.items() if index in s},
            "circle_mm": {n: float(s[index].circle_mm.mean()) for n, s in scores.items() if index in s},
        }
        for index in sorted(about)
    ]


def overview(contents: dict[str, dict[str, Any]]) -> str:
    """Format the scores as text.

    Args:
        contents: Result files by the name of the entry.

    Returns:
        A line per entry, then a line per comparison with the declared machine.
    """
    if not contents:
        return "no results yet"
    summary = summarize(contents)
    lines = [
        f"{'entry':24} {'plants':>6} {'over bound':>22} {'success':>8} {'circle mm':>10} {'square mm':>10}"
    ]
    for name, s in summary["entries"].items():
        mean, low, high = s["over_bound"]
        lines.append(
            f"{name:24} {s['plants']:6d} {mean:7.3f} [{low:.3f}, {high:.3f}] {s['success'][0]:8.3f} "
            f"{s['circle_mm'][0]:10.4f} {s['square_mm'][0]:10.4f}"
        )
    for name, parts in summary["steps"].items():
        texts = [
            f"{part} better {c['better']}, worse {c['worse']} of {c['plants']}" for part, c in parts.items()
        ]
        lines.append(f"{name} against its declared machine: {'; '.join(texts)}")
    return "\n".join(lines)
