"""Fit candidate effects together with the machine's parameters, with few iterations, to rank them.

An effect is a deviation from the nominal model; a structural one adds coordinates. A trial is the fit of a
machine with one candidate effect, its last one. The cost is chi-squared, the sum of squared residuals in
units of the noise.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from ...arrays import Array
from ...dynamics.simulation import Motion
from ...machine import AppliedEffect, Machine
from ...preparation.dataset import Dataset, PreparedRecording
from ..budget import spend
from ..fit.estimation import Fit, fit, prediction_cost
from ..fit.model_error import continue_fit, polish, search_step
from ..forces.force_sizes import effect_force, residue_force
from ..judge import trial as judge
from ..judge.criteria import SelectionCriteria
from ..judge.error import FitError
from ..predict.free_parameters import (
    FreeParameter,
    default_free_parameters,
    prior_precision,
    values_at,
)
from ..predict.linearization import ResidualModel
from ..predict.prediction import POLISH_STEP, SEARCH_BANDWIDTH, SIMULATION, predict
from .candidates import Candidate, SearchState, candidates, effect_parameters, is_required
from .screening import Resemblance, ScoredCandidate, Screening
from .structures import screen_structures
from .typical_scales import TypicalScales, typical_scales

# Effects that are fitted in place of a selected one because these runs may not distinguish them.
_RESEMBLING = 3
_SHAPES = 2  # starting values of an effect at a site that are fitted
# Changes of the logarithm of a threshold; a trial is also fitted from the one that promises most, if it does.
_THRESHOLD_CHANGES = (-0.7, -0.35, 0.35, 0.7)
_TRIAL_ITERATIONS, _TRIAL_TOLERANCE = 8, 1e-3  # a trial need not converge fully to be ranked


class ScreenedFit(NamedTuple):
    """A fit with its candidates, for adding the next effect and for replacing present ones.

    Attributes:
        scales: Typical sizes on the machine.
        screening: Fit, data, candidates, the effects that may be replaced and those that candidates may
            resemble.
    """

    scales: TypicalScales
    screening: Screening


def screened_fit(current: Fit, data: Dataset, without: Mapping[str, Machine] | None = None) -> ScreenedFit:
    """Propose candidates for a fitted machine, and linearize the residual with respect to them.

    In simulation, effects of drives that begin each run in an unknown state, such as the heat of a winding,
    are left out: with another gain in each run, they would describe each run separately.

    Args:
        current: Fit of the machine.
        data: Runs that were fitted.
        without: By the label of an effect that may be replaced, the fitted machine without it. Default: none.
    """
    state = SearchState.of(current, data)
    proposed = candidates(state)
    if current.bandwidth == SIMULATION:
        proposed = [c for c in proposed if c.effect.site != "drive" or c.effect.initial_spread is None]
    spend(f"screening {len({c.label for c in proposed})} effects at their components ({current.mode})")
    compared = [_itself(e, state) for e in current.machine.effects if _is_comparable(e, current.machine)]
    return ScreenedFit(
        state.scales, Screening.of(current, proposed, data, without=without, compared=compared)
    )


def _is_comparable(effect: AppliedEffect, machine: Machine) -> bool:
    """Return whether others may replace an effect, to first order: nothing depends on its presence."""
    return not effect.definition.replaces_model_part and not is_required(machine, effect.label)


def _itself(effect: AppliedEffect, state: SearchState) -> Candidate:
    """Return an effect with its parameters as a candidate."""
    sizes = state.sizes(effect.definition, effect.site)
    return Candidate(effect.definition, effect.site, (dict(effect.parameters),), sizes)


def trial_fits(
    current: Fit,
    data: Dataset,
    enough: float,
    criteria: SelectionCriteria,
    screened: ScreenedFit | None = None,
) -> list[Fit]:
    """Fit the machine with each of the most promising effects, one at a time.

    A linearized model ranks the candidates by the reduction of chi-squared; at most six effects at their
    sites (`max_full_fits`) are fitted, which promise enough of the required gain, of the best one's, and of
    the force that remains. Once one explains the data (`judge.trial.explains_alone`), only its possible
    rivals are fitted as well. If a parameter of the machine is at its limit, or no candidate is promising
    although chi-squared per sample is above 1.5 (`judge.trial.may_be_local_minimum`), the candidates are also
    ranked at the declared parameters and fitted from there.

    Args:
        current: Fit without candidates; the trials have its observer bandwidth.
        data: Runs that are fitted.
        enough: Reduction of chi-squared per sample that the search requires, dimensionless. Candidates with a
            linearized reduction below 60 % of it (`criteria.linear_gain_ratio`) are not fitted.
        criteria: Decision thresholds of the rules of `judge.trial`.
        screened: The fit with its candidates, if it is known already.

    Returns:
        Fits, not fully converged, in any order: machine, k parameters (theta, dimensionless, shape (k,)) and
        cost (chi-squared). One per effect and component, two where effects are also fitted from the declared
        parameters.
    """
    trials: list[Fit] = []
    if math.isfinite(current.cost):
        trials = _trial_fits_from(screened or screened_fit(current, data), current, data, enough, criteria)
    # Those of effects stay as they are where the machine's begin anew.
    at_limit = any(f.at_limit(t) for f, t in zip(current.free, current.theta, strict=True) if not f.of_effect)
    if judge.may_be_local_minimum(
        current.error, criteria, any_trial=bool(trials), parameter_at_limit=at_limit
    ):
        declared = _at_declared_parameters(current, data)
        if math.isfinite(declared.cost):
            trials += _trial_fits_from(screened_fit(declared, data), current, data, enough, criteria)
    return trials


def _at_declared_parameters(current: Fit, data: Dataset) -> Fit:
    """Return the machine of a fit with the declared parameters (theta 0), except those of its effects."""
    theta = _declared_theta(current)
    machine = current.machine.replace(values_at(current.free, theta))
    cost = prediction_cost(machine, data, current.bandwidth)
    return dataclasses.replace(current, machine=machine, theta=theta, cost=cost)


def _declared_theta(fitted: Fit) -> Array:
    """Return theta at which effects have the parameters of a fit, and all others are as declared, 0."""
    return np.where([f.of_effect for f in fitted.free], fitted.theta, 0.0)


def _trial_fits_from(
    screened: ScreenedFit, current: Fit, data: Dataset, enough: float, criteria: SelectionCriteria
) -> list[Fit]:
    """Return fits with the most promising candidates, ranked at a fit's parameters and fitted from there."""
    trials: list[Fit] = []
    start, ranked = screened.screening.fit, screened.screening.ranked()
    # Largest linearized gain of a candidate that explains the data, and the effects that do.
    best_promise, explaining = 0.0, set[str]()
    promising = _promising(start, ranked, data, enough, criteria)
    goal = judge.largest_useful_cost(current.error, enough, criteria)
    for i, scored in enumerate(promising):
        # Where a candidate explains the data, only its possible rivals are fitted as well: those with a
        # similar gain, and the same effect at other sites (a common limit explains nearly as much as that of
        # one drive).
        fitted = [t.machine.effects[-1].label for t in trials]
        elsewhere = scored.candidate.effect.name in explaining and scored.candidate.label not in fitted
        if elsewhere or judge.may_be_rival(scored.gain, best_promise, criteria):
            spend(f"trial fit {i + 1} of {len(promising)}: {scored.candidate.label}")
            trial = fit_with_candidate(start, scored, screened.scales, data, goal=goal)
            trials = _with_better_shape(trials, trial)
            if judge.explains_alone(current.error, trial.error, criteria):
                best_promise = max(best_promise, scored.gain)
                explaining.add(scored.candidate.effect.name)
    return trials


def _with_better_shape(trials: list[Fit], trial: Fit) -> list[Fit]:
    """Add a trial; of trials with the same effect at the same site, keep the one with the lowest cost."""
    label = trial.machine.effects[-1].label
    others = [t for t in trials if t.machine.effects[-1].label != label]
    same = [t for t in trials if t.machine.effects[-1].label == label]
    return [*others, min((*same, trial), key=lambda t: t.cost)]


def structural_trial_fits(
    current: Fit, trials: list[Fit], data: Dataset, enough: float, criteria: SelectionCriteria
) -> list[Fit]:
    """Fit the machine with each of the best effects that replace a part of the model, one at a time.

    These effects add coordinates (structural effects) or replace dry friction. Their trials take longer than
    those of other effects, because each needs newly compiled simulation code.

    Args:
        current: Fit without candidates; the trials have its observer bandwidth.
        trials: Trials with other effects. If the best one reduces chi-squared by `enough`, only candidates
            with a linearized reduction of at least `enough`, and of at least 10 % of the best one's
            (`criteria.min_structural_promise`), are fitted.
        enough: Reduction of chi-squared per sample that the search requires, dimensionless.

    Returns:
        One fit per effect and component, after few iterations, the best one of its starting values: machine,
        k parameters (theta, dimensionless, shape (k,)) and cost (chi-squared).
    """
    scales = typical_scales(current, data)
    useful = max((current.cost - t.cost for t in trials), default=0.0) / data.count
    least = judge.least_structural_promise(useful, enough, criteria)
    goal = judge.largest_useful_cost(current.error, enough, criteria)
    fits: list[Fit] = []
    spend("screening the effects that replace a part of the model")
    promising = screen_structures(current, data, scales, least)
    for i, machine in enumerate(promising):
        spend(f"trial fit {i + 1} of {len(promising)}: {machine.effects[-1].label}")
        fits = _with_better_shape(fits, _replace(current, machine, scales, data, goal))
    return fits


def best_error(trials: list[Fit]) -> FitError | None:
    """Return the error of the trial with the smallest cost; None without trials."""
    return min(trials, key=lambda trial: trial.cost).error if trials else None


def indistinguishable(screened: ScreenedFit, label: str, largest_loss: float) -> list[AppliedEffect]:
    """Return the effects that these runs cannot distinguish from an effect of the machine.

    Args:
        screened: Fit of the machine with all effects, and its candidates.
        label: Label of one of the effects. The result is empty for an effect that adds coordinates or
            replaces dry friction, or that another effect requires.
        largest_loss: Increase of chi-squared, dimensionless, to first order, up to which the runs do not
            distinguish effects.

    Returns:
        Other effects with the parameters that resemble it most, at most three, the most similar one first.
    """
    screening = screened.screening
    if label not in screening.compared:
        return []
    found: dict[str, Resemblance] = {}
    for each in (*screening.resembling(label), *_periodic_resemblances(screening, label)):
        known = found.get(each.effect.label)
        if each.loss <= largest_loss and (known is None or each.loss < known.loss):
            found[each.effect.label] = each
    nearest = sorted(found.values(), key=lambda each: each.loss)
    return [each.effect for each in nearest[:_RESEMBLING]]


def _periodic_resemblances(screening: Screening, label: str) -> list[Resemblance]:
    """Return the periodic effects that resemble an effect, with the periods of the motion without it."""
    fitted, data = screening.fit, screening.data
    effects = {e.label: e for e in fitted.machine.effects}
    effect = effects.pop(label)
    machine = fitted.machine.replace(effects=tuple(effects.values()))
    kept = [f.name in machine.parameters for f in fitted.free]
    free, theta = tuple(itertools.compress(fitted.free, kept)), fitted.theta[kept]
    state = SearchState.of(dataclasses.replace(fitted, machine=machine, free=free, theta=theta), data)
    by_label: dict[str, list[Candidate]] = {}
    for candidate in candidates(state):
        periodic = any(p.role in ("rate", "period") for p in candidate.effect.parameters)
        if periodic and candidate.label != label:
            by_label.setdefault(candidate.label, []).append(candidate)
    # Strongest first. What resembles the effect has the period that is strongest without it.
    others = [candidate for shapes in by_label.values() for candidate in shapes[:_SHAPES]]
    if not others:
        return []
    spend(f"comparing {label} with {len(by_label)} periodic effects")
    return Screening.of(fitted, others, data, compared=[_itself(effect, state)]).resembling(label)


def replacement_fit(
    current: Fit, label: str, screened: ScreenedFit, refitted: Machine, criteria: SelectionCriteria
) -> tuple[Fit, Fit] | None:
    """Replace one selected effect by the most promising other effect and fit the machine again.

    An effect that was selected while other effects were missing may represent a mixture of several causes.

    Args:
        current: Fit with all selected effects.
        label: Label (name@component) of the effect to replace.
        screened: This fit with its candidates, and with this effect among those that may be replaced.
        refitted: Machine before effects were added (`without_effect`).
        criteria: Decision threshold `linear_gain_ratio`.

    Returns:
        Fit without the effect, and the converged fit with the other one, whose cost may be higher than that
        of `current`. None if the effect cannot be removed, or if no other effect has a linearized gain of at
        least the fraction `linear_gain_ratio` of the effect's gain.
    """
    if label not in screened.screening.removable:
        return None
    data, (ranked, gain) = screened.screening.data, screened.screening.in_place_of(label)
    if not ranked or not judge.may_replace(ranked[0].gain, gain, criteria):
        return None
    reduced = without_effect(current, label, data, refitted, thorough=False)
    if reduced is None:
        return None
    trial = fit_with_candidate(reduced, ranked[0], screened.scales, data)
    return reduced, converge(trial, data, thorough=False)


def fit_in_place_of(
    current: Fit, label: str, rival: AppliedEffect, data: Dataset, *, goal: float = math.inf
) -> Fit:
    """Fit a machine again in which a rival effect replaces another effect.

    Args:
        current: Fit of the machine with all selected effects, among them the effect to replace.
        label: Label (name@component) of the effect to replace.
        rival: Effect that replaces it, with its starting values.
        goal: Cost, dimensionless, above which the fit is of no use (`fit`).

    Returns:
        Fit: machine, k parameters (theta, dimensionless, shape (k,)) and cost (chi-squared; infinite if the
        machine diverges), with the observer bandwidth of `current`.
    """
    remaining = tuple(e for e in current.machine.effects if e.label != label)
    machine = current.machine.replace(effects=remaining, uncertainty=None).with_effects(rival)
    kept = [f for f in current.free if f.name in machine.parameters and not f.name.startswith(f"{label}.")]
    # The fit continues from the parameters of the other effects; the rival's start at their given values
    # (theta = 0).
    kept_theta = [t for f, t in zip(current.free, current.theta, strict=True) if f in kept]
    names, scales, step = (
        {f.name for f in kept},
        typical_scales(current, data),
        search_step(current.bandwidth, data),
    )
    added = [f for f in effect_parameters(rival, machine, scales) if f.name not in names]
    theta = np.concatenate([kept_theta, np.zeros(len(added))])
    free = (*kept, *added)
    return fit(machine, free, data, current.bandwidth, theta=theta, longest_step=step, goal=goal)


def _promising(
    current: Fit, ranked: list[ScoredCandidate], data: Dataset, enough: float, criteria: SelectionCriteria
) -> list[ScoredCandidate]:
    """Return the few best candidates that may reduce the cost enough, up to two shapes per effect and site.

    A shape is a set of starting values, such as a period. Two are fitted, because a fit does not move from
    one period to another, and linearization may rank a wrong one first. They differ in more than a threshold,
    which a fit finds. Candidates with clearly less force than what remains unexplained are left out before
    anything is fitted.
    """
    best: dict[str, list[ScoredCandidate]] = {}
    least = judge.least_promise(enough, data.count, ranked[0].gain if ranked else 0.0, criteria)
    residue = residue_force(current, data)
    for scored in ranked:
        shapes = best.get(scored.candidate.label, [])
        if scored.gain <= least or len(best) == criteria.max_full_fits:
            break
        if len(shapes) == _SHAPES or any(s.candidate.differs_in_thresholds(scored.candidate) for s in shapes):
            continue
        remaining = residue * np.sqrt(max(1.0 - scored.gain / current.cost, 0.0))
        size = effect_force(current.machine, scored.candidate.applied(scored.amounts), data)
        if judge.promises_enough_force(size, float(remaining), criteria):
            best[scored.candidate.label] = [*shapes, scored]
    return sorted(itertools.chain(*best.values()), key=lambda scored: -scored.gain)


def fit_with_candidate(
    current: Fit, scored: ScoredCandidate, scales: TypicalScales, data: Dataset, *, goal: float = math.inf
) -> Fit:
    """Add a candidate effect to the machine and fit both together, with few iterations.

    If the effect has a threshold, a fit from another one, which promises a lower cost, is made as well; the
    better fit counts.

    Args:
        current: Fit without the effect; the new one has the same observer bandwidth.
        scored: Screened candidate with the amounts (weights) of its basis functions.
        scales: Typical forces, speeds and travels on this machine; the new parameters are multiples of them.
        data: Runs that are fitted.
        goal: Cost, dimensionless, above which the fit is of no use (`fit`).

    Returns:
        Fit, not fully converged.
    """
    machine = current.machine.with_effects(scored.candidate.applied(scored.amounts))
    added = effect_parameters(machine.effects[-1], machine, scales)
    theta = np.concatenate([current.theta, [f.theta(machine.parameters[f.name]) for f in added]])
    free = (*current.free, *added)
    best = _trial_fit(machine, free, theta, current, data, goal=goal)
    for j in (j for j, f in enumerate(free) if f in added and f.switch):
        moved = _other_threshold(best, j, data)
        if moved is not None:
            trial = _trial_fit(machine, free, moved, current, data, goal=min(goal, best.cost))
            best = min(best, trial, key=lambda each: each.cost)
    return best


def _other_threshold(fitted: Fit, j: int, data: Dataset) -> Array | None:
    """Return theta with another threshold j if that promises a lower cost; None if none does.

    From a wrong threshold, other parameters may imitate what the right one does. What they may make up for at
    each of some thresholds is therefore left out, to first order.
    """
    if not math.isfinite(fitted.cost):
        return None
    model = ResidualModel(fitted.machine, fitted.free, data, fitted.bandwidth, fitted.longest_step)
    moved = fitted.theta + np.outer(_THRESHOLD_CHANGES, np.eye(len(fitted.free))[j])
    point = model.at(fitted.theta)

    def changes(run: PreparedRecording, motion: Motion) -> Array:
        there = predict(
            point.machine,
            run,
            model.bandwidth,
            period=data.period,
            parameters=model.parameters(moved),
            initial_state=point.starts[run.name].state,
            longest_step=model.longest_step,
        )
        return model.residuals(run, there.readings) - model.residuals(run, motion.readings)

    equations = model.linearize(fitted.theta, changes).normal_equations
    others = np.arange(len(fitted.free)) != j
    equations = equations.of_some(others, np.arange(len(moved)))
    precision = prior_precision(fitted.free)[np.ix_(others, others)]
    costs = [equations.with_added(k).least_cost(precision) for k in range(len(moved))]
    best = int(np.argmin(np.nan_to_num(costs, nan=math.inf)))
    return moved[best] if costs[best] < fitted.cost else None


def _replace(current: Fit, machine: Machine, scales: TypicalScales, data: Dataset, goal: float) -> Fit:
    """Fit a machine in which an effect replaces a part of the model, with default free parameters.

    For a structural effect, the fit starts from the declared parameters, because parameters that were fitted
    without the effect compensate for it. With a narrower observer, the present parameters are accurate
    enough.
    """
    effect = machine.effects[-1]
    if (effect.definition.structure or effect.definition.tension) and current.bandwidth >= SEARCH_BANDWIDTH:
        machine = _as_declared(current).with_effects(effect)
    return _trial_fit(machine, *_all_free(machine, scales), current, data, goal=goal)


def _as_declared(current: Fit) -> Machine:
    """Return the machine of a fit with declared parameters, but those of its effects."""
    return current.machine.replace({f.name: f.center for f in current.free if not f.of_effect})


def _all_free(machine: Machine, scales: TypicalScales) -> tuple[tuple[FreeParameter, ...], Array]:
    """Return the default free parameters of a machine with effects, and theta at their present values."""
    free = list(default_free_parameters(machine, effects=False))
    for e in machine.effects:
        free += effect_parameters(e, machine, scales)
    return tuple(free), np.array([f.theta(machine.parameters[f.name]) for f in free])


def fit_with_effects(current: Fit, effects: Sequence[AppliedEffect], data: Dataset) -> Fit:
    """Add effects that were fitted before to a machine, and fit all parameters until convergence.

    A second fit starts from the declared parameters of the machine (`converge`); the better one counts.

    Args:
        current: Fit without the effects; the new one has the same observer bandwidth.
        effects: The effects with their starting values, those that others need first.
        data: Runs that are fitted.
    """
    machine = start_with_effects(current, effects)
    trial = _trial_fit(machine, *_all_free(machine, typical_scales(current, data)), current, data)
    return converge(trial, data, thorough=True)


def start_with_effects(current: Fit, effects: Sequence[AppliedEffect]) -> Machine:
    """Return the machine from which a fit with more effects starts.

    Its parameters are those of the fit. If an effect adds coordinates, they are the declared ones, because
    the fitted ones compensate for the missing effect.

    Args:
        current: Fit without the effects.
        effects: The effects with their starting values, those that others need first.
    """
    structural = any(e.definition.structure for e in effects)
    return (_as_declared(current) if structural else current.machine).with_effects(*effects)


def _trial_fit(
    machine: Machine,
    free: tuple[FreeParameter, ...],
    theta: Array,
    current: Fit,
    data: Dataset,
    *,
    goal: float = math.inf,
) -> Fit:
    """Fit a candidate with few iterations, at the bandwidth of the current fit."""
    return fit(
        machine,
        free,
        data,
        current.bandwidth,
        theta=theta,
        iterations=_TRIAL_ITERATIONS,
        tolerance=_TRIAL_TOLERANCE,
        longest_step=search_step(current.bandwidth, data),
        goal=goal,
    )


def converge(trial: Fit, data: Dataset, *, thorough: bool) -> Fit:
    """Continue the fit of a machine with a candidate effect until it converges.

    Args:
        trial: Fit with a candidate effect, not fully converged.
        thorough: Whether to fit a second time, from the declared parameters of the machine and the present
            parameters of its effects, and to return the better fit. Otherwise the fit may end in a local
            minimum, because the parameters of the trial were first fitted without the effect and compensate
            for it.
    """
    reset = dataclasses.replace(trial, theta=_declared_theta(trial))
    continued = continue_fit(trial, data, trial.bandwidth)
    if not thorough:
        return continued
    again = continue_fit(reset, data, trial.bandwidth, goal=continued.cost)
    return min(continued, again, key=lambda candidate_fit: candidate_fit.cost)


def machine_without(machine: Machine, label: str, refitted: Machine) -> Machine | None:
    """Return a machine without one of its effects, with the same values of all other parameters.

    Args:
        machine: Machine with the effect.
        label: Label of the effect: its name and the component on which it acts, such as "cogging@motor1".
        refitted: Machine before effects were added. If the effect adds coordinates, the other effects are
            added to this one anew, because components may have changed.

    Returns:
        Copy of the machine; None if another effect requires the effect or acts on a coordinate that the
        effect adds.
    """
    if is_required(machine, label):
        return None
    removed = next(e for e in machine.effects if e.label == label)
    others = tuple(e for e in machine.effects if e is not removed)
    if not removed.definition.structure:
        return machine.replace(effects=others)
    try:
        reduced = refitted.with_effects(*(e for e in others if e not in refitted.effects))
    except ValueError:
        return None  # a site is missing
    parameters = reduced.parameters
    return reduced.replace({n: value for n, value in machine.parameters.items() if n in parameters})


def without_effect(
    current: Fit, label: str, data: Dataset, refitted: Machine, *, thorough: bool = True
) -> Fit | None:
    """Remove one effect from the machine and fit the remaining free parameters again.

    If it requires another effect at its site with the same parameters, of which it may be the larger part, a
    second fit starts with its parameters in this other effect; the better fit counts.

    Args:
        current: Fit of the machine with the effect; the new one has the same observer bandwidth.
        label: Label of the effect: its name and the component on which it acts, such as "cogging@motor1".
        data: Runs that were fitted.
        refitted: Machine before effects were added (`machine_without`).
        thorough: Whether to fit until convergence with the shortest integration step, rather than with few
            iterations.

    Returns:
        The fit; None if another effect requires the effect or acts on a coordinate that the effect adds.
    """
    machine = machine_without(current.machine, label, refitted)
    if machine is None:
        return None
    removed = next(e for e in current.machine.effects if e.label == label)
    kept = np.array([free.name in machine.parameters for free in current.free])
    free, theta = tuple(itertools.compress(current.free, kept)), current.theta[kept]
    if thorough:
        step = search_step(current.bandwidth, data)
        near = fit(machine, free, data, current.bandwidth, theta=theta, longest_step=step)
        reduced = fit(machine, free, data, current.bandwidth, theta=near.theta, longest_step=POLISH_STEP)
    else:
        reduced = _trial_fit(machine, free, theta, current, data)
    required = next(
        (e for e in machine.effects if e.label == f"{removed.definition.requires}@{removed.site}"), None
    )
    if required is None or required.parameters.keys() != removed.parameters.keys():
        return reduced
    # Of two effects of the same form, the removed one may be the larger: the other then takes its parameters.
    promoted = fit_in_place_of(reduced, required.label, required.with_parameters(removed.parameters), data)
    return min(reduced, polish(promoted, data) if thorough else promoted, key=lambda fitted: fitted.cost)
