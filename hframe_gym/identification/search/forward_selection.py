"""Forward selection of the effects that a machine lacks.

An effect is a deviation from the nominal model, such as cogging. The best candidates of the screening are
fitted together with the machine's parameters. The best of them is selected if it reduces chi-squared per
sample by enough and passes the tests of `significance`; the search continues from there. At the end, effects
that fail a test beside the others are removed. `SelectionCriteria` holds the thresholds. A gain is a
reduction of chi-squared per sample. A rival is another effect that explains the same data equally well. An
observer, which feeds the measurements back, corrects predictions (`model_error`).
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterable, Iterator
from functools import cache, partial
from typing import NamedTuple

from ...line_log import LineLog
from ...machine import AppliedEffect, Machine
from ...preparation.dataset import Dataset
from ..budget import BudgetEndedError, expect_tests, may_begin_again, note_error, seconds_spent, spend
from ..evidence.rivals import (
    close_rivals,
    compare_rivals,
    hidden_rivals,
    limited_last,
    most_likely_fit,
    rivals_in_combination,
    selected_first,
    simplest_first,
)
from ..evidence.significance import TestedFit, doubt_about_candidate, doubt_beside_others
from ..evidence.tried_effects import ConsideredEffect, SelectedEffect, Selection, Step
from ..fit.estimation import Fit, describe_gain
from ..fit.long_run_variance import long_run_variance
from ..fit.model_error import (
    continue_fit,
    fit_with_model_error,
    has_narrowest_observer,
    likelihood_deficit,
    narrower_observer,
    polish,
)
from ..fit.start_estimation import with_probable_starts
from ..fit.voltage_updates import other_updates
from ..judge import trial as judge
from ..judge.criteria import SelectionCriteria
from ..judge.effect import enough_gain, hidden_by, may_be_no_effect
from ..judge.error import FitError, is_enough, nearly_explains, only_noise_is_left, required_gain
from ..judge.rival import largest_resembling_loss
from ..judge.trial import StructureEvidence
from ..predict.prediction import SIMULATION
from ..propose.trial_fits import (
    ScreenedFit,
    best_error,
    converge,
    fit_with_effects,
    indistinguishable,
    machine_without,
    replacement_fit,
    screened_fit,
    structural_trial_fits,
    trial_fits,
    without_effect,
)
from .outcome import VoltagesChangeError


class _Comparison(NamedTuple):
    """What comparing an effect with its rivals has shown: labels of those tried, and those that remained."""

    fitted: Fit
    data: Dataset
    tried: frozenset[str] = frozenset()
    remaining: tuple[AppliedEffect, ...] = ()


class _Candidates(NamedTuple):
    """Candidates for the next effect.

    Attributes:
        current: Fit without any of them.
        trials: Trial fits with one of them each.
        enough: Reduction of chi-squared per sample for which an effect is selected.
        converged: Function that returns the converged fit of a trial; it remembers its results.
        doubt: Function of a converged fit that returns why its effect may not exist; it remembers as well.
        unexplained: Fits whose effects explain what no effect may cause, as far as they were tested.
    """

    current: Fit
    trials: list[Fit]
    enough: float
    converged: Callable[[Fit], Fit]
    doubt: Callable[[Fit], str]
    unexplained: list[Fit]


class EffectSearch:
    """Forward selection of effects, at the observer bandwidth that the remaining model error requires.

    Args:
        refitted: Machine before effects are added.
        log: Called with a line of text for each candidate.
        drawback: Function of the fit with an effect that passes all tests. It returns a drawback of the
            effect, a clause that follows "it ", or "". An effect without a drawback is preferred even if it
            explains less; if all have one, the effect that explains most is selected. An effect with a
            drawback replaces no earlier one. Default: no drawbacks.
        counts: Whether the number of voltage changes between the rows is checked again after each effect.

    Attributes:
        considered: Effects that reduced the error but failed a test, by label (name@site).
        reached: Fit and effects selected so far; None before the first step.
        data: The recordings; `run` may replace the initial states of their runs by more probable ones.
    """

    def __init__(
        self,
        data: Dataset,
        refitted: Machine,
        criteria: SelectionCriteria,
        log: LineLog,
        drawback: Callable[[Fit], str] | None = None,
        *,
        counts: bool = True,
    ) -> None:
        self.data, self._refitted, self._criteria, self._log = data, refitted, criteria, log
        self._drawback, self._counts = drawback, counts
        self.considered: dict[str, ConsideredEffect] = {}
        # Observer bandwidth and excess of chi-squared at which structural effects were tried and no effect
        # passed.
        self._structures_failed = (math.nan, math.inf)
        self.reached: Selection | None = None
        # Gain of the best candidate of the last step that failed a test, and that step; its trial fit is the
        # first.
        self._doubted: tuple[float, Step] | None = None
        # Fits with their candidates, the latest for each observer bandwidth and effects.
        self._screened: dict[tuple[float | str, ...], ScreenedFit] = {}
        self._compared: dict[str, _Comparison] = {}  # of effects with their rivals, the latest by label
        self._likely: tuple[Fit, Dataset, Fit] | None = (
            None  # the latest fit, its data and the most likely fit
        )
        self._seconds = 0.0  # processor time for the fit and the tests of the last effect that passed, s

    def with_data(self, data: Dataset) -> EffectSearch:
        """Return a copy of this search that fits other data and remembers what it has tried.

        Args:
            data: Prepared recordings to fit, for example with corrected zeros.

        Returns:
            Search before its first step (`reached` is None), with copies of `considered` and of the latest
            candidates by observer and effects. If structural effects were tried in vain, they are tried again
            only when the error has clearly fallen since (`judge.trial.is_worth_structures`).
        """
        search = EffectSearch(
            data, self._refitted, self._criteria, self._log, self._drawback, counts=self._counts
        )
        search.considered, search._structures_failed = dict(self.considered), self._structures_failed
        search._screened = dict(self._screened)
        return search

    def run(self, current: Fit, selected: tuple[SelectedEffect, ...] = ()) -> Selection:
        """Add effects one by one while one reduces the error enough and passes all tests.

        The least reduction is `judge.effect.enough_gain`; the tests are those of
        `judge.effect.doubt_about_candidate`. Effects that fail one of them are added to `considered`. After
        each selected effect, the bandwidth of the observer that corrects predictions by the measurements is
        chosen anew (maximum likelihood), and earlier effects may be replaced by others that now explain more.
        If no effect passes, the best one that failed is tried together with a second one, because each of two
        missing effects can hide the other. The search ends at `max_effects` effects or when only noise of
        known size is left (`min_gain`).

        Args:
            current: Fit of the machine with the effects selected so far.
            selected: Effects selected so far.

        Returns:
            Fit of the machine with all effects, and all selected effects with their fitted parameters.

        Raises:
            VoltagesChangeError: If the machine with a selected effect shows that the voltages change more or
                less often between the rows than the predictions assume.
            BudgetEndedError: If the time for the search is used up; `reached` then has what was selected.
        """
        criteria = self._criteria
        current, self.data = with_probable_starts(current, self.data, criteria)
        noise_known = not self.data.has_voltage_errors
        while judge.search_goes_on(current.error, len(selected), criteria, noise_known=noise_known):
            self.reached = current, selected
            found = self._next_effect(current)
            extended = (
                self._next_pair(current, selected) if found is None else self._extended(selected, *found)
            )
            if extended is None:
                break
            best, selected = extended
            self.reached = best, selected
            expect_tests((len(selected) + 1) * self._seconds)  # a fit with the finest step comes before
            # A wide observer follows noise that lasts, which may leave more than held voltages do.
            likely = fit_with_model_error(best, self.data) if noise_known else None
            # Effects beside held voltages that are not held may be false; another number of changes moves
            # them little.
            counts_again = self._counts and (noise_known or may_begin_again())
            counted = likely or best
            if counts_again and (updates := other_updates(counted, self.data, criteria)):
                raise VoltagesChangeError(counted.machine, selected, updates)
            likely = likely or fit_with_model_error(best, self.data)
            moved = likely.bandwidth != best.bandwidth
            current, selected = self._settled(likely, selected, last_too=moved)
            current, self.data = with_probable_starts(current, self.data, criteria)
            note_error(current.chi2)
        for s in selected:
            self.considered.pop(s.effect.label, None)
        return current, tuple(s.with_values(current.machine) for s in selected)

    def start_with(self, current: Fit, known: tuple[SelectedEffect, ...]) -> Selection:
        """Add the effects of an earlier search to a machine, except those that do not pass the tests here.

        The earlier search assumed other voltages between the rows. Each effect must again reduce the error by
        `judge.effect.enough_gain`, beside the others, and pass `judge.effect.doubt_about_candidate`. Another
        effect that explains more replaces it.

        Args:
            current: Fit of the machine without these effects.
            known: Effects in the order in which they were selected.

        Returns:
            Start for `run`: the fit of the machine with the effects that passed, and these effects.
        """
        data = self.data
        while known:
            spend(f"fitting {', '.join(s.effect.label for s in known)} to other voltages between the rows")
            began = seconds_spent()
            complete = fit_with_effects(current, [s.effect for s in known], data)
            again = {s.effect.label: s for s in known}
            for s in sorted(known, key=lambda s: s.gain):
                label = s.effect.label
                reduced: Fit | None = current
                if len(known) > 1:
                    reduced = without_effect(complete, label, data, self._refitted, thorough=False)
                if reduced is None:  # another effect requires it
                    continue
                if not self._passes_again(label, reduced, complete):
                    known = tuple(other for other in known if other is not s)
                    break  # those that passed beside it may fail without it
                gain = (reduced.cost - complete.cost) / data.count
                again[label] = dataclasses.replace(s, gain=gain, machine_without=reduced.machine)
            else:
                selected = tuple(s.with_values(complete.machine) for s in again.values())
                self.reached = complete, selected
                expect_tests(seconds_spent() - began)
                # The last one won against all others, but held voltages are another machine than interpolated
                # ones.
                held_before = [*data.updates_rejected][-1:] == [1]
                likely = fit_with_model_error(complete, data)
                moved = likely.bandwidth != complete.bandwidth
                return self._settled(likely, selected, last_too=held_before or moved)
        return current, ()

    def _passes_again(self, label: str, reduced: Fit, complete: Fit) -> bool:
        """Return whether a machine's effect passes a candidate's tests beside the others, and log it."""
        effect = next(e for e in complete.machine.effects if e.label == label)
        enough = self._enough(reduced)
        self._log(f"  {label} {describe_gain(reduced, complete)}")
        if not is_enough(reduced.error, complete.error, enough):
            self._log(f"  {label} is not selected: a reduction by {enough:.2g} is required")
            return False
        doubt = doubt_about_candidate(TestedFit(reduced, self.data), complete, self._criteria, effect)
        if doubt:
            self._log(f"  {label} is not selected: it {doubt}")
            self.considered[label] = ConsideredEffect(effect, complete.machine, reduced.machine, doubt)
        return not doubt

    def _settled(self, current: Fit, selected: tuple[SelectedEffect, ...], *, last_too: bool) -> Selection:
        """Return the machine at its most likely observer, after others took the place of effects and rivals.

        Args:
            current: Fit of the machine with all effects at this observer.
            last_too: Whether another effect may take the place of the last one as well. It has won against
                all others, but a narrower observer than that of its trial shows more of what is slow.
        """
        current, selected = self._exchange(current, selected, selected if last_too else selected[:-1])
        if judge.is_worth_comparing_rivals(current.error, self._criteria):
            likely, others = self.settle_rivals(current, selected)
            if likely is not current:
                return fit_with_model_error(likely, self.data), others
        return current, selected

    def _extended(self, selected: tuple[SelectedEffect, ...], without: Fit, trials: list[Fit]) -> Selection:
        """Return the first trial fit, and selected effects with its effect and the rivals among others."""
        gain = without.cost - trials[0].cost
        effect = trials[0].machine.effects[-1]
        variance = partial(long_run_variance, trials[0], effect.label, self.data)
        rivals = close_rivals(trials, without, variance, self._criteria)
        new = SelectedEffect(effect, gain / self.data.count, without.machine, rivals)
        return trials[0], (*selected, new)

    def _next_pair(self, current: Fit, selected: tuple[SelectedEffect, ...]) -> Selection | None:
        """Return the machine with two more effects, of which the first passes only beside the second.

        Of two effects with similar forces, the smaller one does not exceed the force that remains
        unexplained, and the parameters of the machine may compensate for the larger one until the smaller one
        is there. None if there is no such pair, or if the error is so small that it may be that of a residue
        without a name.
        """
        data, criteria, doubted = self.data, self._criteria, self._doubted
        if doubted is None or not judge.is_worth_searching_pairs(current.error, len(selected), criteria):
            return None
        trial, extended = self._extended(selected, *doubted[1])
        label = extended[-1].effect.label
        self._log(f"  searching for an effect that hides {label}")
        found = self._next_effect(fit_with_model_error(trial, data))
        if found is None:
            return None
        best, extended = self._extended(extended, *found)
        reduced = without_effect(best, label, data, self._refitted)
        effect, tested = extended[-2].effect, TestedFit(best, data)
        doubt = doubt_beside_others(reduced, tested, effect, criteria) if reduced else ""
        if doubt:
            self._log(f"  {label} is not selected: it {doubt}")
            return None
        return best, extended

    def _next_effect(self, current: Fit) -> Step | None:
        """Return the fit without the next effect, and trial fits with one effect each, that selected first.

        An observer hides slow errors, such as those of a missing constant force. If no effect passes, the
        next narrower one is tried; the effect must then make up for its lower likelihood. If much is left in
        simulation, narrower ones follow, up to the simulation, as long as the model nearly explained the data
        with the one before; the effect must then explain what is left.
        """
        self._doubted, criteria = None, self._criteria
        found = self._passing(current, self._enough(current), structures=True)
        if found is not None or has_narrowest_observer(current, self.data):
            return found
        narrower = narrower_observer(current, self.data)
        enough = self._enough(current) + likelihood_deficit(narrower, current, self.data)
        found = self._passing(narrower, enough)
        if found is not None or self.data.has_voltage_errors:
            return found
        simulated = continue_fit(current, self.data, SIMULATION)
        if not judge.is_worth_narrower_observer(narrower.error, simulated.error, criteria):
            return None
        # What explains most of a simulation shows best with the narrowest observer.
        while not has_narrowest_observer(narrower, self.data) and judge.is_worth_narrower_observer(
            narrower.error, simulated.error, criteria
        ):
            narrower = narrower_observer(narrower, self.data)
        found = self._passing(narrower, required_gain(narrower.error, criteria))
        trials = [continue_fit(found[1][0], self.data, SIMULATION)] if found else []
        return found if judge.explains_alone(simulated.error, best_error(trials), criteria) else None

    def _with_candidates(self, current: Fit, earlier: tuple[SelectedEffect, ...] = ()) -> ScreenedFit:
        """Return a fit with its candidates; with those of effects they may replace, if not known yet."""
        known = self._screened.get(_effects_and_observer(current))
        if known is not None and known.screening.fit is current and known.screening.data is self.data:
            return known
        machines = {
            s.effect.label: machine_without(current.machine, s.effect.label, self._refitted) for s in earlier
        }
        without = {label: machine for label, machine in machines.items() if machine is not None}
        screened = screened_fit(current, self.data, without)
        self._screened[_effects_and_observer(current)] = screened
        return screened

    def _enough(self, fitted: Fit) -> float:
        """Return the reduction of chi-squared per sample for which an effect is selected."""
        return enough_gain(fitted.error, self._criteria, voltages_known=not self.data.has_voltage_errors)

    def _passing(self, current: Fit, enough: float, *, structures: bool = False) -> Step | None:
        """Return a fit, and trial fits with one more effect, first the one that passes all tests, or None."""
        data, criteria = self.data, self._criteria
        screened = self._with_candidates(current) if math.isfinite(current.cost) else None
        trials = trial_fits(current, data, enough, criteria, screened)
        structures = structures and self._worth_structures(current, trials)
        if structures:
            trials += structural_trial_fits(current, trials, data, enough, criteria)
        trials = limited_last(simplest_first(trials, current, criteria), current)
        best = self._best(current, trials, enough)
        if best is None:
            if structures:
                self._structures_failed = (current.bandwidth, _undivided(current.error, data).excess)
            return None
        return current, selected_first(best, trials)

    def _worth_structures(self, current: Fit, trials: list[Fit]) -> bool:
        """Return whether to try effects that replace a part of the model (`judge.is_worth_structures`)."""
        best = best_error(trials)
        definitions = [t.machine.effects[-1].definition for t in trials if t.error == best]
        remembers = any(d.force is not None and d.next_state is not None for d in definitions)
        error, least = _undivided(current.error, self.data), best and _undivided(best, self.data)
        evidence = StructureEvidence(error, least, remembers, *self._structures_failed)
        return judge.is_worth_structures(evidence, self._criteria)

    def _exchange(
        self, current: Fit, selected: tuple[SelectedEffect, ...], earlier: tuple[SelectedEffect, ...]
    ) -> Selection:
        """Replace earlier effects by others that explain the data better beside the later ones (recursively).

        The first effects are selected while others are still missing, and may represent a mixture of causes.
        """
        data, criteria = self.data, self._criteria
        if only_noise_is_left(current.error, criteria):
            return current, selected
        if not earlier:
            return current, selected
        # The next step begins with the same candidates if nothing is replaced.
        screened = self._with_candidates(current, earlier)
        for old in earlier:
            replaced = replacement_fit(current, old.effect.label, screened, self._refitted, criteria)
            if replaced is None:
                continue
            reduced, better = replaced
            enough = is_enough(current.error, better.error, required_gain(current.error, criteria))
            if not enough or doubt_about_candidate(TestedFit(reduced, data), better, criteria):
                continue
            effect = better.machine.effects[-1]
            if self._drawback is not None and (drawback := self._drawback(better)):
                self._log(f"  {effect.label} does not replace {old.effect.label}: it {drawback}")
                continue
            self._log(f"  {effect.label} replaces {old.effect.label}: it {describe_gain(current, better)}")
            total = (reduced.cost - better.cost) / data.count
            # The finest step and all other effects decide between them; this fit has neither.
            known = (
                next(e for e in current.machine.effects if e.label == old.effect.label),
                *old.rival_effects,
            )
            rivals = tuple(e for e in known if e.label != effect.label)
            new = SelectedEffect(effect, total, reduced.machine, rivals)
            others = tuple(s for s in selected if s is not old)
            return self._exchange(fit_with_model_error(better, data), (*others, new), others)
        return current, selected

    def _best(self, current: Fit, trials: list[Fit], enough: float) -> Fit | None:
        """Return the converged fit of the first trial that passes all tests, None if there is none.

        One with a drawback is returned only if no other one passes without, as far as the time reaches.
        """
        converged = cache(partial(self._converged, current))
        doubt = cache(partial(self._doubt, TestedFit(current, self.data)))
        candidates = _Candidates(current, trials, enough, converged, doubt, unexplained=[])
        passed: Fit | None = None
        try:
            for trial in trials:
                if not judge.is_worth_convergence(current.error, trial.error, enough, self._criteria):
                    break
                fitted = self._tested(candidates, trial)
                if fitted is None:
                    continue
                drawback = "" if self._drawback is None else self._drawback(fitted)
                if not drawback:
                    return fitted
                self._log(f"  {fitted.machine.effects[-1].label} waits for others: it {drawback}")
                passed = passed or fitted
        except BudgetEndedError:
            if passed is None:
                raise
        return passed

    def _converged(self, current: Fit, trial: Fit) -> Fit:
        """Return the converged fit of a trial beside the effects of `current`."""
        return converge(trial, self.data, thorough=not nearly_explains(current.error, self._criteria))

    def _doubt(self, without: TestedFit, fitted: Fit) -> str:
        """Return why the last effect of a fit may not exist, or ""."""
        return doubt_about_candidate(without, fitted, self._criteria)

    def _tested(self, candidates: _Candidates, trial: Fit) -> Fit | None:
        """Return the converged fit of a trial if its effect passes all tests, else None."""
        current, enough, began = candidates.current, candidates.enough, seconds_spent()
        fitted = candidates.converged(trial)
        effect, gain = fitted.machine.effects[-1], (current.cost - fitted.cost) / self.data.count
        self._log(f"  {effect.label} {describe_gain(current, fitted)}")
        if not is_enough(current.error, fitted.error, enough):
            self._log(f"  {effect.label} is not selected: a reduction by {enough:.2g} is required")
            return None
        doubt = candidates.doubt(fitted)
        if may_be_no_effect(doubt):
            candidates.unexplained.append(fitted)
        doubt = doubt or self._doubt_beside(candidates.unexplained, current, fitted, enough)
        if not doubt and nearly_explains(current.error, self._criteria):
            doubt = self._doubt_beside(self._doubtful_rivals(candidates, fitted), current, fitted, enough)
        if not doubt:
            self._seconds = seconds_spent() - began
            return fitted
        self._log(f"  {effect.label} is not selected: it {doubt}")
        self.considered[effect.label] = ConsideredEffect(effect, fitted.machine, current.machine, doubt)
        if self._doubted is None or gain > self._doubted[0]:
            self._doubted = gain, (current, selected_first(fitted, candidates.trials))
        return None

    def _doubtful_rivals(self, candidates: _Candidates, fitted: Fit) -> Iterator[Fit]:
        """Yield fits with rivals, not tested yet, that explain at least as much as an effect but may be none.

        Which of two effects that explain the same is tested first depends on trials that have not converged.
        """
        trials, label = selected_first(fitted, candidates.trials), fitted.machine.effects[-1].label
        variance = partial(long_run_variance, fitted, label, self.data)
        rivals = {e.label for e in close_rivals(trials, candidates.current, variance, self._criteria)}
        for trial in trials[1:]:
            if trial.machine.effects[-1].label not in rivals:
                continue
            rival = candidates.converged(trial)
            known = rival in candidates.unexplained or rival.cost > fitted.cost
            if not known and may_be_no_effect(candidates.doubt(rival)):
                yield rival

    def _doubt_beside(self, others: Iterable[Fit], current: Fit, fitted: Fit, enough: float) -> str:
        """Return the doubt that an effect explains what others do, which explain as much, or "".

        Args:
            others: Fits with one other effect each, whose gain chance or unknown voltages may cause.
            current: Fit without any of these effects.
            fitted: Fit with the effect.
            enough: Reduction of chi-squared per sample for which an effect is selected.
        """
        effect = fitted.machine.effects[-1]
        for other in others:
            first = other.machine.effects[-1]
            if other.cost > fitted.cost or first.label == effect.label:
                continue
            both = fit_with_effects(current, [first, effect], self.data)
            own = is_enough(other.error, both.error, enough)
            if not own or doubt_about_candidate(TestedFit(other, self.data), both, self._criteria):
                return hidden_by(first.label)
        return ""

    def with_indistinguishable(
        self, current: Fit, selected: tuple[SelectedEffect, ...]
    ) -> tuple[SelectedEffect, ...]:
        """Add to each selected effect the rivals that these runs may not distinguish from it.

        The trial fits of the search show rivals only among the few best candidates of one step. Here all
        candidates are compared with the effect, to first order, in the machine with all other effects;
        `settle_rivals` then fits those that may replace it. An effect may replace it if chi-squared increases
        by no more than twice what chance causes (`judge.rival.largest_resembling_loss`). For a delay or lag
        in a log slower than its controller, the others are always added (`hidden_rivals`).

        Args:
            current: Fit of the machine with all selected effects.
            selected: These effects, with their rivals.

        Returns:
            The same effects with more rivals.
        """
        # That of the last step, if it only was refined since.
        screened = self._screened.get(_effects_and_observer(current)) or self._with_candidates(current)
        extended = []
        for s in selected:
            known = {s.effect.label, *(e.label for e in (*current.machine.effects, *s.rival_effects))}
            loss = largest_resembling_loss(
                long_run_variance(current, s.effect.label, self.data), self._criteria
            )
            found = [*hidden_rivals(s.effect, self.data)]
            found += indistinguishable(screened, s.effect.label, loss) if math.isfinite(loss) else []
            further = tuple({e.label: e for e in found if e.label not in known}.values())
            if further:
                self._log(f"  {s.effect.label} resembles {', '.join(e.label for e in further)} in these runs")
            extended.append(dataclasses.replace(s, rival_effects=(*s.rival_effects, *further)))
        return tuple(extended)

    def settle_rivals(self, current: Fit, selected: tuple[SelectedEffect, ...]) -> Selection:
        """Compare each selected effect with its rivals again, in a machine with all other selected effects.

        Rivals of an effect explained the data about equally well when it was selected, while effects were
        missing and an observer hid differences. Each rival is now fitted in its place (`compare_rivals`). If
        chance does not explain the difference in likelihood, the most likely rival replaces the effect, and
        the comparison starts again; rivals that are less likely by more than chance are dropped.
        `rivals_in_combination` adds possible rivals.

        Args:
            current: Fit of the machine with all selected effects.
            selected: These effects, with their rivals.

        Returns:
            Fit of the machine with the most likely effects, and these effects with the rivals that remain.
        """
        settled: tuple[SelectedEffect, ...] = ()
        present = {s.effect.label for s in selected}
        for old in selected:
            others = [s.effect for s in selected if s is not old]
            others += [e for s in selected if s is not old for e in s.rival_effects if e.label not in present]
            further = rivals_in_combination(old.effect, old.rival_effects, others, current.machine)
            past = self._compared.get(old.effect.label)
            if past is None or past.fitted is not current or past.data is not self.data:
                past = _Comparison(current, self.data)
            new = [rival for rival in old.rival_effects if rival.label not in past.tried]
            further = tuple(rival for rival in further if rival.label not in past.tried)
            compared = compare_rivals(
                current,
                old.effect.label,
                new,
                self.data,
                self._criteria,
                in_combination=further,
                likely=partial(self._most_likely, current),
            )
            remaining = (*past.remaining, *compared.remaining)
            if compared.better is not None:
                effect = compared.better.machine.effects[-1]
                self._log(
                    f"  {effect.label} replaces {old.effect.label}: it is more likely beside all effects"
                )
                remaining = tuple(rival for rival in remaining if rival.label != effect.label)
                winner = SelectedEffect(effect, old.gain, old.machine_without, remaining)
                return self.settle_rivals(compared.better, (*(s for s in selected if s is not old), winner))
            tried = past.tried | {rival.label for rival in (*new, *further)}
            self._compared[old.effect.label] = _Comparison(current, self.data, tried, remaining)
            settled = (*settled, dataclasses.replace(old, rival_effects=remaining))
        return current, tuple(s.with_values(current.machine) for s in settled)

    def _most_likely(self, current: Fit) -> Fit:
        """Return `most_likely_fit` of a fit, which takes long and is reused; the latest one is kept."""
        if self._likely is None or self._likely[0] is not current or self._likely[1] is not self.data:
            self._likely = current, self.data, most_likely_fit(current, self.data)
        return self._likely[2]

    def polished(self, current: Fit) -> Fit:
        """Fit again with the shortest integration step.

        Args:
            current: Fit of the machine with all selected effects.

        Returns:
            The result of `polish`; at the smallest observer bandwidth that suits the data, the result of
            `most_likely_fit`, which comparing rivals needs as well and which is computed once.
        """
        if has_narrowest_observer(current, self.data):  # then no other fit is compared with it
            return self._most_likely(current)
        return polish(current, self.data)

    def prune(self, current: Fit, selected: tuple[SelectedEffect, ...]) -> Selection:
        """Remove effects that later effects have made superfluous; `considered` lists them.

        Each effect is tested beside all other selected effects (`judge.effect.doubt_beside_others`), the one
        with the smallest gain first. It is kept if nothing speaks against it, or if another effect requires
        it or acts on a coordinate that it adds. After a removal, the others are tested again.

        Args:
            current: Fit of the machine with all selected effects; its observer bandwidth is used throughout.
            selected: All selected effects.

        Returns:
            The fit of the machine with the remaining effects (`current` if all remain), and these effects.
        """
        without: dict[str, Machine] = {}
        tested = TestedFit(current, self.data)
        for candidate in sorted(selected, key=lambda s: s.gain):
            reduced = without_effect(current, candidate.effect.label, self.data, self._refitted)
            if reduced is None:
                continue
            without[candidate.effect.label] = reduced.machine
            doubt = doubt_beside_others(reduced, tested, candidate.effect, self._criteria)
            if doubt:
                self._log(f"  {candidate.effect.label} is removed: it {doubt}")
                self.considered[candidate.effect.label] = ConsideredEffect(
                    candidate.effect, current.machine, reduced.machine, doubt
                )
                # Those that passed beside it may fail without it.
                others = (s for s in selected if s is not candidate)
                return self.prune(reduced, tuple(s.with_values(reduced.machine) for s in others))
        return current, tuple(s.with_values(current.machine, without.get(s.effect.label)) for s in selected)


def _undivided(error: FitError, data: Dataset) -> FitError:
    """Return an error of which all may be a missing effect's, if the share of unknown voltages is unknown."""
    return dataclasses.replace(error, floor=0.0) if data.has_voltage_errors else error


def _effects_and_observer(fitted: Fit) -> tuple[float | str, ...]:
    """Return observer bandwidth, rad/s, and labels of the effects of a fit."""
    return (fitted.bandwidth, *(e.label for e in fitted.machine.effects))
