"""Outcome of a search, and the same without some of its effects."""

from __future__ import annotations

from typing import NamedTuple

from ...line_log import LineLog
from ...machine import Machine
from ...preparation.dataset import Dataset
from ..evidence.tried_effects import ConsideredEffect, SelectedEffect
from ..fit.estimation import Fit
from ..fit.voltage_updates import VoltageUpdates
from ..judge.verdict import Verdict, verdict_after_removal
from ..predict.prediction import SIMULATION


class VoltagesChangeError(Exception):
    """A search found that the voltages change more or less often between the rows than it assumed.

    Attributes:
        machine: Machine with the effects found so far.
        selected: These effects.
        updates: Number of voltage changes per row.
    """

    def __init__(
        self, machine: Machine, selected: tuple[SelectedEffect, ...], updates: VoltageUpdates
    ) -> None:
        super().__init__("the voltages change otherwise between the rows")
        self.machine, self.selected, self.updates = machine, selected, updates


class SearchOutcome(NamedTuple):
    """Outcome of a search.

    Attributes:
        before: Fit of the refitted machine, without effects.
        before_explains: Whether that machine explains the data.
        explained: Whether the machine with the effects explains the data, or unknown voltages between the
            rows may cause all of the remaining error.
        verdict: "effect_found", "no_effect" or "unexplained".
        after: Fit of the machine with the effects.
        selected: The selected effects.
        considered: Effects that reduced the error of the fitted runs but failed a test.
        data: Runs that the machines were fitted to.
        contradiction: Name of the run that was left out because it contradicts the others; None if all were
            used.
        unfinished: Activity of the search when its budget ended, in words; "" if the search is complete.
        bandwidth: Bandwidth of the observer with which the search judged effects, rad/s; `after` may have
            been fitted in simulation since.
    """

    before: Fit
    before_explains: bool
    explained: bool
    verdict: Verdict
    after: Fit
    selected: tuple[SelectedEffect, ...]
    considered: tuple[ConsideredEffect, ...]
    data: Dataset
    contradiction: str | None = None
    unfinished: str = ""
    bandwidth: float = SIMULATION


def with_removed(
    outcome: SearchOutcome, removed: SelectedEffect, reduced: Fit, reason: str, log: LineLog
) -> SearchOutcome:
    """Return an outcome in which one of the effects is moved to the considered (rejected) ones.

    Args:
        outcome: Outcome with the effect.
        removed: The effect, one of `outcome.selected`.
        reduced: Fit without the effect, with all others.
        reason: Why it is removed, a clause that follows "it ".
        log: Called with a line of text.

    Returns:
        Outcome with the fit `reduced`, or the refitted machine if no effect is left, and the verdict of
        `judge.verdict.verdict_after_removal`.
    """
    log(f"  {removed.effect.label} is removed: it {reason}")
    entry = ConsideredEffect(removed.effect, outcome.after.machine, reduced.machine, reason)
    selected = tuple(s for s in outcome.selected if s is not removed)
    after = reduced if selected else outcome.before
    return outcome._replace(
        verdict=verdict_after_removal(outcome.verdict, bool(selected), outcome.before_explains),
        after=after,
        selected=tuple(s.with_values(after.machine) for s in selected),
        considered=(*outcome.considered, entry),
    )


def without_names(outcome: SearchOutcome, reason: str) -> SearchOutcome:
    """Return an outcome that names no effect: all are moved to the considered (rejected) ones.

    Args:
        outcome: Outcome with effects.
        reason: Why the effects are not named, a clause that follows "it is not named: ".

    Returns:
        Outcome with the fit of the refitted machine; the verdict is "no_effect" if this machine explains the
        fitted runs, else "unexplained".
    """
    entries = (
        ConsideredEffect(s.effect, outcome.after.machine, outcome.before.machine, f"is not named: {reason}")
        for s in outcome.selected
    )
    return outcome._replace(
        verdict=verdict_after_removal(outcome.verdict, False, outcome.before_explains),
        after=outcome.before,
        selected=(),
        considered=(*entries, *outcome.considered),
    )
