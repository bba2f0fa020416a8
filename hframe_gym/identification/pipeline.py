"""Identification from recordings to a verdict: prepare, refit, select effects, evaluate on held-out runs."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..errors import InputError
from ..machine import Machine
from ..recordings import Recording, without_outliers
from ..registry import load_plugins
from .criteria import SelectionCriteria
from .dataset import MIN_ROWS, Dataset, prepare, refine_encoder_offsets, with_all_measurements, with_known_positions
from .effect_size import drive_force, effect_force
from .estimation import Fit, fit, prediction_cost, with_uncertainty
from .experiment_design import design_discriminating_experiment
from .forward_selection import (
    ConsideredEffect,
    EffectSearch,
    Log,
    SelectedEffect,
    Selection,
)
from .free_parameters import default_free_parameters
from .held_out import error_reduction, held_out_gain, hold_out, is_excited
from .model_error import explains, fit_with_model_error, polish
from .nonparametric import add_tables
from .prediction import SEARCH_BANDWIDTH
from .recording_simulation import evaluate_held_out
from .residual import is_white, rank_dependences
from .result import IdentificationResult, RejectedEffect, Verdict
from .sensor_properties import Range, blank_saturated, range_effects, saturation_ranges
from .trial_fits import without_effect

_MAX_DEPENDENCES = 6  # Variables that the report lists for the residual force.


def identify(
    recordings: Sequence[Recording],
    machine: Machine,
    *,
    held_out: Sequence[str] = (),
    criteria: SelectionCriteria | None = None,
    log: Log | None = None,
) -> IdentificationResult:
    """Identify the effects that a machine's model lacks.

    The machine's parameters are fitted to the recordings. Effects are selected that reduce the remaining error. The
    declared machine, the refitted one, and that with effects are simulated over the held-out runs, to which nothing was
    fitted.

    Args:
        recordings: Runs of one rig, at least two.
        machine: Machine as declared.
        held_out: Names of the runs to evaluate on. Default: every fourth, see `hold_out`.
        criteria: Decision thresholds. Default: `SelectionCriteria()`.
        log: Called with a line of text after each part of the work. Default: nothing is reported.

    Returns:
        Verdict, machines, selected effects and their errors on the held-out runs.

    Raises:
        InputError: If the runs cannot be divided into fitted and held-out ones, or `recordings` is a path.
    """
    began = time.perf_counter()
    if isinstance(recordings, str | Path):
        raise InputError(f"identify needs recordings, not a path; call load_recordings({str(recordings)!r}, machine)")
    load_plugins()  # the search tries their effects as well
    criteria = criteria or SelectionCriteria()
    log = log or (lambda line: None)
    recordings = sorted(recordings, key=lambda recording: recording.name)  # the result depends on no other order
    held_names = hold_out(recordings, held_out)
    _refuse_unusable(recordings, held_names)
    as_measured = recordings
    recordings = [_cleaned(recording, machine, log) for recording in recordings]
    all_runs, ranges = _prepare(recordings, machine, criteria, log)
    validation, excluded = with_known_positions(all_runs.with_runs(held_names))
    validation = with_all_measurements(validation, recordings)
    data, unused = with_known_positions(all_runs.with_runs([r.name for r in recordings if r.name not in held_names]))
    log(f"fitting {machine.name} to {len(data.runs)} runs, {len(validation.runs)} held out")
    # With the widest observer bandwidth first: it tolerates a model that is still wrong.
    base = fit(machine, default_free_parameters(machine), data, SEARCH_BANDWIDTH)
    log(f"refitted machine: {_describe(base)}")
    before = polish(fit_with_model_error(base, data), data)
    log(f"refitted machine: {_describe(before)}")
    log("searching for effects")
    outcome = _Search(base, before, data, criteria, log).run()
    outcome = _without_unconfirmed(outcome, before, explains(before, base.chi2, criteria), data, validation, log)
    result = _result(outcome, machine, before, ranges, data, validation, as_measured, criteria)
    log(f"verdict: {result.verdict}")
    return dataclasses.replace(result, seconds=time.perf_counter() - began, excluded=(*unused, *excluded))


def _refuse_unusable(recordings: Sequence[Recording], held_names: Sequence[str]) -> None:
    """Raise InputError if a run is too short for the filters, or no fitted run moves a sensor."""
    for recording in recordings:
        if len(recording.time_s) < MIN_ROWS:
            raise InputError(
                f"run {recording.name}: number of rows is {len(recording.time_s)}, at least {MIN_ROWS} are needed"
            )
    fitted = [recording for recording in recordings if recording.name not in held_names]
    if not any(len(np.unique(values[np.isfinite(values)])) > 1 for run in fitted for values in run.outputs.T):
        raise InputError(f"runs {', '.join(run.name for run in fitted)}: no sensor moves, so nothing can be identified")


def _cleaned(recording: Recording, machine: Machine, log: Log) -> Recording:
    """Return a recording without outliers, and log how many there were."""
    cleaned = without_outliers(recording, machine)
    if cleaned is not recording:
        count = np.isfinite(recording.outputs).sum(axis=0) - np.isfinite(cleaned.outputs).sum(axis=0)
        found = ", ".join(f"{n} of {c}" for n, c in zip(count, machine.output_channels, strict=True) if n)
        log(f"{recording.name}: outliers are not used: {found}")
    return cleaned


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
    for run in everything.runs:
        for warning in run.initial.warnings:
            log(f"warning: {warning}")
    return everything, ranges


class _Outcome(NamedTuple):
    """Outcome of a search.

    Attributes:
        verdict: "effect_found", "no_effect" or "unexplained".
        after: Fit of the machine with the effects.
        selected: The selected effects.
        considered: Effects that reduced the error of the fitted runs but failed a test.
    """

    verdict: Verdict
    after: Fit
    selected: tuple[SelectedEffect, ...]
    considered: tuple[ConsideredEffect, ...]


def _without_unconfirmed(
    outcome: _Outcome, before: Fit, before_explains: bool, data: Dataset, validation: Dataset, log: Log
) -> _Outcome:
    """Remove effects that do not reduce the error of the held-out runs, weakest first.

    The held-out runs can only remove an effect here, never add or change one. They say nothing about an effect that
    they do not excite; then the runs that were left out in turn (`leave_one_out_gain`) must suffice.
    """
    verdict, after, selected, considered = outcome
    while selected:
        runs = refine_encoder_offsets(validation, after.machine, data)
        gains = {s.effect.label: held_out_gain(s, after.machine, runs, after.bandwidth) for s in selected}
        refuted = [
            s for s in selected if gains[s.effect.label] <= 0.0 and is_excited(s.effect, after.machine, runs, data)
        ]
        if not refuted:
            break
        weakest = min(refuted, key=lambda s: gains[s.effect.label])
        reason = "does not reduce the error of the held-out runs"
        log(f"  {weakest.effect.label} is removed: it {reason}")
        refined = refine_encoder_offsets(data, after.machine)
        reduced = without_effect(after, weakest.effect.label, refined, before.machine)
        if reduced is None:  # another one acts on its coordinate
            break
        entry = ConsideredEffect(weakest.effect, after.machine, reduced.machine, reason)
        selected = tuple(s for s in selected if s is not weakest)
        after, considered = reduced if selected else before, (*considered, entry)
        selected = tuple(s.with_values(after.machine) for s in selected)
        verdict = verdict if selected else "no_effect" if before_explains else "unexplained"
    return _Outcome(verdict, after, selected, considered)


def _result(
    outcome: _Outcome,
    machine: Machine,
    before: Fit,
    ranges: dict[str, Range],
    data: Dataset,
    validation: Dataset,
    recordings: Sequence[Recording],
    criteria: SelectionCriteria,
) -> IdentificationResult:
    """Evaluate declared, refitted and corrected machine on the held-out runs, and propose an experiment."""
    verdict, after, selected, considered = outcome
    refined = refine_encoder_offsets(data, after.machine)
    corrected, selected = _corrected(after, selected, ranges, refined, f"{machine.name}-identified")
    refitted = before.machine.replace(name=f"{machine.name}-refitted")
    declared_evaluation, refitted_evaluation, corrected_evaluation = (
        evaluate_held_out(m, data, validation, recordings) for m in (machine, refitted, corrected)
    )
    corrected = corrected_evaluation.machine
    experiments = (
        design_discriminating_experiment(after, corrected, s.effect.label, s.rival_effects, refined) for s in selected
    )
    validation = refine_encoder_offsets(validation, corrected, data)
    drives = drive_force(corrected, data)
    return IdentificationResult(
        verdict="effect_found" if selected and verdict == "no_effect" else verdict,
        declared=declared_evaluation,
        before=refitted_evaluation,
        after=corrected_evaluation,
        effects=selected,
        gains={s.effect.label: held_out_gain(s, corrected, validation, after.bandwidth) for s in selected},
        considered=tuple(_rejected(c, data, validation, after.bandwidth) for c in considered),
        sizes={s.effect.label: effect_force(corrected, s.effect, data) / drives for s in selected},
        dependence=tuple(rank_dependences(before.machine, data)[:_MAX_DEPENDENCES]),
        white=is_white(corrected, validation),
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
    selected += tuple(SelectedEffect(e, (), 0.0, fitted) for e in limits)
    return fitted.with_effects(*limits), selected


def _describe(fitted: Fit) -> str:
    """Return chi-squared and observer bandwidth of a fit, for the log."""
    return f"chi-squared per sample {fitted.chi2:.4g} ({fitted.mode})"


class _Search:
    """The search for effects that explain the residual of the refitted machine.

    Args:
        base: Machine refitted at `SEARCH_BANDWIDTH`.
        before: Machine refitted at the bandwidth that its remaining error requires.
        data: Prepared recordings to fit.
        criteria: Decision thresholds.
        log: Called with a line of text at each stage.
    """

    def __init__(self, base: Fit, before: Fit, data: Dataset, criteria: SelectionCriteria, log: Log) -> None:
        self._base, self._before, self._data = base, before, data
        self._criteria, self._log = criteria, log

    def run(self) -> _Outcome:
        """Search for effects, then for tables if no known effects explain the residual."""
        after, effects, considered = self._known_effects()
        if self._explains(after):
            verdict: Verdict = "effect_found" if effects else "no_effect"
            return _Outcome(verdict, after if effects else self._before, effects, considered)
        tabled = self._with_tables((after, effects))
        if tabled is not None:
            return _Outcome("effect_found", *tabled, considered)
        if effects and self._wide_cost(after) < self._criteria.max_partial_cost_fraction * self._base.cost:
            return _Outcome("effect_found", after, effects, considered)
        return _Outcome("unexplained", self._before, (), considered)

    def _known_effects(self) -> tuple[Fit, tuple[SelectedEffect, ...], tuple[ConsideredEffect, ...]]:
        """Return the fit with effects of the library, the effects, and those that failed a test."""
        criteria, data, log = self._criteria, self._data, self._log
        search = EffectSearch(data, self._before.machine, criteria, log)
        current, effects = search.run(self._before)
        refined = refine_encoder_offsets(data, current.machine)
        if refined is not data:
            # The encoders' zeros are known better with the effects, which may reveal further ones.
            data, search = refined, search.with_data(refined)
            current = polish(current, data)
            current, effects = search.run(fit_with_model_error(current, data), effects)
        if effects:
            current = polish(current, data)
            current, effects = search.prune(current, effects)
        return current, effects, tuple(search.considered.values())

    def _with_tables(self, selected: Selection) -> Selection | None:
        """Return a model with tables, alone or beside the selected effects, if it explains the residual."""
        criteria, data, log = self._criteria, self._data, self._log
        log("no known effect explains the residual; searching for a table of force or friction")
        after, effects = selected
        wide = self._base if not effects else fit(after.machine, after.free, data, SEARCH_BANDWIDTH, theta=after.theta)
        for start, known, count in ((self._base, (), 1), (wide, effects, 2)):
            fitted, more = add_tables(start, known, data, criteria=criteria, max_tables=count, log=log)
            if len(more) > len(known):
                # No further search beside a table: what its straight pieces leave looks like many a small effect.
                refined = polish(fit_with_model_error(fitted, data), data)
                candidate, kept = EffectSearch(data, self._before.machine, criteria, log).prune(refined, more)
                limit = criteria.max_table_cost_fraction * min(self._base.cost, wide.cost)
                if kept and (self._explains(candidate) or self._wide_cost(candidate) < limit):
                    return candidate, kept
        return None

    def _wide_cost(self, fitted: Fit) -> float:
        """Return the cost of a machine at the bandwidth of the search, at which all machines can be compared."""
        return prediction_cost(fitted.machine, self._data, SEARCH_BANDWIDTH)

    def _explains(self, after: Fit) -> bool:
        """Return whether a fit leaves only the sensors' noise, or a negligible part of the initial residual."""
        return explains(after, self._base.chi2, self._criteria)


def _rejected(entry: ConsideredEffect, data: Dataset, validation: Dataset, bandwidth: float) -> RejectedEffect:
    """Return a rejected effect with its size and its gain on the held-out runs."""
    return RejectedEffect(
        entry.effect,
        effect_force(entry.machine, entry.effect, data) / drive_force(entry.machine, data),
        error_reduction(entry.machine_without, entry.machine, validation, bandwidth),
        entry.reason,
    )
