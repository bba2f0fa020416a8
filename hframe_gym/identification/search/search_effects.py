"""Search for what a model lacks in runs of which one may contradict the others."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import cache

from ...line_log import LineLog
from ...machine import Machine
from ...preparation.dataset import Dataset
from ..budget import Budget, BudgetEndedError, StageEnds, note_error, spend, stage_ends
from ..evidence.tried_effects import SelectedEffect, Selection
from ..fit.cross_validation import contradicting_run
from ..fit.estimation import Fit, prediction_cost
from ..fit.model_error import continue_fit, fit_with_model_error, polish
from ..fit.run_differences import find_run_differences
from ..judge.criteria import SelectionCriteria
from ..judge.error import nearly_explains
from ..judge.run import differs_in_a_parameter, uses_all_runs
from ..predict.prediction import SEARCH_BANDWIDTH
from ..propose.trial_fits import converge
from .forward_selection import EffectSearch
from .model_search import ModelSearch
from .outcome import SearchOutcome

Confirmed = Callable[[SearchOutcome], bool]  # whether held-out runs confirm an outcome


def search_effects(
    machine: Machine,
    data: Dataset,
    criteria: SelectionCriteria,
    log: LineLog,
    *,
    confirmed: Confirmed | None = None,
    budget: Budget | None = None,
    ends: StageEnds | None = None,
    refitted: Fit | None = None,
    known: tuple[SelectedEffect, ...] = (),
) -> SearchOutcome:
    """Refit a machine and search for the effects (deviations from the nominal model) that it lacks.

    One run, the suspect, may contradict the others because of a mistake, or because it excites a missing
    effect more. Effects are first searched for without the suspect, unless all runs differ from each other in
    one parameter. The suspect is then left out and named in the outcome (`contradiction`), unless one of
    these conditions holds:

    - The effects found without the suspect explain all runs. Or they explain the other runs, no single
      parameter with another value in the suspect explains it, and with one more effect they explain all runs.
    - These effects do not explain the other runs, but the effects found in all runs explain all runs, or
      leave less than ten times the chi-squared per sample of the search without the suspect.

    Args:
        machine: Machine as declared.
        confirmed: Function that returns whether the held-out runs confirm an outcome from which a suspect was
            left out. If it returns False, the outcome of a search in all runs is returned. Default: it
            returns True.
        budget: Processor time after which the search ends. The refit of the machine is always completed.
            Default: the search ends by itself.
        ends: Fractions of the budget after which search and tests end. Default: those of complete runs.
        refitted: Fit of the machine to these runs at `SEARCH_BANDWIDTH`, if it is known already.
        known: Effects that a search with other voltages between the rows selected; they must pass again.

    Returns:
        Verdict, fits of the machine without and with the effects, and the selected and the rejected effects.
        If the budget ended, they contain the effects selected so far that passed the same tests, and no
        tables. The suspect is then left out only if these effects explain the other runs and are confirmed.
    """
    searches = [ModelSearch(machine, data, criteria, log, refitted, known=known)]
    budget, ends = budget or Budget(), ends or stage_ends(machine)
    try:
        with budget.limiting(ends.search, tests=ends.tests):
            return _search_with_suspect(searches, machine, data, criteria, log, confirmed, known)
    except BudgetEndedError:
        log(f"  {budget.reason} ({budget.doing}); what was found so far is tested")
    tests = budget.until(ends.tests)
    # Without time for a search, the refit is nevertheless completed.
    last_fit = budget.until(ends.last_fit) if budget.seconds > 0.0 else Budget()
    for search in reversed(searches[1:]):
        outcome = search.finished_early(tests, last_fit)
        # A run is only left out if one machine explains the others, and held-out runs do not contradict it as
        # well.
        if outcome.explained and (confirmed is None or confirmed(outcome)):
            return outcome._replace(unfinished=budget.doing)
    return searches[0].finished_early(tests, last_fit)._replace(unfinished=budget.doing)


def _search_with_suspect(
    searches: list[ModelSearch],
    machine: Machine,
    data: Dataset,
    criteria: SelectionCriteria,
    log: LineLog,
    confirmed: Confirmed | None,
    known: tuple[SelectedEffect, ...],
) -> SearchOutcome:
    """Search as `search_effects` describes; a second search, without the suspect, is added to `searches`."""
    all_runs = searches[0]
    note_error(all_runs.before.chi2)
    spend("comparing the runs with each other")
    suspect, in_all_runs = contradicting_run(all_runs.base, data), cache(all_runs.run)
    if suspect is None:
        return in_all_runs()

    def without_suspect(outcome: SearchOutcome) -> SearchOutcome:
        log(f"no effect explains {suspect}; it is not used")
        outcome = outcome._replace(contradiction=suspect)
        return outcome if confirmed is None or confirmed(outcome) else in_all_runs()

    log(f"{suspect} differs most from the other runs; fitting these without it")
    without = data.with_runs([run.name for run in data.runs if run.name != suspect])
    others = ModelSearch(machine, without, criteria, log, known=known)
    others.suspect = suspect
    searches.append(others)
    if not others.needs_no_effect and all_runs.runs_differ:
        return in_all_runs()
    log(f"searching for effects without {suspect}")
    extended = _fitted_to_all(others.selection, data)
    if extended[1] and nearly_explains(extended[0].error, criteria):
        return all_runs.run(extended)
    outcome = others.run()
    if not outcome.explained:
        log(f"no effects explain the others without {suspect}; searching in all runs")
        complete = in_all_runs()
        if uses_all_runs(_wide_chi2(outcome), complete.explained, lambda: _wide_chi2(complete)):
            return complete
        return without_suspect(outcome)
    if _differs_in_a_parameter(suspect, outcome, data, criteria):
        return without_suspect(outcome)
    log(f"searching for an effect that explains {suspect}")
    one_more = dataclasses.replace(criteria, max_effects=len(outcome.selected) + 1)
    search = EffectSearch(data, all_runs.before.machine, one_more, log)
    extended = search.run(*_fitted_to_all((outcome.after, outcome.selected), data))
    if nearly_explains(extended[0].error, criteria):
        log(f"{suspect} is used")
        return all_runs.run(extended)
    return without_suspect(outcome)


def _fitted_to_all(selection: Selection, data: Dataset) -> Selection:
    """Return the machine with selected effects, fitted to all runs; other values may change them."""
    fitted, effects = selection
    wide = converge(continue_fit(fitted, data, SEARCH_BANDWIDTH), data, thorough=True)
    return polish(fit_with_model_error(wide, data), data), effects


def _differs_in_a_parameter(
    suspect: str, outcome: SearchOutcome, data: Dataset, criteria: SelectionCriteria
) -> bool:
    """Return whether a run is explained as well as the others by another value of a parameter in it alone."""
    difference = find_run_differences(outcome.after, data, criteria)
    if difference is None:
        return False
    return differs_in_a_parameter(suspect, difference.different_run, difference.chi2, _wide_chi2(outcome))


def _wide_chi2(outcome: SearchOutcome) -> float:
    """Return the final machine's chi-squared per sample at the largest observer bandwidth, common to all."""
    return prediction_cost(outcome.after.machine, outcome.data, SEARCH_BANDWIDTH) / outcome.data.count
