"""Linearised screening: how much of what is left could each candidate explain, without fitting any.

A candidate of small size adds a known force, or a known change of a reading, along the fitted machine's own
trajectory.  The response to it, one lane of the kernel a column, is what the residual is compared with; what the
machine's own parameters could mimic is projected out; the squared correlation with the residual is the cost that
fitting it would save, to first order.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..machine import Machine
from .candidates import Candidate
from .dataset import Dataset, PreparedRecording
from .effect_perturbation import EffectPerturbation, MotionRecord, addition
from .estimation import Fit, over_runs, parameter_table, prior_precision, second_difference_penalty
from .initial_state_projection import projection
from .prediction import SEARCH_STEP, coarse, predict, residuals

Array = NDArray[np.float64]
_STEP = 1e-4
# Columns whose responses are held at once, so that long recordings fit into memory.
_AT_ONCE = 64


class ScoredCandidate(NamedTuple):
    """A candidate, the cost it would save, and the amounts of its columns that save it."""

    candidate: Candidate
    gain: float
    amounts: tuple[float, ...]


def additions(machine: Machine, chosen: Sequence[Candidate], motion: MotionRecord) -> EffectPerturbation:
    """What all columns of some candidates add, in order: force (K, n, coordinates), reading (K, n, sensors)."""
    forces, readings = [], []
    for _, group in itertools.groupby(chosen, key=lambda c: c.label):
        members = list(group)
        columns = [column for c in members for column in c.columns]
        parameters = {name: np.array([column[name] for column in columns]) for name in columns[0]}
        own = addition(machine, members[0].effect, members[0].site, parameters, motion)
        forces.append(own.force)
        readings.append(
            np.zeros((len(columns), *motion.readings.shape)) if own.reading is None else own.reading,
        )
    return EffectPerturbation(np.concatenate(forces), np.concatenate(readings))


def screen(fit: Fit, candidates: Sequence[Candidate], data: Dataset) -> list[ScoredCandidate]:
    """Candidates by the cost they would save, best first; those of the wrong sign save nothing."""
    if not candidates:
        return []
    own = len(fit.free)
    thetas = np.vstack([fit.theta, fit.theta + _STEP * np.eye(own)])
    table = parameter_table(fit.machine, fit.free, thetas)
    period = data.period

    rows = coarse(data)

    def missed(run: PreparedRecording, readings: Array) -> Array:
        return residuals(run, data, readings, rows)

    def products(run: PreparedRecording) -> Array:
        motion = predict(fit.machine, run, fit.mode, period=period, parameters=table, states=True)
        base = missed(run, motion.readings)
        jacobian = (base[1:] - base[0]) / _STEP
        added = additions(fit.machine, candidates, MotionRecord(run.time_s, run.inputs, *(part[0] for part in motion)))
        still = np.zeros_like(added.force[:1])
        quiet = missed(run, predict(fit.machine, run, fit.mode, period=period, extra_force=still).readings)
        columns = []
        for first in range(0, len(added.force), _AT_ONCE):
            part = slice(first, first + _AT_ONCE)
            moved = predict(
                fit.machine,
                run,
                fit.mode,
                period=period,
                extra_force=_STEP * added.force[part],
                extra_reading=None if added.reading is None else _STEP * added.reading[part],
            )
            columns.append((missed(run, moved.readings) - quiet) / _STEP)
        stacked = np.vstack([jacobian, *columns, base[:1]])
        project = projection(fit.machine, run, data, fit.mode, SEARCH_STEP, rows)
        stacked = stacked if project is None else project(stacked)
        return stacked @ stacked.T

    gram = np.sum(list(over_runs(products, data)), axis=0)
    hessian = gram[:own, :own] + prior_precision(fit.free) + np.diag(1e-9 * np.diag(gram)[:own])
    mimic = np.linalg.solve(hessian, gram[:own, own:])
    left = gram[own:, own:] - gram[own:, :own] @ mimic
    found, first = [], 0
    for candidate in candidates:
        columns = np.arange(first, first + len(candidate.columns))
        first += len(columns)
        own_products = left[np.ix_(columns, columns)]
        found.append(_saving(candidate, own_products, left[columns, -1], gram[own + columns, own + columns], fit.chi2))
    return sorted(found, key=lambda s: -s.gain)


def _saving(candidate: Candidate, L: Array, towards: Array, before: Array, chi2: float) -> ScoredCandidate:
    """L (k, k): products of the candidate's columns, towards (k,) theirs with the residual, after projection."""
    nothing = ScoredCandidate(candidate, 0.0, (0.0,) * len(towards))
    if not np.all(np.isfinite(L)) or not np.any(np.diag(L) > 1e-6 * before):
        return nothing
    ridge = 1e-9 * np.diag(np.maximum(np.diag(L), 1e-300))
    if candidate.effect.against:
        ridge += chi2 * second_difference_penalty(len(towards))
    amounts: Array = np.array(np.ones_like(towards) if candidate.fixed else -np.linalg.solve(L + ridge, towards), float)
    if len(amounts) == 1 and not candidate.fixed:
        p = candidate.effect.parameter(candidate.effect.amplitudes[0])
        unit = candidate.columns[0][p.name]
        amounts = np.array(np.clip(amounts, p.lower / unit, p.upper / unit), float)
    gain = float(-2 * amounts @ towards - amounts @ L @ amounts)
    if not gain > 0.0:
        return nothing
    return ScoredCandidate(candidate, gain, tuple(amounts.tolist()))
