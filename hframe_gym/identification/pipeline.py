"""Identification from recordings to a verdict: prepare, refit, select effects, evaluate on held-out runs."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..machine import Machine
from ..recordings import Recording
from ..registry import load_plugins
from .criteria import SelectionCriteria
from .dataset import Dataset, prepare, refine_encoder_offsets, with_all_measurements
from .estimation import Fit, fit, with_uncertainty
from .experiment_design import design_discriminating_experiment
from .forward_selection import Log, SelectedEffect, Selection, minimum_gain, prune_effects, select_effects
from .free_parameters import default_free_parameters
from .nonparametric import add_tables
from .prediction import POLISH_STEP, Mode, has_feedback
from .residual import channel_errors, force_error, is_white, rank_dependences
from .result import IdentificationResult, ModelEvaluation, PredictionErrors, Verdict
from .sensor_properties import Range, blank_saturated, range_effects, saturation_ranges

_HOLD_OUT_EVERY = 4  # Every fourth run is held out.
_MAX_DEPENDENCES = 6  # Variables that the report lists for the residual force.


def hold_out(recordings: Sequence[Recording], chosen: Sequence[str] = ()) -> tuple[str, ...]:
    """Choose the runs that are held out: excluded from the fit and used to evaluate it.

    Args:
        recordings: All runs.
        chosen: Names of the runs to hold out. Default: every fourth, the last one if there are fewer than four.

    Returns:
        Names of the held-out runs.

    Raises:
        InputError: If a run is unknown or no run is left to fit.
    """
    names = [r.name for r in recordings]
    unknown = [c for c in chosen if c not in names]
    if unknown:
        raise InputError(f"--hold-out {unknown[0]}: no such run; the runs are {', '.join(names)}")
    kept = tuple(chosen) or tuple(names[_HOLD_OUT_EVERY - 1 :: _HOLD_OUT_EVERY]) or tuple(names[-1:])
    if len(set(kept)) >= len(names):
        raise InputError(
            f"runs: {len(names)}, held out: {len(set(kept))}; at least one must be left to fit, so split the recording "
            "into several runs or hold out fewer"
        )
    return kept


def identify(
    recordings: Sequence[Recording],
    machine: Machine,
    *,
    held_out: Sequence[str] = (),
    criteria: SelectionCriteria | None = None,
    log: Log | None = None,
) -> IdentificationResult:
    """Identify the effects that a machine's model lacks.

    The machine's parameters are fitted to the recordings. Effects are selected that reduce the remaining error, and
    declared, refitted and corrected machine are evaluated by simulating the held-out runs, which nothing was fitted to.

    Args:
        recordings: Runs of one rig, at least two.
        machine: Machine as declared.
        held_out: Names of the runs to evaluate on. Default: every fourth, see `hold_out`.
        criteria: Decision thresholds. Default: `SelectionCriteria()`.
        log: Called with a line of text at each stage. Default: nothing is reported.

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
    kept = hold_out(recordings, held_out)
    everything, ranges = _prepare(recordings, machine, criteria, log)
    validation = with_all_measurements(everything.with_runs(kept), recordings)
    data = everything.with_runs([r.name for r in recordings if r.name not in kept])
    log(f"fitting {machine.name} to {len(data.runs)} runs, {len(validation.runs)} held out")
    base = fit(machine, default_free_parameters(machine), data, "one_step")
    before = _refined(base, data, _mode(base, data, criteria))
    log(f"refitted machine: chi-squared per sample {base.chi2:.4g} (one-step prediction)")
    if _simulates(before):
        log(f"refitted machine: chi-squared per sample {before.chi2:.4g} (simulation)")
    log("searching for effects")
    verdict, after, selected = _Search(base, before, data, criteria, log).run()
    result = _result(verdict, machine, before, after, selected, ranges, data, validation, criteria)
    log(f"verdict: {result.verdict}")
    return dataclasses.replace(result, seconds=time.perf_counter() - began)


def _prepare(
    recordings: Sequence[Recording], machine: Machine, criteria: SelectionCriteria, log: Log
) -> tuple[Dataset, dict[str, Range]]:
    """Return all recordings without saturated measurements, and the ranges of the sensors that saturate."""
    everything = prepare(recordings, machine)
    ranges = saturation_ranges(recordings, machine, everything.noise, criteria)
    if ranges:
        log(f"saturated at the end of the range: {', '.join(ranges)}")
        noise = everything.noise
        usable = [blank_saturated(r, ranges, machine, noise, criteria) for r in recordings]
        everything = prepare(usable, machine)
    for run in everything.runs:
        for warning in run.initial.warnings:
            log(f"warning: {warning}")
    return everything, ranges


def _result(
    verdict: Verdict,
    machine: Machine,
    before: Fit,
    after: Fit,
    selected: tuple[SelectedEffect, ...],
    ranges: dict[str, Range],
    data: Dataset,
    validation: Dataset,
    criteria: SelectionCriteria,
) -> IdentificationResult:
    """Evaluate declared, refitted and corrected machine on the held-out runs, and propose an experiment."""
    refined = refine_encoder_offsets(data, after.machine)
    corrected, selected = _corrected(after, selected, ranges, refined, f"{machine.name}-identified")
    refitted = before.machine.replace(name=f"{machine.name}-refitted")
    declared_evaluation, refitted_evaluation, corrected_evaluation = (
        ModelEvaluation(m, _errors(m, refine_encoder_offsets(validation, m, data)))
        for m in (machine, refitted, corrected)
    )
    experiments = (
        design_discriminating_experiment(after, corrected, s.effect.label, s.rival_effects, refined) for s in selected
    )
    validation = refine_encoder_offsets(validation, corrected, data)
    return IdentificationResult(
        verdict="effect_found" if selected and verdict == "no_effect" else verdict,
        declared=declared_evaluation,
        before=refitted_evaluation,
        after=corrected_evaluation,
        effects=selected,
        gains={s.effect.label: _held_out_gain(s, corrected, validation, before.mode) for s in selected},
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


def _simulates(fitted: Fit) -> bool:
    """Return whether a fit is one of the simulation, not of the one-step prediction."""
    return not has_feedback(fitted.mode)


def _mode(fitted: Fit, data: Dataset, criteria: SelectionCriteria) -> Mode:
    """Return the mode that decides: simulation, or one-step prediction where the simulation drifts away."""
    errors = channel_errors(fitted.machine, data)
    outputs = np.concatenate([run.outputs for run in data.runs])
    largest = 0.0
    for channel, values in zip(fitted.machine.output_channels, outputs.T, strict=True):
        rmse = errors[channel].rmse
        if rmse is not None:
            largest = max(largest, rmse / max(float(np.nanstd(values)), 1e-12))
    return "simulation" if largest < criteria.max_drift else "one_step"


def _refined(fitted: Fit, data: Dataset, mode: Mode) -> Fit:
    """Return the fit refined in a mode, at the finer integration step."""
    return fit(fitted.machine, fitted.free, data, mode, theta=fitted.theta, longest_step=POLISH_STEP)


class _Search:
    """The search for effects that explain the residual of the refitted machine.

    Args:
        base: Machine refitted in one-step prediction.
        before: Machine refitted in the mode that decides.
        data: Prepared recordings to fit.
        criteria: Decision thresholds.
        log: Called with a line of text at each stage.
    """

    def __init__(self, base: Fit, before: Fit, data: Dataset, criteria: SelectionCriteria, log: Log) -> None:
        self._base, self._before, self._data = base, before, data
        self._criteria, self._log = criteria, log
        self._refined: dict[tuple[str, ...], Fit] = {(): before}  # by labels of the effects
        self._simulation = _simulates(before)
        self._close = self._simulation and before.chi2 < criteria.max_simulation_chi2

    def run(self) -> tuple[Verdict, Fit, tuple[SelectedEffect, ...]]:
        """Search for effects, then for tables if no known effects explain the residual.

        Returns:
            Verdict: "effect_found", "no_effect" or "unexplained".
            Fit of the machine with the effects, in the mode that decides.
            The selected effects.
        """
        base, before, criteria = self._base, self._before, self._criteria
        min_gain = criteria.min_gain_one_step
        if not self._simulation:
            min_gain = max(min_gain, criteria.min_gain_fraction_unverified * base.chi2)
        selected_one_step = select_effects(
            base, (), self._data, criteria=criteria, min_gain=min_gain, log=self._log, finished=self._finished
        )
        after, effects = self._completed(*selected_one_step)
        if self._close and selected_one_step[1] and not self._explains(after):
            alternative, others = self._completed(before, ())
            if alternative.cost < after.cost:
                after, effects = alternative, others
        if self._explains(after):
            return ("effect_found", after, effects) if effects else ("no_effect", before, ())
        tabled = self._with_tables(selected_one_step, after)
        if tabled is not None:
            return "effect_found", *tabled
        if effects and after.cost < criteria.max_partial_cost_fraction * before.cost:
            return "effect_found", after, effects
        return "unexplained", before, ()

    def _completed(self, fitted: Fit, effects: tuple[SelectedEffect, ...]) -> Selection:
        """Return the fit refined, with effects that only the simulation shows, and without superfluous ones."""
        criteria, data, log = self._criteria, self._data, self._log
        current = self._refined.get(_labels(fitted)) or _refined(fitted, data, self._before.mode)
        if self._simulation:
            refined_data = refine_encoder_offsets(data, current.machine)
            if refined_data is not data:
                data = refined_data
                current = _refined(current, data, self._before.mode)
            if current.chi2 < criteria.max_simulation_chi2:
                gain = criteria.min_gain_simulation
                current, effects = select_effects(current, effects, data, criteria=criteria, min_gain=gain, log=log)
        return prune_effects(current, effects, data, criteria=criteria, log=log, longest_step=POLISH_STEP)

    def _finished(self, fitted: Fit) -> bool:
        """Return whether the simulation is explained, or shows that the last effect is not real."""
        if not self._simulation or fitted.chi2 > self._criteria.max_simulation_chi2:
            return False
        labels = _labels(fitted)
        previous = self._refined.get(labels[:-1])
        current = self._refined[labels] = _refined(fitted, self._data, self._before.mode)
        if current.chi2 < self._criteria.explained_chi2:
            return True
        if not self._close or previous is None:
            return False
        gain = (previous.cost - current.cost) / self._data.count
        return gain < minimum_gain(current, self._criteria.min_gain_simulation, self._criteria)

    def _with_tables(self, selected: Selection, after: Fit) -> Selection | None:
        """Return a model with tables, alone or beside the selected effects, if it explains the residual."""
        criteria, data, log = self._criteria, self._data, self._log
        log("no known effect explains the residual; searching for a table of force or friction")
        for start, effects, count in ((self._base, (), 1), (*selected, 2)):
            fitted, more = add_tables(start, effects, data, criteria=criteria, max_tables=count, log=log)
            if len(more) > len(effects):
                # No further search beside a table: what its straight pieces leave looks like many a small effect.
                refined = _refined(fitted, data, self._before.mode)
                candidate, kept = prune_effects(
                    refined, more, data, criteria=criteria, log=log, longest_step=POLISH_STEP
                )
                limit = criteria.max_table_cost_fraction * min(self._before.cost, after.cost)
                if kept and (self._explains(candidate) or candidate.cost < limit):
                    return candidate, kept
        return None

    def _explains(self, after: Fit) -> bool:
        """Return whether a fit leaves only the sensors' noise, or a negligible part of the initial residual."""
        criteria = self._criteria
        return after.chi2 < max(criteria.explained_chi2, criteria.explained_fraction * self._before.chi2)


def _labels(fitted: Fit) -> tuple[str, ...]:
    """Return the labels of a fitted machine's effects."""
    return tuple(e.label for e in fitted.machine.effects)


def _errors(machine: Machine, data: Dataset) -> PredictionErrors:
    """Return the errors of a machine on a data set."""
    return PredictionErrors(channel_errors(machine, data), force_error(machine, data))


def _held_out_gain(selected: SelectedEffect, machine: Machine, validation: Dataset, mode: Mode) -> float:
    """Return the fraction of the held-out squared error that this effect alone removes.

    The error is that of the simulation; where the simulation drifts, it is the error of the drives' force, if the
    machine has one.
    """

    def squared_error(m: Machine) -> float:
        force = force_error(m, validation) if has_feedback(mode) else None
        if force is not None:
            return force**2
        ratios = [e.noise_ratio for e in channel_errors(m, validation).values() if e.noise_ratio is not None]
        return float(np.mean(np.square(ratios)))

    others = tuple(e for e in machine.effects if e.label != selected.effect.label)
    structural = selected.effect.definition.structure
    without = selected.machine_without if structural else machine.replace(effects=others)
    return 1.0 - squared_error(machine) / squared_error(without)
