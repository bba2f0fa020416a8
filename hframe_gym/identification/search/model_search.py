"""The search for a machine that explains some runs: refit, library effects, then tables, and the verdict."""

from __future__ import annotations

import dataclasses
from contextlib import suppress
from functools import cache, cached_property
from typing import NamedTuple

from ...effects.smooth_table import TABLE_FAMILY
from ...line_log import LineLog
from ...machine import HOOKS, Effect, Machine, argument_names
from ...preparation.dataset import Dataset
from ..budget import Budget, BudgetEndedError, during_tests, spend, stage_ends
from ..evidence.effect_parameters import parameter_values
from ..evidence.effect_variables import curves_of_one_variable
from ..evidence.tried_effects import ConsideredEffect, SelectedEffect, Selection
from ..fit.estimation import Fit, fit, prediction_cost
from ..fit.lost_voltages import estimate_lost_voltages
from ..fit.model_error import (
    continue_fit,
    fit_with_model_error,
    polish,
    refined_in_simulation,
)
from ..fit.run_differences import RunDifferences, best_by_run, find_run_differences
from ..fit.run_observers import fit_run_by_run
from ..fit.slow_logs import fit_slow_log
from ..fit.start_estimation import refine_dataset
from ..judge.criteria import SelectionCriteria
from ..judge.drift import DriftEvidence, imitates_drift, less_well_than_by_run
from ..judge.effect import parameter_at_limit
from ..judge.error import (
    FitError,
    explains,
    is_enough,
    nearly_explains,
    required_gain,
    voltages_may_cause,
)
from ..judge.table import TableEvidence, accepts_table, is_one_curve
from ..judge.verdict import PartialEvidence, Verdict, verdict_of_effects, verdict_of_rest
from ..predict.free_parameters import default_free_parameters
from ..predict.prediction import SEARCH_BANDWIDTH, SIMULATION
from ..propose.trial_fits import without_effect
from .forward_selection import EffectSearch
from .outcome import SearchOutcome
from .tables import add_tables, fit_with_moved_knots

# Verdict, and why effects are removed; "" if they are not.
Decision = tuple[Verdict, str]


class Found(NamedTuple):
    """Effects that a search found, with the fit of the machine.

    Attributes:
        fitted: Fit of the machine with the selected effects; of the refitted machine, if there are none.
        effects: The selected effects.
        considered: Effects that failed a test.
    """

    fitted: Fit
    effects: tuple[SelectedEffect, ...] = ()
    considered: tuple[ConsideredEffect, ...] = ()


class ModelSearch:
    """The search for a machine that explains some runs: refit, effects, tables, verdict.

    Args:
        machine: Machine as declared.
        refitted: Fit of the machine to these runs at `SEARCH_BANDWIDTH`, if it is known already.
        before: Fit at the bandwidth that the remaining error requires, if it is known already.
        known: Effects that a search with other voltages between the rows selected; they must pass again.

    Attributes:
        base: Machine refitted at `SEARCH_BANDWIDTH`.
        before: Machine refitted at the bandwidth that its remaining error requires.
        suspect: Name of the run that was left out; None if there is none.
    """

    suspect: str | None = None

    def __init__(
        self,
        machine: Machine,
        data: Dataset,
        criteria: SelectionCriteria,
        log: LineLog,
        refitted: Fit | None = None,
        before: Fit | None = None,
        known: tuple[SelectedEffect, ...] = (),
    ) -> None:
        self._known = known
        self._data, self._criteria, self._log = data, criteria, log
        self._data_after = data  # with the initial states and zeros that follow from the machine with effects
        # What takes long: fits refined in simulation, and the runs with the starts and zeros that follow from
        # a fit.
        self._refinements: dict[Fit, Fit] = {}
        self._data_of_fits: dict[tuple[Fit, Dataset], Dataset] = {}
        self._searches: list[EffectSearch] = []  # one after the other
        # What passed the tests of effects beside each other, once these have ended.
        self._passed: Found | None = None
        # With the widest observer bandwidth first: it tolerates a model that is still wrong.
        self.base = refitted or fit(machine, default_free_parameters(machine), data, SEARCH_BANDWIDTH)
        log(f"refitted machine: {self.base.summary}")
        self.before = before or polish(fit_with_model_error(self.base, data), data)
        if self.before.bandwidth != self.base.bandwidth:
            log(f"refitted machine: {self.before.summary}")

    @cached_property
    def _first_search(self) -> EffectSearch:
        """Search that starts from the refitted machine, without effects."""
        return self._new_search(EffectSearch(self._data, self.before.machine, self._criteria, self._log))

    def _new_search(self, search: EffectSearch) -> EffectSearch:
        """Return a search, and remember it as the present one."""
        self._searches.append(search)
        return search

    @cached_property
    def selection(self) -> Selection:
        """Fit with the effects that were selected one by one, and these effects, before the final tests."""
        self._log("searching for effects")
        search, start = self._first_search, (self.before, ())
        return search.run(*(search.start_with(self.before, self._known) if self._known else start))

    def run(self, start: Selection | None = None) -> SearchOutcome:
        """Search for effects and test them together; if they do not explain the runs, search for tables.

        Args:
            start: Fit with effects that are known already, from which the search goes on. Default: the
                refitted machine, without effects.

        Returns:
            Verdict of the fitted runs, with the machine and the effects and tables that passed all tests.
        """
        if start is not None:
            self._log("searching for further effects")
        self._passed = None
        found = self._passed = self._known_effects(start)
        if tabled := self._in_place_of_curves(found):
            return self._outcome("effect_found", tabled)
        if decided := self._decided(found):
            return decided
        tabled = None if self.runs_differ else self._with_tables(found)
        return self._outcome("effect_found", self._with_rivals(tabled)) if tabled else self._partial(found)

    def fitted(self, found: SearchOutcome) -> SearchOutcome:
        """Refit the machine of a search in some of the rows to all rows, and reach the verdict again.

        Args:
            found: Outcome of a search in some of the rows.

        Returns:
            Outcome with the same effects, without those that the fit moves to a meaningless limit.
        """
        after = self.before
        if found.selected:
            self._data_after = refine_dataset(self._data, found.after.machine)
            after = polish(
                continue_fit(found.after, self._data_after, found.after.bandwidth), self._data_after
            )
        # The search has chosen their observers.
        self._refinements |= {self.before: self.before, after: after}
        complete = self._within_limits(Found(after, found.selected, found.considered))
        if decided := self._decided(complete):
            return decided
        if any(s.effect.definition.family == TABLE_FAMILY for s in complete.effects):
            return self._outcome(found.verdict, complete)
        return self._partial(complete)

    def finished_early(self, tests: Budget, last_fit: Budget) -> SearchOutcome:
        """Return the outcome when the budget has ended: those selected effects that pass final tests.

        No effect is kept if the time for the tests ends first.

        Args:
            tests: Budget of these tests, including fits in simulation of effects that leave an error. What is
                left of it is spent on comparing the effects with all others.
            last_fit: Budget of the last fits of the effects that pass. If it ends, the best parameters so far
                are delivered.
        """
        found, decision = self._tested_early(tests)
        with last_fit.limiting(delivers=True):
            decision = decision or self._verdict(found)
            outcome = self._decide(decision, found)._replace(contradiction=self.suspect)
        # A name is no better for what the search did not reach: other effects may move the machine alike.
        if outcome.selected:
            search = self._searches[-1]
            with suppress(BudgetEndedError), tests.limiting():
                return outcome._replace(
                    selected=search.with_indistinguishable(found.fitted, outcome.selected)
                )
        return outcome

    def _tested_early(self, tests: Budget) -> tuple[Found, Decision | None]:
        """Return the effects that pass the tests, and the decision; none if the tests do not end.

        Where the search had not reached the effects that an earlier one selected, these are tested.
        """
        search = self._searches[-1] if self._searches else None
        after, effects = (search and search.reached) or (self.before, self._known)
        untested: tuple[ConsideredEffect, ...] = ()
        if effects:
            search = search or self._first_search
            try:
                with tests.limiting():
                    if search.reached is None:
                        after, effects = search.start_with(after, effects)
                    if (found := self._passed) is None:
                        for s in effects:
                            search.considered.pop(s.effect.label, None)
                        self._data_after = search.data
                        found = self._tested(search, after, effects)
                    return found, self._verdict(found)
            except BudgetEndedError:
                others = tuple(s for s in effects if s.effect.label not in search.considered)
                untested = self._removed(after, others, "was not tested before the budget ended")
                self._data_after = self._data
        rejected = (*untested, *(search.considered.values() if search else ()))
        return Found(self.before, (), rejected), None

    def _decided(self, found: Found) -> SearchOutcome | None:
        """Return the outcome if no table can change it: effects explain the data, or imitate a drift."""
        decision = self._verdict_of_effects(found)
        return decision and self._decide(decision, found)

    def _partial(self, found: Found) -> SearchOutcome:
        """Return the outcome where an error remains that neither effects nor a table describe."""
        return self._decide(self._verdict_of_rest(found), found)

    def _verdict(self, found: Found) -> Decision:
        """Return the decision about effects where no time is left for others or for tables."""
        return self._verdict_of_effects(found) or self._verdict_of_rest(found)

    def _verdict_of_effects(self, found: Found) -> Decision | None:
        """Return the decision if a table cannot change it (`_decided`)."""
        return verdict_of_effects(
            bool(found.effects), self._imitated_drift(found.fitted), lambda: self._explains(found.fitted)
        )

    def _verdict_of_rest(self, found: Found) -> Decision:
        """Return the decision where an error remains (`_partial`)."""
        return verdict_of_rest(
            bool(found.effects),
            lambda: self.runs_differ,
            self._voltages_may_cause(found),
            lambda: self._partial_evidence(found.fitted),
            self._criteria,
        )

    def _decide(self, decision: Decision, found: Found) -> SearchOutcome:
        """Return the outcome of a decision: a verdict, and why effects are removed."""
        verdict, reason = decision
        if reason or not found.effects:
            removed = self._removed(found.fitted, found.effects, reason)
            found = Found(self.before, (), found.considered + removed)
        return self._outcome(verdict, found)

    def _removed(
        self, after: Fit, effects: tuple[SelectedEffect, ...], reason: str
    ) -> tuple[ConsideredEffect, ...]:
        """Log that effects are removed, and return them as considered; the reason follows "it "."""
        for s in effects:
            self._log(f"  {s.effect.label} is removed: it {reason}")
        return tuple(ConsideredEffect(s.effect, after.machine, self.before.machine, reason) for s in effects)

    def _imitated_drift(self, after: Fit) -> str:
        """Return the name of the parameter that differs by run, if effects only imitate it, else ""."""
        declared = {e.label for e in self.before.machine.effects}
        named = [e for e in after.machine.effects if e.label not in declared]
        over_time = [e for e in named if _may_differ_by_run(e.definition)]
        states = sum(bool(e.definition.initial_spread) for e in over_time) * len(self._data.runs)

        @cache
        def without() -> Fit | None:
            start: Fit | None = after
            for effect in over_time:
                start = start and without_effect(start, effect.label, self._data, self.before.machine)
            return start

        def error_without() -> FitError | None:
            start = without()
            return None if start is None else self._wide_error(start)

        @cache
        def by_run() -> RunDifferences | None:
            start = without()
            return None if start is None else best_by_run(start, self._data)

        def error_by_run() -> FitError | None:
            found = by_run()
            return found and dataclasses.replace(self.base, cost=found.chi2 * self._data.count).error

        evidence = DriftEvidence(
            unknowns=sum(len(e.parameters) for e in over_time) + states,
            values=len(self._data.runs) - 1,
            explained=lambda: self._explains(self._refined(after)),
            wide=lambda: self._wide_error(after),
            without=error_without,
            by_run=error_by_run,
        )
        found = imitates_drift(evidence, self._criteria) and by_run()
        return found.quantity.name if found else ""

    @cached_property
    def _difference(self) -> RunDifferences | None:
        """The parameter that differs by run and explains the runs without effects, if there is one."""
        difference = find_run_differences(self.before, self._data, self._criteria)
        if difference is not None:
            self._log(f"{difference.quantity.name} differs between the runs")
        return difference

    @property
    def needs_no_effect(self) -> bool:
        """Whether the refitted machine explains the runs without effects (`judge.error.explains`)."""
        return self._explains(self.before)

    @cached_property
    def runs_differ(self) -> bool:
        """Whether a parameter with another value in each run explains the runs, as no effect can.

        A parameter that only rises or only falls does not count, because a table over time may explain it;
        nor does a single run that differs, because the others may have effects.
        """
        return self._difference is not None and not self._drifts and self._difference.different_run is None

    @property
    def _drifts(self) -> bool:
        """Whether this parameter only rises or only falls over the runs, as a table over time may explain."""
        return self._difference is not None and self._difference.drifts

    def _within_limits(self, found: Found, search: EffectSearch | None = None) -> Found:
        """Remove effects that the final fit moves to a range limit, and those that fail without them.

        The search asks the same of its own fit, with an observer, from which the final one in simulation may
        differ.
        """
        for s in found.effects:
            if s.effect.definition.family == TABLE_FAMILY:
                continue
            label, data = s.effect.label, self._data_of(found.fitted)
            reason = parameter_at_limit(parameter_values(label, self._refined(found.fitted)))
            reduced = reason and without_effect(found.fitted, label, data, self.before.machine)
            if reduced:
                considered = found.considered + self._removed(found.fitted, (s,), reason)
                others = tuple(o.with_values(reduced.machine) for o in found.effects if o is not s)
                if not others:
                    return Found(self.before, (), considered)
                if search := search or (self._searches[-1] if self._searches else None):
                    reduced, others = search.prune(reduced, others)
                return self._within_limits(Found(reduced, others, considered), search)
        return found

    def _outcome(self, verdict: Verdict, found: Found) -> SearchOutcome:
        """Return the outcome, with machines fitted again, in simulation and run by run, if that is better."""
        # A refined fit may be its own refinement as well; the search judged the first one.
        of_search = (fitted for fitted, refined in self._refinements.items() if refined is found.fitted)
        judged = next(of_search, found.fitted)
        after = self._final(found.fitted)  # first: the other one is for comparison
        before = after if found.fitted is self.before else self._final(self.before)
        return SearchOutcome(
            before,
            self._explains(self.before),
            self._explains(found.fitted) or self._voltages_may_cause(found),
            verdict,
            after,
            tuple(s.with_values(after.machine) for s in found.effects),
            found.considered,
            self._data_after,
            bandwidth=judged.bandwidth,
        )

    def _final(self, fitted: Fit) -> Fit:
        """Return a fit refined in simulation and, if it explains the data, with each run's observer.

        Logs that are slower than the controller are fitted by instruments, if that is better.
        """
        refined, data = self._refined(fitted), self._data_of(fitted)
        by_run = fit_run_by_run(refined, data) if self._explains(fitted) else refined
        return fit_slow_log(by_run, data)

    def _data_of(self, fitted: Fit) -> Dataset:
        """Return the runs with the encoders' zeros that follow from the effects of a fit."""
        if fitted is self.before:
            return self._data
        key = fitted, self._data_after
        if key not in self._data_of_fits:
            self._data_of_fits[key] = refine_dataset(self._data_after, fitted.machine)
        return self._data_of_fits[key]

    def _refined(self, fitted: Fit) -> Fit:
        """Return a fit refined in simulation."""
        if fitted not in self._refinements:
            self._refinements[fitted] = refined_in_simulation(fitted, self._data_of(fitted))
        return self._refinements[fitted]

    def _known_effects(self, start: Selection | None) -> Found:
        """Search from a fit for effects of the library."""
        criteria, data = self._criteria, self._data
        if start is None:
            search, (current, effects) = self._first_search, self.selection
        else:
            search = self._new_search(EffectSearch(data, self.before.machine, criteria, self._log))
            search.reached = start
            current, effects = search.run(*start)
        refined = refine_dataset(search.data, current.machine)
        if refined is not search.data:
            # More accurate zeros may reveal further effects.
            found_at, search = current, self._new_search(search.with_data(refined))
            search.reached = current, effects
            # With the same integration step, so that only the zeros make a difference.
            current = fit_with_model_error(continue_fit(current, refined, current.bandwidth), refined)
            lower = is_enough(found_at.error, current.error, required_gain(found_at.error, criteria))
            if lower or current.bandwidth != found_at.bandwidth:
                current, effects = search.run(current, effects)
        # Starts that a wrong machine estimates compensate what it lacks.
        if effects or self._explains(current):
            self._data_after = search.data
        if not effects and start is None and self._explains(current):
            self.before, self._data = polish(current, search.data), search.data
        if not effects:
            return Found(current, (), tuple(search.considered.values()))
        search.reached = current, effects
        if not nearly_explains(current.error, criteria):
            # Few effects of a machine that is far from explaining the runs are named. Rivals of others do not
            # matter.
            found = self._passed = self._tested(search, current, effects)
            if self._verdict(found)[0] != "effect_found":
                return found
            for s in effects:
                search.considered.pop(s.effect.label, None)
        spend("comparing rivals")
        effects = search.with_indistinguishable(current, effects)
        spend("comparing rivals")
        current, effects = search.settle_rivals(current, effects)
        search.reached = current, effects
        return self._tested(search, current, effects)

    def _tested(self, search: EffectSearch, current: Fit, effects: tuple[SelectedEffect, ...]) -> Found:
        """Return those effects of a search that pass the tests beside each other, also in simulation.

        The search may end meanwhile; the tests go on in the time that is kept for them.
        """
        spend("testing each effect beside the others")
        with during_tests():
            return self._passing_together(search, current, effects)

    def _passing_together(
        self, search: EffectSearch, current: Fit, effects: tuple[SelectedEffect, ...]
    ) -> Found:
        """Return those effects that pass the tests of `_tested`."""
        current, effects = search.prune(search.polished(current), effects)
        simulated = self._refined(current)
        # Without the error that an observer causes, unless the simulation leaves more than the observer
        # corrects.
        accurate = self._explains(simulated) or not self._explains(current)
        if simulated.bandwidth == SIMULATION != current.bandwidth and accurate:
            current, effects = search.prune(simulated, effects)
        found = self._within_limits(Found(current, effects, tuple(search.considered.values())), search)
        return self._without_imitations(found, search)

    def _without_imitations(self, found: Found, search: EffectSearch) -> Found:
        """Remove effects that only imitate a parameter differing by run; others must hold without them.

        Alone, they are removed by the verdict, unless a table over time may take their place.
        """
        imitations = [s for s in found.effects if _may_differ_by_run(s.effect.definition)]
        others = tuple(s for s in found.effects if s not in imitations)
        drift = self._imitated_drift(found.fitted) if imitations and (others or self._drifts) else ""
        reduced: Fit | None = found.fitted if drift else None
        for s in imitations:
            data = self._data_of(found.fitted)
            reduced = reduced and without_effect(reduced, s.effect.label, data, self.before.machine)
        if reduced is None:  # the verdict removes all effects, if these cannot be removed alone
            return found
        considered = found.considered + self._removed(
            found.fitted, tuple(imitations), less_well_than_by_run(drift)
        )
        if not others:
            return Found(self.before, (), considered)
        reduced, others = search.prune(reduced, tuple(s.with_values(reduced.machine) for s in others))
        return self._within_limits(Found(reduced, others, considered), search)

    def _with_tables(self, found: Found) -> Found | None:
        """Return a model with tables, alone or beside the selected effects, if it explains the residual."""
        self._log("no known effect explains the residual; searching for a table of force or friction")
        alone = Found(self.base, (), found.considered)
        beside = found._replace(
            fitted=continue_fit(found.fitted, self._data, SEARCH_BANDWIDTH) if found.effects else self.base
        )
        for start, count in ((alone, 1), (beside, 2)):
            if (tabled := self._tabled(start, count)) is not None:
                replaced = len(found.effects) - len(start.effects)
                evidence = TableEvidence(
                    explained=self._explains(tabled.fitted),
                    excess=self._wide_error(tabled.fitted).excess,
                    refitted=self.base.error.excess,
                    with_effects=beside.fitted.error.excess,
                    effects=replaced,
                )
                if accepts_table(evidence):
                    return tabled
        return None

    def _with_rivals(self, tabled: Found) -> Found:
        """Return effects beside a table with those that these runs hardly distinguish from them.

        Before the table, the machine was far from explaining the runs, so that rivals were not compared.
        """
        library = tuple(s for s in tabled.effects if s.effect.definition.family != TABLE_FAMILY)
        if not library:
            return tabled
        listed = self._searches[-1].with_indistinguishable(tabled.fitted, library)
        by_label = {s.effect.label: s for s in listed}
        return tabled._replace(effects=tuple(by_label.get(s.effect.label, s) for s in tabled.effects))

    def _in_place_of_curves(self, found: Found) -> Found | None:
        """Return a model with a table in place of effects of one variable that imitate another curve."""
        after = found.fitted
        curves = curves_of_one_variable([s.effect for s in found.effects], after.machine)
        if not curves or not self._explains(after) or self.runs_differ:
            return None
        left = self._simulated_cost(after)
        if nearly_explains(dataclasses.replace(after, cost=left).error, self._criteria):
            return None
        self._log("several effects depend on one variable; searching for a table in their place")
        start: Fit | None = continue_fit(after, self._data, SEARCH_BANDWIDTH)
        for effect in curves:
            start = start and without_effect(start, effect.label, self._data, self.before.machine)
        if start is None:
            return None
        others = tuple(s for s in found.effects if s.effect not in curves)
        tabled = self._tabled(Found(start, others, found.considered), 1)
        if tabled is None or not self._explains(tabled.fitted):
            return None
        return tabled if is_one_curve(self._simulated_cost(tabled.fitted), left) else None

    def _tabled(self, known: Found, count: int) -> Found | None:
        """Return a fit with up to `count` tables added to known effects; None if none passes the tests."""
        fitted, more = add_tables(
            known.fitted,
            known.effects,
            self._data,
            criteria=self._criteria,
            max_tables=count,
            log=self._log,
        )
        if len(more) == len(known.effects):
            return None
        data = refine_dataset(self._data, fitted.machine)  # starts are more accurate with the table
        fitted = fit_with_moved_knots(fitted, data, self._criteria)
        # No search beside a table: many small effects resemble the error of its straight pieces.
        refined = polish(fit_with_model_error(fitted, data), data)
        search = EffectSearch(data, self.before.machine, self._criteria, self._log)
        tabled = Found(*search.prune(refined, more), known.considered)
        if self._explains(tabled.fitted):
            tabled = self._within_limits(tabled, search)
        return tabled if tabled.effects else None

    def _simulated_cost(self, fitted: Fit) -> float:
        """Return the cost of the simulation of a machine, refined in simulation."""
        return prediction_cost(self._refined(fitted).machine, self._data_of(fitted), SIMULATION)

    def _wide_error(self, fitted: Fit) -> FitError:
        """Return the error of a machine at the largest observer bandwidth, common to all machines."""
        cost = prediction_cost(fitted.machine, self._data, SEARCH_BANDWIDTH)
        return dataclasses.replace(self.base, cost=cost).error

    def _partial_evidence(self, after: Fit) -> PartialEvidence:
        """Return the errors of a machine with effects and of the refitted machine, per sample."""
        count = self._data.count

        def simulated(fitted: Fit) -> float:
            return prediction_cost(self._refined(fitted).machine, self._data, SIMULATION) / count

        return PartialEvidence(
            wide=(self._wide_error(after), self._wide_error(self.base)),
            simulated=(simulated(after), simulated(self.before)),
        )

    def _voltages_may_cause(self, found: Found) -> bool:
        """Return whether unknown voltages between the rows may cause all that effects leave."""
        unknown = bool(found.effects) and self._data.has_voltage_errors
        return unknown and voltages_may_cause(found.fitted.error, self._criteria)

    def _explains(self, after: Fit) -> bool:
        """Return whether a fit explains the runs (`judge.error.explains`)."""
        bare = after.machine.effects == self.before.machine.effects
        count = self._data.count
        return explains(
            after.error,
            self._criteria,
            without_effects=bare,
            simulated=lambda: self._simulated_cost(after) / count,
        )


def fitted_to_all_rows(
    found: SearchOutcome,
    machine: Machine,
    data: Dataset,
    criteria: SelectionCriteria,
    log: LineLog,
    budget: Budget,
) -> SearchOutcome:
    """Refit the result of a search in some of the rows to all rows, and reach the verdict again.

    Args:
        found: Outcome of a search in some of the rows.
        machine: Machine from which the search started.
        data: All rows of the runs to fit, without the run that the search left out.
        budget: Processor time of the identification.

    Returns:
        Outcome with machines fitted to all rows; `found`, marked as unfinished, if the budget ended before.
    """
    try:
        with budget.limiting(stage_ends(machine, in_part=True).all_rows):
            spend("fitting all rows")
            log("fitting all rows")
            complete = estimate_lost_voltages(data, found.after.machine)
            before = polish(found.before, complete)
            wide = continue_fit(before, complete, SEARCH_BANDWIDTH)
            outcome = ModelSearch(machine, complete, criteria, log, wide, before).fitted(found)
    except BudgetEndedError:
        log(f"  {budget.reason} ({budget.doing}); the machines are fitted to a part of the rows")
        return found._replace(unfinished=found.unfinished or budget.doing)
    return outcome._replace(contradiction=found.contradiction, unfinished=found.unfinished)


def _may_differ_by_run(definition: Effect) -> bool:
    """Return whether an effect is a function of time, or begins each run in an unknown state."""
    hooks = (getattr(definition, name) for name in HOOKS)
    return bool(definition.initial_spread) or any(hook and "t" in argument_names(hook) for hook in hooks)
