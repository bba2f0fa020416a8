"""Significance of an effect: the tests that it must pass against noise and model error.

An effect that reduces the error may still not exist. Other runs must confirm it (leave-one-run-out), chance must not
explain the reduction, the machine must stay stable, and its force must exceed the one that remains unexplained.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri, fdtri

from ...machine import HOOKS, AppliedEffect, Machine, argument_names
from ...preparation.dataset import Dataset
from ..fit.covariance import BLOCK_S
from ..fit.estimation import Fit
from ..fit.force_sizes import drive_force, effect_force, force_difference, residue_force
from ..fit.model_error import fit_with_model_error, leave_one_out_gain, minimum_gain, narrower_observer
from ..judge.criteria import SelectionCriteria
from ..predict.free_parameters import prior_precision
from ..predict.linearization import ResidualModel
from ..predict.prediction import SIMULATION, block_size, map_runs, noise_floor
from ..propose.candidates import covered_by_runs
from .machine_validation import validation_fault

Array = NDArray[np.float64]

# Variable of a coordinate, drive or belt by the name of an argument of an effect's formulas (`Effect`).
_VARIABLES = {
    "q": "position",
    "dq": "position",
    "v": "speed",
    "direction": "speed",
    "t": "time",
    "V": "voltage",
    "i": "current",
    "s": "extension",
    "rate": "extension",
}
# An error in an effect's form is not removed by another form to less than a fiftieth. Of an error of less than about
# twice the noise, too little is visible to tell.
_CORRECTION_REMAINDER, _CLEAR_ERROR = 0.02, 5.0  # fraction of the error beyond the noise; chi-squared per sample
_NOISE_S = 0.05  # s; longer than the correlation of a sensor's noise
_AT_LIMIT = 0.01  # relative distance from the limit of a parameter's range
_CHANCE = 1e-4  # probability of a false effect among a hundred candidates: 1 %


def depend_on_same_variable(first: AppliedEffect, second: AppliedEffect, machine: Machine) -> bool:
    """Check whether two effects are functions of the same variable of the same component, such as its speed.

    If so, a small effect may be an error in the formula of a large one: an inaccurate formula of friction leaves a
    force that depends on the speed as well.

    Args:
        first: One effect (deviation from the nominal model) at its component.
        second: Another effect.
        machine: Machine on which both act.

    Returns:
        True for example for Stribeck friction and quadratic drag of one coordinate, two functions of its speed. False
        if only one of them is periodic in the variable, or if one adds coordinates.
    """
    sites = [machine.coordinate_of_site(e.site, e.definition.site) or e.site for e in (first, second)]
    structural = first.definition.structure or second.definition.structure
    return not structural and sites[0] == sites[1] and bool(_variables(first) & _variables(second))


def _variables(effect: AppliedEffect) -> set[tuple[str, bool]]:
    """Return the variables on which the formulas of an effect depend, and whether it is periodic in them."""
    periodic = any(p.role in ("period", "rate") for p in effect.definition.parameters)
    hooks = [getattr(effect.definition, hook) for hook in HOOKS if getattr(effect.definition, hook)]
    arguments = {name for hook in hooks for name in argument_names(hook)}
    return {(_VARIABLES[name], periodic) for name in arguments & set(_VARIABLES)}


def long_run_variance(fitted: Fit, label: str, data: Dataset) -> float:
    """Return by which factor a residual that is correlated in time raises the gain that an effect reaches by chance.

    The gain is the reduction of the cost (sum of squared residuals in units of the noise). The factor is the ratio of
    the residual's long-run variance to the variance of white noise, in the direction in which the effect changes the
    predictions. The long-run variance follows from sums of the residual over blocks that count as independent. Blocks
    of 50 ms, of 0.5 s and complete runs are tried. Few blocks estimate a variance inaccurately; the factor is then
    larger by the ratio of the quantiles of the F and the chi-squared distribution.

    Args:
        fitted: Fit with the effect (deviation from the nominal model), at any observer bandwidth.
        label: Label (name@site) of the effect, of which at least one parameter is free.
        data: Runs that were fitted (times, voltages, measurements, SI).

    Returns:
        Factor, dimensionless, at least 1: the largest for the three kinds of blocks and all combinations of the
        effect's parameters. It is infinite if the machine diverges at the fitted or slightly different parameters.

    References:
        Liang and Zeger (1986), "Longitudinal data analysis using generalized linear models".
    """
    model = ResidualModel(fitted.machine, fitted.free, data, fitted.bandwidth, fitted.longest_step)
    runs = list(map_runs(model.at(fitted.theta).linearize_run, data))
    if not all(np.isfinite(run.jacobian).all() and np.isfinite(run.residual).all() for run in runs):
        return math.inf
    of_effect = np.array([parameter.name.startswith(f"{label}.") for parameter in fitted.free])
    others = ~of_effect
    hessian = sum((run.jacobian @ run.jacobian.T for run in runs), prior_precision(fitted.free))
    # Change of the effect's parameters with adapted other parameters: one row per parameter of the effect.
    directions = np.eye(len(fitted.free))[of_effect]
    directions[:, others] = -np.linalg.solve(hessian[np.ix_(others, others)], hessian[np.ix_(others, of_effect)]).T
    responses = [directions @ run.jacobian for run in runs]
    inverse = np.linalg.pinv(sum(response @ response.T for response in responses), hermitian=True)
    short, long = (block_size(seconds, fitted.machine, data) for seconds in (_NOISE_S, BLOCK_S))
    largest = 0.0
    for size in (short, long, max(run.residual.size for run in runs)):
        blocks = [_block_sums(j * run.residual, size) for j, run in zip(responses, runs, strict=True)]
        scores = np.concatenate(blocks, axis=1)  # (parameters of the effect, blocks)
        largest = max(largest, float(np.linalg.eigvals(inverse @ scores @ scores.T).real.max()))
    count = sum(-(-run.residual.size // long) for run in runs)
    parameters = len(directions)
    quantiles = fdtri(parameters, count, 1.0 - _CHANCE), chdtri(parameters, _CHANCE) / parameters
    return max(1.0, largest * float(quantiles[0] / quantiles[1]))


def _block_sums(rows: Array, size: int) -> Array:
    """Return sums over blocks of that many values, shape (k, blocks), of k rows; the last block may be shorter."""
    return np.asarray(np.add.reduceat(rows, np.arange(0, rows.shape[1], size), axis=1))


def doubt_about_candidate(current: Fit, trial: Fit, data: Dataset, criteria: SelectionCriteria) -> str:
    """Return a reason why an effect may not exist although it reduces the error, or "" if it passes all tests.

    An effect is a deviation from the nominal model. Three tests are always made:

    - The machine with the effect does not diverge under random rated voltages, and the tension of a belt does not fall
      when the belt is extended.
    - The force of the effect is larger than the force that remains unexplained.
    - The effect is not a small correction to another effect that depends on the same variable.

    Two more are made only if chi-squared per sample (mean squared residual / noise variance) without the effect is
    below `criteria.explained_chi2`, 1.5 by default, because missing effects falsify them:

    - Runs to which the effect was not fitted confirm it.
    - Chance does not explain the reduction of the error.

    Args:
        current: Fit of the machine without the effect.
        trial: Fit of the machine with the effect as the last entry of `machine.effects`. Both fits have the same
            observer bandwidth (the observer corrects predictions by the measurements).
        data: Runs that were fitted (times, voltages, measurements, SI).
        criteria: Decision thresholds.

    Returns:
        Clause that follows "it ", such as "is not confirmed by runs that it was not fitted to".
    """
    # While other effects are missing, a fit without one run says little about the machine, and what they leave is
    # correlated in time; `doubt_beside_others` repeats these tests.
    nearly_explained = current.chi2 < criteria.explained_chi2
    return _doubt(current, trial, trial.machine.effects[-1], data, criteria, nearly_explained=nearly_explained)


def doubt_beside_others(
    reduced: Fit, complete: Fit, effect: AppliedEffect, data: Dataset, criteria: SelectionCriteria
) -> str:
    """Return a reason why an effect of a machine may not exist, given all other effects, or "" if it passes all tests.

    The effect must reduce the error by enough, and pass all five tests that `doubt_about_candidate` lists. No parameter
    of it may end at a limit of its range, unless that limit is a meaningful value (0 or a starting value): the
    recordings then ask for a value that the effect cannot have, and another effect imitates it.

    Args:
        reduced: Fit of the machine with all other effects.
        complete: Fit of the machine with all effects. Both fits have the same observer bandwidth (the observer corrects
            predictions by the measurements).
        effect: Effect (deviation from the nominal model) in question.
        data: Runs that were fitted (times, voltages, measurements, SI).
        criteria: Decision thresholds.

    Returns:
        Clause that follows "it ", such as "has no effect on the error".
    """
    if reduced.cost - complete.cost < minimum_gain(complete, criteria) * data.count:
        return "has no effect on the error"
    at_limit = _at_limit(next(e for e in complete.machine.effects if e.label == effect.label), complete)
    return at_limit or _doubt(reduced, complete, effect, data, criteria, nearly_explained=True)


def _at_limit(effect: AppliedEffect, complete: Fit) -> str:
    """Return that a parameter of an effect ends at a limit of its range, which is no meaningful value, else ""."""
    free = {f.name: f for f in complete.free}
    for p in effect.definition.parameters:
        value = effect.parameters[p.name]
        fitted = free.get(f"{effect.label}.{p.name}")
        if fitted is not None and covered_by_runs(p):
            low, high = (1.0 + _AT_LIMIT) * fitted.lower, (1.0 - _AT_LIMIT) * fitted.upper
            if value >= high or (p.role == "rate" and value <= low):
                return (
                    f"fits only with {p.name} at the limit of what the runs cover ({value:.3g} {p.unit}): they cannot "
                    "tell it from a simpler cause"
                )
        for limit in {p.lower, p.upper} - {0.0, *p.grid}:
            if math.isclose(value, limit, rel_tol=_AT_LIMIT):
                return f"fits only with {p.name} at the limit of its range ({limit:g}): another effect may imitate it"
    return ""


def _doubt(
    without: Fit,
    with_effect: Fit,
    effect: AppliedEffect,
    data: Dataset,
    criteria: SelectionCriteria,
    *,
    nearly_explained: bool,
) -> str:
    """Return the first reason against an effect; two of the tests need a machine that nearly explains the data."""
    return (
        (_unconfirmed(without, with_effect, data, criteria) if nearly_explained else "")
        or validation_fault(with_effect.machine)
        or (_by_chance(without, with_effect, effect, data, criteria) if nearly_explained else "")
        or _too_small(without, with_effect, effect, data, criteria)
        or _form_error(without, with_effect, effect, data, criteria)
    )


def _unconfirmed(without: Fit, with_effect: Fit, data: Dataset, criteria: SelectionCriteria) -> str:
    """Return that an effect describes single runs rather than the machine, "" if other runs confirm it."""
    gain, confirmed = without.cost - with_effect.cost, leave_one_out_gain(without, with_effect, data)
    if confirmed >= criteria.min_confirmed_fraction * gain:
        return ""
    there = f"{100 * confirmed / gain:.0f} % of the gain" if confirmed >= 0.0 else "their error grows with it"
    return f"is not confirmed by runs that it was not fitted to ({there})"


def _by_chance(
    without: Fit, with_effect: Fit, effect: AppliedEffect, data: Dataset, criteria: SelectionCriteria
) -> str:
    """Return that chance may explain the gain because the remaining error is correlated, "" if it cannot.

    In doubt, the gain with the next narrower observer decides: an observer hides slow errors, and with them what an
    effect explains, whereas model error imitates an effect the less, the longer it adds up.
    """

    def exceeds_chance(reduced: Fit, complete: Fit) -> bool:
        variance = long_run_variance(complete, effect.label, data)
        return reduced.cost - complete.cost >= criteria.min_chance_gain * variance

    if exceeds_chance(without, with_effect):
        return ""
    if with_effect.bandwidth != SIMULATION and exceeds_chance(
        narrower_observer(without, data), narrower_observer(with_effect, data)
    ):
        return ""
    return "reduces the error by no more than chance may, since the remaining error is correlated in time"


def _too_small(
    without: Fit, with_effect: Fit, effect: AppliedEffect, data: Dataset, criteria: SelectionCriteria
) -> str:
    """Return that an effect is smaller than what remains unexplained, or negligible beside the drives, else ""."""
    size, residue = _forces(without, with_effect, effect, data)
    drives = drive_force(with_effect.machine, data)
    if size < criteria.min_drive_force_ratio * drives and not effect.definition.structure:
        return f"has a force of {size:.2g} N, {size / drives:.1g} of that of the drives"
    if criteria.min_promised_force_ratio * residue <= size < criteria.min_force_ratio * residue:
        # In doubt, what remains is measured by the observer that is then needed.
        size, residue = _forces(without, fit_with_model_error(with_effect, data), effect, data)
    if size >= criteria.min_force_ratio * residue:
        return ""
    verb = "explains" if effect.definition.structure else "has"
    return f"{verb} a force of {size:.2g} N, where {residue:.2g} N remain unexplained"


def _forces(without: Fit, with_effect: Fit, effect: AppliedEffect, data: Dataset) -> tuple[float, float]:
    """Return the force of an effect and the force that remains unexplained beside it, N."""
    size, residue = effect_force(with_effect.machine, effect, data), residue_force(with_effect, data)
    if effect.definition.structure:  # no force at the machine's coordinates: what it takes from the unexplained one
        size = math.sqrt(max(residue_force(without, data) ** 2 - residue**2, 0.0))
    return size, residue


def _form_error(
    without: Fit, with_effect: Fit, effect: AppliedEffect, data: Dataset, criteria: SelectionCriteria
) -> str:
    """Return that an effect may be an error in the form of one of another family, "" if nothing speaks for that."""
    machine = with_effect.machine
    # What an inexact form leaves has no simple formula itself. An effect that removes nearly all of an error of several
    # times the noise is therefore no correction of another effect's form.
    floor = noise_floor(without.bandwidth, criteria)
    removes_all = with_effect.chi2 - floor < _CORRECTION_REMAINDER * (without.chi2 - floor)
    if removes_all and without.chi2 > _CLEAR_ERROR:
        return ""
    for other in (e for e in machine.effects if e.definition.family != effect.definition.family):
        if depend_on_same_variable(effect, other, machine):
            # The force beyond what the parameters of the machine and of the other effect can represent.
            fraction = force_difference(without.machine, machine, data) / max(effect_force(machine, other, data), 1e-12)
            if fraction < criteria.max_form_error:
                percent = f"adds {100 * fraction:.0f} % to the force of {other.label}"
                return f"{percent}, which depends on the same variable: the form of that effect may be in error"
    return ""
