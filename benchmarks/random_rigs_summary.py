"""Summarize the results on random rigs: names, detection against size, confusion, coverage, errors, time."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

Row = dict[str, Any]
MAX_RELATIVE_STD = 0.2  # above it a parameter counts as not identifiable and does not enter the coverage
QUANTILES = {"68": 1.0, "95": 1.96}  # half-widths of the intervals in standard deviations
# Noise variances: below this gain of one parameter, chance is not excluded (docs/how_it_decides.md).
NO_TRACE = 24.0
LOGS = {"1": (1, 1), "2 to 5": (2, 5), "8 to 20": (8, 20)}  # changes of the voltages from one row to the next
NOTHING, UNEXPLAINED, OTHERS = "(nothing)", "(unexplained)", "(not there)"
_SLOPES = (0.1, 0.2, 0.4, 0.8)  # widths of the detection curve, in natural logarithms of the size
_SIZES = np.geomspace(0.01, 3.0, 200)


def summary(rows: list[Row]) -> dict[str, Any]:
    """Summarize the rows of all rigs.

    Returns:
        Plain data, by topic.
    """
    detection = detection_sizes(rows)
    clean, residue = split_by_residue(rows)
    return {
        "rigs": len(rows),
        "names": _names(rows, detection),
        "verdicts": {
            kind: dict(Counter(r["verdict"] for r in _of_kind(rows, kind)))
            for kind in sorted({r["kind"] for r in rows})
        },
        "detection": detection,
        "confusion": confusion(rows),
        "false_names": {
            "clean": _false_names(clean),
            "residue": _false_names(residue),
            "off_form": _false_names(_of_kind(rows, "off-form")),
            "outside": _false_names(_of_kind(rows, "outside")),
            "by_residue": {
                kind: _false_names([r for r in residue if r["residue"] == kind])
                for kind in sorted({r["residue"] for r in residue})
            },
        },
        "coverage": {
            name: coverage(some, keep)
            for name, some, keep in (
                ("clean, effects", clean, lambda i: i["effect"]),
                ("clean, machine", clean, lambda i: not i["effect"]),
                ("residue, effects", residue, lambda i: i["effect"]),
                ("residue, machine", residue, lambda i: not i["effect"]),
            )
        },
        "unseen": _errors(clean, residue),
        "logs": _by_log(rows),
        "stable": sum(r["stable"] for r in rows),
        "consistent": sum(r["consistency"] <= 0.05 for r in rows),
        "seconds": _durations([r["seconds"] for r in rows]),
        "repeated_seconds": _durations([r["repeated_seconds"] for r in rows if "repeated_seconds" in r]),
        "repeatable": sum(r.get("repeatable", False) for r in rows),
    }


def _durations(seconds: list[dict[str, float]]) -> dict[str, dict[str, float]]:
    """Return the median and the longest of some durations, s, by clock; nothing if there are none."""
    return {
        clock: {"median": _median(s[clock] for s in seconds), "most": max(s[clock] for s in seconds)}
        for clock in ("wall", "cpu")
        if seconds
    }


def split_by_residue(rows: list[Row]) -> tuple[list[Row], list[Row]]:
    """Divide the rigs without effects or with library effects.

    Returns:
        Rigs without a residue.
        Rigs with a residue.
    """
    usual = [r for r in rows if r["kind"] in ("none", "library")]
    return [r for r in usual if not r["residue"]], [r for r in usual if r["residue"]]


def _of_kind(rows: list[Row], kind: str) -> list[Row]:
    return [r for r in rows if r["kind"] == kind]


def _median(values: Iterable[float]) -> float | None:
    some = list(values)
    return float(np.median(some)) if some else None


def _names(rows: list[Row], detection: dict[str, Any]) -> dict[str, Any]:
    """Count the identified hidden effects, by kind of rig, and those above the family's detection size."""
    clean, residue = split_by_residue(rows)
    groups = {
        "clean": clean,
        "residue": residue,
        "off_form": _of_kind(rows, "off-form"),
        "outside": _of_kind(rows, "outside"),
    }
    counts = {}
    for name, some in groups.items():
        hidden = [h for r in some for h in r["hidden"] if not h["absorbed"]]
        counts[name] = {
            "rigs": len(some),
            "right": sum(r["complete"] and not r["extra"] for r in some),
            "effects": len(hidden),
            "identified": sum(h["identified"] for h in hidden),
        }
    above = [h for r in clean for h in r["hidden"] if _above(h, detection)]
    hidden = [h for r in _of_kind(rows, "library") for h in r["hidden"] if not h["absorbed"]]
    median = _median(h["size"] for h in hidden)
    large = [h for h in hidden if h["size"] > median and not _without_trace(h)]
    return counts | {
        "above_detection": {"effects": len(above), "identified": sum(h["identified"] for h in above)},
        "above_median_size": {
            "effects": len(large), "identified": sum(h["identified"] for h in large), "size": median,
        },
        "without_trace": {"effects": sum(map(_without_trace, hidden))},
    }  # fmt: skip


def _without_trace(hidden: dict[str, Any]) -> bool:
    """Return whether the runs to identify do not show a hidden effect, so that no method can find it."""
    trace = hidden.get("trace")
    return trace is not None and trace < NO_TRACE


def _above(hidden: dict[str, Any], detection: dict[str, Any]) -> bool:
    """Return whether a hidden effect is larger than the size at which half of its family are identified."""
    size = detection.get(hidden["family"], {}).get("half")
    counted = not hidden["absorbed"] and not _without_trace(hidden)
    return counted and (size is None or hidden["size"] > size)


def detection_sizes(rows: list[Row]) -> dict[str, Any]:
    """Estimate the size at which half of the effects of a family are identified.

    A logistic curve over the logarithm of the size is fitted to the effects with a trace in clean rigs and
    rigs with a residue.

    Returns:
        By family: count, identified, half (fraction of the full size; None if all are identified), points
        (pairs of size and whether it was identified), all of effects with a trace; without_trace (sizes of
        the others).
    """
    points: dict[str, list[tuple[float, bool]]] = defaultdict(list)
    without_trace: dict[str, list[float]] = defaultdict(list)
    for row in _of_kind(rows, "library"):
        for hidden in row["hidden"]:
            if hidden["absorbed"]:
                continue
            if _without_trace(hidden):
                without_trace[hidden["family"]].append(hidden["size"])
            else:
                points[hidden["family"]].append((hidden["size"], hidden["identified"]))
    families = sorted(points.keys() | without_trace.keys())
    return {
        family: {
            "count": len(some),
            "identified": sum(identified for _, identified in some),
            "half": _half(some),
            "points": sorted(some),
            "without_trace": sorted(without_trace[family]),
        }
        for family, some in ((family, points[family]) for family in families)
    }


def _half(points: list[tuple[float, bool]]) -> float | None:
    """Return the size at which the most likely logistic curve is one half; None if all were identified."""
    size, identified = np.array([p[0] for p in points]), np.array([p[1] for p in points], dtype=bool)
    if identified.all():
        return None
    best, likelihood = float(_SIZES[-1]), -np.inf
    for width in _SLOPES:
        distance = (np.log(size) - np.log(_SIZES)[:, None]) / width  # (candidates, effects)
        total = -np.logaddexp(0.0, np.where(identified, -distance, distance)).sum(axis=1)
        if total.max() > likelihood:
            best, likelihood = float(_SIZES[int(np.argmax(total))]), float(total.max())
    return best


def confusion(rows: list[Row]) -> dict[str, dict[str, int]]:
    """Count by hidden family what was named.

    Returns:
        Counts by hidden family and named family. An effect that was identified counts at its family. For one
        that was not, the false names of its rig count, or the verdict. The row "(not there)" counts all other
        false names.
    """
    counts: dict[str, Counter[str]] = defaultdict(Counter)
    for row in rows:
        extra = [e["family"] for e in row["named"] if e["extra"]]
        missed = [h for h in row["hidden"] if not h["identified"]]
        for hidden in row["hidden"]:
            if hidden["identified"]:
                counts[hidden["family"]][hidden["family"]] += 1
            elif extra:
                counts[hidden["family"]].update(extra)
            else:
                counts[hidden["family"]][UNEXPLAINED if row["verdict"] == "unexplained" else NOTHING] += 1
        if not missed:
            counts[OTHERS].update(extra)
    return {family: dict(sorted(named.items())) for family, named in sorted(counts.items())}


def _false_names(rows: list[Row]) -> dict[str, Any]:
    """Count the rigs in which something was named that is not there."""
    return {
        "rigs": len(rows),
        "with_false_name": sum(bool(r["extra"]) for r in rows),
        "names": sum(len(r["extra"]) for r in rows),
        "which": {r["rig"]: r["extra"] for r in rows if r["extra"]},
    }


def coverage(rows: list[Row], keep: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
    """Return how many true values lie inside the reported intervals.

    Args:
        keep: Predicate that selects intervals.

    Returns:
        Number of parameters with a relative standard deviation below `MAX_RELATIVE_STD`, the fraction inside
        the intervals of 68 and 95 %, and the median and the root mean square of the error in standard
        deviations.
    """
    intervals = [i for r in rows for i in r["intervals"] if keep(i)]
    z = np.array(
        [i["z"] for i in intervals if i["relative_std"] is not None and i["relative_std"] < MAX_RELATIVE_STD]
    )
    if not len(z):
        return {"parameters": 0}
    inside = {name: float(np.mean(np.abs(z) <= width)) for name, width in QUANTILES.items()}
    return {
        "parameters": len(z),
        **inside,
        "median": float(np.median(np.abs(z))),
        "rms": float(np.sqrt(np.mean(z**2))),
    }


def _errors(clean: list[Row], residue: list[Row]) -> dict[str, Any]:
    """Summarize the errors on unseen runs: over the noise, and over what the true machine reaches.

    "over_truth" leaves out rigs with an effect that the runs to identify do not show: unseen runs may show
    it.
    """
    over_noise = [r["unseen"]["after"]["mean"] for r in clean]
    over_truth = {
        name: [_over_truth(r) for r in some] for name, some in (("clean", clean), ("residue", residue))
    }
    shown = [r for r in [*clean, *residue] if not any(map(_without_trace, r["hidden"]))]
    return {
        "clean_over_noise": _quantiles(over_noise, 1.1),
        "clean_over_truth": _quantiles(over_truth["clean"], 1.1),
        "residue_over_truth": _quantiles(over_truth["residue"], 1.2),
        "over_truth": _quantiles([_over_truth(r) for r in shown], 1.3),
    }


def _over_truth(row: Row) -> float:
    """Return the error of the answer on unseen runs over that of the true machine."""
    return float(row["unseen"]["after"]["mean"] / row["unseen"]["true"]["mean"])


def _by_log(rows: list[Row]) -> dict[str, Any]:
    """Summarize the rigs in closed loop by the changes of the voltages from one row of a log to the next."""
    groups = {}
    for name, (fewest, most) in LOGS.items():
        some = [r for r in rows if r.get("updates") and fewest <= r["updates"] <= most]
        if some:
            clean, residue = split_by_residue(some)
            groups[name] = {
                "rigs": len(some),
                "right": sum(r["complete"] and not r["extra"] for r in some),
                "with_false_name": sum(bool(r["extra"]) for r in some),
                "over_truth": _errors(clean, residue)["over_truth"],
            }
    return groups


def _quantiles(values: list[float], limit: float) -> dict[str, Any]:
    """Return median, 90 and 95 % quantile, and the fraction below a limit."""
    if not values:
        return {"rigs": 0}
    median, p90, p95 = (float(v) for v in np.quantile(values, [0.5, 0.9, 0.95]))
    within = float(np.mean(np.array(values) <= limit))
    return {"rigs": len(values), "median": median, "p90": p90, "p95": p95, "limit": limit, "within": within}


def show(console: Console, content: dict[str, Any]) -> None:
    """Print a summary."""
    names = Table("rigs", "count", "right", "effects", "identified", "rigs with false names")
    for name, counts in content["names"].items():
        if "rigs" in counts:
            false = content["false_names"][name]["with_false_name"]
            names.add_row(
                name, *(str(counts[key]) for key in ("rigs", "right", "effects", "identified")), str(false)
            )
    console.print(names)
    for name, text in (("above_detection", "detection size"), ("above_median_size", "size")):
        above = content["names"][name]
        console.print(f"above the median {text}: {above['identified']} of {above['effects']} identified")
    console.print(f"without a trace in the runs: {content['names']['without_trace']['effects']} effects")
    for name, found in content["logs"].items():
        errors = found["over_truth"]
        if errors["rigs"]:
            unseen = f"median {errors['median']:.3g}, {errors['within']:.0%} within {errors['limit']}"
            console.print(
                f"{name} changes of the voltages a row: {found['right']} of {found['rigs']} right, "
                f"{found['with_false_name']} with a false name; unseen over the true machine: {unseen}"
            )
    for kind, verdicts in content["verdicts"].items():
        counts = ", ".join(f"{verdict} {count}" for verdict, count in sorted(verdicts.items()))
        console.print(f"verdicts, {kind}: {counts}")
    sizes = Table("family", "effects", "identified", "half are found at")
    for family, found in content["detection"].items():
        half = "all found" if found["half"] is None else f"{found['half']:.1%}"
        sizes.add_row(family, str(found["count"]), str(found["identified"]), half)
    console.print(sizes)
    for name, found in content["coverage"].items():
        if found["parameters"]:
            console.print(
                f"coverage, {name}: {found['68']:.0%} of 68 %, "
                f"{found['95']:.0%} of 95 % ({found['parameters']} values)"
            )
    for name, found in content["unseen"].items():
        if found["rigs"]:
            console.print(
                f"unseen, {name.replace('_', ' ')}: median {found['median']:.3g}, "
                f"95 % quantile {found['p95']:.3g}, {found['within']:.0%} within {found['limit']}"
            )
    wall, cpu = content["seconds"]["wall"], content["seconds"]["cpu"]
    console.print(
        f"stable {content['stable']}, simulate equals the report {content['consistent']} "
        f"of {content['rigs']}; wall {wall['median']:.0f} s median, {wall['most']:.0f} s slowest; "
        f"cpu {cpu['median']:.0f} s, {cpu['most']:.0f} s"
    )
    if again := content["repeated_seconds"]:
        console.print(
            f"again, with compiled code: cpu {again['cpu']['median']:.0f} s median, "
            f"{again['cpu']['most']:.0f} s slowest; {content['repeatable']} reports equal"
        )
