"""Identification from recordings to a verdict: prepare, refit, select effects, evaluate on held-out runs."""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..distributed import single_threaded_linear_algebra
from ..errors import InputError, merge_run_warnings
from ..machine import Machine
from ..preparation.dataset import (
    Dataset,
    clean_recording,
    prepare,
    require_motion,
    require_rows,
    with_all_measurements,
    with_known_positions,
)
from ..preparation.sensor_properties import Range, blank_saturated, range_effects, saturation_ranges
from ..recordings import Recording
from ..registry import load_plugins
from .budget import Budget, default_budget
from .evidence.held_out import (
    contradicting_held_out_runs,
    error_reduction,
    held_out_gain,
    hold_out,
    is_excited,
    worsens_simulation,
)
from .evidence.tried_effects import ConsideredEffect, Log, SelectedEffect
from .fit.covariance import with_uncertainty
from .fit.estimation import Fit, prediction_cost
from .fit.force_sizes import drive_force, effect_force
from .fit.lost_voltages import with_lost_voltages
from .fit.plain_fit import PlainFit, better_start, plain_fit, refined_equally
from .fit.residual import Dependence, errors_by_channel, white_sensors
from .fit.run_differences import describe_run_differences
from .fit.start_estimation import refine_dataset
from .judge.criteria import SelectionCriteria
from .judge.held_out import HeldOutEffect, refuted_effects
from .judge.run import exchanges_held_out
from .judge.verdict import (
    JUDGING_BANDWIDTH,
    Evidence,
    contradiction_of_names,
    contradiction_of_no_effect,
    remaining,
    verdict_after_removal,
)
from .predict.prediction import POLISH_STEP
from .propose.dependences import are_causes, rank_dependences
from .propose.trial_fits import without_effect
from .report.experiment_design import design_discriminating_experiment
from .report.recording_simulation import ModelEvaluation, PredictionErrors, error_ratio, evaluate_held_out
from .report.result import Hint, IdentificationResult, PlainResult, RejectedEffect, Unfinished
from .search.input_timing import with_input_timing
from .search.search_effects import SearchOutcome, search_effects

_CONTRADICTION = (
    "{} is not used: the other runs agree with one machine to within their noise, and no effect explains why this run "
    "differs. Check its voltages, gains and sensors."
)
_HELD_OUT_CONTRADICTION = (
    "{} was held out and contradicts the fitted runs: either something was wrong with it (check its voltages, gains "
    "and sensors), or it shows what the fitted runs do not excite (hold out another run with --hold-out). The "
    "errors on held-out runs include it."
)
_HINT = (
    "If the held-out runs are fitted as well, {} would explain all runs, but no other run confirms it. Record another "
    "run such as {} and identify again."
)
_UNEXCITED = (
    "The held-out runs do not excite {}: the gain on them says nothing, and only the fitted runs confirm it. Hold out "
    "other runs with --hold-out for an independent test."
)
_AS_GOOD_AS_PLAIN = 1.01  # ratio of errors on the held-out runs; smaller differences are chance
_REFINED = (
    "The parameters were fitted again in simulation, because the plain fit of inertia and friction predicted the "
    "held-out runs better."
)
_WORSE_THAN_PLAIN = "predicts the held-out runs worse than a plain fit of inertia and friction"
_PLAIN_DELIVERED = (
    "The machine that is delivered is the plain fit of inertia and friction, because that of the search has {:.3g} "
    "times its error on the held-out runs; terms beside them: {}."
)
_MAX_NEAREST = 3  # Effects that a hint lists as the nearest of the library.
_MAX_DEPENDENCES = 6  # Variables that the report lists for the residual force.


@single_threaded_linear_algebra()  # the result depends on no number of threads
def identify(
    recordings: Sequence[Recording],
    machine: Machine,
    *,
    held_out: Sequence[str] = (),
    criteria: SelectionCriteria | None = None,
    log: Log | None = None,
    budget: float | Budget | None = None,
) -> IdentificationResult:
    """Identify the effects (deviations such as friction curves or backlash) that a machine's model lacks.

    The machine's parameters are fitted to the recordings; then effects are selected that reduce the remaining error.
    Three machines (declared, refitted, with effects) are simulated over the held-out runs, to which nothing was fitted.

    Args:
        recordings: Runs of one rig (times, s; voltages, V; measurements, m or rad), at least two.
        machine: Machine as declared.
        held_out: Names of the runs to evaluate on. Default: one of each four similar runs, see `hold_out`.
        criteria: Decision thresholds. Default: `SelectionCriteria()`.
        log: Called with a line of text after each part of the work. Default: nothing is reported.
        budget: Processor time that the identification may take, s (all threads together). When most of it is used up,
            the search ends, what it found is tested and evaluated as usual, and `unfinished` of the result says what it
            was doing; the refit is always completed. The result depends on the budget only then. 0: refit only;
            `math.inf`: no limit. Default: a minute per core, more for long sessions (`budget.default_budget`).

    Returns:
        Verdict ("effect_found", "no_effect", or "unexplained" if an error remains that no effect explains), the three
        machines with their errors on the held-out runs, and the selected effects.

    Raises:
        InputError: If the runs cannot be divided into fitted and held-out ones, a held-out name is unknown, a run has
            fewer than 20 rows, no sensor moves in the fitted runs, or `recordings` is a path.
    """
    began = time.perf_counter()
    if isinstance(recordings, str | Path):
        raise InputError(f"identify needs recordings, not a path; call load_recordings({str(recordings)!r}, machine)")
    load_plugins()  # the search tries their effects as well
    criteria = criteria or SelectionCriteria()
    log = log or (lambda line: None)
    recordings = sorted(recordings, key=lambda recording: recording.name)  # the result depends on no other order
    require_rows(recordings)
    held_names = hold_out(recordings, held_out)
    require_motion([recording for recording in recordings if recording.name not in held_names])
    if not isinstance(budget, Budget):
        budget = Budget(default_budget(recordings, machine) if budget is None else budget)
    if math.isfinite(budget.seconds):
        rows = sum(len(recording.time_s) for recording in recordings)
        log(f"{len(recordings)} runs, {rows} rows: at most about {budget.seconds:.0f} s of processor time")
    cleaned = [clean_recording(recording, machine, log) for recording in recordings]
    all_runs, ranges = _prepare(cleaned, machine, criteria, log)
    search = partial(_search, machine, all_runs, criteria=criteria, log=log, budget=budget)
    checked = search(held_names)
    complete = not checked.outcome.selected and not held_out and not checked.outcome.unfinished
    hint = _effects_of_differing_runs(checked, search, log) if complete else ()
    agreeing = checked.held_out.with_runs([r.name for r in checked.held_out.runs if r.name not in checked.differing])
    outcome = with_input_timing(_without_unconfirmed(checked.outcome, agreeing, log), agreeing, criteria, log)
    messages: tuple[str, ...] = (_CONTRADICTION.format(outcome.contradiction),) if outcome.contradiction else ()
    messages += (*map(_HELD_OUT_CONTRADICTION.format, checked.differing), *hint)
    evaluated = _evaluated(
        outcome, machine, ranges, with_all_measurements(checked.held_out, cleaned), recordings, criteria
    )
    reason = _contradiction(evaluated, checked.differing, criteria)
    if reason and outcome.selected:
        for s in outcome.selected:
            log(f"  {s.effect.label} is not named: {reason}")
        outcome = _without_names(outcome, reason)
        evaluated = _evaluated(outcome, machine, ranges, evaluated.validation, recordings, criteria)
        reason = _contradiction(evaluated, checked.differing, criteria) or reason
    plain, evaluated, delivered = _at_least_plain(evaluated, checked.plain, machine, ranges, recordings, criteria, log)
    if outcome.selected and not evaluated.outcome.selected:
        reason = delivered
    messages += (delivered,) if delivered and delivered != reason else ()
    outcome = evaluated.outcome
    if reason:
        outcome = outcome._replace(verdict="unexplained")
    if messages or outcome.verdict == "unexplained":
        messages += describe_run_differences(outcome.after, _comparable_runs(checked, all_runs), criteria)
    result = _result(evaluated._replace(outcome=outcome), criteria)
    unfinished = Unfinished(outcome.unfinished, budget.reason, budget.interrupted) if outcome.unfinished else None
    result = dataclasses.replace(result, reason=reason, hint=_hint(result), unfinished=unfinished, plain=plain)
    messages += _unexcited(result, outcome.after.bandwidth)
    log(f"verdict: {result.verdict}")
    for s in (s for s in result.effects if s.rivals):
        log(f"these runs cannot distinguish {s.effect.label} from {', '.join(s.rivals)}")
    result = dataclasses.replace(result, contradicting=checked.differing, excluded=(*messages, *checked.messages))
    return dataclasses.replace(result, seconds=time.perf_counter() - began)


class _CheckedOutcome(NamedTuple):
    """Outcome of a search in the fitted runs, and what the held-out runs say about it.

    Attributes:
        outcome: Outcome of the search.
        held_out: Runs that were not fitted.
        differing: Names of those that contradict the machine which explains the fitted runs.
        messages: What the user should know about the division of the runs, one sentence each.
        plain: Plain fit to the fitted runs, if there is one.
    """

    outcome: SearchOutcome
    held_out: Dataset
    differing: tuple[str, ...]
    messages: tuple[str, ...]
    plain: PlainFit | None = None


def _search(
    machine: Machine,
    all_runs: Dataset,
    held_names: Sequence[str],
    *,
    criteria: SelectionCriteria,
    log: Log,
    budget: Budget,
) -> _CheckedOutcome:
    """Search for effects in the runs that are not held out, and compare the result with those that are."""
    fitted_names = [run.name for run in all_runs.runs if run.name not in held_names]
    held_out, excluded = with_known_positions(all_runs.with_runs(held_names))
    data, unused = with_known_positions(all_runs.with_runs(fitted_names))
    names = ", ".join(run.name for run in held_out.runs)
    log(f"fitting {machine.name} to {len(data.runs)} runs, {len(held_out.runs)} held out ({names})")
    data, held_out = with_lost_voltages(machine, data, held_out, log)
    plain = plain_fit(machine, data)
    machine = _start(machine, data, plain, log)

    def confirmed(outcome: SearchOutcome) -> bool:
        differing = _contradicting_held_out_runs(outcome, held_out)
        if differing:
            log(f"{', '.join(differing)} contradicts these runs as well; searching in all fitted runs")
        return not differing

    outcome = search_effects(machine, data, criteria, log, confirmed=confirmed, budget=budget)
    differing = _contradicting_held_out_runs(outcome, held_out)
    return _CheckedOutcome(outcome, held_out, differing, (*unused, *excluded), plain)


def _start(machine: Machine, data: Dataset, plain: PlainFit | None, log: Log) -> Machine:
    """Return the machine from which the refit starts: as declared, or with inertia and friction of the plain fit."""
    start = better_start(machine, data, plain)
    if start is not machine:
        values, declared = start.parameters, machine.parameters
        changed = ", ".join(f"{n} {v / declared[n]:.2g}" for n, v in values.items() if declared.get(n) not in (0.0, v))
        log(f"the fit starts from values that follow from the motion; times the declared ones: {changed}")
    return start


def _at_least_plain(
    evaluated: _Evaluated,
    plain: PlainFit | None,
    machine: Machine,
    ranges: dict[str, Range],
    recordings: Sequence[Recording],
    criteria: SelectionCriteria,
    log: Log,
) -> tuple[PlainResult | None, _Evaluated, str]:
    """Compare the outcome with the plain fit on the held-out runs, and deliver no machine that predicts them worse.

    Returns:
        The plain fit with its errors, the outcome that is delivered, and a sentence about what replaced the machine of
        the search; "" if that predicts the held-out runs at least as well.
    """
    if plain is None:
        return None, evaluated, ""
    outcome, validation = evaluated.outcome, evaluated.validation

    def errors_of(candidate: Machine) -> ModelEvaluation:
        return evaluate_held_out(candidate, outcome.data, validation, recordings, criteria)

    reference = errors_of(plain.machine.replace(name=f"{machine.name}-plain"))
    result = PlainResult(reference, plain.terms)
    log(f"plain fit: {reference.held_out.noise_ratio:.4g} times the noise on the held-out runs")
    if not error_ratio(evaluated.after, reference) > _AS_GOOD_AS_PLAIN:
        return result, evaluated, ""
    if outcome.selected:  # their parameters were fitted to short predictions
        after = refined_equally(outcome.after, outcome.data)
        selected = tuple(s.with_values(after.machine) for s in outcome.selected)
        refined = outcome._replace(after=after, selected=selected)
        again = _evaluated(refined, machine, ranges, validation, recordings, criteria)
        if error_ratio(again.after, reference) <= _AS_GOOD_AS_PLAIN:
            return result, again, _REFINED
    sentence = _PLAIN_DELIVERED.format(error_ratio(evaluated.after, reference), ", ".join(plain.terms) or "none")
    log(sentence)
    outcome = _without_names(outcome, _WORSE_THAN_PLAIN) if outcome.selected else outcome
    outcome = outcome._replace(before=plain.simulated, after=plain.simulated)
    delivered = _evaluated(outcome, machine, ranges, validation, recordings, criteria)
    return dataclasses.replace(result, delivered=True), delivered, sentence


def _comparable_runs(checked: _CheckedOutcome, all_runs: Dataset) -> Dataset:
    """Return the fitted, the held-out and the contradictory runs; with estimated voltages, where rows were dropped."""
    used = {run.name: run for run in (*checked.outcome.data.runs, *checked.held_out.runs)}
    names = [*used, checked.outcome.contradiction]
    return dataclasses.replace(all_runs, runs=tuple(used.get(r.name, r) for r in all_runs.runs if r.name in names))


def _effects_of_differing_runs(
    checked: _CheckedOutcome, search: Callable[[Sequence[str]], _CheckedOutcome], log: Log
) -> tuple[str, ...]:
    """Return a hint if every held-out run contradicts the fitted ones, and effects would explain all runs together.

    Either something was wrong with the held-out runs, or only they excite an effect. The effects are searched for with
    these runs fitted. They are named only as a hint: no run is left that could confirm them.

    Args:
        checked: Outcome of the search, without effects.
        search: Function that searches with other held-out runs, given their names.
        log: Called with a line of text.

    Returns:
        A sentence for the user, or nothing.
    """
    fitted = [run.name for run in checked.outcome.data.runs]
    if not exchanges_held_out(len(checked.differing), len(checked.held_out.runs), len(fitted)):
        return ()
    names, others = ", ".join(checked.differing), fitted[: len(checked.differing)]
    log(f"all held-out runs contradict the fitted ones ({names}); searching with {', '.join(others)} held out instead")
    exchanged = search(others)
    outcome = exchanged.outcome
    if not outcome.selected or not outcome.explained or outcome.contradiction or exchanged.differing:
        return ()
    effects = ", ".join(s.effect.label for s in outcome.selected)
    return (_HINT.format(effects, names),)


def _contradicting_held_out_runs(outcome: SearchOutcome, held_out_runs: Dataset) -> tuple[str, ...]:
    """Return the names of the held-out runs that contradict the machine which explains the fitted runs."""
    refined = refine_dataset(held_out_runs, outcome.after.machine, outcome.data)
    return contradicting_held_out_runs(outcome.after, outcome.before.machine, outcome.selected, refined)


def _unexcited(result: IdentificationResult, bandwidth: float) -> tuple[str, ...]:
    """Return a sentence about the effects on which the held-out runs do not depend; only fitted runs confirm them."""
    machine = result.after.machine
    effects = [s.effect.label for s in result.effects if not is_excited(s, machine, result.held_out, bandwidth)]
    return (_UNEXCITED.format(", ".join(effects)),) if effects else ()


def _prepare(
    recordings: Sequence[Recording], machine: Machine, criteria: SelectionCriteria, log: Log
) -> tuple[Dataset, dict[str, Range]]:
    """Return all recordings without saturated measurements, and the ranges of the sensors that saturate."""
    everything = prepare(recordings, machine)
    ranges = saturation_ranges(recordings, machine, everything.noise, criteria)
    if ranges:
        log(f"saturated at the end of the range: {', '.join(ranges)}")
        usable = [blank_saturated(r, ranges, machine, everything.noise, criteria) for r in recordings]
        everything = prepare(usable, machine)
    if everything.jitter:
        log(f"the clock {everything.describe_jitter()}")
    for warning in merge_run_warnings((run.name, w) for run in everything.runs for w in run.initial.warnings):
        log(f"warning: {warning}")
    return everything, ranges


def _without_unconfirmed(outcome: SearchOutcome, validation: Dataset, log: Log) -> SearchOutcome:
    """Remove effects that do not reduce the error of the held-out runs, weakest first.

    The held-out runs can only remove an effect here, never add or change one. An effect that they do not excite is
    kept: the fitted runs, left out one by one (`leave_one_out_gain`), have confirmed it. If each effect reduces their
    error but all together make their simulation worse than without effects, the weakest is removed as well.
    """
    before, after, verdict = outcome.before, outcome.after, outcome.verdict
    selected, considered, data = outcome.selected, outcome.considered, outcome.data
    while selected and validation.runs:
        runs = refine_dataset(validation, after.machine, data)
        shown = {
            s.effect.label: HeldOutEffect(
                held_out_gain(s, after.machine, runs, after.bandwidth),
                is_excited(s, after.machine, runs, after.bandwidth),
            )
            for s in selected
        }
        refuted, reason = refuted_effects(shown, partial(worsens_simulation, before.machine, after.machine, runs))
        refined = refine_dataset(data, after.machine)
        ordered = (next(s for s in selected if s.effect.label == label) for label in refuted)
        fits = ((s, without_effect(after, s.effect.label, refined, before.machine)) for s in ordered)
        # The weakest that can be removed: no other effect requires it or acts on a coordinate that it added.
        weakest, reduced = next(((s, fitted) for s, fitted in fits if fitted is not None), (None, None))
        if weakest is None or reduced is None:
            break
        log(f"  {weakest.effect.label} is removed: it {reason}")
        entry = ConsideredEffect(weakest.effect, after.machine, reduced.machine, reason)
        selected = tuple(s for s in selected if s is not weakest)
        after, considered = reduced if selected else before, (*considered, entry)
        selected = tuple(s.with_values(after.machine) for s in selected)
        verdict = verdict_after_removal(verdict, bool(selected), outcome.before_explains)
    return outcome._replace(verdict=verdict, after=after, selected=selected, considered=considered)


class _Evaluated(NamedTuple):
    """Outcome of a search with the three machines, simulated over the held-out runs.

    Attributes:
        outcome: Outcome of the search, with its effects, or those that saturated sensors show.
        selected: These effects, with the values of the corrected machine.
        declared: Machine as declared.
        before: Refitted machine.
        after: Machine with the effects.
        refined: Fitted runs with the initial states that follow from this machine.
        validation: Held-out runs.
    """

    outcome: SearchOutcome
    selected: tuple[SelectedEffect, ...]
    declared: ModelEvaluation
    before: ModelEvaluation
    after: ModelEvaluation
    refined: Dataset
    validation: Dataset


def _evaluated(
    outcome: SearchOutcome,
    machine: Machine,
    ranges: dict[str, Range],
    validation: Dataset,
    recordings: Sequence[Recording],
    criteria: SelectionCriteria,
) -> _Evaluated:
    """Simulate the declared, the refitted and the corrected machine over the held-out runs."""
    refined = refine_dataset(outcome.data, outcome.after.machine)
    corrected, selected = _corrected(outcome.after, outcome.selected, ranges, refined, f"{machine.name}-identified")
    refitted = outcome.before.machine.replace(name=f"{machine.name}-refitted")
    declared, before, after = (
        evaluate_held_out(m, outcome.data, validation, recordings, criteria) for m in (machine, refitted, corrected)
    )
    return _Evaluated(outcome, selected, declared, before, after, refined, validation)


def _contradiction(evaluated: _Evaluated, differing: Sequence[str], criteria: SelectionCriteria) -> str:
    """Return why the held-out runs contradict the verdict of the search, a clause; "" if they do not."""
    outcome = evaluated.outcome
    if not outcome.selected and outcome.verdict != "no_effect":
        return ""
    evidence = _evidence(evaluated, differing, criteria)
    if outcome.selected:
        reason = contradiction_of_names(evidence, outcome.explained, criteria)
        if reason and not outcome.explained:  # ranking the causes takes seconds
            causes = rank_dependences(outcome.before.machine, outcome.data)
            named = are_causes([s.effect for s in outcome.selected], causes, outcome.before.machine)
            evidence = dataclasses.replace(evidence, causes_named=named)
            reason = contradiction_of_names(evidence, outcome.explained, criteria)
        return reason
    return contradiction_of_no_effect(evidence, criteria)


def _evidence(evaluated: _Evaluated, differing: Sequence[str], criteria: SelectionCriteria) -> Evidence:
    """Return what the held-out runs that do not contradict the fitted ones say; all of them if all contradict."""
    runs = evaluated.validation.runs
    agreeing = [run for run in runs if run.name not in differing] or list(runs)

    def errors(model: ModelEvaluation) -> PredictionErrors:
        by_run, measured = [model.errors[run.name] for run in agreeing], [run.outputs for run in agreeing]
        channels = errors_by_channel(by_run, model.machine, evaluated.validation.noise, measured)
        return PredictionErrors(channels, None, model.held_out.lacking)

    def finite(value: float | None) -> float:
        return math.inf if value is None or not math.isfinite(value) else value

    before, after = errors(evaluated.before), errors(evaluated.after)
    motion = after.motion_ratio
    return Evidence(
        left=finite(after.noise_ratio),
        left_before=finite(before.noise_ratio),
        motion=0.0 if math.isnan(motion) else motion,  # nothing moves
        lacking=finite(after.lacking),
        remaining_prediction=_remaining_prediction(evaluated, [run.name for run in agreeing], criteria),
    )


def _remaining_prediction(evaluated: _Evaluated, names: Sequence[str], criteria: SelectionCriteria) -> float:
    """Return the fraction of the squared prediction error that effects leave on some of the held-out runs.

    Errors are in units of the noise at rest: jitter of the clock is an estimate from the motion, and a sensor that
    repeats its measurements may be mistaken for it. The observer is slow enough to show what a missing force does over
    some tenths of a second, and fast enough that its errors do not add up over the run, where parameters fitted beside
    a wrong effect compensate for it.
    """
    validation = refine_dataset(evaluated.validation, evaluated.after.machine, evaluated.outcome.data).with_runs(names)
    quiet = [dataclasses.replace(r, noise=np.broadcast_to(validation.noise, r.noise.shape)) for r in validation.runs]
    validation = dataclasses.replace(validation, runs=tuple(quiet))
    after, before = (
        prediction_cost(model.machine, validation, JUDGING_BANDWIDTH, longest_step=POLISH_STEP) / validation.count
        for model in (evaluated.after, evaluated.before)
    )
    return remaining(after, before, 1.0)


def _without_names(outcome: SearchOutcome, reason: str) -> SearchOutcome:
    """Return an outcome whose effects are listed as considered instead of named."""
    entries = (
        ConsideredEffect(s.effect, outcome.after.machine, outcome.before.machine, f"is not named: {reason}")
        for s in outcome.selected
    )
    return outcome._replace(
        verdict="unexplained", after=outcome.before, selected=(), considered=(*entries, *outcome.considered)
    )


def _hint(result: IdentificationResult) -> Hint | None:
    """Return where the missing force acts and on what it depends, and the nearest effects, if none is named.

    If single sensors deviate although others would show an error of the motion, the first of them is the component.
    """
    if result.verdict != "unexplained" or not result.dependence:
        return None
    strongest: Dependence = result.dependence[0]
    component = strongest.component or next(iter(result.after.deviating_sensors), strongest.coordinate)
    nearest = sorted(result.considered, key=lambda entry: -entry.held_out_gain)
    labels = dict.fromkeys(entry.effect.label for entry in nearest if entry.held_out_gain > 0.0)
    return Hint(component, strongest.variable, strongest.explained, tuple(labels)[:_MAX_NEAREST])


def _result(evaluated: _Evaluated, criteria: SelectionCriteria) -> IdentificationResult:
    """Collect the result of an evaluated outcome, and propose an experiment."""
    outcome, selected, refined = evaluated.outcome, evaluated.selected, evaluated.refined
    before, after, data = outcome.before, outcome.after, outcome.data
    corrected = evaluated.after.machine
    experiments = (
        design_discriminating_experiment(after, corrected, s.effect.label, s.rival_effects, refined) for s in selected
    )
    validation = refine_dataset(evaluated.validation, corrected, data)
    drives = drive_force(corrected, data)
    return IdentificationResult(
        verdict="effect_found" if selected and outcome.verdict == "no_effect" else outcome.verdict,
        declared=evaluated.declared,
        before=evaluated.before,
        after=evaluated.after,
        effects=selected,
        gains={s.effect.label: held_out_gain(s, corrected, validation, after.bandwidth) for s in selected},
        considered=tuple(_rejected(c, data, validation, after.bandwidth) for c in outcome.considered),
        sizes={s.effect.label: effect_force(corrected, s.effect, data) / drives for s in selected},
        dependence=tuple(rank_dependences(before.machine, data)[:_MAX_DEPENDENCES]),
        white=bool(white_sensors(corrected, validation).all()),
        fitted=data,
        held_out=validation,
        seconds=0.0,
        experiment=next(filter(None, experiments), None),
        criteria=criteria,
    )


def _corrected(
    after: Fit, selected: tuple[SelectedEffect, ...], ranges: dict[str, Range], data: Dataset, name: str
) -> tuple[Machine, tuple[SelectedEffect, ...]]:
    """Return the machine with its uncertainty and one range per saturated sensor, and all its effects."""
    fitted = with_uncertainty(after, data).replace(name=name)
    limits = range_effects(ranges, [s.effect for s in selected])
    labels = {e.label for e in limits}
    fitted = fitted.replace(effects=tuple(e for e in fitted.effects if e.label not in labels))
    selected = tuple(s for s in selected if s.effect.label not in labels)
    selected += tuple(SelectedEffect(e, 0.0, fitted) for e in limits)
    return fitted.with_effects(*limits), selected


def _rejected(entry: ConsideredEffect, data: Dataset, validation: Dataset, bandwidth: float) -> RejectedEffect:
    """Return a rejected effect with its size and its gain on the held-out runs."""
    return RejectedEffect(
        entry.effect,
        effect_force(entry.machine, entry.effect, data) / drive_force(entry.machine, data),
        error_reduction(entry.machine_without, entry.machine, validation, bandwidth),
        entry.reason,
    )
