"""Tables of the protocol `gap-v1`."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

from tools.tables.result_tables import markdown, table, with_interval

HELD = "gap_71000"  # summary of the held set: seed 71000


@table("gap")
@table(HELD)
def gap(results: dict[str, Any]) -> str:
    """Format the scores of the entries of gap-v1, sorted by settling time over the bound."""
    rows = [
        [
            f"`{name}`",
            s["track"],
            s["knowledge"],
            f"{s['plants']}",
            f"{s['seeds']}" if s["learned"] else "",
            with_interval(*s["over_bound"]),
            with_interval(*s["settling_s"]),
            f"{100 * s['success'][0]:.1f} %",
            with_interval(*(1e3 * mm for mm in s["circle_mm"]), decimals=0),
            with_interval(*(1e3 * mm for mm in s["square_mm"]), decimals=0),
            f"{s['belt_force_N']:.0f}",
            f"{100 * s['saturated'][0]:.1f} %",
            f"{100 * s['left'][0]:.1f} %",
            f"{s['prepare_cpu_s'][0]:.0f}",
            f"{s['control_us'][0]:.0f}",
        ]
        for name, s in results["entries"].items()
    ]
    header = [
        "entry",
        "track",
        "knows",
        "plants",
        "seeds",
        "moves: over the bound",
        "until 0.2 mm, s",
        "within 0.2 mm",
        "circle, um rms",
        "square, um rms",
        "largest belt force, N",
        "at the limit",
        "left the workspace",
        "preparation, s",
        "control, us",
    ]
    return markdown(header, rows)


@table("gap_steps", source="gap")
@table(f"{HELD}_steps", source=HELD)
def gap_steps(results: dict[str, Any]) -> str:
    """Format how often each model of the plant is better than the declared one in gap-v1."""
    rows = []
    for name, parts in results["steps"].items():
        cells = []
        for c in parts.values():
            cells += [_counts(c), with_interval(*c["ratio"])]
        rows.append([f"`{name}`", f"{parts['reach']['plants']}", *cells])
    titles = [
        title for part in ("moves", "circle", "square") for title in (f"{part}: better, worse", "ratio")
    ]
    return markdown(["entry, against its declared model", "plants", *titles], rows)


@table("gap_scored_by", source="gap")
@table(f"{HELD}_scored_by", source=HELD)
def gap_scored_by(results: dict[str, Any]) -> str:
    """Format which code scored which entries of gap-v1 on which plants; seeds of an agent are joined."""
    rows = []
    for row in results["scored_by"]:
        seeds: dict[str, list[str]] = {}
        for name in row["entries"]:
            found = re.fullmatch(r"(.+)-seed(\d+)(.*)", name)
            entry, seed = (f"{found[1]}{found[3]}", found[2]) if found else (name, "")
            seeds.setdefault(entry, []).append(seed)
        names = []
        for entry, of_entry in seeds.items():
            word = "seed" if len(of_entry) == 1 else "seeds"
            names.append(f"`{entry}`" + (f" ({word} {', '.join(of_entry)})" if any(of_entry) else ""))
        every = len(row["plants"]) == len(results["plants"])
        rows.append([row["code"], ", ".join(names), "all" if every else ", ".join(map(str, row["plants"]))])
    return markdown(["scored by", "entries", "plants"], rows, ":--")


@table("gap_learned", source="gap")
def gap_learned(results: dict[str, Any]) -> str:
    """Format the best learned entry of gap-v1 against the best other one, by track and task."""
    rows = []
    for track, parts in results["learned"].items():
        for part, c in parts.items():
            rows.append(
                [
                    track,
                    {"reach": "moves"}.get(part, part),
                    f"`{c['learned']}`",
                    f"`{c['other']}`",
                    f"{c['plants']}",
                    _counts(c),
                    with_interval(*c["ratio"]),
                ]
            )
    header = ["track", "task", "best learned entry", "best other entry", "plants", "better, worse", "ratio"]
    return markdown(header, rows)


@table("gap_trained")
def gap_trained(results: dict[str, Any]) -> str:
    """Format agents trained on corrected machines beside the same agents with these machines' laws."""
    rows = []
    for row in results["rows"]:
        cells = []
        for part, decimals in (("reach", 3), ("circle", 0), ("square", 0)):
            scale = 1.0 if part == "reach" else 1e3
            low, high = row[part]["difference"][1:]
            sign = "" if low <= 0.0 <= high else " (better)" if high < 0.0 else " (worse)"
            corrected, trained = (scale * row[part][of] for of in ("corrected", "trained"))
            cells += [f"{corrected:.{decimals}f}", f"{trained:.{decimals}f}{sign}"]
        kept = ", ".join(f"{steps}" for steps in row["kept_steps"].values())
        rows.append([f"`{row['entry'].replace('-seed0', '')}`", f"{row['plant']}", *cells, kept])
    titles = [
        f"{part}, {of}"
        for part in ("moves, s", "circle, um", "square, um")
        for of in ("corrected", "trained")
    ]
    return markdown(["entry", "plant", *titles, "steps of the agents kept: moves, paths"], rows)


def _counts(comparison: dict[str, Any]) -> str:
    """Format on how many plants an entry is better and worse, in parentheses: significantly."""
    c = comparison
    return f"{c['better']} ({c['clearly_better']}), {c['worse']} ({c['clearly_worse']})"


@table("model_error")
def model_error(results: dict[str, Any]) -> str:
    """Format how fast moves are with an exact model, other parameters and undeclared effects."""
    rows = []
    for name, of in sorted(results["rows"].items(), key=lambda item: -item[1]["gain"][0]):
        cells = [f"{of[key][0]:.3f}" for key in ("effects", "parameters", "exact")]
        mean, low, high = (100.0 * value for value in of["gain"])
        agent, comma, rest = name.partition(",")
        rows.append([f"`{agent}`{comma}{rest}", *cells, f"{mean:.1f} % ({low:.1f} to {high:.1f})"])
    return markdown(["", "parameters and effects differ", "parameters differ", "exact", "gain"], rows)


@table("model_error_machines")
def model_error_machines(results: dict[str, Any]) -> str:
    """Format how fast moves are with the declared and with an exact model, on other machines."""
    rows = []
    for name, of in sorted(results["rows"].items(), key=lambda item: -item[1]["gain"][0]):
        gains = [
            f"{100.0 * mean:.1f} % ({100.0 * low:.1f} to {100.0 * high:.1f})"
            for mean, low, high in (of["gain"], of["median_gain"])
        ]
        failed = ", ".join(map(str, of["failed"]))
        rows.append([f"`{name}`", f"{of['declared'][0]:.3f}", f"{of['exact'][0]:.3f}", *gains, failed])
    return markdown(["", "declared", "exact", "gain", "gain of the median", "moves that fail"], rows)


@table("hand_over")
def hand_over(results: dict[str, Any]) -> str:
    """Format how fast moves are if another controller takes over near the goal, with both models."""
    rows = []
    for row in results["rows"]:
        first, last = row["distance_mm"] == 0.0, row["distance_mm"] >= 1000.0
        cells = [
            f"{row[model][key][0]:.4f}" for key in ("near_s", "settling_s") for model in ("declared", "exact")
        ]
        name = "never" if first else "from the start" if last else f"{row['distance_mm']:g} mm"
        rows.append([name, *cells])
    head = [f"until {band}, {model} model" for band in ("5 mm", "0.2 mm") for model in ("declared", "exact")]
    return markdown(["`pid` takes over", *head], rows)


_OF_TWO_CONTROLLERS = tuple(
    f"{base}{step}" for base in ("pid", "predictive") for step in ("", "-refitted", "-corrected", "-online")
)


@table("gap_plants", source="gap")
def gap_plants(results: dict[str, Any]) -> str:
    """Format what each plant of gap-v1 hides, what was identified, and settling times of two controllers."""
    return plants_table(results, _OF_TWO_CONTROLLERS)


@table(f"{HELD}_plants", source=HELD)
def gap_held_plants(results: dict[str, Any]) -> str:
    """Format what each plant of the held set hides, what was identified, and all entries' settling times."""
    return plants_table(results, sorted(results["entries"]))


def plants_table(results: dict[str, Any], names: Sequence[str]) -> str:
    """Format what each plant hides, what was identified, and the settling times of some entries.

    Args:
        results: Summary of a set of plants.
        names: Names of the entries; those without results are left out.
    """
    names = [name for name in names if name in results["entries"]]
    refused = {(row["plant"], row["entry"]) for row in results.get("refused", ())}
    rows = []
    for plant in results["plants"]:
        found = " + ".join(plant.get("found", ())) or plant.get("verdict", "")
        times = [plant["settling_s"].get(name) for name in names]
        absent = ["refused" if (plant["plant"], name) in refused else "" for name in names]
        cells = [no if t is None else f"{t:.3f}" for t, no in zip(times, absent, strict=True)]
        rows.append([f"{plant['plant']}: {plant['hides']}", found, *cells])
    return markdown(["plant", "identified", *(f"`{name}`" for name in names)], rows)
