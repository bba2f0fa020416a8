"""Screen candidates by the cost that each would save to first order, without fitting any.

A candidate of small size adds a known force, or a known change of a measurement, along the fitted machine's motion.
The response of the predicted measurements to it is one column of the linearized residual.  After elimination of the
machine's free parameters, the squared correlation of column and residual is the cost that fitting the candidate would
save.

Structural effects (a yawing bridge, idlers with inertia) and those that replace dry friction (presliding) have no small
version to linearize around.  Every starting value of theirs is simulated instead, and the difference from the present
machine's prediction is the column.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..dynamics.simulation import Motion, parameter_batch
from ..effects import EFFECTS, effect_sites
from ..machine import Effect, Machine
from .dataset import Dataset, PreparedRecording
from .effect_perturbation import EffectPerturbation, MotionRecord, addition
from .estimation import Fit
from .free_parameters import prior_precision, second_difference_penalty
from .linearization import DIFFERENCE_STEP, ResidualModel, Responses
from .prediction import mechanical_rows_per_block, predict

if TYPE_CHECKING:
    from .candidates import Candidate
    from .typical_scales import TypicalScales

Array = NDArray[np.float64]

_COLUMNS_AT_ONCE = 64  # bounds the memory of long recordings
_MIMICKED = 1e-6  # fraction of a column's square below which the machine's parameters explain it entirely
_RIDGE = 1e-9
_FITTED_STRUCTURES = 3


class ScoredCandidate(NamedTuple):
    """A candidate with its predicted benefit.

    Attributes:
        candidate: Effect, site and starting values.
        gain: Cost that it would save.
        amounts: Weights of its columns that save it.
    """

    candidate: Candidate
    gain: float
    amounts: tuple[float, ...]


def screen(fit: Fit, candidates: Sequence[Candidate], data: Dataset) -> list[ScoredCandidate]:
    """Rank candidates by the cost that they would save to first order.

    Args:
        fit: Fit of the present machine.
        candidates: Effects, sites and starting values to compare.
        data: Runs that were fitted.

    Returns:
        Scored candidates, best first; those that would need the wrong sign save nothing.
    """
    if not candidates:
        return []
    model = _screening_model(fit, data)

    def responses(run: PreparedRecording, motion: Motion) -> Array:
        record = MotionRecord(run.time_s, run.inputs, *(part[0] for part in motion))
        return _perturbation_responses(model, run, candidate_perturbations(fit.machine, candidates, record))

    equations = model.linearize(fit.theta, responses).normal_equations
    ridge = np.diag(_RIDGE * np.diag(equations.information))
    reduced = equations.eliminate_parameters(prior_precision(fit.free) + ridge)
    scored, first = [], 0
    for candidate in candidates:
        columns = np.arange(first, first + len(candidate.columns))
        first += len(columns)
        before = equations.response_information[columns, columns]
        information = reduced.response_information[np.ix_(columns, columns)]
        scored.append(_score(candidate, information, reduced.response_gradient[columns], before, fit.chi2))
    return sorted(scored, key=lambda s: -s.gain)


def candidate_perturbations(
    machine: Machine, candidates: Sequence[Candidate], motion: MotionRecord
) -> EffectPerturbation:
    """Return the perturbations of all columns of some candidates, in order.

    Args:
        machine: Machine that moves.
        candidates: Candidates; neighbors of the same effect and site are evaluated together.
        motion: Motion of the machine.

    Returns:
        Forces (columns, n, coordinates) and changes of measurements (columns, n, sensors).
    """
    forces, readings = [], []
    for _, group in itertools.groupby(candidates, key=lambda c: c.label):
        members = list(group)
        columns = [column for c in members for column in c.columns]
        parameters = {name: np.array([column[name] for column in columns]) for name in columns[0]}
        perturbation = addition(machine, members[0].effect, members[0].site, parameters, motion)
        untouched = np.zeros((len(columns), *motion.readings.shape))
        forces.append(perturbation.force)
        readings.append(untouched if perturbation.reading is None else perturbation.reading)
    return EffectPerturbation(np.concatenate(forces), np.concatenate(readings))


def _screening_model(fit: Fit, data: Dataset) -> ResidualModel:
    """Return the residual of a fit with rows averaged to blocks, which mechanical effects do not notice."""
    return ResidualModel(fit.machine, fit.free, data, fit.mode, rows_per_block=mechanical_rows_per_block(data))


def _perturbation_responses(model: ResidualModel, run: PreparedRecording, added: EffectPerturbation) -> Array:
    """Return the derivatives of a run's residual with respect to perturbations, shape (columns, rows)."""

    def residual(force: Array, measurement: Array | None) -> Array:
        motion = predict(
            model.machine,
            run,
            model.mode,
            period=model.data.period,
            extra_force=DIFFERENCE_STEP * force,
            extra_measurement=None if measurement is None else DIFFERENCE_STEP * measurement,
            longest_step=model.longest_step,
        )
        return model.residuals(run, motion.readings)

    # The unperturbed residual comes from the same kernel, the one that takes extra forces.
    unperturbed = residual(np.zeros_like(added.force[:1]), None)
    columns = []
    for first in range(0, len(added.force), _COLUMNS_AT_ONCE):
        part = slice(first, first + _COLUMNS_AT_ONCE)
        measurement = None if added.reading is None else added.reading[part]
        columns.append((residual(added.force[part], measurement) - unperturbed) / DIFFERENCE_STEP)
    return np.vstack(columns)


def _score(candidate: Candidate, information: Array, gradient: Array, before: Array, chi2: float) -> ScoredCandidate:
    """Return the cost that a candidate would save with its best admissible amounts.

    Args:
        candidate: Candidate with k columns.
        information: Products of its columns after elimination of the free parameters, shape (k, k).
        gradient: Their products with the residual, shape (k,).
        before: Squares of the columns before elimination, shape (k,).
        chi2: Cost per value of the present fit, which scales the smoothness prior of tables.
    """
    nothing = ScoredCandidate(candidate, 0.0, (0.0,) * len(gradient))
    if not np.all(np.isfinite(information)) or not np.any(np.diag(information) > _MIMICKED * before):
        return nothing
    ridge = _RIDGE * np.diag(np.maximum(np.diag(information), 1e-300))
    if candidate.effect.against:
        ridge += chi2 * second_difference_penalty(len(gradient))
    if candidate.fixed:
        amounts: Array = np.ones_like(gradient)
    else:
        amounts = np.array(-np.linalg.solve(information + ridge, gradient), float)
        if len(amounts) == 1:
            amplitude = candidate.effect.parameter(candidate.effect.amplitudes[0])
            unit = candidate.columns[0][amplitude.name]
            amounts = np.array(np.clip(amounts, amplitude.lower / unit, amplitude.upper / unit), float)
    gain = float(-2 * amounts @ gradient - amounts @ information @ amounts)
    if not gain > 0.0:
        return nothing
    return ScoredCandidate(candidate, gain, tuple(amounts.tolist()))


def has_no_small_version(effect: Effect) -> bool:
    """Return whether an effect replaces a part of the machine, so that it cannot be linearized around zero."""
    return bool(effect.structure or effect.friction)


def screen_structures(current: Fit, data: Dataset, scale: TypicalScales, minimum_gain: float) -> list[Machine]:
    """Return the present machine with each of the most promising effects that replace a part of it.

    To first order such effects promise less than a fit achieves, so several are returned, and structural effects with
    their two best starting values.

    Args:
        current: Fit of the present machine.
        data: Runs that were fitted.
        scale: Typical values, to which the starting values are relative.
        minimum_gain: Decrease of the cost per measured value below which an effect is not promising.

    Returns:
        Machines with one more effect, which is their last, best first.
    """
    machine = current.machine
    present = {e.label for e in machine.effects}
    promising: list[tuple[float, list[Machine]]] = []
    for effect in filter(has_no_small_version, EFFECTS.values()):
        for site in effect_sites(effect, machine):
            if f"{effect.name}@{site}" in present:
                continue
            starting_values = _starting_values(effect, scale.of(machine.site_coordinate(site) or ""))
            variants = [machine.with_effects(effect.at(site, **values)) for values in starting_values]
            gains = _structure_gains(variants, current, data)
            if gains.max() > minimum_gain * data.count:
                best = np.argsort(-gains)[: 2 if effect.structure else 1]
                promising.append((float(gains.max()), [variants[int(k)] for k in best]))
    promising.sort(key=lambda p: -p[0])
    return [variant for _, variants in promising[:_FITTED_STRUCTURES] for variant in variants]


def _starting_values(effect: Effect, typical: Mapping[str, float]) -> list[dict[str, float]]:
    """Return the grid of an effect's starting values; those of structural effects are absolute, SI."""
    grids = [[g * (1.0 if effect.structure else typical.get(p.unit, 1.0)) for g in p.grid] for p in effect.parameters]
    names = [p.name for p in effect.parameters]
    return [dict(zip(names, values, strict=True)) for values in itertools.product(*grids)]


def _structure_gains(variants: list[Machine], current: Fit, data: Dataset) -> Array:
    """Return the cost that moving from the present machine towards each variant would save, shape (variants,).

    The step from one to the other, less what the free parameters can mimic, is scaled by its best positive weight.
    """
    model = _screening_model(current, data)
    table = np.concatenate([parameter_batch(variant) for variant in variants])
    responses = _structure_responses(model, variants[0], table)
    equations = model.linearize(current.theta, responses).normal_equations
    reduced = equations.eliminate_parameters(prior_precision(current.free))
    squares, gradient = np.diag(reduced.response_information), reduced.response_gradient
    gains = np.where(gradient < 0.0, gradient**2 / np.maximum(squares, 1e-300), 0.0)
    return np.where(np.isfinite(gains), gains, 0.0)


def _structure_responses(model: ResidualModel, variant: Machine, table: Array) -> Responses:
    """Return the function that gives the steps of a run's residual to variants with parameters (variants, P)."""

    def responses(run: PreparedRecording, motion: Motion) -> Array:
        moved = predict(variant, run, model.mode, period=model.data.period, parameters=table)
        return model.residuals(run, moved.readings) - model.residuals(run, motion.readings)

    return responses


# Aliases until all packages use the new names.
additions = candidate_perturbations
