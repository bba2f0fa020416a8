"""Forward selection of the effects that a machine lacks.

The best candidates of the screening are fitted together with the machine's parameters; the best of them is selected if
it reduces chi-squared per sample by enough, and the search continues from there. At the end, effects that no longer
reduce it by enough are removed. `SelectionCriteria` holds the thresholds. A gain is a reduction of chi-squared.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..machine import AppliedEffect, Machine
from .candidates import candidates, effect_parameters
from .criteria import SelectionCriteria
from .dataset import Dataset, TypicalScales, scales_of_motion
from .estimation import Fit, fit, with_uncertainty
from .free_parameters import FreeParameter, default_free_parameters
from .model_error import effect_force, fit_with_model_error, leave_one_out_gain, residue_force, search_step
from .prediction import SEARCH_BANDWIDTH, map_runs, predict
from .residual import missing_force
from .screening import ScoredCandidate, screen, screen_structures

Array = NDArray[np.float64]
Log = Callable[[str], None]
_TRIAL_ITERATIONS, _TRIAL_TOLERANCE = 8, 1e-3  # A trial need not converge fully to be ranked.


@dataclass(frozen=True)
class SelectedEffect:
    """An effect of the corrected machine.

    Attributes:
        effect: The effect with its fitted parameters.
        rivals: Labels of effects that explain the data equally well, and descriptions of causes that no recording can
            distinguish from this effect.
        gain: Reduction of chi-squared per sample on the fitted runs.
        machine_without: The machine as it was fitted before the effect was added.
        rival_effects: The rivals among the fitted candidates.
    """

    effect: AppliedEffect
    rivals: tuple[str, ...]
    gain: float
    machine_without: Machine
    rival_effects: tuple[AppliedEffect, ...] = ()

    def with_values(self, machine: Machine) -> SelectedEffect:
        """Return a copy in which the effect has the parameter values of a machine that was fitted later.

        Args:
            machine: Machine that contains the effect.

        Returns:
            Copy with the updated effect.
        """
        effect = next(e for e in machine.effects if e.label == self.effect.label)
        return dataclasses.replace(self, effect=effect)


Selection = tuple[Fit, tuple[SelectedEffect, ...]]


@dataclass(frozen=True)
class ConsideredEffect:
    """An effect that reduces the error but was not selected.

    Attributes:
        label: Label of the effect, name@site.
        gain: Reduction of chi-squared per sample on the fitted runs.
        reason: Why it was not selected; a clause that follows "it ".
    """

    label: str
    gain: float
    reason: str


class EffectSearch:
    """Forward selection of effects, at the observer bandwidth that the remaining model error requires.

    Args:
        data: Prepared recordings to fit.
        criteria: Decision thresholds.
        log: Called with a line of text for the candidates of each step, selected or not.

    Attributes:
        considered: Effects that reduced the error but failed a test, by label.
    """

    def __init__(self, data: Dataset, criteria: SelectionCriteria, log: Log) -> None:
        self._data, self._criteria, self._log = data, criteria, log
        self.considered: dict[str, ConsideredEffect] = {}

    def run(self, current: Fit, selected: tuple[SelectedEffect, ...] = ()) -> Selection:
        """Add one effect after another while one reduces the error by enough and passes the tests of `_doubt`.

        Args:
            current: Fit of the machine with the effects selected so far.
            selected: Effects selected so far.

        Returns:
            Fit of the machine with all effects, at the bandwidth that its remaining error requires.
            All selected effects with their fitted parameters.
        """
        data, criteria = self._data, self._criteria
        while len(selected) < criteria.max_effects and current.chi2 > criteria.noise_level:
            enough = minimum_gain(current, criteria)
            trials = sorted(_trials(current, data, enough, criteria), key=lambda trial: trial.cost)
            best = self._best(current, trials, enough)
            if best is None:
                break
            trials = [best, *(t for t in trials if t.machine.effects[-1].label != best.machine.effects[-1].label)]
            effect, gain = best.machine.effects[-1], (current.cost - best.cost) / data.count
            close = _rivals(trials, current, data, criteria)
            names = (*(e.label for e in close), *effect.definition.equivalent)
            selected = (*selected, SelectedEffect(effect, names, gain, current.machine, close))
            current = fit_with_model_error(best, data)
        for s in selected:
            self.considered.pop(s.effect.label, None)
        return current, tuple(s.with_values(current.machine) for s in selected)

    def _best(self, current: Fit, trials: list[Fit], enough: float) -> Fit | None:
        """Return the converged fit of the first trial that passes all tests, None if there is none."""
        for trial in trials:
            if (current.cost - trial.cost) / self._data.count < self._criteria.min_trial_gain * enough:
                return None
            converged = _converged(trial, self._data)
            effect, gain = converged.machine.effects[-1], (current.cost - converged.cost) / self._data.count
            self._log(f"  {effect.label} {describe_gain(current, converged)}")
            if gain < enough:
                continue
            doubt = self._doubt(current, converged)
            if not doubt:
                return converged
            self._log(f"  {effect.label} is not selected: it {doubt}")
            self.considered[effect.label] = ConsideredEffect(effect.label, gain, doubt)
        return None

    def _doubt(self, current: Fit, trial: Fit) -> str:
        """Return why a candidate may not exist although it reduces the error, "" if nothing speaks against it."""
        data, criteria = self._data, self._criteria
        gain = current.cost - trial.cost
        confirmed = leave_one_out_gain(current, trial, data)
        if confirmed < criteria.min_confirmed_fraction * gain:
            return f"is not confirmed by runs that it was not fitted to ({100 * confirmed / gain:.0f} % of the gain)"
        size = effect_force(trial.machine, trial.machine.effects[-1], data)
        residue = residue_force(trial, data)
        if size < criteria.min_force_ratio * residue:
            return f"has a force of {1e3 * size:.2g} mN, where {1e3 * residue:.2g} mN remain unexplained"
        return ""


def describe_gain(before: Fit, after: Fit) -> str:
    """Describe the benefit of an effect: "reduces chi-squared per sample from 98.99 to 0.79 (simulation)".

    Args:
        before: Fit without the effect.
        after: Fit with the effect, at the same observer bandwidth.

    Returns:
        Text that continues a sentence whose subject is the effect.
    """
    observer = f"observer of {before.bandwidth:g} rad/s" if before.bandwidth else "simulation"
    return f"reduces chi-squared per sample from {before.chi2:.4g} to {after.chi2:.4g} ({observer})"


def _trials(current: Fit, data: Dataset, enough: float, criteria: SelectionCriteria) -> list[Fit]:
    """Return the fits of the most promising candidates; structural ones are tried where no other explains the data."""
    scales = typical_scales(current, data)
    proposed = candidates(
        current.machine,
        data,
        scales,
        missing_force(current.machine, data),
        slow_friction=current.bandwidth < SEARCH_BANDWIDTH,
    )
    promising = _promising(screen(current, proposed, data), enough * data.count, criteria)
    trials = [fit_with_candidate(current, scored, scales, data) for scored in promising]
    floor = criteria.one_step_floor if current.bandwidth >= SEARCH_BANDWIDTH else 1.0
    if not any(t.chi2 - floor < criteria.structural_remainder * (current.chi2 - floor) for t in trials):
        any_useful = max((current.cost - t.cost for t in trials), default=0.0) >= enough * data.count
        machines = screen_structures(current, data, scales, enough if any_useful else 0.0)
        trials += [_replace(current, machine, scales, data) for machine in machines]
    return trials


def _promising(ranked: list[ScoredCandidate], enough: float, criteria: SelectionCriteria) -> list[ScoredCandidate]:
    """Return the few best candidates, one shape of each effect and site, that may reduce the cost by enough."""
    best: dict[str, ScoredCandidate] = {}
    least = max(criteria.linear_gain_ratio * enough, criteria.min_promise * ranked[0].gain if ranked else 0.0)
    for scored in ranked:
        if scored.gain > least:
            best.setdefault(scored.candidate.label, scored)
    return list(best.values())[: criteria.max_full_fits]


def fit_with_candidate(current: Fit, scored: ScoredCandidate, scales: TypicalScales, data: Dataset) -> Fit:
    """Add a candidate effect to the machine and fit the parameters of both together, with few iterations.

    Args:
        current: Fit without the effect; its observer bandwidth is used.
        scored: Screened candidate with the weights of its basis functions.
        scales: Typical sizes on this machine.
        data: Prepared recordings to fit.

    Returns:
        Fit that suffices to rank the candidate, not fully converged.
    """
    machine = current.machine.with_effects(scored.candidate.applied(scored.amounts))
    added = effect_parameters(machine.effects[-1], machine, scales)
    values = machine.parameters
    theta = np.concatenate([current.theta, [f.theta(values[f.name]) for f in added]])
    return _trial_fit(machine, (*current.free, *added), theta, current, data)


def _replace(current: Fit, machine: Machine, scales: TypicalScales, data: Dataset) -> Fit:
    """Fit a machine in which an effect replaces a part of the model, with default free parameters.

    Where the structure is new, the search starts from the declared parameters: those fitted without the effect
    compensate for it.
    """
    effect = machine.effects[-1]
    if effect.definition.structure:
        declared = {f.name: f.center for f in current.free if "@" not in f.name}
        machine = current.machine.replace(declared).with_effects(effect)
    free = list(default_free_parameters(machine, effects=False))
    for e in machine.effects:
        free += effect_parameters(e, machine, scales)
    theta = np.array([f.theta(machine.parameters[f.name]) for f in free])
    return _trial_fit(machine, tuple(free), theta, current, data)


def _trial_fit(machine: Machine, free: tuple[FreeParameter, ...], theta: Array, current: Fit, data: Dataset) -> Fit:
    """Fit a candidate with few iterations, at the bandwidth of the current fit."""
    return fit(
        machine,
        free,
        data,
        current.bandwidth,
        theta=theta,
        iterations=_TRIAL_ITERATIONS,
        tolerance=_TRIAL_TOLERANCE,
        longest_step=search_step(current.bandwidth),
    )


def _converged(trial: Fit, data: Dataset) -> Fit:
    """Return the better of two converged fits, from the trial and from the declared parameters.

    Without the effect the machine's parameters had compensated for it, sometimes in a local minimum.
    """
    of_effects = np.array(["@" in f.name for f in trial.free])
    fits = [
        fit(trial.machine, trial.free, data, trial.bandwidth, theta=theta, longest_step=search_step(trial.bandwidth))
        for theta in (trial.theta, np.where(of_effects, trial.theta, 0.0))
    ]
    return min(fits, key=lambda candidate_fit: candidate_fit.cost)


def _rivals(trials: list[Fit], current: Fit, data: Dataset, criteria: SelectionCriteria) -> tuple[AppliedEffect, ...]:
    """Return the effects of the trials that explain the data as well as the best one."""
    best = trials[0]
    margin = max(
        criteria.rival_gain_margin * data.count, (1.0 - criteria.rival_gain_fraction) * (current.cost - best.cost)
    )
    close = (t.machine.effects[-1] for t in trials[1:] if t.cost - best.cost < margin)
    return tuple(e for e in close if e.label != best.machine.effects[-1].label)


def minimum_gain(current: Fit, criteria: SelectionCriteria) -> float:
    """Return the smallest reduction of chi-squared per sample for which an effect is selected.

    Args:
        current: Fit without the effect; its bandwidth decides between the limits of simulation and prediction.
        criteria: Decision thresholds, which raise the result for short recordings and large residuals.

    Returns:
        Required reduction of chi-squared per sample.
    """
    wide = current.bandwidth >= SEARCH_BANDWIDTH
    min_gain = criteria.min_gain_one_step if wide else criteria.min_gain_simulation
    excess = current.chi2 - 1.0
    large = excess >= criteria.large_excess
    fraction = criteria.min_gain_fraction_large_excess if large else criteria.min_gain_fraction
    return max(min_gain, criteria.min_total_gain / current.count, fraction * excess)


def prune_effects(
    current: Fit,
    selected: tuple[SelectedEffect, ...],
    data: Dataset,
    *,
    criteria: SelectionCriteria,
    log: Log,
    longest_step: float,
) -> Selection:
    """Remove effects without which the machine fits the data as well, weakest first.

    Later effects may make earlier ones superfluous. An effect is also removed if its amplitude is within a few standard
    deviations of zero. Structural effects are kept, because the other effects act on the coordinates that they add.

    Args:
        current: Fit of the machine with all selected effects; its observer bandwidth is used throughout.
        selected: All selected effects.
        data: Prepared recordings to fit.
        criteria: Decision thresholds.
        log: Called with a line of text for every effect that is removed.
        longest_step: Maximum integration step, s.

    Returns:
        Fit of the machine with the remaining effects.
        The remaining effects with their fitted parameters.
    """
    for candidate in sorted(selected, key=lambda s: s.gain):
        if candidate.effect.definition.structure:
            continue
        reduced = without_effect(current, candidate.effect.label, data, longest_step=longest_step)
        gain = (reduced.cost - current.cost) / data.count
        superfluous = gain < minimum_gain(current, criteria)
        if superfluous or _uncertain(current, candidate.effect, data, criteria):
            reason = "has no effect on the error" if superfluous else "has an amplitude that may be zero"
            log(f"  {candidate.effect.label} is removed: it {reason}")
            # The others are examined again: what was worth its place beside this effect need not be so alone.
            others = tuple(s for s in selected if s is not candidate)
            return prune_effects(reduced, others, data, criteria=criteria, log=log, longest_step=longest_step)
    return current, tuple(s.with_values(current.machine) for s in selected)


def _uncertain(current: Fit, effect: AppliedEffect, data: Dataset, criteria: SelectionCriteria) -> bool:
    """Return whether an effect's only amplitude is within a few standard deviations of zero."""
    names = effect.definition.amplitudes
    if len(names) != 1:
        return False
    machine = with_uncertainty(current, data)
    name = f"{effect.label}.{names[0]}"
    std = machine.uncertainty.std(name) if machine.uncertainty else None
    return std is not None and abs(machine.parameters[name]) < criteria.min_standard_deviations * std


def without_effect(current: Fit, label: str, data: Dataset, *, longest_step: float) -> Fit:
    """Remove one effect from the machine and fit the remaining free parameters again.

    Args:
        current: Fit of the machine with the effect; its observer bandwidth is used.
        label: Label of the effect, name@site.
        data: Prepared recordings to fit.
        longest_step: Maximum integration step, s.

    Returns:
        Fit without the effect.
    """
    others = tuple(e for e in current.machine.effects if e.label != label)
    kept = [i for i, free in enumerate(current.free) if not free.name.startswith(f"{label}.")]
    return fit(
        current.machine.replace(effects=others),
        [current.free[i] for i in kept],
        data,
        current.bandwidth,
        theta=current.theta[kept],
        longest_step=longest_step,
    )


def typical_scales(current: Fit, data: Dataset) -> TypicalScales:
    """Compute typical forces, speeds and travels from the motion that a fitted machine predicts.

    Args:
        current: Fit of the machine.
        data: Prepared recordings.

    Returns:
        Typical sizes, see `TypicalScales`.
    """
    motions = list(
        map_runs(lambda run: predict(current.machine, run, current.bandwidth, period=data.period, states=True), data)
    )
    positions, velocities = (
        np.concatenate([getattr(m, key)[0] for m in motions]) for key in ("positions", "velocities")
    )
    return scales_of_motion(current.machine, positions, velocities, [run.inputs for run in data.runs])
