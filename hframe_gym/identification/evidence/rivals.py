"""Choose between rivals: effects that explain the data about equally well.

A trial is the fit of a machine with one candidate effect, the last one in its list. Two trials are equally
good if their costs (sums of squared residuals in units of the noise) differ by less than a margin of
`SelectionCriteria`.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from functools import cache
from typing import NamedTuple

from ...effects import EFFECTS, effect_sites
from ...machine import AppliedEffect, Machine
from ...preparation.dataset import Dataset
from ..fit.estimation import Fit
from ..fit.long_run_variance import long_run_variance
from ..fit.model_error import (
    bandwidths_for,
    continue_fit,
    cost_of_loss,
    has_narrowest_observer,
    likelihood_loss,
    polish,
)
from ..fit.voltage_updates import is_timing
from ..judge.chance import LongRunVariance
from ..judge.criteria import SelectionCriteria
from ..judge.effect import parameter_at_limit, simpler_effect
from ..judge.rival import (
    RivalEvidence,
    TrialEvidence,
    chance_margin,
    equal_margin,
    is_likelier,
    may_be_the_cause,
    only_a_row_tells,
    preference,
    remains_rival,
)
from ..judge.trial import gives_way
from ..predict.prediction import SEARCH_BANDWIDTH
from ..propose.candidates import is_required
from ..propose.trial_fits import fit_in_place_of
from .effect_parameters import parameter_values


def simplest_first(trials: list[Fit], current: Fit, criteria: SelectionCriteria) -> list[Fit]:
    """Sort trial fits of different effects by preference: of equally good fits, the simplest comes first.

    Fits are as good as the best one if their cost (sum of squared residuals in units of the noise) exceeds
    its cost by no more than 3 % of the reduction from the cost of `current` to that of the best fit.

    Args:
        trials: Fits with one candidate effect each.
        current: Fit without a candidate, with the same observer bandwidth (rad/s) as the trials.
        criteria: Decision threshold `rival_gain_fraction`, whose default gives these 3 %.

    Returns:
        The same fits in a new order. First those that are as good as the best one, by number of free
        parameters; with equal numbers, effects that need no special part of the machine, such as a magnet,
        come first. Then all others, by cost.
    """
    ranked = sorted(trials, key=lambda trial: trial.cost)
    if not ranked:
        return ranked
    limit = ranked[0].cost + equal_margin(current.error, ranked[0].cost, criteria)

    def key(trial: Fit) -> tuple[bool, int, bool]:
        needs_part = bool(trial.machine.effects[-1].definition.needs_part)
        return preference(trial.cost, len(trial.free), needs_part, limit)

    return sorted(ranked, key=key)


def limited_last(trials: list[Fit], current: Fit) -> list[Fit]:
    """Move trial fits with a parameter at its limit behind others that explain about as much.

    Args:
        trials: Fits with one candidate effect each.
        current: Fit without a candidate, with the same observer bandwidth (rad/s) as the trials.

    Returns:
        The same fits. The last ones are those with a parameter at its limit that reduce the cost by less than
        twice as much as the best fit without one (`judge.trial.gives_way`).
    """

    def gain(trial: Fit) -> float:
        return current.cost - trial.cost

    def at_limit(trial: Fit) -> bool:
        return bool(parameter_at_limit(parameter_values(trial.machine.effects[-1].label, trial)))

    best_other = max((gain(trial) for trial in trials if not at_limit(trial)), default=0.0)
    return sorted(trials, key=lambda trial: at_limit(trial) and gives_way(gain(trial), best_other))


def selected_first(best: Fit, trials: list[Fit]) -> list[Fit]:
    """Return the fit of the selected effect, followed by the trial fits of other effects.

    Args:
        best: Converged fit whose last effect is the selected one; it takes the place of its trials.
        trials: Fits with one candidate effect each.
    """
    label = best.machine.effects[-1].label
    return [best, *(t for t in trials if t.machine.effects[-1].label != label)]


def close_rivals(
    trials: list[Fit], current: Fit, variance: Callable[[], LongRunVariance], criteria: SelectionCriteria
) -> tuple[AppliedEffect, ...]:
    """Return the rivals of a selected effect: other tried effects that may be the actual cause.

    Which ones may, `judge.rival.may_be_the_cause` decides.

    Args:
        trials: Fits with one candidate effect each; the first has the selected effect.
        current: Fit without a candidate, with the same observer bandwidth (rad/s) as the trials.
        variance: Function that returns the variance that the residual of the first trial has in the direction
            of its effect (`long_run_variance`); it is called at most once, if a rival needs it.
        criteria: Decision thresholds of `may_be_the_cause`.

    Returns:
        Rivals with their fitted parameters, each effect once per component, in the order of the trials.
    """
    best = trials[0]
    selected = best.machine.effects[-1].label
    variance = cache(variance)
    close: dict[str, AppliedEffect] = {}  # an effect may have been tried from several starting values
    for trial in trials[1:]:
        effect = trial.machine.effects[-1]
        evidence = TrialEvidence(current.error, best.error, trial.cost, variance)
        if effect.label != selected and may_be_the_cause(evidence, criteria):
            close.setdefault(effect.label, effect)
    return tuple(close.values())


def rivals_in_combination(
    effect: AppliedEffect, rivals: Sequence[AppliedEffect], others: Sequence[AppliedEffect], machine: Machine
) -> tuple[AppliedEffect, ...]:
    """Return further possible rivals of an effect that was selected together with others of its kind.

    Two constant forces at two components move a stage of two axes like two others at other components,
    although no single one is like another. The search compares effects one by one, so that it does not find
    these rivals.

    Args:
        effect: The selected effect.
        rivals: Its known rivals.
        others: All other selected effects and their rivals.
        machine: Machine with all selected effects.

    Returns:
        One effect of the same kinds at each coordinate that has none of them, with amplitude 0; only kinds
        whose single parameter is an amplitude, for example `constant_force` and `voltage_offset`. Empty if no
        other effect is of these kinds.
    """
    kinds = {e.name: e.definition for e in (effect, *rivals)}
    of_others = {e.name: e.definition for e in others}
    if not kinds.keys() & of_others.keys():
        return ()
    kinds |= of_others
    present = [e for e in (*machine.effects, *rivals) if e.name in kinds]
    occupied = {machine.coordinate_of_site(e.site, e.definition.site) for e in present}
    further: list[AppliedEffect] = []
    for definition in kinds.values():
        if definition.structure or not len(definition.amplitudes) == len(definition.parameters) == 1:
            continue
        for site in effect_sites(definition, machine):
            coordinate = machine.coordinate_of_site(site, definition.site)
            if coordinate is not None and coordinate not in occupied:
                occupied.add(coordinate)
                further.append(definition.at(site, **dict.fromkeys(definition.amplitudes, 0.0)))
    return tuple(further)


def hidden_rivals(effect: AppliedEffect, data: Dataset) -> tuple[AppliedEffect, ...]:
    """Return effects that a log cannot distinguish from a delay or lag, because it lacks some voltages.

    Args:
        effect: A selected effect.
        data: Runs that were fitted.

    Returns:
        The other delays and lags at the same site, with the same duration. Empty if the effect is neither a
        delay nor a lag, lasts too long to pass within a row (`judge.rival.only_a_row_tells`), or if all
        voltages are known.
    """
    if not is_timing(effect.definition) or not data.has_voltage_errors:
        return ()
    durations = [*effect.parameters.values()]
    if not only_a_row_tells(durations, data.period):
        return ()
    others = (e for e in EFFECTS.values() if is_timing(e) and e.name != effect.name)
    return tuple(
        other.at(effect.site, **{p.name: max(durations) for p in other.parameters}) for other in others
    )


class ComparedRivals(NamedTuple):
    """Comparison of an effect of the machine with its rivals, beside all other effects.

    Attributes:
        better: Fit with the most likely rival in place of the effect, the last effect of its machine, at the
            observer bandwidth of the given fit or in simulation; None if no rival is more likely.
        remaining: Rivals that remain possible: chance explains by how much they are less likely than the
            effect, or they were not tried.
    """

    better: Fit | None
    remaining: tuple[AppliedEffect, ...]


def compare_rivals(
    current: Fit,
    label: str,
    rivals: Sequence[AppliedEffect],
    data: Dataset,
    criteria: SelectionCriteria,
    *,
    in_combination: Sequence[AppliedEffect] = (),
    likely: Callable[[], Fit] | None = None,
) -> ComparedRivals:
    """Compare an effect of a machine with its rivals by likelihood; each is fitted in place of the effect.

    Rivals that the log cannot distinguish (`hidden_rivals`) remain without being fitted. A rival replaces the
    effect, or is excluded, only if the difference in likelihood exceeds what chance may cause: `chance` of
    the criteria, increased where the residual is correlated in time.

    Args:
        current: Fit of the machine with all effects.
        label: Label (name@site) of the effect to compare.
        rivals: Its rivals. Rivals that add coordinates (structural effects) are not tried. Rivals that the
            machine contains beside the effect are dropped, because both exist, and so are those that are a
            simpler effect with their fitted parameters. None is tried for an effect that adds
            coordinates, or that another effect requires.
        in_combination: Further rivals, from `rivals_in_combination`, whose size is not known yet.
        likely: Function that returns `most_likely_fit` of the fit, if it is already known.

    Returns:
        The most likely rival and those that remain, with parameters fitted beside all other effects.
    """
    present = {effect.label: effect for effect in current.machine.effects}
    rivals = tuple(rival for rival in (*rivals, *in_combination) if rival.label not in present)
    untold = {rival.label for rival in hidden_rivals(present[label], data)}
    possible = [rival for rival in rivals if not rival.definition.structure and rival.label not in untold]
    if not possible or present[label].definition.structure or is_required(current.machine, label):
        return ComparedRivals(None, tuple(rivals))

    def margin_of(fitted: Fit, fitted_label: str) -> float:
        """Return the difference of losses that chance may cause if the fit with this effect is right."""
        return chance_margin(long_run_variance(fitted, fitted_label, data), data.count, criteria)

    present_fit = likely() if likely else most_likely_fit(current, data)
    loss, margin = likelihood_loss(present_fit, data), margin_of(present_fit, label)
    better, least, tried = None, loss, {}
    for rival in possible:
        known = rival not in in_combination
        # A known rival that exceeds this loss neither replaces the effect nor remains.
        largest = loss + margin if known else math.inf
        if known:
            goal = _goal(largest, current, data)
            start = fit_in_place_of(current, label, rival, data, goal=goal)
        else:
            start = _sized(current, label, rival, data)
        trial = most_likely_fit(start, data, largest)
        if simpler_effect(parameter_values(rival.label, trial)):
            continue
        rival_loss, own_margin = likelihood_loss(trial, data), margin_of(trial, rival.label)
        evidence = RivalEvidence(loss, margin, rival_loss, own_margin, known)
        if is_likelier(evidence, least):
            better, least = trial, rival_loss
        if remains_rival(evidence):
            tried[rival.label] = trial.machine.effects[-1]
    untried = {rival.label: rival for rival in rivals if rival not in possible}
    remaining = tried | untried
    return ComparedRivals(
        better, tuple(remaining[rival.label] for rival in rivals if rival.label in remaining)
    )


def _sized(current: Fit, label: str, rival: AppliedEffect, data: Dataset) -> Fit:
    """Fit a rival of unknown size in place of an effect, first with the widest observer.

    In a simulation, the missing force displaces the stage so far that the fit would not find the way back.
    """
    wide = dataclasses.replace(current, bandwidth=SEARCH_BANDWIDTH)
    return continue_fit(fit_in_place_of(wide, label, rival, data), data, current.bandwidth)


def most_likely_fit(fitted: Fit, data: Dataset, largest_loss: float = math.inf) -> Fit:
    """Fit again with the observer of a fit and with the narrowest one; return the more likely fit.

    The narrowest observer that suits the data is that of a simulation, if the voltages are known
    (`bandwidths_for`). Both fits have the shortest integration step: that of the search is too inaccurate to
    distinguish a delay of 0.1 ms from a lag.

    Args:
        fitted: Fit at any observer bandwidth, from which both fits start.
        data: Runs to fit.
        largest_loss: Loss, -2 log(likelihood) per measured value, dimensionless; a fit that cannot become as
            small ends early. Default: no early end.
    """
    narrowest = bandwidths_for(data)[-1]
    fits = [fitted]
    if fitted.bandwidth != narrowest:
        goal = cost_of_loss(largest_loss, fitted.machine, data, narrowest)
        fits.append(continue_fit(fitted, data, narrowest, goal=goal))
    return min(
        (
            polish(start, data, goal=cost_of_loss(largest_loss, start.machine, data, start.bandwidth))
            for start in fits
        ),
        key=lambda candidate: likelihood_loss(candidate, data),
    )


def _goal(largest_loss: float, fitted: Fit, data: Dataset) -> float:
    """Return the cost above which a fit at a bandwidth is of no use; infinite if it goes on in simulation."""
    if not has_narrowest_observer(fitted, data):
        return math.inf
    return cost_of_loss(largest_loss, fitted.machine, data, fitted.bandwidth)
