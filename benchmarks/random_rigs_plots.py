"""Draw the results on random rigs: confusion, detection by size, calibration, errors on unseen runs, time."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.ticker import LogLocator, NullFormatter
from scipy.stats import norm

from benchmarks.random_rigs_summary import MAX_RELATIVE_STD, Row, split_by_residue
from benchmarks.results_file import save_figure
from tools.repository import FIGURES

_GREEN, _RED, _GRAY, _AMBER = "#3b7d4f", "#c4513d", "0.6", "#e0b04c"
_RATIO_LIMITS = (0.5, 1e3)  # ratios beyond are drawn at the limit


def draw(rows: list[Row], content: dict[str, Any], set_name: str) -> None:
    """Write docs/figures/SET_*.png.

    Args:
        content: Summary of the results.
        set_name: Name of the results, such as random_rigs_1.
    """
    FIGURES.mkdir(parents=True, exist_ok=True)

    def path(name: str) -> Path:
        return FIGURES / f"{set_name}_{name}.png"

    _confusion(content["confusion"], path("confusion"))
    _detection(content["detection"], path("detection"))
    _calibration(rows, path("calibration"))
    _errors(rows, path("errors"))


def _confusion(counts: dict[str, dict[str, int]], path: Path) -> None:
    """Draw the counts of named families by hidden family."""
    hidden = list(counts)
    named = sorted({name for row in counts.values() for name in row}, key=lambda n: (n.startswith("("), n))
    table = np.array([[counts[h].get(n, 0) for n in named] for h in hidden])
    figure, axes = plt.subplots(
        figsize=(0.32 * len(named) + 2.5, 0.28 * len(hidden) + 2.0), layout="constrained"
    )
    share = table / np.maximum(table.sum(axis=1, keepdims=True), 1)
    axes.imshow(share, cmap="Greens", vmin=0.0, vmax=1.0, aspect="auto")
    for i, j in zip(*np.nonzero(table), strict=True):
        axes.text(
            j,
            i,
            str(table[i, j]),
            ha="center",
            va="center",
            fontsize=6,
            color="w" if share[i, j] > 0.6 else "k",
        )
    axes.set_xticks(range(len(named)), named, rotation=90, fontsize=6)
    axes.set_yticks(range(len(hidden)), hidden, fontsize=6)
    axes.set_xlabel("named family\n(number of effects; color: fraction of the row)")
    axes.set_ylabel("hidden family")
    save_figure(figure, path)


def _detection(detection: dict[str, Any], path: Path) -> None:
    """Draw effects by family and size, and the size at which half are identified, if some but not all are.

    Effects without a trace in the runs, which no method can find, are drawn apart from the missed ones.
    """
    figure, axes = plt.subplots(figsize=(6, 0.27 * len(detection) + 1.5), layout="constrained")
    identified = {family: [p[0] for p in found["points"] if p[1]] for family, found in detection.items()}
    missed = {family: [p[0] for p in found["points"] if not p[1]] for family, found in detection.items()}
    hidden = {family: found["without_trace"] for family, found in detection.items()}
    for sizes, marker, color, shift, name in (
        (identified, "o", _GREEN, 0.12, "identified"),
        (missed, "x", _RED, -0.12, "not identified"),
        (hidden, "+", _GRAY, -0.12, "without a trace in the runs"),
    ):
        points = [(100 * size, row + shift) for row, some in enumerate(sizes.values()) for size in some]
        if points:
            axes.plot(*np.transpose(points), marker, ms=4, color=color, label=name)
    halves = [
        (100 * found["half"], row)
        for row, found in enumerate(detection.values())
        if found["half"] is not None and found["identified"] > 0
    ]
    if halves:
        axes.plot(*np.transpose(halves), "|", ms=13, color="black", label="half are identified")
    axes.set_xscale("log")
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.xaxis.set_major_formatter("{x:g}")
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.set_yticks(range(len(detection)), list(detection), fontsize=7)
    axes.invert_yaxis()
    axes.set_xlabel("size, % of the full one")
    figure.legend(loc="outside upper center", ncols=2, fontsize=7, frameon=False)
    save_figure(figure, path)


def _calibration(rows: list[Row], path: Path) -> None:
    """Draw the fraction of true values inside symmetric intervals over the intervals' level."""
    figure, axes = plt.subplots(figsize=(4.2, 4.2), layout="constrained")
    level = np.linspace(0.01, 0.999, 200)
    axes.plot(level, level, color=_GRAY, lw=0.8)
    for some, style, which in zip(
        split_by_residue(rows), ("-", "--"), ("clean", "with residue"), strict=True
    ):
        for of_effect, color, what in ((True, _GREEN, "effects"), (False, _AMBER, "machine")):
            z = [
                abs(i["z"])
                for r in some
                for i in r["intervals"]
                if i["effect"] == of_effect
                and i["relative_std"] is not None
                and i["relative_std"] < MAX_RELATIVE_STD
            ]
            if z:
                inside = np.mean(np.array(z)[:, None] <= norm.ppf(0.5 + 0.5 * level), axis=0)
                axes.plot(level, inside, style, color=color, label=f"{what}, {which} ({len(z)})")
    axes.set_xlabel("level of the reported interval")
    axes.set_ylabel("fraction of true values inside")
    axes.legend(fontsize=7, frameon=False)
    save_figure(figure, path)


def _errors(rows: list[Row], path: Path) -> None:
    """Draw the error on unseen runs after identification over that of the true machine."""
    figure, axes = plt.subplots(figsize=(5, 4.5), layout="constrained")
    for some, marker, color, name in zip(
        split_by_residue(rows), "os", (_GREEN, _RED), ("clean", "with residue"), strict=True
    ):
        if some:
            true, after = (
                np.clip([r["unseen"][k]["mean"] for r in some], *_RATIO_LIMITS) for k in ("true", "after")
            )
            axes.loglog(true, after, marker, ms=4, color=color, label=name)
    axes.loglog(_RATIO_LIMITS, _RATIO_LIMITS, color=_GRAY, lw=0.8, label="equal errors")
    axes.set_xlabel("error of the true machine on unseen runs / noise")
    axes.set_ylabel("error of the identified machine on unseen runs / noise")
    axes.legend(fontsize=7)
    save_figure(figure, path)
