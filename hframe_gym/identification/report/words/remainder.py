"""Sentences on the remaining error: its size, whether it is noise, and its possible cause."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal

from ....effects.smooth_table import HOOK_OF_KIND
from ....web_page import number
from ...judge.criteria import SelectionCriteria
from ...judge.table import is_better_than_table
from ...judge.verdict import error_beyond_noise
from ..content.document import Evaluation, Report
from ..units import readable_unit

NOTICEABLE_ERROR = 1.3  # Remaining error over noise that the report calls unexplained.
# Error in percent of the motion that is small: a feed-forward control by the machine removes the other 99 %.
_SMALL_PERCENT_OF_MOTION = 1.0
_WHOLE = 100.0  # percent; a larger force is no part of another one.
# A simulation whose error is beyond both has drifted: times the noise, and percent of the motion before or
# after.
_MAX_NOISE_RATIO, _MAX_PERCENT_OF_MOTION = 50.0, 50.0
DIVERGES = "infinitely many (its simulation diverges)"


def tone_of_remainder(report: Report) -> Literal["good", "neutral", "warning"]:
    """Return the tone (color) of the page, which depends on the remaining error, not on the names found.

    Returns:
        "good" if the error is at most `max_noise_ratio_explained` times the noise, and beyond it at most
        `max_motion_error` of the motion of every channel, and the verdict is not "unexplained"; otherwise
        "neutral" if it is at most 1 % of the motion of every channel that has more error than noise;
        "warning" if it is larger, or the simulation diverges.
    """
    criteria, left = SelectionCriteria(), report.left
    percents = percents_of_motion(report.after)
    largest = max(percents, default=0.0)
    if left is None:
        return "warning"
    beyond = error_beyond_noise(max(report.after.percents_of_motion, default=0.0) / 100.0, left)
    at_noise = left <= criteria.max_noise_ratio_explained and beyond <= criteria.max_motion_error
    if at_noise and report.verdict != "unexplained":
        return "good"
    return "neutral" if percents and largest <= _SMALL_PERCENT_OF_MOTION else "warning"


def percents_of_motion(evaluation: Evaluation) -> list[float]:
    """Return errors in percent of the motion of those channels whose error is at least 1.3 times the noise.

    If there are none, those of all channels that move. The noise of a coarse sensor, such as that of a
    current, may be a larger part of its motion than what is left at the positions, and says nothing of the
    model.
    """
    above = [
        error.percent_of_motion
        for error in evaluation.channels.values()
        if error.percent_of_motion is not None and (error.noise_ratio or 0.0) >= NOTICEABLE_ERROR
    ]
    return above or evaluation.percents_of_motion


def drifts(report: Report) -> bool:
    """Return whether the simulation drifts, so that the report states the drives' force error instead.

    It drifts if its error on the held-out runs exceeds 50 times the noise, and that of the refitted or the
    delivered machine half of the motion of a channel. Without a force error, the result is False.
    """
    ratio = report.after.noise_ratio
    if report.after.force_error is None or ratio is None or ratio <= _MAX_NOISE_RATIO:
        return False
    percents = [*report.before.percents_of_motion, *report.after.percents_of_motion]
    return not percents or max(percents) > _MAX_PERCENT_OF_MOTION


def cause_of_remainder(report: Report) -> str:
    """Return the end of a sentence about the remaining error: ", whose cause was not found." for example.

    If held-out runs contradict the fitted ones, these are the cause, and a sentence on the error of the other
    runs follows; otherwise it is `reason_of_remainder`. The result is "" if the error is below 1.3 times the
    sensors' noise, or unknown because the simulation diverges.
    """
    if (left := report.left) is None or left < NOTICEABLE_ERROR:
        return ""
    if not (runs := report.contradicting):
        return f"{reason_of_remainder(report)}."
    subject = f"{' and '.join(runs)} contradict{'s' if len(runs) == 1 else ''}"
    others = report.left_in_others
    elsewhere = (
        ""
        if others is None
        else f" On the other held-out runs, it is {number(others)} times the sensors' noise."
    )
    return f", because {subject} the fitted runs (see the warnings).{elsewhere}"


def reason_of_remainder(report: Report) -> str:
    """Return the end of a sentence with the reason for the remaining error on the held-out runs.

    Args:
        report: Content of report.json, with the error `left`.

    Returns:
        Text that begins with a punctuation mark and ends without one. One of these: the error with the
        formula recommended in place of a table, if it is clearly smaller; that a table names no cause; that
        unknown voltages may be the cause; that the motion is unstable;
        that rounded stamps may be the cause; that the cause was not found.
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
        return (
            f"; with the proposed formula ({formulas[error]}) "
            f"in place of the table, it is {number(error)} times the sensors' noise"
        )
    if tables:
        return ". A table has straight pieces and names no cause"
    if report.unknown_voltages:
        commands = report.unknown_voltages.commands
        return f", of which the unknown {commands} between the rows may cause a part or all"
    if report.unstable:
        return ", because the motion is unstable (see the notes)"
    if report.rounded_stamps:
        return ", which the rounding of the time stamps may cause (see the notes)"
    return ", whose cause was not found"


def largest_position_error(evaluation: Evaluation) -> str:
    """Return the largest rms error of the position channels as text, such as "12 µm rms at x_m".

    Angles count only if there are no lengths. Without positions, it is the error of the channel with the
    largest multiple of its noise, because other units cannot be compared. Without errors, the text is
    "diverges, or not measured".
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


def in_user_units(evaluation: Evaluation) -> str:
    """Return `largest_position_error` of a machine, preceded by "at most " if it has several channels."""
    most = "at most " if len(evaluation.channels) > 1 else ""
    return f"{most}{largest_position_error(evaluation)}"


def missing_forces(evaluations: Sequence[Evaluation]) -> list[str]:
    """Return the missing force of each of several machines as text, such as "3 %"; "" if unknown.

    They are in percent of the drives' force. If one exceeds 100 %, because the drives hardly acted, or if the
    commands do not determine the drives' force, all are in N or Nm.
    """
    parts = [evaluation.missing_force_percent for evaluation in evaluations]
    forces = [evaluation.missing_force for evaluation in evaluations]
    known = [part for part in parts if part is not None]
    if any(forces) and (not known or max(known) > _WHOLE):
        return ["" if force is None else f"{number(force.value)} {force.unit}" for force in forces]
    return ["" if part is None else f"{number(part)} %" for part in parts]


def parts_of_remainder(report: Report, *, error: bool = True) -> list[str]:
    """Return phrases for the remaining error on the held-out runs.

    Args:
        report: Content of report.json.
        error: Whether the first phrase states it as a length or angle and in multiples of the noise.

    Returns:
        This phrase, the error in percent of the motion, and the missing force, each if it is known; empty if
        the delivered machine diverges.
    """
    if report.left is None:
        return []
    motions, (force,) = percents_of_motion(report.after), missing_forces([report.after])
    several = len(report.after.channels) > 1
    parts = []
    if error:
        over_all = "; over all channels" if several else ","
        left = f"{number(report.left)} times the sensors' noise"
        parts.append(f"{largest_position_error(report.after)}{over_all} {left}")
    if motions:
        some = max(motions) < max(report.after.percents_of_motion)
        of_channel = f" of the channel{' above its noise' * some} where that is most" if several else ""
        parts.append(f"{number(max(motions))} % of the motion{of_channel}")
    if force and not force.startswith("0 "):
        parts.append(f"a missing force of {force}{' of that of the drives' * force.endswith('%')}")
    return parts


def remainder_in_words(report: Report, *, error: bool) -> list[str]:
    """Return a sentence with the remaining error in percent of the motion and the missing force.

    Args:
        report: Content of report.json.
        error: Whether to state the error as a length or angle and in multiples of the noise as well, because
            no other sentence does.

    Returns:
        One sentence, or none if nothing is known of motion and force.
    """
    parts = parts_of_remainder(report, error=error)
    return [f"Left on the held-out runs: {'; '.join(parts)}."] if len(parts) > error else []
