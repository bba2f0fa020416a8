"""Find a delay or lag of the drives that the observer of the search hides.

A machine that lacks forces of unknown size is compared with the measurements by an observer of 60 rad/s. It passes slow
errors and suppresses fast ones. A delay of a fraction of a sampling period changes the motion only for moments after a
change of the voltage, so that slow forces without a name bury its benefit, however certain it is. Unlike a small force,
it cannot be a substitute for them: its force follows from the known voltages and from one parameter. Such effects are
therefore judged by a wider observer, at which what a delay explains is fast.
"""

from __future__ import annotations

from collections.abc import Iterator

from ...machine import Effect
from ...preparation.dataset import Dataset
from ..evidence.held_out import NO_GAIN, held_out_gain, is_excited
from ..evidence.machine_validation import validation_fault
from ..evidence.rivals import close_rivals, simplest_first
from ..evidence.significance import long_run_variance
from ..evidence.tried_effects import ConsideredEffect, Log, SelectedEffect
from ..fit.estimation import Fit
from ..fit.force_sizes import typical_scales
from ..fit.model_error import continue_fit, leave_one_out_gain, likelihood_loss, polish
from ..fit.residual import missing_force
from ..fit.start_estimation import refine_dataset
from ..judge.criteria import SelectionCriteria
from ..predict.prediction import LONGEST_OBSERVER_PERIOD, SEARCH_BANDWIDTH
from ..propose.candidates import candidates
from ..propose.screening import screen
from ..propose.trial_fits import converge, fit_with_candidate
from .search_effects import SearchOutcome

# Bandwidth times sampling period of the observer that judges. It is that of the search at the longest period.
_RATE = SEARCH_BANDWIDTH * LONGEST_OBSERVER_PERIOD


def with_input_timing(
    outcome: SearchOutcome, validation: Dataset, criteria: SelectionCriteria, log: Log
) -> SearchOutcome:
    """Add a delay or lag of the drives to the effects that a search found, if the fitted runs confirm it.

    It is tried where effects explain most of the error, but leave forces of unknown size. Judged by an observer whose
    bandwidth times the sampling period is 0.3, an effect is added if it passes these tests:

    - This observer is more likely than that of the search (60 rad/s): the sensors resolve fast errors.
    - The effect is fast: it removes a larger fraction of the error than with the observer of the search.
    - Chance does not explain the reduction, given how the remaining error is correlated in time.
    - Runs (of fewer than four, pieces of them) to which it was not fitted confirm it.
    - The machine with the effect does not diverge under random rated voltages.
    - The effect reduces the error of the held-out runs, if these excite it.

    The parameters are fitted with the observer of the search, together with all others.

    Args:
        outcome: Outcome of a search, after the held-out runs have confirmed its effects.
        validation: Held-out runs (times, voltages, measurements, SI) that do not contradict the fitted ones.
        criteria: Decision thresholds.
        log: Called with a line of text for an effect that is tried.

    Returns:
        Outcome with one more effect, or with the effect among those that failed a test; `outcome` itself if none is
        tried.
    """
    after, selected = outcome.after, outcome.selected
    wide = _RATE / outcome.data.period
    tried = selected and not outcome.explained and after.bandwidth == SEARCH_BANDWIDTH < wide
    if not tried or any(_is_timing(e.definition) for e in after.machine.effects):
        return outcome
    data = refine_dataset(outcome.data, after.machine)
    current = continue_fit(after, data, wide)
    if not likelihood_loss(current, data) < likelihood_loss(after, data):
        return outcome
    log("searching for a delay or lag of the drives")
    case = (current, data, criteria)
    trials = simplest_first(list(_trials(current, data)), *case)
    if not trials:
        return outcome
    best = converge(trials[0], data, thorough=False)
    effect = best.machine.effects[-1]
    extended = polish(continue_fit(best, data, after.bandwidth), data)
    gain = (after.cost - extended.cost) / data.count
    added = SelectedEffect(extended.machine.effects[-1], gain, after.machine, close_rivals([best, *trials[1:]], *case))
    doubt = _doubt((after, extended), (current, best), data, criteria)
    doubt = doubt or _denied(added, extended, refine_dataset(validation, extended.machine, data))
    if doubt:
        log(f"  {effect.label} is not selected: it {doubt}")
        entry = ConsideredEffect(added.effect, extended.machine, after.machine, doubt)
        return outcome._replace(considered=(*outcome.considered, entry))
    percent = 100 * _removed_fraction(current, best)
    log(f"  {effect.label} removes {percent:.2g} % of the error (observer of {wide:.0f} rad/s)")
    chosen = tuple(s.with_values(extended.machine) for s in (*selected, added))
    return outcome._replace(after=extended, selected=chosen)


def _is_timing(effect: Effect) -> bool:
    """Return whether an effect delays the voltages or lets the currents lag behind them."""
    return effect.delay is not None or (effect.current is not None and effect.next_state is not None)


def _trials(current: Fit, data: Dataset) -> Iterator[Fit]:
    """Fit each delay and lag of the library that promises to reduce the error, once per component."""
    scales = typical_scales(current, data)
    proposed = candidates(current.machine, data, scales, missing_force(current.machine, data))
    tried: set[str] = set()
    for scored in screen(current, [c for c in proposed if _is_timing(c.effect)], data):
        if scored.gain > 0.0 and scored.candidate.label not in tried:
            tried.add(scored.candidate.label)
            yield fit_with_candidate(current, scored, scales, data)


def _removed_fraction(without: Fit, with_effect: Fit) -> float:
    """Return the fraction of the cost that an effect removes."""
    return 1.0 - with_effect.cost / without.cost


def _doubt(search: tuple[Fit, Fit], wide: tuple[Fit, Fit], data: Dataset, criteria: SelectionCriteria) -> str:
    """Return a reason against an effect, a clause that follows "it ", or "" if it passes all tests.

    Args:
        search: Fits without and with the effect, at the observer bandwidth of the search.
        wide: The same at the bandwidth that judges.
        data: Runs that were fitted.
        criteria: Decision thresholds.
    """
    gain = wide[0].cost - wide[1].cost
    if _removed_fraction(*wide) <= max(_removed_fraction(*search), 0.0):
        return "explains a slow error, not a fast one"
    if gain < criteria.min_chance_gain * long_run_variance(wide[1], wide[1].machine.effects[-1].label, data):
        return "reduces the error by no more than chance may, since the remaining error is correlated in time"
    if leave_one_out_gain(*wide, data) < criteria.min_confirmed_fraction * gain:
        return "is not confirmed by runs that it was not fitted to"
    return validation_fault(wide[1].machine)


def _denied(added: SelectedEffect, extended: Fit, validation: Dataset) -> str:
    """Return that the held-out runs excite an effect and deny it, "" if they do not."""
    of_effect = (added, extended.machine, validation, extended.bandwidth)
    denied = validation.runs and is_excited(*of_effect) and held_out_gain(*of_effect) <= 0.0
    return NO_GAIN if denied else ""
