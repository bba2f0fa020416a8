"""Answers to the first questions of a reader of the report."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ....machine import Machine
from ....web_page import number
from ...judge.criteria import SelectionCriteria
from ..content.document import Report
from ..content.result_curves import RunCurves
from ..content.saved_result import SavedResult
from ..diagnostics.parameter_diagnostics import parameter_doubts, with_structure_of
from ..diagnostics.unequal_belts import unequal_belts
from ..plots.held_out_curves import run_ratio
from ..units import percent, readable_unit
from .remainder import NOTICEABLE_ERROR, cause_of_remainder, parts_of_remainder
from .rows import EffectRow
from .verdict import (
    dependence_sentences,
    found_effects,
    hidden_effects,
    nearest_effects,
    undeclared_friction,
    unfinished_search,
    unknown_voltages,
)

# Fraction of the squared simulation error; effects that remove less are named for what observers show.
_MAIN_PART = 0.5
_CHANGED_STDS = 3.0  # Standard deviations beyond which a parameter differs from its declared value.
_NAMED_CHANGES = 3  # Parameters that are named, those first that changed most.


def answers(
    saved: SavedResult, effects: Sequence[EffectRow], runs: Sequence[str], step: str
) -> dict[str, list[str]]:
    """Answer the five first questions of a reader of the report page.

    Args:
        saved: The saved result.
        effects: The effects that were found, as rows of the page (`effect_rows`).
        runs: Names of the held-out runs, the worst first.
        step: The most important next step, in words.

    Returns:
        Sentences by question, in the order of the page: what is wrong, how sure that is, how much is left, on
        which run, and what to do now.
    """
    report = saved.report
    return {
        "What is wrong": [
            *unknown_voltages(report),
            *undeclared_friction(report),
            *wrong_with_declared(saved),
        ],
        "How sure": [*unfinished_search(report), *_certainty(saved, effects)],
        "How much is left": [*_left(report), *_left_at_belts(saved)],
        "On which run": _worst_run(saved, runs),
        "What now": [step],
    }


def wrong_with_declared(saved: SavedResult) -> list[str]:
    """Return sentences on what is wrong with the declared machine, by the verdict.

    With "effect_found", the effects; with "no_effect", that there are none; both with the parameters that
    differ most from the declared ones and belts that differ. With "unexplained", on what the missing force
    depends.

    Args:
        saved: The saved result.
    """
    report = saved.report
    belts = [pair.sentence() for pair in unequal_belts(saved.machine, saved.declared, _CHANGED_STDS)]
    if report.verdict == "effect_found":
        return [f"{found_effects(report)}.", *_changes(saved), *belts]
    if report.verdict == "no_effect":
        nothing = "No effect was found." if cause_of_remainder(report) else "No effect is missing."
        changes = _changes(saved) or ["No parameter differs clearly from its declared value."]
        return [nothing, *hidden_effects(report), *changes, *belts]
    unknown = "The model lacks something that no known effect explains."
    return [unknown, *dependence_sentences(report), *nearest_effects(report)]


def _changes(saved: SavedResult) -> list[str]:
    """Return a sentence about the reliable parameters that differ most from their declared values."""
    machine, doubts = saved.machine, parameter_doubts(saved.machine, saved.declared)
    declared = with_structure_of(machine, saved.declared)
    changes = {}
    for name, reasons in doubts.items():
        before = declared.parameters.get(name)
        std = (machine.uncertainty.std(name) if machine.uncertainty else None) or math.inf
        if reasons or not before or abs(machine.parameters[name] - before) < _CHANGED_STDS * std:
            continue
        changes[name] = 100.0 * (machine.parameters[name] / before - 1.0)
    largest = sorted(changes, key=lambda name: -abs(changes[name]))[:_NAMED_CHANGES]
    texts = [f"{name} {changes[name]:+.3g} %" for name in largest]
    return [f"Parameters that differ most from the declared machine: {', '.join(texts)}."] if texts else []


def _certainty(saved: SavedResult, effects: Sequence[EffectRow]) -> list[str]:
    """Say how sure the verdict is: what the held-out runs say, what else explains them, what is uncertain."""
    report = saved.report
    if report.verdict == "unexplained":
        why = report.reason or "no effect of the library passes the tests on the fitted and the held-out runs"
        return [f"No name is given: {why}."]
    sentences = []
    if effects:
        sentences += removed_by_effects(report)
        rivals = [f"{e.name} at {e.site} (or {', '.join(e.rivals)})" for e in effects if e.rivals]
        others = "effect that was tried" if report.unfinished else "effect of the library"
        sentences.append(
            f"These runs do not tell apart: {'; '.join(rivals)}."
            if rivals
            else f"No other {others} explains these runs as well."
        )
        sentences += _precision(saved.machine)
    return [*sentences, _whiteness(report)]


def removed_by_effects(report: Report) -> list[str]:
    """Return sentences on the fraction of the squared simulation error beyond noise that the effects remove.

    If this is less than half and more than twice the noise is left, a second sentence says that a slower
    cause is not explained. There are none if the report does not state the fraction.
    """
    if (explained := report.explained) is None:
        return []
    removed = (
        f"The effects remove {percent(max(explained, 0.0))} % of the squared "
        "error beyond the noise on runs to which nothing was fitted."
    )
    left = report.left
    at_noise = left is not None and left <= SelectionCriteria().max_noise_ratio_explained
    if explained >= _MAIN_PART or at_noise:
        return [removed]
    slow = "A slower cause that no effect explains adds up to the rest; they are named by the fast errors."
    return [removed, slow]


def _precision(machine: Machine) -> list[str]:
    """Return a sentence about the least certain parameter of the effects."""
    if (uncertainty := machine.uncertainty) is None:
        return []
    values = {
        name: abs((uncertainty.std(name) or 0.0) / machine.parameters[name])
        for name in uncertainty.names
        if "@" in name and machine.parameters[name]
    }
    if not values:
        return []
    name = max(values, key=lambda name: values[name])
    percents = number(100.0 * values[name])
    return [f"The least certain parameter of the effects is {name}: its standard deviation is {percents} %."]


def _whiteness(report: Report) -> str:
    """Return whether noise explains the error that is left."""
    if report.residual.white:
        return "The remaining error is consistent with the sensors' noise."
    if (report.left or math.inf) < NOTICEABLE_ERROR:
        return (
            "The remaining error is about as large as the sensors' noise, but it is correlated in time: "
            "a small systematic part is left."
        )
    return "The remaining error is larger than the sensors' noise."


def _left(report: Report) -> list[str]:
    """Return the error that is left, in the user's terms, and why it is, if that is known."""
    left = parts_of_remainder(report)
    if not left:
        return ["The simulation diverges, so that it has no error."]
    why = "" if report.verdict == "unexplained" else cause_of_remainder(report)
    return [f"{'; '.join(left)}{why or '.'}"]


def _left_at_belts(saved: SavedResult) -> list[str]:
    """Return the error of a machine without linear sensors as a distance on its pulleys' circumference."""
    machine, errors = saved.machine, saved.report.after.channels
    if not machine.belts or any(sensor.channel.endswith("_m") for sensor in machine.sensors):
        return []
    pulleys = {c.name: c.radius for c in machine.coordinates if c.kind == "rotary"}
    travels = {
        sensor.channel: abs(factor) * pulleys[name] * rmse
        for sensor in machine.sensors
        for name, factor in sensor.row.items()
        if sensor.of_position and name in pulleys and (rmse := errors[sensor.channel].rmse) is not None
    }
    if not travels:
        return []
    largest = max(travels.values())
    factor, unit = readable_unit("_m", largest)
    return [f"At the circumference of the pulley, that is {number(factor * largest)} {unit}."]


def _worst_run(saved: SavedResult, runs: Sequence[str]) -> list[str]:
    """Return the held-out run of largest error, with the channel and the time of its largest deviation."""
    report, curves = saved.report, saved.curves
    ratios, run = {name: run_ratio(report, curves, name) for name in runs}, runs[0]
    if (worst := ratios[run]) is None:
        return [f"Nothing was measured in {run}."]
    if not math.isfinite(worst):
        return [f"{run}, in which the simulation diverges."]
    text = f"{run}: {number(worst)} times the noise{_largest_deviation(report, curves.runs[run])}."
    others = [ratio for name in runs[1:] if (ratio := ratios[name]) is not None]
    if others:
        best = number(min(others))
        text += f" The other held-out run{'s have' if len(others) > 1 else ' has'} {best}"
        text += f" to {number(max(others))} times the noise." if len(others) > 1 else " times the noise."
    return [text]


def _largest_deviation(report: Report, run: RunCurves) -> str:
    """Return a clause about the largest deviation, of the channel that deviates most, relative to noise."""
    time_s, errors = run.time_s, np.abs(np.nan_to_num(run.errors["after"]))
    sizes = [
        float(errors[:, j].max()) / noise if (noise := report.noise_of(channel)) else 0.0
        for j, channel in enumerate(report.channels)
    ]
    if not any(sizes):
        return ""
    j = int(np.argmax(sizes))
    row = int(np.argmax(errors[:, j]))
    channel = report.channels[j]
    factor, unit = readable_unit(channel, float(errors[row, j]))
    size, after_s = factor * float(errors[row, j]), time_s[row] - time_s[0]
    return f", up to {number(size)} {unit} at {channel} after {after_s:.3g} s"
