"""Rivals: effects that explain the same error. Which of several trials is preferred, and which one is more likely."""

from __future__ import annotations

from collections.abc import Sequence

from ..machine import AppliedEffect
from .criteria import SelectionCriteria
from .dataset import Dataset
from .estimation import Fit
from .evidence import long_run_variance
from .model_error import at_bandwidth, information_loss, polish
from .prediction import SIMULATION
from .trial_fits import fit_in_place_of


def _margin(current: Fit, best_cost: float, data: Dataset, criteria: SelectionCriteria) -> float:
    """Return the difference of cost from the best trial within which another one explains the data as well."""
    gain = current.cost - best_cost
    return max(criteria.rival_gain_margin * data.count, (1.0 - criteria.rival_gain_fraction) * gain)


def simplest_first(trials: list[Fit], current: Fit, data: Dataset, criteria: SelectionCriteria) -> list[Fit]:
    """Sort trials by their cost; those as good as the best one come first, fewest parameters first.

    Args:
        trials: Fits with one candidate effect (deviation from the model) each.
        current: Fit without candidates, at the same bandwidth (rad/s) of the observer that corrects predictions.
        data: Prepared recordings (times, voltages, measurements, SI).
        criteria: Decision thresholds.

    Returns:
        The trials in that order, each with the parameters theta, shape (k,).
    """
    ranked = sorted(trials, key=lambda trial: trial.cost)
    if not ranked:
        return ranked
    limit = ranked[0].cost + _margin(current, ranked[0].cost, data, criteria)
    return sorted(ranked, key=lambda trial: (trial.cost > limit, len(trial.free) if trial.cost <= limit else 0))


def close_rivals(
    trials: list[Fit], current: Fit, data: Dataset, criteria: SelectionCriteria
) -> tuple[AppliedEffect, ...]:
    """Return the effects (deviations from the model) of trials that explain the data as well as the first one.

    Args:
        trials: Fits with one candidate each, the selected one first.
        current: Fit without candidates, at the same bandwidth (rad/s) of the observer that corrects predictions.
        data: Prepared recordings (times, voltages, measurements, SI).
        criteria: Decision thresholds.

    Returns:
        Effects with their fitted parameters.
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
    """Find the rival that is more likely than an effect of the machine, by more than chance may explain.

    Args:
        current: Fit of the machine with all effects (deviations from the model).
        label: Label (name@site) of the effect that may be replaced.
        rivals: Its rivals; structural ones, and those that the machine has already, are not tried.
        data: Prepared recordings to fit (times, voltages, measurements, SI).
        criteria: Decision thresholds.

    Returns:
        Fit (machine, parameters theta, shape (k,), cost) with the most likely rival in its place, as the last effect,
        at the given observer bandwidth (rad/s) or in simulation. None if no rival is more likely.
    """
    present = {effect.label for effect in current.machine.effects}
    possible = [rival for rival in rivals if not rival.definition.structure and rival.label not in present]
    best, least = None, information_loss(_polished(current, data), data) if possible else 0.0
    for rival in possible:
        trial = _polished(fit_in_place_of(current, label, rival, data), data)
        enough = criteria.min_chance_gain * long_run_variance(trial, rival.label, data) / data.count
        loss = information_loss(trial, data)
        if loss < least - enough:
            best, least = trial, loss
    return best


def _polished(fitted: Fit, data: Dataset) -> Fit:
    """Return the more likely one of a fit with the shortest integration step and of the same in simulation.

    The errors of the search's integration step would hide what distinguishes a delay of 0.1 ms from a lag.
    """
    fits = (polish(fitted, data), polish(at_bandwidth(fitted, SIMULATION, data), data))
    return min(fits, key=lambda candidate: information_loss(candidate, data))
