"""Compare the machine of the search with simpler ones, and deliver none that predicts worse than these.

The simpler machines are the plain fit and the machine as declared. Where no cause is named, effects may still
describe the remaining error of complete runs: those whose names the held-out runs withdrew, and others from a
search that starts from the refitted machine or the plain fit, whichever is better.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np

from ...effects.smooth_table import TABLE_FAMILY
from ...line_log import LineLog
from ...machine import AppliedEffect, Machine
from ...preparation.dataset import Dataset
from ...preparation.runs.excerpt import is_long, representative_part
from ..budget import LAST_STAGE_END, Budget, BudgetEndedError
from ..evidence.held_out import contradicting_held_out_runs
from ..evidence.tried_effects import SelectedEffect, Selection
from ..fit.estimation import Fit, describe_gain, prediction_cost
from ..fit.plain_fit import PlainFit, equally_weighted, refined_equally
from ..judge.criteria import SelectionCriteria
from ..judge.delivery import (
    NO_CLEAR_GAIN,
    description_helps,
    forces_contradict,
    held_out_run_decides,
    is_worse_than,
    needs_description,
)
from ..judge.error import AS_GOOD
from ..predict.prediction import SIMULATION
from ..propose.trial_fits import fit_with_effects
from ..search.forward_selection import EffectSearch
from ..search.outcome import SearchOutcome, without_names
from .evaluation import Evaluated, HeldOutTest, HeldOutTests, Judged, with_certain_effects
from .machine_errors import ModelEvaluation, error_ratio

_MAX_EFFECTS = 2  # Each further one takes longer and removes less.
# In a step: far from the data, as here, linearized gains say little about which effect is the best.
_TRIALS = 8
_BUDGET_PART = (
    0.4  # of the budget of the identification; 0.3 ended before the second effect of a motor was found
)
_LONGEST = 45.0  # s of processor time
_REFINED = (
    "The parameters were fitted again in simulation, because the plain "
    "fit of inertia and friction predicted the held-out runs better."
)
_NO_CAUSES = (
    "The machine that is delivered has {}, with values that were fitted to complete runs, because "
    "the plain fit of inertia and friction predicted the held-out runs better than the values of the search. "
    "They are no causes: with them, the machine lacks {:.3g} % of the drives' force, without them {:.3g} %."
)
_CONTRADICTED = "with values that predict complete runs, more force is missing than without it"
_WORSE_THAN_PLAIN = "predicts the held-out runs worse than a plain fit of inertia and friction"
_PLAIN_DELIVERED = (
    "The machine that is delivered is the plain fit of inertia and friction, "
    "because that of the search has {:.3g} times its error on the held-out runs; terms beside them: {}."
)
_DECLARED_DELIVERED = (
    "The machine that is delivered is the declared one: "
    "fitted to the other runs, it has {:.3g} times its error on the held-out runs. "
    "The runs may differ in what the model takes as constant, such as load or friction."
)
_WORSE_THAN_DECLARED = "predicts the held-out runs worse than the declared machine"
_DESCRIPTION = (
    "The machine that is delivered describes the remaining error by {}. "
    "They are no causes: other effects with similar forces might describe these runs as well. "
    "With them, the error on the held-out runs is {:.3g} times that without."
)
_ONLY_COMPLETE_RUNS = (
    " This holds for complete runs only: with them, the machine lacks {:.3g} % of the drives' force, "
    "without them {:.3g} %. Control with before.json, which has none of them."
)


# Whether the held-out runs confirm a machine with more effects as a description.
Helps = Callable[[Machine], bool]
# Searches for descriptions: fits with effects, and the labels of these.
DescriptionSearch = Callable[[Helps], Iterable[tuple[Fit, tuple[str, ...]]]]


@dataclass(frozen=True)
class PlainResult:
    """The plain fit of inertia and friction, which uses no declared values, with its errors for comparison.

    Attributes:
        evaluation: The machine with its errors on the held-out runs.
        terms: Labels of its terms beside inertia and friction: constant force, weight, input delay.
        delivered: Whether identification delivers this machine, because that of the search predicts worse.
    """

    evaluation: ModelEvaluation
    terms: tuple[str, ...] = ()
    delivered: bool = False


class Delivered(NamedTuple):
    """Result of an identification after the comparison with simpler machines.

    Attributes:
        evaluated: The outcome with its machines.
        plain: Plain fit with its errors, if there is one.
        remarks: A sentence on the machine that replaced the one of the search; empty if none did.
    """

    evaluated: Evaluated
    plain: PlainResult | None
    remarks: tuple[str, ...]


def reserve_time_after_search(
    budget: Budget, tests: HeldOutTests, plain: PlainFit | None, fitted: Dataset, held_out: Dataset
) -> None:
    """Reserve processor time for the evaluations after a search, if a held-out run is long (`is_long`).

    The machines that are known before the search (the declared one and the plain fits) are evaluated, to
    measure how long that takes. After the search, the refitted and the corrected machine are evaluated. The
    starts of the fitted runs, the uncertainty and the report of the delivered machine take as long as one
    evaluation for each run.

    Args:
        budget: Budget of the identification, in which the time is reserved.
        tests: Tests by which machines are compared; they remember these evaluations.
        plain: Plain fit to the fitted runs, if there is one.
        fitted: Runs that are fitted.
        held_out: Held-out runs, prepared.
    """
    session, names = tests.session, [run.name for run in held_out.runs]
    if not any(is_long(run, session.machine) for run in session.recordings if run.name in names):
        return
    test = tests.of(held_out)
    plain_fits = () if plain is None else (*plain.simpler, plain, *plain.extended)
    for machine in (session.machine, *(p.machine for p in plain_fits)):
        test.errors(machine, fitted)
    budget.reserve(test.seconds() * (2.0 + _runs_to_report(test, fitted)))


def _runs_to_report(test: HeldOutTest, fitted: Dataset) -> float:
    """Return how many evaluations take as long as the starts, the uncertainty and the report of a machine."""
    return len(fitted.runs) / len(test.held_out.runs)


def no_worse(
    judgment: Judged, plain: PlainFit | None, log: LineLog, budget: Budget, *, differing: Sequence[str] = ()
) -> Delivered:
    """Compare the machine of a search with simpler ones, and deliver none that predicts worse than these.

    A machine is worse than the plain fit or the declared machine if its simulation error on the held-out runs
    is (`judge.delivery.is_worse_than`), unless an unstable motion explains this error. One with effects is
    first fitted again in simulation. If a simpler machine replaces one with effects, no effect is named for
    this reason. If no cause is named, a machine with effects that describe the remaining error may replace
    one without (`best_description`). Held-out runs that contradict all of these machines do not count.

    Args:
        judgment: Outcome of a search after the tests on the held-out runs.
        plain: Plain fit to the fitted runs, if there is one.
        log: Called with a line of text for each decision.
        budget: Budget of the identification, of which a description may use a part.
        differing: Names of the held-out runs that contradict the fitted ones.

    Returns:
        The outcome with the machine to deliver (`evaluated.after`), the plain fit with its errors, and a
        sentence if another machine than that of the search is delivered.
    """
    evaluated = judgment.evaluated
    against_all = _runs_against_all(evaluated, plain, differing)
    if not against_all:
        return _chosen(judgment, plain, log, budget)
    names = [run.name for run in evaluated.held_out.runs if run.name not in against_all]
    if not names:
        known = None if plain is None else PlainResult(_plain_errors(plain, evaluated), plain.terms)
        return Delivered(evaluated, known, ())
    return _over_all_runs(_chosen(_over_runs(judgment, names), plain, log, budget), evaluated.test)


def _chosen(judgment: Judged, plain: PlainFit | None, log: LineLog, budget: Budget) -> Delivered:
    """Return the machine that predicts the runs of a judgment best, as `no_worse` says."""
    evaluated = judgment.evaluated
    result, delivered, sentence = None, evaluated, ""
    if plain is not None:
        result, delivered, sentence = _compared(judgment, plain, log, budget)
    elif (described := best_description(judgment, evaluated.before, None, log)) is not None:
        delivered, sentence = described
    if _is_worse(delivered.after, evaluated.declared, delivered.test, delivered.outcome.data):
        sentence = _DECLARED_DELIVERED.format(error_ratio(delivered.after, evaluated.declared))
        log(sentence)
        result = result and dataclasses.replace(result, delivered=False)
        delivered = _instead(evaluated, _declared(evaluated), _WORSE_THAN_DECLARED)
    if evaluated.outcome.selected and not delivered.outcome.selected:
        clause = sentence.removesuffix(".")
        return Delivered(delivered._replace(reason=clause), result, ())
    remarks = (sentence,) if sentence else ()
    return Delivered(delivered._replace(reason=evaluated.reason), result, remarks)


def _runs_against_all(evaluated: Evaluated, plain: PlainFit | None, differing: Sequence[str]) -> set[str]:
    """Return the held-out runs that do not choose between machines, because they contradict all of them.

    Args:
        evaluated: Outcome of the search with its machines.
        plain: Plain fit to the fitted runs, if there is one.
        differing: Names of the held-out runs that contradict the fitted ones.
    """
    if not differing:
        return set()
    outcome, held_out = evaluated.outcome, evaluated.held_out

    def contradicted(model: ModelEvaluation) -> set[str]:
        simpler = dataclasses.replace(outcome.after, machine=model.machine)
        return {*contradicting_held_out_runs(simpler, model.machine, (), held_out)}

    simpler = [evaluated.declared] if plain is None else [evaluated.declared, _plain_errors(plain, evaluated)]
    by_all = {*differing}.intersection(*map(contradicted, simpler))
    explained = outcome.explained if outcome.selected else outcome.before_explains
    return {name for name in by_all if not held_out_run_decides(explained, contradicts_all=True)}


def _over_runs(judgment: Judged, names: Sequence[str]) -> Judged:
    """Return a judgment with the errors over some of its held-out runs only."""

    def over(evaluated: Evaluated) -> Evaluated:
        part = evaluated.test.with_runs(names)
        return part.evaluate(evaluated.outcome)._replace(reason=evaluated.reason)

    withdrawn = judgment.withdrawn
    return Judged(over(judgment.evaluated), None if withdrawn is None else over(withdrawn))


def _over_all_runs(delivered: Delivered, test: HeldOutTest) -> Delivered:
    """Return what is delivered with its errors over all held-out runs, some of which did not choose it."""
    evaluated, plain = delivered.evaluated, delivered.plain
    if plain is not None:
        errors = test.errors(plain.evaluation.machine, evaluated.outcome.data)
        plain = dataclasses.replace(plain, evaluation=errors)
    evaluated = test.evaluate(evaluated.outcome)._replace(reason=evaluated.reason)
    return delivered._replace(evaluated=evaluated, plain=plain)


def _compared(
    judgment: Judged, plain: PlainFit, log: LineLog, budget: Budget
) -> tuple[PlainResult, Evaluated, str]:
    """Return the plain fit with its errors, the delivered outcome, and what replaced the search's machine."""
    evaluated = judgment.evaluated
    outcome, test = evaluated.outcome, evaluated.test
    has_belts = bool(test.session.machine.belts)
    further = None if has_belts else partial(_further_descriptions, plain, evaluated, log, budget)
    plain, reference = confirmed(plain, evaluated)
    result = PlainResult(reference, plain.terms)
    log(f"plain fit: {reference.held_out.noise_ratio:.4g} times the noise on the held-out runs")
    if not has_belts:
        budget.reserve(
            test.seconds() * (1.0 + _runs_to_report(test, outcome.data))
        )  # a description, the report
    base = reference if _is_worse(evaluated.before, reference, test, outcome.data) else evaluated.before
    if (described := best_description(judgment, base, further, log)) is not None:
        return result, *described
    ratio = error_ratio(evaluated.after, reference)
    if ratio > 1.0 and test.explains_unstable_motion(evaluated.after, outcome.data):
        return result, evaluated, ""
    if outcome.selected and ratio > 1.0:  # their parameters were fitted to short predictions
        with budget.limiting(LAST_STAGE_END, delivers=True):
            after = refined_equally(outcome.after, outcome.data)
        selected = tuple(s.with_values(after.machine) for s in outcome.selected)
        found = outcome._replace(after=after, selected=selected)
        again = test.evaluate(with_certain_effects(found, test.criteria, log))
        if error_ratio(again.after, reference) < ratio and not _simulates_worse(again.after, reference, test):
            lacking, without = again.after.held_out.lacking, evaluated.before.held_out.lacking
            if lacking is None or without is None or not forces_contradict(lacking, without):
                return result, again, _REFINED
            labels = ", ".join(s.effect.label for s in outcome.selected)
            sentence = _NO_CAUSES.format(labels, 100.0 * lacking, 100.0 * without)
            log(sentence)
            return result, _instead(evaluated, after, _CONTRADICTED), sentence
    if not _simulates_worse(evaluated.after, reference, test):
        return result, evaluated, ""
    sentence = _PLAIN_DELIVERED.format(
        error_ratio(evaluated.after, reference), ", ".join(plain.terms) or "none"
    )
    log(sentence)
    delivered = _instead(evaluated, plain.simulated, _WORSE_THAN_PLAIN)
    return dataclasses.replace(result, delivered=True), delivered, sentence


def confirmed(plain: PlainFit, evaluated: Evaluated) -> tuple[PlainFit, ModelEvaluation]:
    """Choose the terms of a plain fit by the simulation error of the held-out runs.

    Args:
        plain: Plain fit to the fitted runs.
        evaluated: Outcome of a search, with the tests on the held-out runs.

    Returns:
        The plain fit with the chosen terms, and its errors. Terms that the fitted runs determine are left out
        if the error is smaller without them; uncertain terms are added if it is worse without them
        (`judge.delivery.is_worse_than`).
    """
    best, reference = plain, _plain_errors(plain, evaluated)
    for simpler in reversed(plain.simpler):
        found = _plain_errors(simpler, evaluated)
        if error_ratio(found, reference) < 1.0:
            best, reference = simpler, found
    for extended in plain.extended:
        found = _plain_errors(extended, evaluated)
        if _simulates_worse(reference, found, evaluated.test):
            best, reference = extended, found
    return best, reference


def start_of_description(plain: PlainFit, evaluated: Evaluated) -> PlainFit:
    """Return the plain fit with only those terms that clearly improve the simulation of the held-out runs.

    The fits of `plain` with fewer, its own and more terms (a constant force, a weight, a delay) are compared
    in this order. One takes the place of the best one before if it reduces the squared error by more than a
    factor of 1.2 (`judge.delivery.description_helps`). A term that hardly helps may be false, and would hide
    a part of what the description, whose search begins from this fit, should find: a constant force that of
    a spring.

    Args:
        plain: Plain fit to the fitted runs.
        evaluated: Outcome of a search; its test simulates the held-out runs.
    """
    fewest_first = (*plain.simpler, plain, *plain.extended)
    best = fewest_first[0]
    for other in fewest_first[1:]:
        ratio = error_ratio(_plain_errors(other, evaluated), _plain_errors(best, evaluated))
        if description_helps(ratio):
            best = other
    return best


def _plain_errors(plain: PlainFit, evaluated: Evaluated) -> ModelEvaluation:
    """Return a plain fit with its errors on the held-out runs."""
    name = f"{evaluated.test.session.machine.name}-plain"
    return evaluated.test.errors(plain.machine.replace(name=name), evaluated.outcome.data)


def _is_worse(model: ModelEvaluation, reference: ModelEvaluation, test: HeldOutTest, fitted: Dataset) -> bool:
    """Return whether a machine predicts the held-out runs worse than a reference."""
    return _simulates_worse(model, reference, test) and not test.explains_unstable_motion(model, fitted)


def _simulates_worse(model: ModelEvaluation, reference: ModelEvaluation, test: HeldOutTest) -> bool:
    """Return whether a machine simulates the held-out runs worse than a reference.

    Errors of rounded stamps add up along a run: which of two machines that they explain errs less is chance.
    """
    worse = is_worse_than(error_ratio(model, reference), model.held_out.noise_ratio, test.criteria)
    return worse and not test.rounded_stamps_explain(model)


def _instead(evaluated: Evaluated, fitted: Fit, reason: str) -> Evaluated:
    """Return the outcome with another machine instead of that of the search, without names."""
    outcome = evaluated.outcome
    if outcome.selected:
        outcome = without_names(outcome, reason)._replace(verdict="unexplained")
    return evaluated.test.evaluate(outcome._replace(after=fitted))


def _declared(evaluated: Evaluated) -> Fit:
    """Return the declared machine as a fit without free parameters."""
    machine, data = evaluated.test.session.machine, evaluated.outcome.data
    cost = prediction_cost(machine, data, SIMULATION)
    return Fit(machine, (), np.zeros(0), cost, data.count, SIMULATION, np.zeros((0, 0)))


class Description(NamedTuple):
    """Outcome whose machine has effects that describe the remaining error, without naming causes."""

    evaluated: Evaluated
    sentence: str


def best_description(
    judgment: Judged, base: ModelEvaluation, further: DescriptionSearch | None, log: LineLog
) -> Description | None:
    """Return the description of the remaining error that predicts the held-out runs best.

    A description consists of effects that are no named causes. Those whose names were withdrawn are tried
    first; if they do not help or leave more than twice the noise, those of `further`. Each must be clearly
    better than the best machine so far (`judge.delivery.description_helps`).

    Args:
        judgment: Outcome of a search with its machines.
        base: Machine without a description.
        further: Search for other descriptions. None: no search.
        log: Called with a line of text for each description.

    Returns:
        The best description; None if effects are named, only noise is left, or no description helps.
    """
    evaluated, withdrawn = judgment
    outcome, test = evaluated.outcome, evaluated.test

    def needed(model: ModelEvaluation) -> bool:
        left = model.held_out.noise_ratio
        return needs_description(outcome.verdict, len(outcome.selected), left, test.criteria)

    if not needed(evaluated.after):
        return None
    best = None
    if withdrawn is not None:
        labels = tuple(s.effect.label for s in withdrawn.outcome.selected)
        best = _better_description(best, withdrawn.outcome.after, labels, evaluated, base, log)
    if further is None or (best is not None and not needed(best.evaluated.after)):
        return best

    def helps(machine: Machine) -> bool:
        without_it = best.evaluated.after if best else base
        return _helps(test.errors(machine, outcome.data), without_it, evaluated)

    for fitted, labels in further(helps):
        best = _better_description(best, fitted, labels, evaluated, base, log)
    return best


def _further_descriptions(
    plain: PlainFit, evaluated: Evaluated, log: LineLog, budget: Budget, helps: Helps
) -> Iterator[tuple[Fit, tuple[str, ...]]]:
    """Search for effects that describe what is left beside inertia and friction."""
    start = fit_to_describe(plain, evaluated, budget)
    part = representative_part(evaluated.outcome.data, start.machine)
    known = effects_of_search(evaluated.outcome)
    yield from descriptions(start, part, evaluated.test.criteria, log, budget, helps, known)


def effects_of_search(outcome: SearchOutcome) -> tuple[AppliedEffect, ...]:
    """Return the effects that a search fitted but does not name, with the values that it found for them.

    Effects that add coordinates and tables are left out: their fits begin from the declared machine.

    Args:
        outcome: Outcome of a search.
    """
    known = {e.label for e in outcome.before.machine.effects}
    found: dict[str, AppliedEffect] = {}
    for considered in outcome.considered:
        for effect in considered.machine.effects:
            definition = effect.definition
            if not definition.structure and definition.family != TABLE_FAMILY and effect.label not in known:
                found.setdefault(effect.label, effect)
    return tuple(found.values())


def fit_to_describe(plain: PlainFit, evaluated: Evaluated, budget: Budget) -> Fit:
    """Return the fit from which a search for a description starts.

    Args:
        plain: Plain fit to the fitted runs.
        evaluated: Outcome of a search, with the tests on the held-out runs.
        budget: Budget of the identification, in which the refitted machine is fitted in simulation.

    Returns:
        The plain fit (`start_of_description`) or the refitted machine, whichever has the smaller simulation
        cost in the fitted runs.
    """
    outcome, terms = evaluated.outcome, start_of_description(plain, evaluated)
    with budget.limiting(LAST_STAGE_END, delivers=True):
        refit = refined_equally(outcome.before, outcome.data)
    equal = equally_weighted(outcome.data)
    return min(
        (terms.simulated, refit), key=lambda fitted: prediction_cost(fitted.machine, equal, SIMULATION)
    )


def _better_description(
    best: Description | None,
    fitted: Fit,
    labels: Sequence[str],
    evaluated: Evaluated,
    base: ModelEvaluation,
    log: LineLog,
) -> Description | None:
    """Return a machine with effects as a description if it is clearly better than the best, else that."""
    again = evaluated.test.evaluate(evaluated.outcome._replace(after=fitted))
    ratio, without_it = error_ratio(again.after, base), best.evaluated.after if best else base
    helps = _helps(again.after, without_it, evaluated)
    log(description_line(labels, ratio, helps=helps))
    if not helps:
        return best
    lacking, without = again.after.held_out.lacking, evaluated.before.held_out.lacking
    return Description(again, description_sentence(labels, ratio, lacking, without))


def _helps(model: ModelEvaluation, without_it: ModelEvaluation, evaluated: Evaluated) -> bool:
    """Return whether a machine with a description predicts the held-out runs clearly better than another."""
    ratio = error_ratio(model, without_it)
    if not description_helps(ratio):
        return False
    predicted = _predicted_ratio(model, without_it, evaluated)
    return predicted is None or description_helps(ratio, predicted)


def _predicted_ratio(
    model: ModelEvaluation, reference: ModelEvaluation, evaluated: Evaluated
) -> float | None:
    """Return the ratio of predictions' squared errors if the motion of a reference is unstable, else None."""
    test, fitted = evaluated.test, evaluated.outcome.data
    if test.unstable_motion(reference, fitted) is None:
        return None
    errors, others = (test.predictions(m, fitted) for m in (model, reference))
    return float(np.nanmean(errors) / np.nanmean(others))


def description_line(labels: Sequence[str], ratio: float, *, helps: bool) -> str:
    """Write a line of the log: whether effects describe the remaining error, and what it is with them.

    Args:
        labels: Labels (name@site) of the effects.
        ratio: Ratio of the simulation errors on the held-out runs with / without the effects, dimensionless.
        helps: Whether the machine with the effects is kept.
    """
    error = f"{ratio:.3g} times the error on the held-out runs"
    effects = ", ".join(labels)
    return f"described by {effects}: {error}" if helps else f"  no description by {effects}: {error}"


def description_sentence(
    labels: Sequence[str], ratio: float, lacking: float | None, without: float | None
) -> str:
    """Write sentences for the report: which effects describe the remaining error, and how well.

    They add that this holds for complete runs only, if the machine with the effects lacks more than 1.2 times
    the force that is missing without them (`judge.delivery.forces_contradict`).

    Args:
        labels: Labels (name@site) of the effects.
        ratio: Ratio of the simulation errors on the held-out runs with / without the effects, dimensionless.
        lacking: Missing force of the machine with the effects, as a fraction of the force of the drives, rms;
            None if unknown.
        without: Missing force of the refitted machine, as the same fraction; None if unknown.
    """
    sentence = _DESCRIPTION.format(", ".join(labels), ratio)
    if lacking is None or without is None or not forces_contradict(lacking, without):
        return sentence
    return sentence + _ONLY_COMPLETE_RUNS.format(100.0 * lacking, 100.0 * without)


def descriptions(
    start: Fit,
    data: Dataset,
    criteria: SelectionCriteria,
    log: LineLog,
    budget: Budget,
    helps: Helps,
    known: Sequence[AppliedEffect] = (),
) -> Iterator[tuple[Fit, tuple[str, ...]]]:
    """Search for a description: add, one by one, the effects that reduce the simulation error most.

    The held-out runs must confirm each effect. One that they do not confirm is tried again after all others,
    because it may describe something that only the fitted runs contain.

    Far from the data, linearized gains overlook effects, and fits from typical values end elsewhere. The
    first effect may therefore also be one of the search, from the values that it has there.

    Args:
        start: Fit in simulation, for example a plain fit.
        data: Runs to fit.
        criteria: Decision thresholds, of which the tests of single effects are used.
        log: Called with a line of text at each stage.
        budget: Budget of the identification, of which the searches may use at most 40 % and 45 s.
        helps: Function of a machine with one more effect that returns whether the held-out runs confirm it.
        known: Effects with the values that short predictions gave them. Default: none.

    Yields:
        Fit with one more effect in simulation, and the labels of all; nothing if no effect passes the tests,
        or after the budget.
    """
    if not budget.has_time(LAST_STAGE_END):
        return
    stage = budget.until(LAST_STAGE_END, min(_BUDGET_PART * budget.seconds, _LONGEST))
    log("describing the remaining error of complete runs")
    equal = equally_weighted(data)
    cost = prediction_cost(start.machine, equal, SIMULATION)
    begin = current = dataclasses.replace(start, bandwidth=SIMULATION, cost=cost, count=equal.count)
    selected: tuple[SelectedEffect, ...] = ()

    def drawback(fitted: Fit) -> str:
        return "" if helps(fitted.machine) else NO_CLEAR_GAIN

    for count in range(1, _MAX_EFFECTS + 1):
        # A description names no cause: an effect may well correct an error in the form of another one.
        effort = dataclasses.replace(criteria, max_effects=count, max_full_fits=_TRIALS, max_form_error=0.0)
        # A cause might ask for other voltages between the rows; a description does not.
        search = EffectSearch(equal, start.machine, effort, log, drawback, counts=False)
        try:
            with stage.limiting():
                current, found = search.run(current, selected)
        except BudgetEndedError:
            current, found = search.reached or (current, selected)
        if not selected:
            with suppress(BudgetEndedError), stage.limiting():
                for effect in known:
                    current, found = _or_known((current, found), begin, effect, equal, helps, log)
        if len(found) == len(selected):
            return
        selected, equal = found, search.data
        with budget.limiting(LAST_STAGE_END, delivers=True):
            refined = refined_equally(current, equal)
        yield refined, tuple(s.effect.label for s in selected)


def _or_known(
    found: Selection, start: Fit, effect: AppliedEffect, data: Dataset, helps: Helps, log: LineLog
) -> Selection:
    """Return the first effect of a description, or a known effect if that leaves less or alone is confirmed.

    The same effect with other values must leave less: a worse fit of it is no other description.

    Args:
        found: Fit with the first effect; `start` without one.
        start: Fit in simulation, without the effect.
        effect: The known effect, from whose values the fit begins.
    """
    try:
        trial = fit_with_effects(start, [effect], data)
    except ValueError:  # the machine lacks what the effect needs, or has it already
        return found
    log(f"  {effect.label} of the search {describe_gain(start, trial)}")
    best, selected = found
    leaves_less = AS_GOOD * trial.cost < best.cost
    is_another = effect.label not in (s.effect.label for s in selected)
    alone = is_another and trial.cost < start.cost and not (selected and helps(best.machine))
    if not ((leaves_less or alone) and helps(trial.machine)):
        return found
    gain = (start.cost - trial.cost) / data.count
    return trial, (SelectedEffect(trial.machine.effects[-1], gain, start.machine),)
