"""Find effects in the fitted runs and check them with the held-out runs, which can only remove effects.

`find_effects` refits the machine and searches (`search_effects`: propose, fit, gather evidence, judge,
repeat).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

from ...arrays import Array
from ...line_log import LineLog
from ...machine import Machine
from ...preparation.dataset import Dataset
from ...preparation.runs.excerpt import LARGEST_FIT, NORMAL_SESSION, describe_part, representative_part
from ...preparation.runs.left_out import with_known_positions
from ..budget import LAST_STAGE_END, SECOND_SEARCH_PART, Budget, BudgetEndedError, stage_ends
from ..evidence.effect_variables import describes_one_run
from ..evidence.held_out import (
    contradicting_held_out_runs,
    held_out_evidence,
    runs_with_effects,
    worsens_simulation,
)
from ..evidence.significance import TestedFit, doubt_beside_others
from ..evidence.tried_effects import SelectedEffect
from ..fit.cross_validation import contradicting_run
from ..fit.estimation import Fit, fit
from ..fit.lost_voltages import held_over_gaps, with_lost_voltages
from ..fit.model_error import continue_fit
from ..fit.plain_fit import PlainFit, better_start, plain_fit
from ..fit.run_differences import find_run_differences
from ..fit.start_estimation import refine_dataset
from ..fit.voltage_updates import VoltageUpdates, can_show_updates, describe_interpolation, voltage_updates
from ..judge.criteria import SelectionCriteria
from ..judge.effect import may_be_no_effect
from ..judge.held_out import refuted_effects
from ..judge.run import MIN_RUNS_COMPARED, exchange_confirms, exchanges_held_out, run_that_differs_alone
from ..predict.free_parameters import default_free_parameters
from ..predict.prediction import SEARCH_BANDWIDTH
from ..predict.voltage_errors import with_voltage_errors
from ..propose.trial_fits import without_effect
from .input_timing import with_input_timing
from .model_search import fitted_to_all_rows
from .outcome import SearchOutcome, VoltagesChangeError, with_removed
from .search_effects import search_effects

_CONTRADICTION = (
    "{} is not used: the other runs agree with one machine to within their noise, "
    "and this run contradicts it. Check its voltages, gains and sensors."
)
_HELD_OUT_CONTRADICTION = (
    "{} was held out and contradicts the fitted runs: "
    "either something was wrong with it (check its voltages, gains and sensors), or it shows what the fitted "
    "runs do not excite (hold out another run with --hold-out). The errors on held-out runs include it."
)
_HINT = (
    "If the held-out runs are fitted as well, {} would explain all runs, but no other run confirms it. "
    "Record another run such as {} and identify again."
)
_BETWEEN_ROWS = (
    "In this log, {}. They are interpolated; {}. `hframe simulate` interpolates them with --updates {}."
)
_PLAIN_ENDED = (
    "The plain fit ended after {:.0f} s of processor time, its part of the budget, "
    "with its best parameters so far. A larger --budget completes it."
)

BeforeSearch = Callable[[PlainFit | None, Dataset, Dataset], None]


class CheckedOutcome(NamedTuple):
    """Outcome of a search in the fitted runs, after the check with the held-out runs.

    Attributes:
        outcome: Outcome of the search.
        held_out: Runs that were not fitted.
        differing: Names of the held-out runs that contradict the machine which explains the fitted runs.
        messages: What the user should know about the division of the runs, one sentence each.
        plain: Plain fit to the fitted runs, if there is one.
        hint: What the user should know if the fitted and the held-out runs contradict each other; a sentence,
            or "".
    """

    outcome: SearchOutcome
    held_out: Dataset
    differing: tuple[str, ...]
    messages: tuple[str, ...] = ()
    plain: PlainFit | None = None
    hint: str = ""

    @property
    def agreeing(self) -> Dataset:
        """Held-out runs that do not contradict the machine."""
        return self.held_out.with_runs([r.name for r in self.held_out.runs if r.name not in self.differing])

    @property
    def judging(self) -> Dataset:
        """Held-out runs that may remove effects.

        They are those that do not contradict the machine, and contradicting ones of whose squared error the
        effects remove more than 90 % (`runs_with_effects`).
        """
        outcome, differing = self.outcome, self.held_out.with_runs(self.differing)
        if not outcome.selected or not differing.runs:
            return self.agreeing
        refined = refine_dataset(differing, outcome.after.machine, outcome.data)
        showing = runs_with_effects(outcome.after, outcome.before.machine, refined)
        names = [
            run.name for run in self.held_out.runs if run.name not in self.differing or run.name in showing
        ]
        return self.held_out.with_runs(names)

    @property
    def remarks(self) -> tuple[str, ...]:
        """What the user should know about runs that contradict others, one sentence each."""
        left_out = self.outcome.contradiction
        remarks = (_CONTRADICTION.format(left_out),) if left_out else ()
        hints = (self.hint,) if self.hint else ()
        return (*remarks, *map(_HELD_OUT_CONTRADICTION.format, self.differing), *hints)

    def without_run(self, name: str) -> CheckedOutcome:
        """Return a copy whose outcome names a run as left out (`contradiction`) of the search."""
        return self._replace(outcome=self.outcome._replace(contradiction=name))

    def comparable_runs(self, all_runs: Dataset) -> Dataset:
        """Return the runs that can be compared: the fitted ones, the held-out ones and one left out.

        Args:
            all_runs: All runs, prepared for a fit. Runs that the search used replace them, because these have
                estimated voltages.
        """
        used = {run.name: run for run in (*self.outcome.data.runs, *self.held_out.runs)}
        names = [*used, self.outcome.contradiction]
        runs = tuple(used.get(r.name, r) for r in all_runs.runs if r.name in names)
        return dataclasses.replace(all_runs, runs=runs)


def find_effects(
    machine: Machine,
    all_runs: Dataset,
    held_names: Sequence[str],
    *,
    may_exchange: bool,
    criteria: SelectionCriteria,
    log: LineLog,
    budget: Budget,
    before_search: BeforeSearch,
) -> CheckedOutcome:
    """Refit a machine and find the effects (deviations from the nominal model) that it lacks.

    The search uses the runs that are not held out. The held-out runs then remove effects that they do not
    confirm. Finally, a delay of the drives is tested, which the observer of the search hides.

    Args:
        machine: Machine as declared.
        all_runs: All runs, prepared for a fit.
        held_names: Names of the runs that are held out.
        may_exchange: Whether to search again with other runs held out, if the held-out runs contradict the
            fitted ones (`exchanged_if_better`).
        criteria: Decision thresholds.
        log: Called with a line of text for each step.
        budget: Processor time after which the search ends.
        before_search: Called before each search with the plain fit, the fitted and the held-out runs.
    """
    search = _RunSearch(machine, all_runs, criteria, log, budget, before_search)
    found = search.without(held_names)
    may_repeat = budget.has_time(SECOND_SEARCH_PART)
    complete = not found.outcome.unfinished and may_repeat
    if complete and may_exchange:
        found = exchanged_if_better(found, search.without, log)
    with budget.limiting(delivers=True):
        outcome = without_unconfirmed(found.outcome, found.judging, criteria, log)
    return found._replace(outcome=_with_input_timing(outcome, found.agreeing, criteria, log, budget))


def _with_input_timing(
    outcome: SearchOutcome, held_out: Dataset, criteria: SelectionCriteria, log: LineLog, budget: Budget
) -> SearchOutcome:
    """Return an outcome with a drive delay or lag if there is one; unchanged where the budget ends before."""
    try:
        with budget.limiting(LAST_STAGE_END):
            return with_input_timing(outcome, held_out, criteria, log)
    except BudgetEndedError:
        return outcome._replace(unfinished=outcome.unfinished or "searching for a delay or lag of the drives")


class _Runs(NamedTuple):
    """The runs of a search, with the machine refitted to them.

    Attributes:
        fitted: Runs to fit, or a representative part of their rows, with lost voltages estimated.
        held_out: Runs that are held out, with lost voltages estimated.
        all_rows: All rows of the runs to fit, as far as they are not too many, if `fitted` has a part of
            them.
        refitted: Machine refitted to `fitted` at `SEARCH_BANDWIDTH`.
        voltages: Voltages as logged, of each run to fit by its name.
        left_out: Name of the run that alone differs from the others and is not fitted, if there is one.
        messages: What the user should know about the runs, one sentence each.
    """

    fitted: Dataset
    held_out: Dataset
    all_rows: Dataset | None
    refitted: Fit
    voltages: dict[str, Array]
    left_out: str | None
    messages: tuple[str, ...]

    def with_message(self, message: str) -> _Runs:
        """Return the same runs with one more sentence for the user."""
        return self._replace(messages=(*self.messages, message))


class _Voltages(NamedTuple):
    """What a search assumes of the voltages between the rows, and where the one before has led.

    Attributes:
        updates: How often they change.
        responding: Machine that shows how the predictions respond to the voltages.
        fitted_with_errors: Whether the fit of this machine allowed for errors of interpolated voltages.
        selected: Effects that the search before selected, which assumed other voltages.
        rejected: Numbers of changes a row that were refuted, each with the number of effects known by then.
    """

    updates: VoltageUpdates
    responding: Machine
    fitted_with_errors: bool
    selected: tuple[SelectedEffect, ...]
    rejected: dict[int, int]

    def after(self, change: VoltagesChangeError) -> _Voltages:
        """Return what the next search assumes, after one that found that the voltages change otherwise."""
        refuted = self.updates.per_row
        rejected = {**self.rejected, refuted: len(change.machine.effects)}
        return _Voltages(change.updates, change.machine, refuted > 1, change.selected, rejected)


class _RunSearch:
    """Searches of an identification in those of its runs that are not held out.

    Args:
        machine: Machine as declared.
        all_runs: All runs, prepared for a fit.
        budget: Processor time after which a search ends.
        before_search: Called before each search with the plain fit, the fitted and the held-out runs.
    """

    def __init__(
        self,
        machine: Machine,
        all_runs: Dataset,
        criteria: SelectionCriteria,
        log: LineLog,
        budget: Budget,
        before_search: BeforeSearch,
    ) -> None:
        self._machine, self._all_runs, self._criteria = machine, all_runs, criteria
        self._log, self._budget, self._before_search = log, budget, before_search

    def without(self, held_names: Sequence[str]) -> CheckedOutcome:
        """Search in the runs that are not held out, and find the held-out runs that contradict the result.

        A search that finds that the voltages change more or less often between the rows is repeated with this
        knowledge.
        """
        runs = self._divided(held_names)
        of_agreeing, agreeing = self._agreeing(runs)
        updates = voltage_updates(of_agreeing, agreeing, self._criteria)
        voltages = _Voltages(updates, self._machine, fitted_with_errors=False, selected=(), rejected={})
        names = [run.name for run in agreeing.runs]
        while True:
            try:
                return self._with_voltages(voltages, runs, names)
            except VoltagesChangeError as change:
                voltages = voltages.after(change)

    def _with_voltages(self, voltages: _Voltages, runs: _Runs, agreeing: Sequence[str]) -> CheckedOutcome:
        """Interpolate voltages as assumed, fit plainly, and search; `agreeing`: runs that contradict none."""
        per_row, logged = voltages.updates.per_row, runs.voltages
        if per_row > 1:
            changes = voltages.updates.describe(self._machine.commands_in_words, runs.fitted.period)
            self._log(f"{changes}; they are interpolated")
            runs = _interpolated(voltages, runs, agreeing, self._log)
            quality = describe_interpolation(runs.refitted.machine, runs.fitted)
            runs = runs.with_message(_BETWEEN_ROWS.format(changes, quality, per_row))
        runs = runs._replace(fitted=dataclasses.replace(runs.fitted, updates_rejected=voltages.rejected))
        # Voltages that are estimated by a machine would make its parameters part of the plain fit.
        to_fit = runs.fitted.with_inputs(logged) if runs.all_rows is None else runs.all_rows
        plain = plain_fit(self._machine, to_fit, self._budget)
        if plain is not None and plain.seconds is not None:
            runs = runs.with_message(_PLAIN_ENDED.format(plain.seconds))
            self._log(
                f"  the plain fit ended after {plain.seconds:.0f} s of processor time, its part of the budget"
            )
        self._before_search(plain, runs.fitted, runs.held_out)
        found = self._found(runs, plain, voltages.selected)
        return found if runs.left_out is None else found.without_run(runs.left_out)

    def _divided(self, held_names: Sequence[str]) -> _Runs:
        """Return the runs to fit and to hold out, without a lone deviating one, and the refitted machine."""
        machine, all_runs, log, budget = self._machine, self._all_runs, self._log, self._budget
        fitted_names = [run.name for run in all_runs.runs if run.name not in held_names]
        held_out, excluded = with_known_positions(all_runs.with_runs(held_names))
        all_rows, unused = with_known_positions(all_runs.with_runs(fitted_names))
        names = ", ".join(run.name for run in held_out.runs)
        log(f"fitting {machine.name} to {len(all_rows.runs)} runs, {len(held_out.runs)} held out ({names})")
        data = representative_part(all_rows, machine, size=budget.session_part * NORMAL_SESSION)
        in_part = data is not all_rows
        if in_part:
            log(f"effects are searched for in {describe_part(data, all_rows)}")
            all_rows = representative_part(all_rows, machine, size=budget.session_part * LARGEST_FIT)
        logged = data
        data, held_out, held = with_lost_voltages(machine, data, held_out, log)
        if held:
            logged, all_rows = held_over_gaps(logged), held_over_gaps(all_rows)
        refitted = self._refitted(data)
        different = _different_run(refitted, data, held_out, self._criteria)
        if different is not None:
            log(f"{different} differs from the other runs; searching without it")
            data, all_rows = _without_run(data, different), _without_run(all_rows, different)
            refitted = self._refitted(data)
        return _Runs(
            data,
            held_out,
            all_rows if in_part else None,
            refitted,
            voltages={run.name: run.inputs for run in logged.runs},
            left_out=different,
            messages=(*unused, *excluded),
        )

    def _agreeing(self, runs: _Runs) -> tuple[Fit, Dataset]:
        """Return the runs that show what voltages do between the rows, and the machine refitted to them.

        The error of a run that contradicts the others would hide what the voltages cause.
        """
        if can_show_updates(runs.fitted):
            self._log(
                f"comparing held {self._machine.commands_in_words} with some that change between the rows"
            )
            suspect = contradicting_run(runs.refitted, runs.fitted)
            if suspect is not None:
                agreeing = _without_run(runs.fitted, suspect)
                return self._refitted(agreeing), agreeing
        return runs.refitted, runs.fitted

    def _refitted(self, data: Dataset) -> Fit:
        """Return the machine refitted to some runs."""
        return fit(self._machine, default_free_parameters(self._machine), data, SEARCH_BANDWIDTH)

    def _found(
        self, runs: _Runs, plain: PlainFit | None, selected: tuple[SelectedEffect, ...]
    ) -> CheckedOutcome:
        """Search in fitted runs or a part of them, fit findings to all rows, and compare with held-out runs.

        Args:
            runs: The runs.
            plain: Plain fit to the fitted ones, if there is one.
            selected: Effects that the search before selected, which assumed other voltages between the rows.
        """
        log, data, all_rows = self._log, runs.fitted, runs.all_rows
        start = _start(self._machine, data, plain, log)

        def confirmed(outcome: SearchOutcome) -> bool:
            differing = _contradicting_runs(outcome, runs.held_out)
            if differing:
                log(f"{', '.join(differing)} contradicts these runs as well; searching in all fitted runs")
            return not differing

        outcome = search_effects(
            start,
            data,
            self._criteria,
            log,
            confirmed=confirmed,
            budget=self._budget,
            ends=stage_ends(self._machine, in_part=all_rows is not None),
            refitted=runs.refitted if start is self._machine and not data.has_voltage_errors else None,
            known=selected,
        )
        if all_rows is not None:
            contradiction = outcome.contradiction
            agreeing = all_rows if contradiction is None else _without_run(all_rows, contradiction)
            # Like held-out runs, other rows can only remove effects.
            outcome = without_unconfirmed(outcome, agreeing, self._criteria, log)
            outcome = fitted_to_all_rows(outcome, start, agreeing, self._criteria, log, self._budget)
        differing = _contradicting_runs(outcome, runs.held_out)
        return CheckedOutcome(outcome, runs.held_out, differing, runs.messages, plain)


def _without_run(data: Dataset, name: str) -> Dataset:
    """Return the runs without one of them."""
    return data.with_runs([run.name for run in data.runs if run.name != name])


def _different_run(
    refitted: Fit, data: Dataset, held_out: Dataset, criteria: SelectionCriteria
) -> str | None:
    """Return the name of the fitted run that alone needs another value of a quantity, if these are too few.

    Of two runs that disagree, either may be wrong; a held-out run that agrees with one of them says which.
    """
    everything = dataclasses.replace(data, runs=(*data.runs, *held_out.runs))
    if not 1 < len(data.runs) < MIN_RUNS_COMPARED <= len(everything.runs):
        return None
    found = find_run_differences(refitted, everything, criteria)
    different = found and run_that_differs_alone(found.different_run, found.chi2, found.chi2_before)
    return different if different in [run.name for run in data.runs] else None


def _interpolated(voltages: _Voltages, runs: _Runs, agreeing: Sequence[str], log: LineLog) -> _Runs:
    """Return the runs with interpolated voltages, without the rows of which the search needs none.

    How the predictions respond to errors of the voltages follows from a machine that is fitted to these runs.
    A fit that does not allow for these errors takes the motion that they cause for friction. A machine that
    was fitted with them is therefore not fitted again without them. The errors of voltages between all rows
    of a long log would need too much memory.
    """
    machine, updates = voltages.responding, voltages.updates.per_row
    data, held_out, _ = with_lost_voltages(
        machine, runs.fitted.with_updates(updates), runs.held_out.with_updates(updates), log
    )
    if not voltages.fitted_with_errors:
        free = default_free_parameters(machine)
        machine = fit(machine, free, data.with_runs(agreeing), SEARCH_BANDWIDTH).machine
    fitted, held_out = (with_voltage_errors(machine, each) for each in (data, held_out))
    return runs._replace(fitted=fitted, held_out=held_out, all_rows=None)


def _start(machine: Machine, data: Dataset, plain: PlainFit | None, log: LineLog) -> Machine:
    """Return the refit's first machine: as declared, or with the plain fit's inertia and friction."""
    start = better_start(machine, data, plain)
    if start is not machine:
        values, declared = start.parameters, machine.parameters
        changed = ", ".join(
            f"{n} {v / declared[n]:.2g}" for n, v in values.items() if declared.get(n) not in (0.0, v)
        )
        log(f"the fit starts from values that follow from the motion; times the declared ones: {changed}")
    return start


def _contradicting_runs(outcome: SearchOutcome, held_out_runs: Dataset) -> tuple[str, ...]:
    """Return the names of the held-out runs that contradict the machine which explains the fitted runs."""
    refined = refine_dataset(held_out_runs, outcome.after.machine, outcome.data)
    return contradicting_held_out_runs(outcome.after, outcome.before.machine, outcome.selected, refined)


def exchanged_if_better(
    found: CheckedOutcome, search_without: Callable[[Sequence[str]], CheckedOutcome], log: LineLog
) -> CheckedOutcome:
    """Search again with other runs held out if all held-out runs contradict the fitted runs.

    The contradicting runs are then fitted, and as many of the others are held out.

    Args:
        found: Outcome of the first search.
        search_without: Function that searches with some runs held out, given their names.
        log: Called with a line of text for each decision.

    Returns:
        The second outcome if its effects explain all runs and its held-out runs confirm them, or if one of
        the first held-out runs is the only one that disagrees with all others. Otherwise the first outcome,
        with a hint for the user if effects explain all runs in the second one.
    """
    others = _runs_to_exchange(found, log)
    if not others:
        return found
    exchanged = search_without(others)
    if exchanged.outcome.contradiction in found.differing and not exchanged.differing:
        return exchanged  # the run that had been held out is the only one that disagrees
    if _explains_all_runs(exchanged) and _is_confirmed(exchanged.outcome, exchanged.held_out):
        log("the runs that are held out now confirm these effects")
        return exchanged
    return found._replace(hint=_hint(found, exchanged))


def _runs_to_exchange(found: CheckedOutcome, log: LineLog) -> list[str]:
    """Return the fitted runs to hold out instead, if every held-out run contradicts the fitted, or none.

    Either something was wrong with the held-out runs, or only they excite an effect.
    """
    fitted = [run.name for run in found.outcome.data.runs]
    if not exchanges_held_out(len(found.differing), len(found.held_out.runs), len(fitted)):
        return []
    others = fitted[: len(found.differing)]
    log(
        f"all held-out runs contradict the fitted ones ({', '.join(found.differing)}); searching with "
        f"{', '.join(others)} held out instead"
    )
    return others


def _explains_all_runs(exchanged: CheckedOutcome) -> bool:
    """Return whether effects explain all runs together, of which others are held out than at first."""
    outcome = exchanged.outcome
    alone = outcome.contradiction or exchanged.differing
    return bool(outcome.selected) and outcome.explained and not alone


def _is_confirmed(outcome: SearchOutcome, held_out: Dataset) -> bool:
    """Return whether the runs that are held out now depend on the effects and confirm them."""
    if any(describes_one_run(s.effect.definition) for s in outcome.selected):
        return False
    machine = outcome.after.machine
    runs = refine_dataset(held_out, machine, outcome.data)
    shown = held_out_evidence(outcome.selected, machine, runs, outcome.bandwidth)
    return exchange_confirms([*shown.values()])


def _hint(found: CheckedOutcome, exchanged: CheckedOutcome) -> str:
    """Return a hint at effects that explain all runs together, if the held-out runs are fitted; otherwise "".

    They are named only as a hint: no run is left that could confirm them.
    """
    if not _explains_all_runs(exchanged):
        return ""
    effects = ", ".join(s.effect.label for s in exchanged.outcome.selected)
    return _HINT.format(effects, ", ".join(found.differing))


def without_unconfirmed(
    outcome: SearchOutcome, held_out: Dataset, criteria: SelectionCriteria, log: LineLog
) -> SearchOutcome:
    """Remove effects that the held-out runs refute, one at a time, the weakest first.

    Which effects are refuted, `judge.held_out.refuted_effects` decides: those that do not reduce the error of
    these runs; if there are none, but all together make the simulation worse, the weakest. An effect that
    they do not excite is kept, because the fitted runs have confirmed it. After each removal, effects go as
    well that chance or unknown voltages may explain without the one that is gone.

    Args:
        outcome: Outcome of a search.
        held_out: Held-out runs that may remove effects (`CheckedOutcome.judging`).
        criteria: Thresholds of the tests by the fitted runs.
        log: Called with a line of text for each effect that is removed.

    Returns:
        The outcome with the removed effects among the considered ones, and the verdict without them.
    """
    before, data = outcome.before, outcome.data
    while outcome.selected and held_out.runs:
        after, selected = outcome.after, outcome.selected
        runs = refine_dataset(held_out, after.machine, data)
        shown = held_out_evidence(selected, after.machine, runs, outcome.bandwidth)
        refuted, reason = refuted_effects(
            shown, partial(worsens_simulation, before.machine, after.machine, runs)
        )
        if not refuted:
            break
        refined = refine_dataset(data, after.machine)
        ordered = (next(s for s in selected if s.effect.label == label) for label in refuted)
        fits = ((s, without_effect(after, s.effect.label, refined, before.machine)) for s in ordered)
        # The weakest that can be removed: no other effect requires it or acts on a coordinate that it added.
        weakest, reduced = next(((s, fitted) for s, fitted in fits if fitted is not None), (None, None))
        if weakest is None or reduced is None:
            break
        outcome = _without_doubted(with_removed(outcome, weakest, reduced, reason, log), criteria, log)
    return outcome


def _without_doubted(outcome: SearchOutcome, criteria: SelectionCriteria, log: LineLog) -> SearchOutcome:
    """Remove effects that chance or unknown voltages may explain without one that has been removed.

    The search selects such effects if another one that hides them makes the difference. What else the tests
    ask compares an effect with all that remains unexplained, to which a removal adds.
    """
    if not outcome.selected:
        return outcome
    data, refitted = outcome.data, outcome.before.machine
    tested = TestedFit(continue_fit(outcome.after, data, outcome.bandwidth), data)
    for s in sorted(outcome.selected, key=lambda s: s.gain):
        label = s.effect.label
        without = without_effect(tested.fitted, label, data, refitted)
        reduced = without_effect(outcome.after, label, data, refitted)
        if without is None or reduced is None:  # another effect requires it
            continue
        effect = next(e for e in tested.fitted.machine.effects if e.label == label)
        doubt = doubt_beside_others(without, tested, effect, criteria)
        if may_be_no_effect(doubt):
            return _without_doubted(with_removed(outcome, s, reduced, doubt, log), criteria, log)
    return outcome
