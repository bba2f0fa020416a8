"""Significance of an effect: the evidence for and against it that `judge.effect` asks for.

An effect that reduces the error may still not exist. Measured here are its gain in runs to which it was not fitted
(leave-one-run-out), the gain that chance may explain, its force and the one that remains unexplained.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ...arrays import Array
from ...machine import HOOKS, AppliedEffect, Machine, argument_names
from ...preparation.dataset import Dataset
from ..fit.covariance import BLOCK_S
from ..fit.estimation import Fit
from ..fit.force_sizes import drive_force, effect_force, force_difference, residue_force
from ..fit.model_error import (
    continue_fit,
    fit_with_model_error,
    has_narrowest_observer,
    leave_one_out_gain,
    narrower_observer,
)
from ..judge import effect as judge
from ..judge.chance import LongRunVariance
from ..judge.criteria import SelectionCriteria
from ..judge.effect import Addition, Chance, EffectEvidence, Forces, ParameterValue, Size
from ..predict.free_parameters import prior_precision
from ..predict.linearization import ResidualModel, RunLinearization
from ..predict.prediction import block_size, map_runs
from ..propose.candidates import covered_by_runs
from .plausibility import plausibility_fault

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
_TABULATED = {"position", "speed", "time"}  # variables of tables (`search.tables.table_variables`)
_NOISE_S = 0.05  # s; longer than the correlation of a sensor's noise


class TestedFit:
    """Fit of a machine with effects, and its fits with other observers and voltages, which the tests of each need.

    They are computed once, when they are needed.

    Attributes:
        fitted: The fit.
        data: Runs that were fitted.
    """

    __test__ = False  # no test of pytest

    def __init__(self, fitted: Fit, data: Dataset) -> None:
        self.fitted, self.data = fitted, data

    @cached_property
    def narrower(self) -> Fit:
        """Fit with the next narrower observer."""
        return narrower_observer(self.fitted, self.data)

    @cached_property
    def likeliest(self) -> Fit:
        """Fit with the most likely observer."""
        return fit_with_model_error(self.fitted, self.data)

    @cached_property
    def interpolation_change(self) -> float:
        """Largest change of the cost, dimensionless, by another interpolation of the voltages between the rows.

        The machine is fitted again to each. The voltages may change once more or once less a row, on straight lines or
        on splines.
        """
        data, fitted = self.data, self.fitted
        others = [data.with_updates(n) for n in (data.updates - 1, data.updates + 1) if n > 1]
        others += [data.with_interpolation("straight"), data.with_interpolation("spline")]
        return max(abs(continue_fit(fitted, other, fitted.bandwidth).cost - fitted.cost) for other in others)


def depend_on_same_variable(first: AppliedEffect, second: AppliedEffect, machine: Machine) -> bool:
    """Check whether two effects are functions of the same variable of the same component, such as its speed.

    If so, a small effect may be an error in the formula of a large one: an inaccurate formula of friction leaves a
    force that depends on the speed as well. A clock whose rate changes acts on all components, and changes with time.

    Args:
        first: One effect at its component.
        second: Another effect.
        machine: Machine on which both act.

    Returns:
        True for example for Stribeck friction and quadratic drag of one coordinate, two functions of its speed, and for
        a drifting clock and a winding that warms up. False if only one of them is periodic in the variable, or if one
        adds coordinates.
    """
    if first.definition.clock or second.definition.clock:
        return _changes_with_time(first) and _changes_with_time(second)
    sites = [machine.coordinate_of_site(e.site, e.definition.site) or e.site for e in (first, second)]
    structural = first.definition.structure or second.definition.structure
    return not structural and sites[0] == sites[1] and bool(_variables(first) & _variables(second))


def _changes_with_time(effect: AppliedEffect) -> bool:
    """Return whether an effect is a function of time or drifts: its state has a time constant beyond fast motion."""
    definition = effect.definition
    if definition.clock or definition.against == "time" or ("time", False) in _variables(effect):
        return True
    constants = [effect.parameters[p.name] for p in definition.parameters if p.unit == "s"]
    return definition.next_state is not None and max(constants, default=0.0) > BLOCK_S


def curves_of_one_variable(effects: Sequence[AppliedEffect], machine: Machine) -> list[AppliedEffect]:
    """Return the effects that are functions of one and the same variable of the same coordinate, two at least.

    Together they are a curve over this variable, periodic ones among them. Effects with a memory are none, and those of
    variables that no table has, such as a voltage.

    Args:
        effects: Effects of the machine among which to look.
        machine: Machine on which they act.

    Returns:
        The largest such group, in the given order; empty if no two effects share a variable.
    """
    groups: dict[tuple[str, str], list[AppliedEffect]] = {}
    for effect in effects:
        variables = {name for name, _ in _variables(effect)}
        remembers = effect.definition.structure or effect.definition.next_state
        if len(variables) == 1 and variables <= _TABULATED and not remembers:
            site = machine.coordinate_of_site(effect.site, effect.definition.site) or effect.site
            groups.setdefault((site, variables.pop()), []).append(effect)
    largest = max(groups.values(), key=len, default=[])
    return largest if len(largest) > 1 else []


def _variables(effect: AppliedEffect) -> set[tuple[str, bool]]:
    """Return the variables on which the formulas of an effect depend, and whether it is periodic in them."""
    periodic = any(p.role in ("period", "rate") for p in effect.definition.parameters)
    hooks = [getattr(effect.definition, hook) for hook in HOOKS if getattr(effect.definition, hook)]
    arguments = {name for hook in hooks for name in argument_names(hook)}
    return {(_VARIABLES[name], periodic) for name in arguments & set(_VARIABLES)}


def long_run_variance(fitted: Fit, label: str, data: Dataset) -> LongRunVariance:
    """Return by which factor a residual that is correlated in time raises the gain that an effect reaches by chance.

    The gain is the reduction of the cost (sum of squared residuals in units of the noise). The factor is the ratio of
    the residual's long-run variance to the variance of white noise, in the direction in which the effect changes the
    predictions. The long-run variance follows from sums of the residual over blocks that count as independent. Blocks
    of 50 ms, of 0.5 s and complete runs are tried.

    Args:
        fitted: Fit with the effect, at any observer bandwidth.
        label: Label (name@site) of the effect, of which at least one parameter is free.
        data: Runs that were fitted.

    Returns:
        The largest factor for the three kinds of blocks and all combinations of the effect's parameters, with the
        number of blocks of 0.5 s. It is infinite if the machine diverges at the fitted or slightly different
        parameters.

    References:
        Liang and Zeger (1986), "Longitudinal data analysis using generalized linear models".
    """
    model = ResidualModel(fitted.machine, fitted.free, data, fitted.bandwidth, fitted.longest_step)
    runs = list(map_runs(model.at(fitted.theta).linearize_run, data))
    of_effect = np.array([parameter.name.startswith(f"{label}.") for parameter in fitted.free])
    blocks = [block_size(seconds, fitted.machine, data) for seconds in (_NOISE_S, BLOCK_S)]
    return variance_along(runs, of_effect, prior_precision(fitted.free), *blocks)


def variance_along(
    runs: Sequence[RunLinearization], of_effect: NDArray[np.bool_], precision: Array, short: int, long: int
) -> LongRunVariance:
    """Return the long-run variance of a residual along the change that an effect causes, over that of white noise.

    Args:
        runs: Linearized residual of each run, with respect to k parameters.
        of_effect: True for the parameters of the effect, shape (k,).
        precision: Precision of the prior of the parameters, dimensionless, shape (k, k).
        short: Values of a block that is longer than the correlation of a sensor's noise.
        long: Values of a block that counts as independent.

    Returns:
        Factor, dimensionless, with the numbers of parameters and of long blocks, as `long_run_variance` describes.
    """
    if not all(np.isfinite(run.jacobian).all() and np.isfinite(run.residual).all() for run in runs):
        return LongRunVariance(math.inf)
    others = ~of_effect
    hessian = sum((run.jacobian @ run.jacobian.T for run in runs), precision)
    # Change of the effect's parameters with adapted other parameters: one row per parameter of the effect.
    directions = np.eye(len(of_effect))[of_effect]
    directions[:, others] = -np.linalg.solve(
        hessian[np.ix_(others, others)], hessian[np.ix_(others, of_effect)]
    ).T
    responses = [directions @ run.jacobian for run in runs]
    inverse = np.linalg.pinv(sum(response @ response.T for response in responses), hermitian=True)
    largest = 1.0
    for size in (short, long, max(run.residual.size for run in runs)):
        sums = [_block_sums(j * run.residual, size) for j, run in zip(responses, runs, strict=True)]
        scores = np.concatenate(sums, axis=1)  # (parameters of the effect, blocks)
        largest = max(largest, float(np.linalg.eigvals(inverse @ scores @ scores.T).real.max()))
    blocks = sum(-(-run.residual.size // long) for run in runs)
    return LongRunVariance(largest, len(directions), blocks)


def _block_sums(rows: Array, size: int) -> Array:
    """Return sums over blocks of that many values, shape (k, blocks), of k rows; the last block may be shorter."""
    return np.asarray(np.add.reduceat(rows, np.arange(0, rows.shape[1], size), axis=1))


def doubt_about_candidate(
    current: Fit, trial: Fit, data: Dataset, criteria: SelectionCriteria, effect: AppliedEffect | None = None
) -> str:
    """Return a reason why an effect may not exist although it reduces the error, or "" if it passes all tests.

    Args:
        current: Fit of the machine without the effect.
        trial: Fit of the machine with the effect. Both fits have the same observer bandwidth (the observer corrects
            predictions by the measurements).
        data: Runs that were fitted.
        criteria: Decision thresholds.
        effect: The effect. Default: the last one of the machine.

    Returns:
        Clause that follows "it ", such as "is not confirmed by runs that it was not fitted to", by
        `judge.effect.doubt_about_candidate`.
    """
    effect = effect or trial.machine.effects[-1]
    evidence = effect_evidence(current, TestedFit(trial, data), effect)
    return judge.doubt_about_candidate(evidence, criteria)


def doubt_beside_others(
    reduced: Fit, complete: TestedFit, effect: AppliedEffect, criteria: SelectionCriteria
) -> str:
    """Return a reason why an effect of a machine may not exist, given all other effects, or "" if it passes all tests.

    Args:
        reduced: Fit of the machine with all other effects.
        complete: Fit of the machine with all effects. Both fits have the same observer bandwidth (the observer corrects
            predictions by the measurements).

    Returns:
        Clause that follows "it ", such as "has no effect on the error", by `judge.effect.doubt_beside_others`.
    """
    return judge.doubt_beside_others(effect_evidence(reduced, complete, effect), criteria)


def effect_evidence(without: Fit, tested: TestedFit, effect: AppliedEffect) -> EffectEvidence:
    """Collect what the fitted runs say about an effect; numbers that take seconds are computed when they are needed.

    Args:
        without: Fit of the machine without the effect.
        tested: Fit of the machine with it, at the same observer bandwidth.
    """
    with_effect, data = tested.fitted, tested.data

    def narrower() -> Chance:
        return _chance(narrower_observer(without, data), tested.narrower, effect, data)

    return EffectEvidence(
        without=without.error,
        with_effect=with_effect.error,
        forceless=_is_forceless(effect),
        confirmed=lambda: leave_one_out_gain(without, with_effect, data),
        fault=lambda: plausibility_fault(with_effect.machine),
        chance=lambda: _chance(without, with_effect, effect, data),
        chance_narrower=None if has_narrowest_observer(with_effect, data) else narrower,
        forces=lambda: _forces(without, with_effect, effect, data),
        forces_accurate=lambda: _forces(without, tested.likeliest, effect, data),
        drives=lambda: drive_force(with_effect.machine, data),
        additions=lambda: _additions(without, with_effect, effect, data),
        parameters=parameter_values(effect.label, with_effect),
        interpolation=(lambda: tested.interpolation_change) if data.updates > 1 else None,
    )


def parameter_values(label: str, fitted: Fit) -> tuple[ParameterValue, ...]:
    """Return the parameters of an effect with the limits at which their values say little.

    Args:
        label: Label (name@site) of the effect.
        fitted: Fit of the machine with it.
    """
    effect = next(e for e in fitted.machine.effects if e.label == label)
    free = {f.name: f for f in fitted.free}
    values = []
    for p in effect.definition.parameters:
        limited = free.get(f"{label}.{p.name}") if covered_by_runs(p) else None
        covered = (limited.lower, limited.upper) if limited is not None else None
        limits = tuple({p.lower, p.upper} - {0.0, *p.grid})
        unit = fitted.machine.effect_unit(effect, p.name)
        values.append(
            ParameterValue(p.name, unit, effect.parameters[p.name], limits, covered, p.role == "rate")
        )
    return tuple(values)


def sizes(effect: AppliedEffect, machine: Machine) -> tuple[Size, ...]:
    """Return the parameters without which an effect of a fitted machine is absent, with their standard deviations.

    Args:
        effect: The effect with its fitted parameters.
        machine: Machine with the covariance of its parameters.

    Returns:
        The sizes that were fitted; none without a covariance.
    """
    uncertainty = machine.uncertainty
    if uncertainty is None:
        return ()
    index = {name: i for i, name in enumerate(uncertainty.names)}
    scaled: list[str] = []
    if effect.definition.viscous:
        # The motion shows the product with the coefficient, which the back-EMF makes uncertain.
        scaled.append(f"{machine.coordinate_of_site(effect.site, effect.definition.site)}.viscous")
    found = []
    for p in effect.definition.parameters:
        if not p.amplitude or f"{effect.label}.{p.name}" not in index:
            continue
        others = (f"{effect.label}.{other.name}" for other in effect.definition.parameters if other is not p)
        names = [f"{effect.label}.{p.name}", *others, *scaled]
        rows = [index[name] for name in names if name in index]
        std = _std_beside_fixed_values(uncertainty.covariance[np.ix_(rows, rows)])
        found.append(Size(p.name, machine.effect_unit(effect, p.name), effect.parameters[p.name], std))
    return tuple(found)


def _std_beside_fixed_values(covariance: Array) -> float:
    """Return the standard deviation that the first parameter has if the others are held, 0 if it has none."""
    scale = np.sqrt(np.diag(covariance))
    if not scale[0] > 0.0:
        return 0.0
    free = scale > 0.0
    correlation = covariance[np.ix_(free, free)] / np.outer(scale[free], scale[free])
    to_first = correlation[1:, 0]
    explained = float(to_first @ np.linalg.lstsq(correlation[1:, 1:], to_first, rcond=None)[0])
    return float(scale[0] * math.sqrt(max(1.0 - explained, 0.0)))  # below 0 by rounding only


def _chance(without: Fit, with_effect: Fit, effect: AppliedEffect, data: Dataset) -> Chance:
    """Return the gain of an effect and the variance that the residual has in its direction."""
    return Chance(without.cost - with_effect.cost, long_run_variance(with_effect, effect.label, data))


def _is_forceless(effect: AppliedEffect) -> bool:
    """Return whether an effect has no force at the machine's coordinates: it adds some, or changes the clock."""
    return bool(effect.definition.structure or effect.definition.clock)


def _forces(without: Fit, with_effect: Fit, effect: AppliedEffect, data: Dataset) -> Forces:
    """Return the force of an effect and the force that remains unexplained beside it, N."""
    size, residue = effect_force(with_effect.machine, effect, data), residue_force(with_effect, data)
    if _is_forceless(effect):  # what it takes from the unexplained one
        size = math.sqrt(max(residue_force(without, data) ** 2 - residue**2, 0.0))
    return Forces(size, residue)


def _additions(without: Fit, with_effect: Fit, effect: AppliedEffect, data: Dataset) -> Iterator[Addition]:
    """Return what an effect adds to each effect of another family that depends on the same variable.

    A clock corrects other effects, but none corrects the clock, which has no force that could be in error.
    """
    machine = with_effect.machine
    for other in machine.effects:
        if (
            other.definition.family != effect.definition.family
            and not other.definition.clock
            and depend_on_same_variable(effect, other, machine)
        ):
            # The force beyond what the parameters of the machine and of the other effect can represent.
            added = (
                _forces(without, with_effect, effect, data).effect
                if effect.definition.clock
                else force_difference(without.machine, machine, data)
            )
            yield Addition(other.label, added / max(effect_force(machine, other, data), 1e-12))
