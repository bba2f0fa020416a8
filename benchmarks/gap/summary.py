"""Summarize the result files of `gap-v1`: a table of all entries, and whether each step of the loop pays."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.gap.catalog import VARIANTS
from benchmarks.gap.entries import family, training_seed
from benchmarks.gap.plants import draw_plant
from benchmarks.gap.protocol import DIGEST, EPISODES, PARTS
from benchmarks.gap.results import PlantScore, compare, interval, plant_scores, read

RESULTS = Path(__file__).parent / "results"
STEPS = (*VARIANTS, "trained")
_MEASURES = {"reach": "settling_s", "circle": "circle_mm", "square": "square_mm"}

Files = dict[str, list[dict[str, Any]]]  # result files by the name of the entry, one per seed of its agent


def read_all(folder: Path) -> dict[str, dict[str, Any]]:
    """Read all result files of a folder.

    Returns:
        Contents by the name of the entry.
    """
    contents = [read(path) for path in sorted(folder.glob("*.json"))]
    return {content["entry"]["name"]: content for content in contents if content["plants"]}


def by_entry(contents: dict[str, dict[str, Any]]) -> Files:
    """Group result files by entry: those of several seeds of an agent belong together.

    Args:
        contents: Result files by name, as `read_all` returns them.
    """
    files: Files = {}
    for name in sorted(contents):
        files.setdefault(family(name), []).append(contents[name])
    return files


def of_same_seeds(
    files: list[dict[str, Any]], others: list[dict[str, Any]]
) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Pair the result files of two entries by the seed of their agents.

    Args:
        files: Result files of an entry, one per seed of its agent.
        others: Result files of another entry.

    Returns:
        Those of each whose seed both have, in the order of the seeds.
    """
    first, second = (
        {training_seed(content["entry"]["name"]): content for content in of} for of in (files, others)
    )
    both = [seed for seed in first if seed in second]
    return [first[seed] for seed in both], [second[seed] for seed in both]


def summarize(contents: dict[str, dict[str, Any]]) -> dict[str, Any]:
    """Compute all entries' scores, with 95 % intervals over plants and seeds, and comparisons between them.

    Args:
        contents: Result files by name, all of one set of plants.

    Returns:
        By key, as plain data: "entries" with the scores, "steps" with the comparison of each model with the
        declared one (by controller and part), "learned" with the comparison of the best learned entry with
        the best other one (by track and part), "scored_by" with the code that scored which plants, "plants"
        with what they hide and what was identified, and "refused" with the entries that refuse a plant.
    """
    files = by_entry(contents)
    entries = {name: scores for name, of_seeds in files.items() if (scores := _scores(of_seeds))}
    steps: dict[str, Any] = {}
    for name, of_seeds in files.items():
        base, _, step = name.rpartition("-")
        mine, declared = of_same_seeds(of_seeds, files.get(base, []))
        if step in STEPS and declared and {name, base} <= set(entries):
            steps[name] = {part: compare(mine, declared, part)._asdict() for part in PARTS}
    return {
        "digest": DIGEST,
        "episodes": EPISODES,
        "entries": dict(sorted(entries.items(), key=lambda item: item[1]["over_bound"][0])),
        "steps": steps,
        "learned": _learned_against_other(files, entries),
        "scored_by": _scored_by(contents),
        "plants": _plants(files),
        "refused": [
            {"entry": name, "plant": row["plant"], "reason": row["refused"]}
            for name, content in contents.items()
            for row in content["plants"]
            if "refused" in row
        ],
    }


def _learned_against_other(files: Files, entries: dict[str, Any]) -> dict[str, Any]:
    """Compare the best learned entry with the best other one, by track and part."""
    found: dict[str, Any] = {}
    for track in dict.fromkeys(s["track"] for s in entries.values()):
        of_track = {name: s for name, s in entries.items() if s["track"] == track}
        for part, measure in _MEASURES.items():
            learned, other = (_best(of_track, kind, measure) for kind in (True, False))
            if learned and other:
                comparison = compare(files[learned], files[other], part)._asdict()
                found.setdefault(track, {})[part] = {"learned": learned, "other": other, **comparison}
    return found


def _best(entries: dict[str, Any], learned: bool, measure: str) -> str:
    """Return the best entry's name, learned or not, of those with the most plants; "" if there is none."""
    chosen = {name: s for name, s in entries.items() if s["learned"] == learned}
    most = max((s["plants"] for s in chosen.values()), default=0)  # those of fewer may be the easier ones
    names = [name for name, s in chosen.items() if s["plants"] == most]
    return min(names, key=lambda name: float(chosen[name][measure][0]), default="")


def _scores(of_seeds: list[dict[str, Any]]) -> dict[str, Any]:
    """Return an entry's scores from the files of all its seeds, on the plants that all have; {} if none."""
    scored = [plant_scores(content) for content in of_seeds]
    plants = sorted(set.intersection(*(set(scores) for scores in scored)))
    if not plants:
        return {}
    rows = [{row["plant"]: row for row in content["plants"]} for content in of_seeds]

    def over(value: Callable[[PlantScore], float]) -> tuple[float, float, float]:
        values = np.array([[value(scores[p]) for p in plants] for scores in scored])
        return interval(values[:, np.isfinite(values).all(axis=0)])

    def cost(value: Callable[[dict[str, Any]], float]) -> tuple[float, float, float]:
        return interval([[value(of[p]) for p in plants] for of in rows])

    entry = of_seeds[0]["entry"]
    return {
        "track": entry["track"],
        "knowledge": entry["knowledge"],
        "learned": entry.get("learned", False),
        "seeds": len(of_seeds),
        "plants": len(plants),
        "versions": sorted({content["versions"]["hframe_gym"] for content in of_seeds}),
        "over_bound": over(lambda s: s.over_bound),
        "settling_s": over(lambda s: float(s.settling_s.mean())),
        "success": over(lambda s: s.success),
        "circle_mm": over(lambda s: float(s.circle_mm.mean())),
        "square_mm": over(lambda s: float(s.square_mm.mean())),
        "belt_force_N": max(scores[p].belt_force_N for scores in scored for p in plants),
        "saturated": over(lambda s: s.saturated),
        "left": over(lambda s: s.left),
        "prepare_cpu_s": cost(lambda row: float(row["about"].get("cpu_s", row["prepare_cpu_s"]))),
        "control_us": cost(lambda row: float(row["control_us"])),
    }


def _scored_by(contents: dict[str, dict[str, Any]]) -> list[dict[str, Any]]:
    """Return which entries were scored on which plants by which commit or, without one, by which version."""
    plants: dict[tuple[str, str], list[int]] = {}
    for name, content in contents.items():
        for row in content["plants"]:
            version = row.get("version", content["versions"]["hframe_gym"])
            code = row.get("commit") or f"version {version}"
            plants.setdefault((code, name), []).append(row["plant"])
    entries: dict[tuple[str, tuple[int, ...]], list[str]] = {}
    for (code, name), indices in sorted(plants.items()):
        entries.setdefault((code, tuple(sorted(indices))), []).append(name)
    return [
        {"code": code, "plants": list(indices), "entries": names}
        for (code, indices), names in entries.items()
    ]


def _plants(files: Files) -> list[dict[str, Any]]:
    """Return what each plant hides, what was identified, and the scores by entry, means over its seeds."""
    scores = {name: [plant_scores(content) for content in of_seeds] for name, of_seeds in files.items()}
    about: dict[int, dict[str, Any]] = {}
    seed = 0
    for of_seeds in files.values():
        for content in of_seeds:
            seed = content["seed"]
            for row in content["plants"]:
                about[row["plant"]] = about.get(row["plant"], {}) | row.get("about", {})

    def means(index: int, measure: str) -> dict[str, float]:
        return {
            name: float(np.mean([getattr(s[index], measure).mean() for s in of_seeds]))
            for name, of_seeds in scores.items()
            if all(index in s for s in of_seeds)
        }

    return [
        {
            "plant": index,
            "hides": draw_plant(seed, index).describe(),
            **about[index],
            "settling_s": means(index, "settling_s"),
            "circle_mm": means(index, "circle_mm"),
        }
        for index in sorted(about)
    ]


def trained_against_corrected(contents: dict[str, dict[str, Any]]) -> dict[str, Any]:
    """Compare agents that were trained on the corrected machine with the same agents with its laws alone.

    Args:
        contents: Result files by the name of the entry: pairs NAME-trained and NAME-corrected.

    Returns:
        "rows", one per agent and plant, as plain data: "entry", "plant", what it "hides", the environment
        steps after which the best agent was kept by task ("kept_steps"), those of its training
        ("training_steps") and their processor time ("training_cpu_s"), and by part the means of both in s and
        mm with the 95 % interval of the paired "difference" over the episodes.
    """
    rows = []
    for name, content in contents.items():
        base, _, step = name.rpartition("-")
        other = contents.get(f"{base}-corrected")
        if step != "trained" or other is None:
            continue
        mine, theirs = plant_scores(content), plant_scores(other)
        for row in content["plants"]:
            index = row["plant"]
            if index not in theirs:
                continue
            parts = {}
            for part, measure in _MEASURES.items():
                trained, corrected = (getattr(scores[index], measure) for scores in (mine, theirs))
                parts[part] = {
                    "corrected": float(corrected.mean()),
                    "trained": float(trained.mean()),
                    "difference": interval(trained - corrected),
                }
            rows.append(
                {
                    "entry": name,
                    "plant": index,
                    "hides": draw_plant(content["seed"], index).describe(),
                    "training_steps": row["about"]["training_steps"],
                    "kept_steps": row["about"]["kept_steps"],
                    "training_cpu_s": row["about"]["training_cpu_s"],
                    **parts,
                }
            )
    return {"rows": rows}


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
