"""Build scorecard.html, one self-contained page that compares the controllers of an evaluation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from ..machine import AXIS_UNITS, AxisUnit
from ..web_page import Panel, number, write_page
from .advice import assumptions, next_steps, worst_move
from .episodes import Command, Episodes
from .metrics import mean_with_interval, ranked_episodes, settling_times
from .plots import distance_panel, distribution_panel, episode_panels, interval_panel, success_panel
from .reported_scores import (
    PATH_ERRORS,
    ratio_to_bounds,
    settling_in,
    task_name,
    unit_of_scores,
    unknown_bound_reasons,
)

_FURTHER_METRICS = {  # column headings of the metrics that all tasks have
    **{f"overshoot_{unit.small}": f"overshoot, {unit.small}" for unit in AXIS_UNITS.values()},
    **{f"final_error_{unit.small}": f"error at the end, {unit.small}" for unit in AXIS_UNITS.values()},
    "delay_ms": "delay behind the goal, ms",
    "energy_J": "energy, J",
    "voltage_variation": "{command.name} variation, {command.unit}",
    "saturation_share": "time at rated {command.name}, %",
    "peak_belt_force_N": "peak belt force, N",
}
_FACTORS = {"saturation_share": 100.0}


def write_scorecard(
    folder: str | Path,
    scores: Mapping[str, Any],
    recorded: Mapping[str, Episodes] | None = None,
    warnings: Sequence[str] = (),
    machine: str | None = None,
) -> Path:
    """Write scorecard.html: verdict, assumptions, scores, intervals, episodes, next steps; return its path.

    Args:
        folder: Folder of the page, created if necessary; an existing page is replaced.
        scores: Content of scores.json (`Evaluation.scores`).
        recorded: Recorded episodes by name of the controller, for the plots of episodes. Default: no plots.
        warnings: Sentences about results that cannot be trusted.
        machine: Name or file of the machine, for the commands on the page. Default: the machine's name.

    Raises:
        ImportError: If a library of the extra `report` is missing.
        OSError: If the file cannot be written.
    """
    recorded, controllers = recorded or {}, scores["controllers"]
    reaches = all("settling_s" in score for score in controllers.values())
    known = (score["success"] for score in controllers.values() if "success" in score)
    unit, command = unit_of_scores(next(known, ())), Command(**scores.get("command", {}))
    verdict = _reach_verdict(scores, recorded, unit) if reaches else _track_verdict(scores, unit)
    all_warnings = list(dict.fromkeys([*scores.get("warnings", ()), *warnings]))
    worst = worst_move(recorded[verdict.best]) if verdict.best and verdict.best in recorded else ""
    values = {
        "title": f"Scorecard: {task_name(scores)} on {scores['machine']}",
        "scores": scores,
        "task": task_name(scores),
        "heading": f"Best: {verdict.best}" if verdict.best else "No controller succeeds",
        "tone": verdict.tone,
        "sentences": verdict.sentences,
        "warnings": all_warnings,
        "assumptions": assumptions(scores),
        "steps": next_steps(
            scores, verdict.best, verdict.second, worst, all_warnings, machine or scores["machine"]
        ),
        "bound_reasons": unknown_bound_reasons(scores),
        "reaches": reaches,
        "bands": list(unit.band_texts.values()),
        "bound_band": unit.band_texts[unit.bound_band],
        "small_unit": unit.small,
        "rows": [_row(name, score, reaches, unit) for name, score in controllers.items()],
        "further": _further_metrics(controllers, command),
        "command": command,
        "panels": _panels(controllers, recorded, reaches, unit),
        "episodes": {name: _median_and_worst(name, episodes) for name, episodes in recorded.items()},
    }
    path = Path(folder) / "scorecard.html"
    write_page(path, "hframe_gym.evaluation", "scorecard.html.j2", values)
    return path


class _Verdict(NamedTuple):
    """Which controller is best (None: none succeeds), in sentences, and which is not significantly worse."""

    best: str | None
    tone: str
    sentences: list[str]
    second: str | None = None


def _median_and_worst(name: str, episodes: Episodes) -> list[Panel]:
    """Return the plots of the median and of the worst episode of a controller."""
    order = ranked_episodes(episodes)
    chosen = {"median": int(order[(len(order) - 1) // 2]), "worst": int(order[-1])}
    return [
        panel
        for which, episode in chosen.items()
        for panel in episode_panels(f"{name}, {which} episode ({episode + 1})", episodes, episode)
    ]


def _reach_verdict(scores: Mapping[str, Any], recorded: Mapping[str, Episodes], unit: AxisUnit) -> _Verdict:
    """Return the fastest of the most successful controllers."""
    controllers, band = scores["controllers"], unit.bound_band
    text = unit.band_texts[band]
    ranked = sorted(
        controllers,
        key=lambda n: (-controllers[n]["success"][band], controllers[n]["settling_s"][band]["mean"]),
    )
    best = controllers[ranked[0]]
    success, settling = best["success"][band], settling_in(best, band)
    if settling is None:
        sentence = f"No controller comes to rest within {text} of its goal in any of the episodes."
        return _Verdict(None, "warning", [sentence])
    sentences = [
        f"{ranked[0]} comes to rest within {text} of the goal in {100 * success:.1f} % of the "
        f"episodes, after {settling['mean']:.3f} s on average (95 % interval {_interval(settling, '.3f')} s)."
    ]
    ratio = ratio_to_bounds(best)
    if ratio:
        sentences.append(f"This is {ratio['mean']:.2f} times the shortest possible time.")
    equal = None
    if len(ranked) > 1 and set(ranked[:2]) <= set(recorded):
        difference = _difference(recorded[ranked[0]], recorded[ranked[1]], scores["seed"])
        sentences.append(_difference_sentence(ranked[1], difference))
        equal = ranked[1] if _includes_zero(difference) else None
    return _Verdict(ranked[0], "good" if success > 0.99 else "neutral", sentences, equal)


def _difference(best: Episodes, second: Episodes, seed: int) -> dict[str, Any]:
    """Return how much the second best controller settles later in the same episodes, s, and its interval."""
    times = [settling_times(e.goal_error, e.time_s, e.unit.bound_size)[0] for e in (second, best)]
    return mean_with_interval(times[0] - times[1], seed)


def _includes_zero(difference: Mapping[str, Any]) -> bool:
    """Return whether a difference is not significant."""
    return bool(difference["ci95"][0] <= 0.0 <= difference["ci95"][1])


def _difference_sentence(name: str, difference: Mapping[str, Any]) -> str:
    """Return a sentence about the settling times of the second best controller, by episode."""
    interval = f"95 % interval {_interval(difference, '.3f')} s"
    if _includes_zero(difference):
        return (
            f"In the same episodes {name} is not significantly slower or faster "
            f"({interval} of the difference)."
        )
    word = "slower" if difference["mean"] > 0 else "faster"
    return (
        f"In the same episodes {name} is {abs(difference['mean']):.3f} s {word} "
        f"({interval} of the difference)."
    )


def _track_verdict(scores: Mapping[str, Any], unit: AxisUnit) -> _Verdict:
    """Return the controller with the smallest contour error."""
    key, small = f"contour_{unit.small}", unit.small
    controllers = {n: s for n, s in scores["controllers"].items() if key in s}
    if not controllers:
        return _Verdict(
            next(iter(scores["controllers"])),
            "neutral",
            ["The table compares the controllers on the same episodes."],
        )
    best = min(controllers, key=lambda n: controllers[n][key]["rms"]["mean"])
    contour = controllers[best][key]
    sentence = (
        f"{best} follows the path with a contour error of {number(contour['rms']['mean'])} {small} rms (95 % "
        f"interval {_interval(contour['rms'], '.3g')} {small}) "
        f"and {number(contour['max']['mean'])} {small} at most, means over the episodes."
    )
    return _Verdict(best, "good", [sentence])


def _interval(value: Mapping[str, Any], form: str) -> str:
    """Return a 95 % interval as text: "0.312 to 0.331"."""
    low, high = value["ci95"]
    return f"{low:{form}} to {high:{form}}"


def _cell(value: Mapping[str, Any] | None, form: str = ".3g", factor: float = 1.0) -> dict[str, str]:
    """Return a mean and its 95 % interval as the texts of a table cell; empty without a value."""
    if value is None:
        return {"mean": "–", "interval": ""}
    low, high = value["ci95"]
    return {
        "mean": f"{factor * value['mean']:{form}}",
        "interval": f"{factor * low:{form}} to {factor * high:{form}}",
    }


def _row(name: str, score: Mapping[str, Any], reaches: bool, unit: AxisUnit) -> dict[str, Any]:
    """Return one controller's row of the main table."""
    if reaches:
        times = [settling_in(score, band) for band in unit.bands]
        cells = [_cell(value, ".3f") for value in (*times, ratio_to_bounds(score))]
    else:
        cells = [
            _cell(score[key][kind]) if key in score else _cell(None)
            for key in _path_keys(unit)
            for kind in ("rms", "max")
        ]
    return {
        "name": name,
        "success": [f"{100 * score['success'][band]:.1f}" for band in unit.bands],
        "cells": cells,
    }


def _path_keys(unit: AxisUnit) -> dict[str, str]:
    """Return the keys of the errors along a path in scores, with their names for readers."""
    return {f"{error}_{unit.small}": f"{error} error" for error in PATH_ERRORS}


def _further_metrics(controllers: Mapping[str, Mapping[str, Any]], command: Command) -> dict[str, Any]:
    """Return headings and rows of the table of the other metrics that any controller has."""
    keys = [key for key in _FURTHER_METRICS if any(key in score for score in controllers.values())]
    rows = {
        name: [_cell(score.get(key), ".3g", _FACTORS.get(key, 1.0)) for key in keys]
        for name, score in controllers.items()
    }
    headings = [_FURTHER_METRICS[key].format(command=command).removesuffix(", ") for key in keys]
    return {"headings": headings, "rows": rows}


def _panels(
    controllers: Mapping[str, Mapping[str, Any]],
    recorded: Mapping[str, Episodes],
    reaches: bool,
    unit: AxisUnit,
) -> list[Panel]:
    """Return the plots that compare the controllers."""
    success = {name: score["success"] for name, score in controllers.items()}
    distribution = [distribution_panel(recorded)] if recorded else []
    if not reaches:
        panels = [success_panel("Episodes whose contour error never exceeds a limit", success)]
        for key, title in _path_keys(unit).items():
            values = {
                name: score[key]["rms"] if key in score else None for name, score in controllers.items()
            }
            panels.append(interval_panel(f"{title.capitalize()}, rms", unit.small, values))
    else:
        panels = [success_panel("Episodes that end within a band around the goal", success)]
        values = {name: settling_in(score, unit.bound_band) for name, score in controllers.items()}
        if not any(values.values()):
            distribution = []  # nothing settles
        else:
            panels.append(interval_panel(f"Settling time to {unit.band_texts[unit.bound_band]}", "s", values))
        ratios = {name: ratio_to_bounds(score) for name, score in controllers.items()}
        if any(ratios.values()):
            panels.append(interval_panel("Settling time / shortest possible time", "", ratios))
    return panels + distribution + ([distance_panel(recorded)] if recorded else [])
