"""The verdict in words, for the command, the window and the page."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ....effects import EFFECTS
from ....web_page import number
from ...fit.voltage_updates import is_timing
from ..content.document import STAGES, Considered, Report, UnknownVoltages, compared_machines
from ..units import readable_unit
from .remainder import DIVERGES, cause_of_remainder, drifts, in_user_units, remainder_in_words

# Fraction of the refitted machine's error below which that of the declared one is mentioned.
_CLEARLY_BETTER = 0.9
_HIDDEN_EFFECTS = 3  # that are listed; the page has all
_DEVIATING = (
    "Only {} deviate{}: the other sensors agree with the simulation, "
    "although they would show an error of the motion. "
    "The cause lies at this sensor, its mounting or frame, or in an elastic part between it and the motors."
)
_BY_INSTRUMENTS = (
    "The standard deviations come from a fit by instruments (smoothed {0} and measurements). "
    "The parameters are those of this fit, or lie between them and those of a fit to the residual "
    "that the statistics of the {0} make white, whichever simulate runs to which they were not fitted best."
)


def verdict_in_words(report: Report) -> str:
    """Describe the verdict and the error on the held-out runs in a few sentences.

    Sentences on voltages that the log lacks and on undeclared friction come first, where there are any. The
    error is the simulation error in units of the sensors' noise, root mean square over the channels. If the
    simulation drifts (`remainder.drifts`), the error of the drives' force in percent is stated instead.
    """
    return " ".join([*unknown_voltages(report), *undeclared_friction(report), _verdict_and_error(report)])


def undeclared_friction(report: Report) -> list[str]:
    """Return a sentence about friction that the motion shows and the machine file lacks, if any.

    It states value, standard deviation and unit, and of dry friction the percentage of the drives' largest
    force.
    """
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
    sizes, refuted = [], []
    for error, channel in largest.values():
        factor, unit = readable_unit(channel, error)
        sizes.append(f"{number(factor * error)} {unit} at {channel}")
        delivered = report.machines["after"].channels.get(channel)
        if delivered and delivered.rmse is not None and delivered.rmse < error:
            refuted.append(f"{number(factor * delivered.rmse)} {unit} at {channel}")
    period = f"{1e3 * unknown.period_s:.3g} ms"
    by_instruments = unknown.fitted_by == "instruments"
    commands = unknown.commands
    changes = (
        f"the controller changes the {commands} about {unknown.changes_per_row} times "
        f"between two rows of this log (every {period}), and the log does not contain these {commands}"
    )
    if late := " and ".join(unknown.late_currents):
        cause = f"Either {changes}, or {late} was read after the voltage of its own row had been applied."
    else:
        cause = f"{changes[:1].upper()}{changes[1:]}."
    return [
        cause,
        *_unknown_error(sizes, refuted),
        *_hidden_delay(report, unknown),
        *([_BY_INSTRUMENTS.format(commands)] if by_instruments else []),
        f"To find more, {complete_log(unknown)}.",
    ]


def complete_log(unknown: UnknownVoltages) -> str:
    """Return how to record what a log slower than its controller lacks, as an imperative clause.

    Args:
        unknown: The voltages that the log lacks; the period of their changes is the one to log at. If
            measured currents make the log look slower, the clause says how to test this first.
    """
    advice = f"log every row of the controller (every {1e3 * unknown.period_s:.3g} ms)"
    if unknown.commands != "set points":
        advice += ", or describe the drives by their set point and log that"
    if unknown.late_currents:
        late = " and ".join(unknown.late_currents)
        without = " ".join(f"--map {channel}=none" for channel in unknown.late_currents)
        return (
            f"first identify without {late} (hframe import {without}): if the controller no longer seems "
            f"faster than the log, shift {late} down by one row; otherwise {advice}"
        )
    return advice


def _unknown_error(sizes: Sequence[str], refuted: Sequence[str]) -> list[str]:
    """Return a sentence about what the unknown voltages cause, by channel, or where less is left."""
    expected = (
        "In a simulation of the held-out runs, even the exact machine is therefore expected to err by "
        f"{' and '.join(sizes)} (rms)"
    )
    if refuted:
        left = " and ".join(refuted)
        return [f"{expected}; the machine that is delivered leaves only {left}, so that this is too large."]
    return [f"{expected}: what changes the motion by less cannot be found."]


def _hidden_delay(report: Report, unknown: UnknownVoltages) -> list[str]:
    """Return a sentence about the delay of drives that passes for fewer changes; none if one was found."""
    definitions = (EFFECTS.get(e.name) for e in report.effects)
    if any(definition is not None and is_timing(definition) for definition in definitions):
        return []
    # Twice as many changes act earlier by a quarter of the row over their number.
    delay = 0.25 * unknown.period_s
    return [
        f"A delay or lag of the drives of up to {1e3 * delay:.2g} ms may be missed: "
        "it passes for half as many changes a row."
    ]


def _verdict_and_error(report: Report) -> str:
    """Describe the verdict and the error on the held-out runs."""
    errors: dict[str, float | None]
    if drifts(report):
        unit = of_refitted = of_delivered = "% of the drives' force"
        errors = {stage: 100.0 * (report.machines[stage].force_error or 0.0) for stage in STAGES}
    else:
        unit = "times the sensors' noise"
        errors = {stage: report.machines[stage].noise_ratio for stage in STAGES}
        of_refitted, of_delivered = (
            f"{unit} ({in_user_units(report.machines[stage])})" for stage in ("before", "after")
        )
    before, after = (number(errors[stage], DIVERGES) for stage in ("before", "after"))
    declared, refitted = errors["declared"], errors["before"]
    if declared is not None and refitted is not None and declared < _CLEARLY_BETTER * refitted:
        before += (
            f" (with the declared parameters: {number(declared)})"  # The refit minimizes short predictions.
        )
    if report.verdict == "effect_found":
        change = "rises" if (errors["after"] or 0.0) > (refitted or np.inf) else "falls"  # None: it diverges
        pronoun = "it" if len(report.effects) == 1 else "them"
        remainder = _remainder(report)
        found = (
            f"{found_effects(report)}. With {pronoun}, the error on the held-out runs "
            f"{change} from {before} to {after} {unit if remainder else of_delivered}.{remainder}"
        )
        left = remainder_in_words(report, error=drifts(report) and not remainder)
        return " ".join([found, *left, *hidden_effects(report), *unfinished_search(report)])
    if report.verdict == "no_effect":
        remainder = _remainder(report)
        start = (
            f"No effect {'was found' if remainder else 'is missing'}: "
            "with refitted parameters, the error of the"
        )
        found = (
            f"{start} declared model on the held-out runs is {before} "
            f"{unit if remainder else of_refitted}.{remainder}"
        )
        left = remainder_in_words(report, error=drifts(report) and not remainder)
        hidden = hidden_effects(report) if remainder else []
        return " ".join([found, *left, *hidden, *unfinished_search(report)])
    text = (
        f"The error of the refitted model on the held-out runs is {before} {of_refitted}, "
        "and no known effect explains it."
    )
    if report.plain and report.plain.delivered:
        text += f" A plain fit of inertia and friction leaves {after} {of_delivered}, and is delivered."
    elif not report.effects and "after" in compared_machines(report):
        text += f" The machine that is delivered leaves {after} {of_delivered}, but names no cause."
    why = [f"Why no other verdict is given: {report.reason}."] if report.reason else []
    parts = [
        text,
        *remainder_in_words(report, error=drifts(report)),
        *why,
        *dependence_sentences(report),
        *nearest_effects(report),
        *unfinished_search(report),
    ]
    return " ".join(parts)


def found_effects(report: Report) -> str:
    """Return a clause that names the effects: "The machine has an effect that its model lacks: ..."."""
    names = ", ".join(f"{e.name.replace('_', ' ')} at {e.site}" for e in report.effects)
    subject = "an effect" if len(report.effects) == 1 else f"{len(report.effects)} effects"
    return f"The machine has {subject} that its model lacks: {names}"


def nearest_effects(report: Report) -> list[str]:
    """Return a sentence about effects of the library that describe a part of the missing force, if any.

    It says that they are no causes. They are those of the report's `hint`.
    """
    labels = report.hint.nearest if report.hint else []
    return (
        [f"The nearest effects of the library, which are no causes: {', '.join(labels)}."] if labels else []
    )


def hidden_effects(report: Report) -> list[str]:
    """Return sentences about effects that a log slower than its controller may hide.

    The first one states how much such an effect may change the motion: by the error that is left. The second
    lists up to three effects with their sizes that reduced the error of both the fitted and the held-out
    runs, but failed a test. The result is empty if only noise is left, or if the log contains all voltages.
    """
    if report.unknown_voltages is None or not cause_of_remainder(report):
        return []
    helpful = [c for c in report.considered if c.held_out_gain is not None and c.held_out_gain > 0.0]
    largest = sorted(helpful, key=lambda c: -(c.held_out_gain or 0.0))[:_HIDDEN_EFFECTS]
    texts = [_with_size(entry) for entry in largest]
    hides = (
        f"The log may hide {'further ' if report.effects else ''}effects in this error, "
        f"also one that changes the motion by as much as is left: {in_user_units(report.after)}."
    )
    if not texts:
        return [hides]
    return [
        f"{hides} It tells these, with about these sizes (SI units), neither from chance nor from what it "
        f"lacks, and nothing says whether they are there: {'; '.join(texts)}."
    ]


def _with_size(entry: Considered) -> str:
    """Return an effect that was rejected with its parameters and, where it has one, its force."""
    sizes = [f"{name} = {value:.2g}" for name, value in entry.parameters.items()]
    if entry.size:
        sizes.append(f"{number(100.0 * entry.size)} % of the drives' force")
    return f"{entry.name.replace('_', ' ')} at {entry.site} ({', '.join(sizes)})"


def unfinished_search(report: Report) -> list[str]:
    """Return a sentence that says why the search ended early and what it did then; none if it is complete."""
    unfinished = report.unfinished
    if unfinished is None:
        return []
    return [
        f"The search is not complete: {unfinished.reason} ({unfinished.stage}); "
        "what would have followed was not tried. A larger --budget continues."
    ]


def _remainder(report: Report) -> str:
    """Return a sentence about the error that the machine of the verdict leaves; "" if that is noise."""
    if not (why := cause_of_remainder(report)):
        return ""
    error = in_user_units(report.after)
    if drifts(report):  # then the verdict does not state the multiple of the noise
        error = f"{number(report.left)} times the sensors' noise ({error})"
    return f" An error of {error} is left{why}"


def dependence_sentences(report: Report) -> list[str]:
    """Return a sentence about sensors that deviate alone; otherwise one about the force that the model lacks.

    It names the variable on which this force depends most, and the fraction of the variance that it explains.
    There is none if no sensor deviates alone and the missing force depends on no variable.
    """
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
