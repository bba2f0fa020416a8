"""Choose between rivals: effects (deviations from the nominal model) that explain the data about equally well.

A trial is the fit of a machine with one candidate effect, the last one in its list. Two trials are equally good if
their costs (sums of squared residuals in units of the noise) differ by less than a margin of `SelectionCriteria`.
"""

from __future__ import annotations

from collections.abc import Sequence

from ..machine import AppliedEffect
from .criteria import SelectionCriteria
from .dataset import Dataset
from .estimation import Fit
from .evidence import long_run_variance
from .model_error import at_bandwidth, likelihood_loss, polish
from .prediction import SIMULATION
from .trial_fits import fit_in_place_of


def _margin(current: Fit, best_cost: float, data: Dataset, criteria: SelectionCriteria) -> float:
    """Return the difference of cost from the best trial up to which another trial is equally good."""
    gain = current.cost - best_cost
    return max(criteria.rival_gain_margin * data.count, (1.0 - criteria.rival_gain_fraction) * gain)


def simplest_first(trials: list[Fit], current: Fit, data: Dataset, criteria: SelectionCriteria) -> list[Fit]:
    """Sort trial fits of different effects by preference: of equally good ones, that with fewest parameters first.

    Fits are as good as the best one if their cost (sum of squared residuals in units of the noise) exceeds its cost by
    no more than a margin.

    Args:
        trials: Fits with one candidate effect (deviation from the model) each.
        current: Fit without candidates, at the same bandwidth (rad/s) of the observer that corrects predictions.
        data: Prepared recordings (times, voltages, measurements, SI).
        criteria: Decision thresholds, among them the margin.

    Returns:
        First the fits that are as good as the best one, by the number k of their parameters (theta, shape (k,)); then
        all others, by cost.
    """
    ranked = sorted(trials, key=lambda trial: trial.cost)
    if not ranked:
        return ranked
    limit = ranked[0].cost + _margin(current, ranked[0].cost, data, criteria)
    return sorted(ranked, key=lambda trial: (trial.cost > limit, len(trial.free) if trial.cost <= limit else 0))


def close_rivals(
    trials: list[Fit], current: Fit, data: Dataset, criteria: SelectionCriteria
) -> tuple[AppliedEffect, ...]:
    """Return the rivals of a selected effect: effects of other trial fits that explain the data about equally well.

    Args:
        trials: Fits with one candidate effect (deviation from the model) each, that of the selected effect first.
        current: Fit without candidates, at the same bandwidth (rad/s) of the observer that corrects predictions.
        data: Prepared recordings (times, voltages, measurements, SI).
        criteria: Decision thresholds, among them the margin within which costs count as equal.

    Returns:
        Rivals with their fitted parameters, each effect and site once, in the order of the trials.
    """
    best = trials[0]
    margin = _margin(current, best.cost, data, criteria)
    close: dict[str, AppliedEffect] = {}  # an effect may have been tried from several starting values
    for trial in trials[1:]:
        effect = trial.machine.effects[-1]
        if trial.cost - best.cost < margin and effect.label != best.machine.effects[-1].label:
            close.setdefault(effect.label, effect)
    return tuple(close.values())


def more_likely_rival(
    current: Fit, label: str, rivals: Sequence[AppliedEffect], data: Dataset, criteria: SelectionCriteria
) -> Fit | None:
    """Replace an effect of the machine by each of its rivals and find the most likely one.

    A rival must be more likely than the effect by more than chance can explain, see `evidence.long_run_variance`.

    Args:
        current: Fit of the machine with all effects (deviations from the model).
        label: Label (name@site) of the effect to replace.
        rivals: Its rivals. Those that add coordinates (structural effects) and those that the machine already has are
            not tried.
        data: Prepared recordings to fit (times, voltages, measurements, SI).
        criteria: Decision thresholds.

    Returns:
        Fit (machine, parameters theta, shape (k,), cost) with the most likely rival, the last effect of its machine, at
        the observer bandwidth of `current` or in simulation. None if no rival is more likely.
    """
    present = {effect.label for effect in current.machine.effects}
    possible = [rival for rival in rivals if not rival.definition.structure and rival.label not in present]
    best, least = None, likelihood_loss(_polished(current, data), data) if possible else 0.0
    for rival in possible:
        trial = _polished(fit_in_place_of(current, label, rival, data), data)
        enough = criteria.min_chance_gain * long_run_variance(trial, rival.label, data) / data.count
        loss = likelihood_loss(trial, data)
        if loss < least - enough:
            best, least = trial, loss
    return best


def _polished(fitted: Fit, data: Dataset) -> Fit:
    """Fit with the shortest integration step, at the given bandwidth and in simulation; return the more likely fit.

    The longer integration step of the search is too inaccurate to distinguish a delay of 0.1 ms from a lag.
    """
    fits = (polish(fitted, data), polish(at_bandwidth(fitted, SIMULATION, data), data))
    return min(fits, key=lambda candidate: likelihood_loss(candidate, data))
