"""Evaluate the outcome of a search on the held-out runs, which judge the verdict and the named effects."""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np

from ...arrays import Array
from ...line_log import LineLog
from ...machine import Machine
from ...preparation.dataset import Dataset, PreparedRecording
from ...preparation.runs.excerpt import representative_part
from ...preparation.sensors.saturation import Range, range_effects
from ...preparation.session import Session, with_all_measurements
from ...preparation.session_zeros import may_correct_zeros
from ..evidence.effect_parameters import sizes
from ..evidence.tried_effects import SelectedEffect
from ..fit.channel_errors import errors_by_channel
from ..fit.covariance import with_uncertainty
from ..fit.estimation import prediction_cost
from ..fit.long_run_variance import variance_of_change
from ..fit.start_estimation import refine_dataset
from ..fit.voltage_updates import is_timing
from ..judge.chance import LongRunVariance, chance_gain
from ..judge.criteria import SelectionCriteria
from ..judge.effect import uncertain_size
from ..judge.unstable_motion import UnstableMotion, explains_unstable_motion, is_unstable
from ..judge.verdict import (
    JUDGING_BANDWIDTH,
    VerdictEvidence,
    contradiction_of_names,
    contradiction_of_no_effect,
    fault_of_fitted_runs,
    remaining,
    rounding_counts,
)
from ..predict.exact_machine import certain_jitter, expected_chi2
from ..predict.prediction import POLISH_STEP, SEARCH_BANDWIDTH, SIMULATION, innovation_variance
from ..predict.stamp_errors import has_stamp_errors, prediction_changes, stamp_deviation
from ..predict.start_uncertainty import prediction_residuals
from ..predict.voltage_errors import simulation_error, with_voltage_errors
from ..propose.dependences import agree_with_causes, rank_dependences
from ..propose.trial_fits import without_effect
from ..search.outcome import SearchOutcome, with_removed, without_names
from .held_out_predictions import largest, predictions_by_run
from .machine_errors import ModelEvaluation, PredictionErrors, evaluate_held_out, with_encoder_zeros
from .unstable_motion import enlargement

_UNSTABLE = (
    "The motion of the held-out runs is unstable, as that of a pendulum above its axis: "
    "in a simulation, an error of the size of the noise grows by a factor of {:.3g}. Simulations of complete "
    "runs therefore say nothing here: an exact machine has such errors as well, and that of one machine "
    "is smaller than that of another by chance. Predictions that the measurements correct judge the verdict "
    "and the machine that is delivered; their squared error is {:.3g} times that of an exact machine at most."
)
_ROUNDED = (
    "The time stamps are rounded, so that they err by {:.2g} ms (standard deviation), and the samples have "
    "no regular clock. The errors that this causes add up in a simulation: an exact machine leaves about "
    "{:.3g} times the noise on the held-out runs. Log the times with more digits."
)


def with_certain_effects(outcome: SearchOutcome, criteria: SelectionCriteria, log: LineLog) -> SearchOutcome:
    """Remove the effects whose amplitude may be zero, given the covariance of the fitted parameters.

    An amplitude is certain if it is 4.9 standard deviations from 0 (`judge.effect.uncertain_size`). The least
    certain effect is removed first and the remaining parameters are fitted again: without it, the other
    effects may be certain. An effect that another one requires stays while the other one does. A possible
    delay of the inputs is no reason to remove a delay or lag of the drives, because it is what such an effect
    describes.

    Args:
        outcome: Outcome of a search, after the held-out runs have removed effects.
        criteria: Decision threshold `chance`.
        log: Called with a line of text for each effect that is removed.

    Returns:
        The outcome with the removed effects among the considered ones, and the verdict without them;
        `outcome` itself if all its effects are certain.
    """
    while outcome.selected:
        data = refine_dataset(outcome.data, outcome.after.machine)
        machine = with_uncertainty(outcome.after, data)
        of_timing = machine
        if any(is_timing(s.effect.definition) for s in outcome.selected):
            of_timing = with_uncertainty(outcome.after, data, indicated_delay=False)
        doubts: list[tuple[float, SelectedEffect, str]] = []
        for s in outcome.selected:
            found = sizes(s.effect, of_timing if is_timing(s.effect.definition) else machine)
            if reason := uncertain_size(found, criteria):
                doubts.append((max(abs(size.value) / size.std for size in found), s, reason))
        for _, uncertain, reason in sorted(doubts, key=lambda doubt: doubt[0]):
            label = uncertain.effect.label
            reduced = without_effect(outcome.after, label, data, outcome.before.machine)
            if reduced is not None:  # no other effect requires it
                outcome = with_removed(outcome, uncertain, reduced, reason, log)
                break
        else:
            break
    return outcome


class _KnownErrors(NamedTuple):
    """Errors of a machine that was evaluated.

    Attributes:
        moving: The machine with the zeros of its encoders, without what its motion does not depend on.
        reference: Runs that it was fitted to, if its zeros follow from them; None otherwise.
        errors: Its errors.
        refined: The held-out runs with the initial states that follow from this machine.
        seconds: Processor time of the evaluation, s.
    """

    moving: Machine
    reference: Dataset | None
    errors: ModelEvaluation
    refined: Dataset
    seconds: float


def _moving(machine: Machine) -> Machine:
    """Return a machine without what its motion does not depend on."""
    return machine.replace(name="", uncertainty=None)


@dataclass(frozen=True)
class HeldOutTest:
    """Evaluation of machines on the same held-out runs, with a cache of their errors.

    Attributes:
        session: All runs, as logged and as prepared, with the declared machine.
        held_out: Held-out runs, prepared.
        criteria: Thresholds of the identification.
    """

    session: Session
    held_out: Dataset
    criteria: SelectionCriteria
    _known: list[_KnownErrors] = field(default_factory=list, init=False, repr=False)
    _motions: list[tuple[Machine, tuple[str, ...], UnstableMotion | None]] = field(
        default_factory=list, init=False, repr=False
    )

    @cached_property
    def complete_runs(self) -> Dataset:
        """Held-out runs with the measurements at the ends of the sensors' ranges, which a fit leaves out."""
        return with_all_measurements(self.held_out, self.session.usable)

    def with_runs(self, names: Sequence[str]) -> HeldOutTest:
        """Return a test of some of the held-out runs, given by their `names`, without cached errors."""
        return HeldOutTest(self.session, self.held_out.with_runs(names), self.criteria)

    def errors(self, machine: Machine, fitted: Dataset, name: str = "") -> ModelEvaluation:
        """Simulate a machine over the held-out runs; the errors of an equal machine are reused.

        Args:
            machine: Any machine with these drives and sensors.
            fitted: Runs that the machine was fitted to.
            name: Name of the machine in the result. Default: the machine's name.

        Returns:
            The machine with its errors, see `evaluate_held_out`.
        """
        named = machine.replace(name=name) if name else machine
        located = with_encoder_zeros(named, fitted)
        if known := self._known_of(located, fitted):
            again = known.errors.machine.replace(name=named.name, uncertainty=named.uncertainty)
            return dataclasses.replace(known.errors, machine=again)
        began = time.process_time()
        refined = refine_dataset(self.complete_runs, located, fitted)
        errors = evaluate_held_out(located, refined, self.session.recordings)
        self._known.append(
            _KnownErrors(
                _moving(located),
                self._reference(located, fitted),
                errors,
                refined,
                time.process_time() - began,
            )
        )
        return errors

    def rounded_stamps_explain(self, model: ModelEvaluation) -> bool:
        """Return whether rounded stamps may cause the simulation error of a machine.

        Args:
            model: Machine with its errors.
        """
        data, most = self.complete_runs, self.criteria.max_noise_ratio_explained
        if not model.held_out.noise_ratio > most or (changes := _rounding(model.machine, data)) is None:
            return False
        expected = np.hypot(data.noise, changes)
        by_run = [model.errors[run.name] for run in data.runs]
        channels = errors_by_channel(by_run, model.machine, expected)
        return PredictionErrors(channels, None).noise_ratio <= most

    def refined_runs(self, model: ModelEvaluation, fitted: Dataset) -> Dataset:
        """Return the held-out runs, with initial states and voltages that follow from a machine.

        Args:
            model: Machine with its errors, which were computed with these runs.
            fitted: Runs that the machine was fitted to; the zeros of encoders may follow from them.
        """
        known = self._known_of(model.machine, fitted)
        return known.refined if known else refine_dataset(self.complete_runs, model.machine, fitted)

    def _known_of(self, located: Machine, fitted: Dataset) -> _KnownErrors | None:
        """Return what is known about a machine that moves like this one, with the zeros of its encoders."""
        moving, reference = _moving(located), self._reference(located, fitted)
        return next((k for k in self._known if k.reference is reference and k.moving == moving), None)

    def _reference(self, machine: Machine, fitted: Dataset) -> Dataset | None:
        """Return the runs that a machine was fitted to, if its zeros follow from them."""
        return fitted if may_correct_zeros(self.held_out, machine) else None

    def seconds(self) -> float:
        """Return the processor time of the longest evaluation of a machine so far, s; 0 before the first one.

        It estimates the time for the delivered machine, whose effects may make an evaluation slower.
        """
        return max((known.seconds for known in self._known), default=0.0)

    def unstable_motion(
        self, model: ModelEvaluation, fitted: Dataset, names: Sequence[str] = ()
    ) -> UnstableMotion | None:
        """Return the evidence about a machine's motion if it is unstable; None if it is stable.

        A motion is unstable if simulations enlarge position errors of the size of the noise more than twice
        (`enlargement`). The result is also None with unknown voltages between the rows, whose influence on
        predictions is not known well enough.

        Args:
            model: Machine with its errors.
            fitted: Runs that the machine was fitted to.
            names: Names of the held-out runs that count. Default: all.
        """
        if self.complete_runs.has_voltage_errors:
            return None
        names = tuple(names) or tuple(run.name for run in self.complete_runs.runs)
        for known, runs, found in self._motions:
            if runs == names and known == model.machine:
                return found
        data = self.complete_runs.with_runs(names)
        enlarged, motion = enlargement(model.machine, data, JUDGING_BANDWIDTH), None
        if is_unstable(enlarged, self.criteria):
            motion = UnstableMotion(enlarged, largest(self.predictions(model, fitted, names)))
        self._motions.append((model.machine, names, motion))
        return motion

    def explains_unstable_motion(self, model: ModelEvaluation, fitted: Dataset) -> bool:
        """Return whether noise that grows along an unstable motion causes a machine's simulation error.

        It is False for an error of no more than twice the noise (`max_noise_ratio_explained`); otherwise
        `judge.unstable_motion.explains_unstable_motion` decides.

        Args:
            model: Machine with its errors on the held-out runs.
            fitted: Runs that the machine was fitted to.
        """
        left = model.held_out.noise_ratio
        if not left > self.criteria.max_noise_ratio_explained:
            return False
        return explains_unstable_motion(left, self.unstable_motion(model, fitted), self.criteria)

    def evaluate(self, outcome: SearchOutcome) -> Evaluated:
        """Simulate the declared, the refitted and the corrected machine over the held-out runs.

        Effects of sensors that saturate, which no search finds, are added to the corrected machine.

        Args:
            outcome: Outcome of a search, without effects that must not be named.

        Returns:
            The outcome with these machines and their errors.
        """
        corrected, selected = _corrected(
            outcome.after.machine.replace(name=f"{self.session.machine.name}-identified"),
            outcome.selected,
            self.session.ranges,
        )
        name = f"{self.session.machine.name}-refitted"
        declared = self.errors(self.session.machine, outcome.data)
        before = self.errors(outcome.before.machine, outcome.data, name)
        after = self.errors(corrected, outcome.data)
        return Evaluated(outcome, selected, declared, before, after, self)

    def contradiction(self, evaluated: Evaluated, differing: Sequence[str]) -> str:
        """Return why the held-out runs contradict the verdict of a search, as a clause; "" if they do not.

        With effects, it is why they must not be named (`judge.verdict.contradiction_of_names`). Of
        "no_effect", it is what `contradiction_of_no_effect` says. Without effects and with the verdict
        "unexplained", it is why the fitted runs have an error that the held-out ones do not show
        (`fault_of_fitted_runs`).

        Args:
            evaluated: Outcome of the search with its machines.
            differing: Names of held-out runs that contradict the fitted ones, which do not count.
        """
        outcome = evaluated.outcome
        if not outcome.selected and outcome.verdict != "no_effect":
            left = evaluated.before.held_out.noise_ratio
            return fault_of_fitted_runs(outcome.before.error, left, self.criteria)
        evaluated = _with_ranges(evaluated)
        evidence = _evidence(evaluated, differing)
        if not outcome.selected:
            return contradiction_of_no_effect(evidence, self.criteria)
        reason = contradiction_of_names(evidence, outcome.explained, self.criteria)
        if reason and outcome.explained and not evidence.voltages_known:
            removal = _removal(evaluated, differing)
            evidence = dataclasses.replace(
                evidence,
                reduction=removal.reduction,
                reduction_std=removal.std,
                reduction_by_chance=removal.by_chance(self.criteria),
            )
            reason = contradiction_of_names(evidence, outcome.explained, self.criteria)
        elif reason and not outcome.explained:  # ranking the causes takes seconds
            part = representative_part(outcome.data, outcome.before.machine)
            causes = rank_dependences(outcome.before.machine, part)
            named = agree_with_causes([s.effect for s in outcome.selected], causes, outcome.before.machine)
            evidence = dataclasses.replace(evidence, causes_named=named)
            if named:
                evidence = _with_fast_error(evidence, evaluated, differing)
            reason = contradiction_of_names(evidence, outcome.explained, self.criteria)
        return reason

    def predictions(self, model: ModelEvaluation, fitted: Dataset, names: Sequence[str] = ()) -> Array:
        """Compute the errors of predictions of the held-out runs, with an observer of 15 rad/s.

        Args:
            model: Machine with its errors.
            fitted: Runs that the machine was fitted to; the zeros of encoders may follow from them.
            names: Names of the held-out runs that are predicted. Default: all.

        Returns:
            Mean squared error in units of the noise / that of an exact machine, dimensionless, shape (runs,
            sensors); NaN if not measured, infinite if a prediction diverges.
        """
        runs = self.complete_runs
        return predictions_by_run(model, runs.with_runs(names) if names else runs, fitted)


class HeldOutTests:
    """Collection of `HeldOutTest`s for one identification; a second search may hold out other runs.

    Args:
        session: All runs, as logged and as prepared, with the declared machine.
        criteria: Thresholds of the identification.
    """

    def __init__(self, session: Session, criteria: SelectionCriteria):
        self.session, self._criteria = session, criteria
        self._tests: dict[Dataset, HeldOutTest] = {}

    def of(self, held_out: Dataset) -> HeldOutTest:
        """Return the test for some held-out runs, with its cached errors if it was returned before."""
        if held_out not in self._tests:
            self._tests[held_out] = HeldOutTest(self.session, held_out, self._criteria)
        return self._tests[held_out]


class Evaluated(NamedTuple):
    """Outcome of a search with the three machines, simulated over the held-out runs.

    Attributes:
        outcome: Outcome of the search.
        selected: Effects of the outcome with the values of the corrected machine, and those of saturated
            sensors.
        declared: Machine as declared with its errors.
        before: Refitted machine.
        after: Machine with the effects.
        test: The held-out runs, on which other outcomes can be compared with this one.
        reason: Reason why the held-out runs contradict the verdict of the search, a clause; "" if they do
            not.
    """

    outcome: SearchOutcome
    selected: tuple[SelectedEffect, ...]
    declared: ModelEvaluation
    before: ModelEvaluation
    after: ModelEvaluation
    test: HeldOutTest
    reason: str = ""

    @property
    def held_out(self) -> Dataset:
        """Held-out runs with the initial states that follow from the machine with the effects."""
        return self.test.refined_runs(self.after, self.outcome.data)


class Judged(NamedTuple):
    """Outcome of a search after the held-out runs have judged it.

    Attributes:
        evaluated: The outcome with its machines, without effects that must not be named.
        withdrawn: The outcome before the removal of effects that the held-out runs do not permit to name;
            None if there are none.
    """

    evaluated: Evaluated
    withdrawn: Evaluated | None = None


def judged(evaluated: Evaluated, differing: Sequence[str], log: LineLog) -> Judged:
    """Let the held-out runs confirm or withdraw the verdict and the names of effects.

    Effects whose names they do not permit (`HeldOutTest.contradiction`) are moved to the considered ones. The
    verdict is then "no_effect" if the refitted machine explains the fitted runs and the held-out runs do not
    contradict that. In all other cases, a contradiction makes the verdict "unexplained".

    Args:
        evaluated: Outcome of a search with its machines.
        differing: Names of held-out runs that contradict the fitted ones.
        log: Called with a line of text for each effect that is not named.

    Returns:
        The outcome without effects that must not be named, with the reason of a contradiction; and the
        outcome with these effects, None if all names are permitted.
    """
    test = evaluated.test
    reason, outcome, withdrawn = test.contradiction(evaluated, differing), evaluated.outcome, None
    if not reason:
        return Judged(evaluated)
    if outcome.selected:
        for s in outcome.selected:
            log(f"  {s.effect.label} is not named: {reason}")
        withdrawn = evaluated
        evaluated = test.evaluate(without_names(outcome, reason))
        if evaluated.outcome.verdict == "no_effect" and not test.contradiction(evaluated, differing):
            return Judged(evaluated, withdrawn)
    outcome = evaluated.outcome._replace(verdict="unexplained")
    return Judged(evaluated._replace(outcome=outcome, reason=reason), withdrawn)


def describe_unstable_motion(evaluated: Evaluated) -> str:
    """Write a note for the report that simulation errors mean little because the motion is unstable.

    Args:
        evaluated: Outcome with the machine that is delivered.

    Returns:
        Sentences with the factor by which errors grow, and the squared error of predictions; "" if
        `HeldOutTest.explains_unstable_motion` is False for this machine.
    """
    test, after, fitted = evaluated.test, evaluated.after, evaluated.outcome.data
    if not test.explains_unstable_motion(after, fitted):
        return ""
    motion = test.unstable_motion(after, fitted)
    return "" if motion is None else _UNSTABLE.format(motion.enlarged, motion.predicted)


def describe_rounded_stamps(evaluated: Evaluated) -> str:
    """Write a note for the report that rounded stamps may cause the error of a machine without effects.

    Args:
        evaluated: Outcome with the machine that is delivered.

    Returns:
        Sentences; "" if another verdict than "no_effect" is given, rounded stamps cause no more than noise,
        or only noise is left.
    """
    test, machine = evaluated.test, evaluated.after.machine
    data = test.complete_runs
    explained = evaluated.after.held_out.noise_ratio <= test.criteria.max_noise_ratio_explained
    if evaluated.outcome.verdict != "no_effect" or explained:
        return ""
    if (changes := _rounding(machine, data)) is None:
        return ""
    deviation = max(stamp_deviation(run, data) for run in data.runs)
    expected = np.hypot(1.0, changes / data.noise)
    return _ROUNDED.format(1e3 * deviation, float(np.sqrt(np.mean(expected**2))))


def _rounding(machine: Machine, data: Dataset) -> Array | None:
    """Return what rounded stamps change in a simulation, in the sensors' units, shape (sensors,).

    None if they do not count (`rounding_counts`), or if voltages between the rows, which err by more, are
    unknown.
    """
    if data.has_voltage_errors or not has_stamp_errors(data):
        return None
    changes = prediction_changes(machine, data, SIMULATION)
    return changes if rounding_counts(float(np.max(changes / data.noise))) else None


def _with_ranges(evaluated: Evaluated) -> Evaluated:
    """Return an evaluation whose refitted machine has saturated sensors' ranges too, which need no search.

    Otherwise the effects of the search would be credited with what the ends of these ranges explain.
    """
    searched, before = evaluated.outcome.after.machine, evaluated.before.machine
    known = {e.label for e in searched.effects}
    ranges = {e.label: e for e in evaluated.after.machine.effects if e.label not in known}
    if not ranges:
        return evaluated
    others = tuple(e for e in before.effects if e.label not in ranges)
    limited = before.replace(effects=(*others, *ranges.values()))
    return evaluated._replace(before=evaluated.test.errors(limited, evaluated.outcome.data))


def _evidence(evaluated: Evaluated, differing: Sequence[str]) -> VerdictEvidence:
    """Return what the held-out runs that do not contradict the fitted ones say; all if none agrees."""
    held_out = evaluated.test.complete_runs
    agreeing = _agreeing(evaluated, differing)

    expected, names = held_out.noise, evaluated.outcome.selected
    runs = held_out.with_runs([run.name for run in agreeing])
    if held_out.has_voltage_errors:
        expected = np.hypot(expected, simulation_error(evaluated.after.machine, runs))

    def errors(model: ModelEvaluation, expected: Array) -> PredictionErrors:
        by_run, measured = [model.errors[run.name] for run in agreeing], [run.outputs for run in agreeing]
        channels = errors_by_channel(by_run, model.machine, expected, measured)
        return PredictionErrors(channels, None, model.held_out.lacking)

    def finite(value: float | None) -> float:
        return math.inf if value is None or not math.isfinite(value) else value

    explained = evaluated.test.criteria.max_noise_ratio_explained
    more_than_noise = finite(errors(evaluated.after, expected).noise_ratio) > explained
    changes = _rounding(evaluated.after.machine, runs) if more_than_noise and not names else None
    rounded = changes is not None
    if changes is not None:
        expected = np.hypot(expected, changes)
    before, after = (errors(model, expected) for model in (evaluated.before, evaluated.after))
    motion = after.motion_ratio
    quiet = _quiet(evaluated, agreeing)
    left, unstable = finite(after.noise_ratio), None
    if math.isfinite(left) and left > explained:
        unstable = evaluated.test.unstable_motion(
            evaluated.after, evaluated.outcome.data, [run.name for run in agreeing]
        )
    return VerdictEvidence(
        left=left,
        left_before=finite(before.noise_ratio),
        motion=0.0 if math.isnan(motion) else motion,  # nothing moves
        lacking=finite(after.lacking),
        remaining_prediction=_remaining_prediction(evaluated, quiet, JUDGING_BANDWIDTH),
        voltages_known=not held_out.has_voltage_errors,
        stamps_known=not rounded,
        predicted=1.0
        if names or not (held_out.has_voltage_errors or rounded)
        else _predicted(evaluated, quiet, JUDGING_BANDWIDTH, SEARCH_BANDWIDTH),
        unstable=unstable,
    )


def _predicted(evaluated: Evaluated, held_out: Dataset, *bandwidths: float) -> float:
    """Return squared error of predictions / that of an exact machine, the largest one of some observers.

    It is infinite if the machine diverges.

    Args:
        evaluated: Outcome with the machine that predicts.
        held_out: Runs with the noise at rest.
        *bandwidths: Bandwidths of the observers, rad/s.
    """
    machine, counts = evaluated.after.machine, sum(run.weights.sum(axis=0) for run in held_out.runs)
    jitter = certain_jitter(machine, evaluated.outcome.data, held_out)

    def of_exact(bandwidth: float) -> float:
        if held_out.has_voltage_errors:
            return expected_chi2(machine, held_out, bandwidth, jitter)
        variance, _ = innovation_variance(machine, held_out, bandwidth)
        changes = prediction_changes(machine, held_out, bandwidth) / held_out.noise
        return variance + float(np.average(changes**2, weights=counts))

    def ratio(bandwidth: float) -> float:
        found = prediction_cost(machine, held_out, bandwidth, longest_step=POLISH_STEP) / held_out.count
        exact = of_exact(bandwidth)
        return found / exact if math.isfinite(exact) else math.inf

    return max(ratio(bandwidth) for bandwidth in bandwidths)


def _agreeing(evaluated: Evaluated, differing: Sequence[str]) -> list[PreparedRecording]:
    """Return the held-out runs that do not contradict the fitted ones; all of them if all contradict."""
    runs = evaluated.test.complete_runs.runs
    return [run for run in runs if run.name not in differing] or list(runs)


def _quiet(evaluated: Evaluated, runs: Sequence[PreparedRecording]) -> Dataset:
    """Return some of the held-out runs with the starts of the corrected machine and the noise at rest.

    Jitter of the clock is an estimate from the motion, and a sensor that repeats its measurements may be
    mistaken for it. So may what unknown voltages between the rows do, which counts by their own statistics,
    in units of this noise.
    """
    held_out = evaluated.held_out.with_runs([run.name for run in runs])
    quiet = [
        dataclasses.replace(r, noise=np.broadcast_to(held_out.noise, r.noise.shape)) for r in held_out.runs
    ]
    data = dataclasses.replace(held_out, runs=tuple(quiet))
    return with_voltage_errors(evaluated.before.machine, data) if data.has_voltage_errors else data


def _remaining_prediction(
    evaluated: Evaluated, held_out: Dataset, bandwidth: float, floor: float = 1.0
) -> float:
    """Return the fraction of squared prediction error that effects leave, beyond that of an exact machine.

    The observer that judges is slow enough to show what a missing force does over some tenths of a second,
    and fast enough that its errors do not add up over the run, where parameters fitted beside a wrong effect
    compensate for it.
    """
    after, before = (
        prediction_cost(model.machine, held_out, bandwidth, longest_step=POLISH_STEP) / held_out.count
        for model in (evaluated.after, evaluated.before)
    )
    return remaining(after, before, floor)


def _with_fast_error(
    evidence: VerdictEvidence, evaluated: Evaluated, differing: Sequence[str]
) -> VerdictEvidence:
    """Return evidence with what effects leave of fast errors, and whether they remove what they should."""
    held_out = _quiet(evaluated, _agreeing(evaluated, differing))
    floor = innovation_variance(evaluated.after.machine, held_out, SEARCH_BANDWIDTH)[0]
    return dataclasses.replace(
        evidence,
        remaining_fast=_remaining_prediction(evaluated, held_out, SEARCH_BANDWIDTH, floor),
        reduction=_removal(evaluated, differing).reduction,
    )


class _Removal(NamedTuple):
    """What effects remove from the squared error of predictions, in units of the noise.

    Attributes:
        removed: Reduction of the squared error.
        expected: That by effects that are right: the square of their change of the predictions.
        variance: Variance of the remaining error in the direction of this change.
    """

    removed: float
    expected: float
    variance: LongRunVariance

    @property
    def reduction(self) -> float:
        """Actual / expected reduction, dimensionless."""
        return self.removed / self.expected if self.expected > 0.0 else 0.0

    @property
    def std(self) -> float:
        """Standard deviation of `reduction`.

        The reduction differs from the expected one by twice the sum of products of the change and the
        remaining error.
        """
        return 2.0 * math.sqrt(self.variance.ratio / self.expected) if self.expected > 0.0 else 0.0

    def by_chance(self, criteria: SelectionCriteria) -> float:
        """Return the value of `reduction` that effects which do not exist hardly ever reach."""
        limit = chance_gain(self.variance, criteria)
        return limit / self.expected if self.expected > 0.0 else math.inf


def _removal(evaluated: Evaluated, differing: Sequence[str]) -> _Removal:
    """Return by how much effects reduce the predictions' squared error, and by how much right ones do."""
    held_out = _quiet(evaluated, _agreeing(evaluated, differing))
    removed = expected = 0.0
    runs = []
    for run in held_out.runs:
        before, after = (
            prediction_residuals(model.machine, run, held_out, JUDGING_BANDWIDTH, longest_step=POLISH_STEP)
            for model in (evaluated.before, evaluated.after)
        )
        removed += float(np.sum(before**2) - np.sum(after**2))
        expected += float(np.sum((before - after) ** 2))
        runs.append((before - after, after))
    variance = variance_of_change(runs, evaluated.after.machine, held_out)
    return _Removal(removed, expected, variance)


def _corrected(
    fitted: Machine, selected: tuple[SelectedEffect, ...], ranges: dict[str, Range]
) -> tuple[Machine, tuple[SelectedEffect, ...]]:
    """Return a fitted machine with one range per saturated sensor, and all its effects."""
    limits = range_effects(ranges, [s.effect for s in selected])
    labels = {e.label for e in limits}
    fitted = fitted.replace(effects=tuple(e for e in fitted.effects if e.label not in labels))
    selected = tuple(
        dataclasses.replace(s, machine_without=s.machine_without.with_effects(*limits))
        for s in selected
        if s.effect.label not in labels
    )
    selected += tuple(SelectedEffect(e, 0.0, fitted) for e in limits)
    return fitted.with_effects(*limits), selected
