"""Words about a result: the verdict in a sentence, and the answers to what a reader of its page asks first."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal

import numpy as np

from ...effects.smooth_table import HOOK_OF_KIND
from ...machine import Machine
from ...web_page import number
from ..fit.parameter_diagnostics import parameter_doubts
from ..judge.criteria import SelectionCriteria
from ..judge.table import is_better_than_table
from ..judge.verdict import error_beyond_noise
from .curves import run_ratio
from .document import STAGES, Evaluation, Report
from .result_curves import RunCurves
from .rows import EffectRow
from .saved_result import SavedResult
from .units import percent, readable_unit

# Error in percent of the motion that is small: a feed-forward control by the machine removes the other 99 %.
_SMALL_PERCENT_OF_MOTION = 1.0
# Fraction of the squared simulation error; effects that remove less are named for what observers show.
_MAIN_PART = 0.5
_NOTICEABLE_ERROR = 1.3  # Remaining error over noise that the report calls unexplained.
_DIVERGES = "infinitely many (its simulation diverges)"
_DEVIATING = (
    "Only {} deviate{}: the other sensors agree with the simulation, although they would show an error of the motion. "
    "The cause lies at this sensor, its mounting or frame, or in an elastic part between it and the motors."
)
# Fraction of the refitted machine's error below which that of the declared one is mentioned.
_CLEARLY_BETTER = 0.9
# A simulation whose error is beyond both has drifted: times the noise, and percent of the motion before or after.
_MAX_NOISE_RATIO, _MAX_PERCENT_OF_MOTION = 50.0, 50.0
_BY_INSTRUMENTS = (
    "The standard deviations come from a fit by instruments (smoothed {0} and measurements). The parameters are "
    "those of this fit, or lie between them and those of a fit to the residual that the statistics of the {0} make "
    "white, whichever simulate runs to which they were not fitted best."
)
_WHOLE = 100.0  # percent; a larger force is no part of another one.
_CHANGED_STDS = 3.0  # Standard deviations beyond which a parameter differs from its declared value.
_NAMED_CHANGES = 3  # Parameters that are named, those first that changed most.


def answers(
    saved: SavedResult, effects: Sequence[EffectRow], runs: Sequence[str], step: str
) -> dict[str, list[str]]:
    """Answer the five questions that a reader of the page has first.

    Args:
        saved: The result.
        effects: Effects that were found.
        runs: Names of the held-out runs, the worst first.
        step: The first of the next steps, in words.

    Returns:
        Sentences by question, in the order of the page: what is wrong, how sure that is, how much is left, on which
        run, and what to do now.
    """
    report = saved.report
    return {
        "What is wrong": [*unknown_voltages(report), *_undeclared_friction(report), *_wrong(saved)],
        "How sure": [*_unfinished(report), *_certainty(saved, effects)],
        "How much is left": [*_left(report), *_left_at_belts(saved)],
        "On which run": _worst_run(saved, runs),
        "What now": [step],
    }


def _wrong(saved: SavedResult) -> list[str]:
    """Return what is wrong with the declared machine."""
    report = saved.report
    if report.verdict == "effect_found":
        return [f"{_found(report)}.", *_changes(saved)]
    if report.verdict == "no_effect":
        nothing = "No effect was found." if _cause_of_remainder(report) else "No effect is missing."
        return [nothing, *(_changes(saved) or ["No parameter differs clearly from its declared value."])]
    unknown = "The model lacks something that no known effect explains."
    return [unknown, *_dependence_sentences(report), *_nearest(report)]


def _changes(saved: SavedResult) -> list[str]:
    """Return a sentence about the reliable parameters that differ most from their declared values."""
    machine, declared = saved.machine, saved.declared
    doubts = parameter_doubts(machine, declared)
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
    """Return how sure the verdict is: what the held-out runs say, what else explains them, what is uncertain."""
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
    """Return how much of the simulation error the effects remove, and why it is little, if it is.

    Args:
        report: Content of report.json.
    """
    if (explained := report.explained) is None:
        return []
    removed = (
        f"The effects remove {percent(max(explained, 0.0))} % of the squared error beyond the noise on runs to which "
        "nothing was fitted."
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
    if (report.left or math.inf) < _NOTICEABLE_ERROR:
        return (
            "The remaining error is about as large as the sensors' noise, but it is correlated in time: a small "
            "systematic part is left."
        )
    return "The remaining error is larger than the sensors' noise."


def _left(report: Report) -> list[str]:
    """Return the error that is left, in the user's terms, and why it is, if that is known."""
    left = _left_parts(report)
    if not left:
        return ["The simulation diverges, so that it has no error."]
    why = "" if report.verdict == "unexplained" else _cause_of_remainder(report)
    return [f"{'; '.join(left)}{why or '.'}"]


def _left_at_belts(saved: SavedResult) -> list[str]:
    """Return the error of a machine without linear sensors as a distance: that of its pulleys' circumference."""
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
    """Return the held-out run with the largest error, with the channel and the time of its largest deviation."""
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
    """Return a clause about the largest deviation, of the channel that deviates most in multiples of its noise."""
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


def tone_of_remainder(report: Report) -> Literal["good", "neutral", "warning"]:
    """Return the tone of the page, which follows from the error that is left and not from the names that were found.

    Args:
        report: Content of report.json.

    Returns:
        "good" if the error is at most `max_noise_ratio_explained` times the noise, and beyond it at most
        `max_motion_error` of the motion of every channel, and the verdict is not "unexplained"; otherwise "neutral" if
        it is at most 1 % of the motion of every channel; "warning" if it is larger, or the simulation diverges.
    """
    criteria, left = SelectionCriteria(), report.left
    percents = report.after.percents_of_motion
    largest = max(percents, default=0.0)
    if left is None:
        return "warning"
    beyond = error_beyond_noise(largest / 100.0, left)
    at_noise = left <= criteria.max_noise_ratio_explained and beyond <= criteria.max_motion_error
    if at_noise and report.verdict != "unexplained":
        return "good"
    return "neutral" if percents and largest <= _SMALL_PERCENT_OF_MOTION else "warning"


def verdict_sentence(report: Report) -> str:
    """Describe in words the verdict and the error on the held-out runs, which were not fitted.

    The error is the simulation error in units of the sensors' noise, root mean square over the channels. If the
    simulation drifts, the relative error of the drives' force is stated instead, if the report contains it.

    Args:
        report: Content of report.json.

    Returns:
        One or more English sentences.
    """
    return " ".join([*unknown_voltages(report), *_undeclared_friction(report), _verdict_sentence(report)])


def _undeclared_friction(report: Report) -> list[str]:
    """Return a sentence about friction that the motion shows and the machine file does not declare."""
    texts = []
    for friction in report.undeclared_friction:
        std = "" if friction.std is None else f" +- {friction.std:.2g}"
        share = friction.percent_of_drives
        of_drives = "" if share is None else f" ({share:.2g} % of the drives' largest force)"
        texts.append(f"{friction.parameter} is {number(friction.value)}{std} {friction.unit}{of_drives}")
    if not texts:
        return []
    return [f"The machine has friction that its file does not declare: {', '.join(texts)}."]


def unknown_voltages(report: Report) -> list[str]:
    """Return sentences about the voltages that a log slower than its controller does not contain.

    Args:
        report: Content of report.json.

    Returns:
        What is missing, what that limits, and what to do; nothing if the log contains all voltages.
    """
    if (unknown := report.unknown_voltages) is None:
        return []
    positions = {c: e for c, e in unknown.errors.items() if c.endswith(("_m", "_rad"))} or unknown.errors
    largest: dict[str, tuple[float, str]] = {}
    for channel, error in positions.items():
        kind = channel.rpartition("_")[2]
        largest[kind] = max(largest.get(kind, (0.0, "")), (error, channel))
    sizes = []
    for error, channel in largest.values():
        factor, unit = readable_unit(channel, error)
        sizes.append(f"{number(factor * error)} {unit} at {channel}")
    period = f"{1e3 * unknown.period_s:.3g} ms"
    by_instruments = unknown.fitted_by == "instruments"
    commands = unknown.commands
    advice = f"log every row of the controller (every {period})"
    if commands != "set points":
        advice += ", or describe the drives by their set point and log that"
    return [
        f"The controller changes the {commands} about {unknown.changes_per_row} times between two rows of this log "
        f"(every {period}), and the log does not contain these {commands}.",
        f"A simulation of the held-out runs therefore errs by {' and '.join(sizes)} (rms), whatever the machine: what "
        "changes the motion by less cannot be found.",
        *([_BY_INSTRUMENTS.format(commands)] if by_instruments else []),
        f"To find more, {advice}.",
    ]


def _verdict_sentence(report: Report) -> str:
    """Describe the verdict and the error on the held-out runs."""
    errors: dict[str, float | None]
    if drifts(report):
        unit = "% of the drives' force"
        errors = {stage: 100.0 * (report.machines[stage].force_error or 0.0) for stage in STAGES}
    else:
        unit = "times the sensors' noise"
        errors = {stage: report.machines[stage].noise_ratio for stage in STAGES}
    before, after = (number(errors[stage], _DIVERGES) for stage in ("before", "after"))
    declared, refitted = errors["declared"], errors["before"]
    if declared is not None and refitted is not None and declared < _CLEARLY_BETTER * refitted:
        before += (
            f" (with the declared parameters: {number(declared)})"  # The refit minimizes short predictions.
        )
    if report.verdict == "effect_found":
        change = "rises" if (errors["after"] or 0.0) > (refitted or np.inf) else "falls"  # None: it diverges
        pronoun = "it" if len(report.effects) == 1 else "them"
        found = (
            f"{_found(report)}. With {pronoun}, the error on the held-out runs "
            f"{change} from {before} to {after} {unit}.{_remainder(report)}"
        )
        return " ".join([*_left_in_words(report), found, *_unfinished(report)])
    if report.verdict == "no_effect":
        remainder = _remainder(report)
        start = f"No effect {'was found' if remainder else 'is missing'}: with refitted parameters, the error of the"
        found = f"{start} declared model on the held-out runs is {before} {unit}.{remainder}"
        return " ".join([found, *([] if remainder else _left_in_words(report)), *_unfinished(report)])
    text = f"The error of the refitted model on the held-out runs is {before} {unit}, and no known effect explains it."
    if report.plain and report.plain.delivered:
        text += f" A plain fit of inertia and friction leaves {after} {unit}, and is delivered."
    why = [f"Why no other verdict is given: {report.reason}."] if report.reason else []
    parts = [
        text,
        *_left_in_words(report),
        *why,
        *_dependence_sentences(report),
        *_nearest(report),
        *_unfinished(report),
    ]
    return " ".join(parts)


def _found(report: Report) -> str:
    """Return a clause that names the effects."""
    names = ", ".join(f"{e.name.replace('_', ' ')} at {e.site}" for e in report.effects)
    subject = "an effect" if len(report.effects) == 1 else f"{len(report.effects)} effects"
    return f"The machine has {subject} that its model lacks: {names}"


def _left_in_words(report: Report) -> list[str]:
    """Return a sentence about the error that is left in the user's terms, if it is known."""
    parts = _left_parts(report)
    return [f"Left on the held-out runs: {'; '.join(parts)}."] if len(parts) > 1 else []


def _left_parts(report: Report) -> list[str]:
    """Return the error that is left: the largest one in mm, all in multiples of the noise, of the motion, the force."""
    if report.left is None:
        return []
    motions, (force,) = report.after.percents_of_motion, missing_forces([report.after])
    left = f"{number(report.left)} times the sensors' noise"
    of_all = f"; over all channels {left}" if len(report.after.channels) > 1 else f", {left}"
    parts = [largest_position_error(report.after) + of_all]
    if motions:
        parts.append(f"{number(max(motions))} % of the motion of the channel where that is most")
    if force and not force.startswith("0 "):
        parts.append(f"a missing force of {force}{' of that of the drives' * force.endswith('%')}")
    return parts


def missing_forces(evaluations: Sequence[Evaluation]) -> list[str]:
    """Return the forces that machines lack, with their unit, "" where none is known.

    They are given in percent of the drives' force. If one is larger than that, the drives hardly acted, and all are
    given in N or Nm; so they are where the commands of the drives tell no force.
    """
    parts = [evaluation.missing_force_percent for evaluation in evaluations]
    forces = [evaluation.missing_force for evaluation in evaluations]
    known = [part for part in parts if part is not None]
    if any(forces) and (not known or max(known) > _WHOLE):
        return ["" if force is None else f"{number(force.value)} {force.unit}" for force in forces]
    return ["" if part is None else f"{number(part)} %" for part in parts]


def _nearest(report: Report) -> list[str]:
    """Return a sentence about the effects of the library that describe a part of the missing force."""
    labels = report.hint.nearest if report.hint else []
    return (
        [f"The nearest effects of the library, which are no causes: {', '.join(labels)}."] if labels else []
    )


def _unfinished(report: Report) -> list[str]:
    """Return a sentence about a search that ended early."""
    unfinished = report.unfinished
    return [f"The search is not complete: {unfinished.reason} ({unfinished.stage})."] if unfinished else []


def drifts(report: Report) -> bool:
    """Return whether the simulation drifts, so that the error of the drives' force describes the machine better.

    Args:
        report: Content of report.json.
    """
    ratio = report.after.noise_ratio
    if report.after.force_error is None or ratio is None or ratio <= _MAX_NOISE_RATIO:
        return False
    percents = [*report.before.percents_of_motion, *report.after.percents_of_motion]
    return not percents or max(percents) > _MAX_PERCENT_OF_MOTION


def _remainder(report: Report) -> str:
    """Return a sentence about the error that the machine of the verdict leaves, "" if it is the sensors' noise."""
    if not (why := _cause_of_remainder(report)):
        return ""
    error = f"{number(report.left)} times the sensors' noise ({largest_position_error(report.after)})"
    return f" An error of {error} is left{why}"


def _cause_of_remainder(report: Report) -> str:
    """Return the end of a sentence about the error that is left: why that is; "" if it is the sensors' noise."""
    if (left := report.left) is None or left < _NOTICEABLE_ERROR:
        return ""
    if not (runs := report.contradicting):
        return f"{reason_of_remainder(report)}."
    subject = f"{' and '.join(runs)} contradict{'s' if len(runs) == 1 else ''}"
    others = report.left_in_others
    elsewhere = "" if others is None else f" On the other held-out runs, it is {number(others)} times."
    return f", because {subject} the fitted runs (see the warnings).{elsewhere}"


def reason_of_remainder(report: Report) -> str:
    """Return a clause about the error that the machine of the verdict leaves on the held-out runs.

    Args:
        report: Content of report.json, with the error `left`.

    Returns:
        What a formula that is recommended in place of a table leaves, if that is clearly less; what a table does not
        describe, for another machine with a table; that voltages which the log lacks may be the cause; or that it is
        not known.
    """
    tables = any(effect.name.partition("[")[0] in HOOK_OF_KIND for effect in report.effects)
    formulas = {
        math.sqrt(sum(error**2 for error in f.held_out.values()) / len(f.held_out)): " + ".join(f.terms)
        for table in report.proposed_formulas
        for f in table.formulas
        if f.recommended and f.held_out
    }
    error = min(formulas, default=math.inf)  # ratio of simulation error to noise, as `left`
    if report.left is not None and is_better_than_table(error, report.left):
        return f"; with the proposed formula ({formulas[error]}) in place of the table, it is {number(error)} times"
    if tables:
        return ". A table has straight pieces and names no cause"
    if report.unknown_voltages:
        commands = report.unknown_voltages.commands
        return f", of which the unknown {commands} between the rows may cause a part or all"
    return ", whose cause was not found"


def largest_position_error(evaluation: Evaluation) -> str:
    """Return the largest rms error of the position channels, in words.

    Lengths come first, then angles. Of channels of other kinds, whose units do not compare, it is the error of the
    channel with the largest multiple of its noise.

    Args:
        evaluation: Errors of a machine.
    """
    errors = evaluation.channels
    measured = {channel: error.rmse for channel, error in errors.items() if error.rmse is not None}
    if not measured:
        return "diverges, or not measured"
    unit_of_positions = next((u for u in ("_m", "_rad") if any(c.endswith(u) for c in measured)), None)
    if unit_of_positions is None:
        channel = max(measured, key=lambda c: errors[c].noise_ratio or 0.0)  # None without noise
    else:
        positions = [c for c in measured if c.endswith(unit_of_positions)]
        channel = max(positions, key=lambda c: measured[c])
    rmse = measured[channel]
    factor, unit = readable_unit(channel, rmse)
    return f"{number(factor * rmse)} {unit} rms at {channel}"


def _dependence_sentences(report: Report) -> list[str]:
    """Return a sentence about sensors that deviate alone, or about the variable that explains most of the force."""
    if sensors := report.residual.sensors:
        return [_DEVIATING.format(" and ".join(sensors), "s" if len(sensors) == 1 else "")]
    sentences = []
    for d in report.residual.depends_on[:1]:
        component = d.component or d.coordinate
        where = f"on {d.coordinate}" if component == d.coordinate else f"(most likely at {component})"
        sentences.append(
            f"The force that the model lacks {where} depends most on {d.variable}, which explains "
            f"{100 * d.share:.0f} % of its variance."
        )
    return sentences
