"""Linearised screening: how much of what is left could each candidate explain, without fitting any.

A candidate of small size adds a known force along the fitted machine's own trajectory.  The response to that force, one
lane of the kernel a candidate, is its column; what the machine's own parameters could mimic is projected out; the
squared correlation with the residual is the cost that fitting it would save, to first order.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..machine import Machine
from .candidates import Candidate
from .data import Data, Run
from .fit import Fit, over_runs, parameter_table
from .prediction import predict, residuals

Array = NDArray[np.float64]
_STEP = 1e-4


class Screened(NamedTuple):
    """A candidate, the cost it would save, and the amplitude (own unit) that saves it."""

    candidate: Candidate
    gain: float
    amplitude: float


def added_force(candidate: Candidate, machine: Machine, run: Run, position: Array, velocity: Array) -> Array:
    """Force (n, coordinates), own units, of the candidate at its unit size along a trajectory (n, coordinates)."""
    definition = candidate.effect
    size = candidate.unit_size
    values = {**candidate.shape, candidate.amplitude: size}
    own = [values[p.name] for p in definition.parameters]
    force = np.zeros_like(position)
    if candidate.site in machine.coordinate_names:
        i = machine.coordinate_names.index(candidate.site)
        q, v = position[:, i], velocity[:, i]
        if definition.force:
            force[:, i] += definition.force(q, v, run.time_s, *own)
        if definition.coulomb:
            force[:, i] -= np.sign(v) * definition.coulomb(q, v, run.time_s, *own)
        if definition.viscous:
            viscous = machine.coordinate(candidate.site).viscous
            force[:, i] -= (definition.viscous(viscous, np.sign(v), *own) - viscous) * v
    if definition.delay:
        late = definition.delay(*own)
        for j, drive in enumerate(machine.drives):
            i = machine.coordinate_names.index(drive.coordinate)
            before = np.concatenate([run.inputs[:1, j], run.inputs[:-1, j]])
            period = np.median(np.diff(run.time_s))
            force[:, i] += drive.gain * (before - run.inputs[:, j]) * late / period
    return force


def screen(fit: Fit, candidates: Sequence[Candidate], data: Data) -> list[Screened]:
    """Candidates by the cost they would save, best first; those of the wrong sign save nothing."""
    if not candidates:
        return []
    own, others = len(fit.free), len(candidates)
    thetas = np.vstack([fit.theta, fit.theta + _STEP * np.eye(own)])
    table = parameter_table(fit.machine, fit.free, thetas)
    count = len(fit.machine.coordinates)
    period = data.period

    def products(run: Run) -> Array:
        positions = predict(fit.machine, run, fit.mode, period=period, parameters=table, velocities=True)
        base = residuals(fit.machine, run, data, positions)
        jacobian = (base[1:] - base[0]) / _STEP
        q, v = positions[0, :, :count], positions[0, :, count:]
        forces = np.array([added_force(c, fit.machine, run, q, v) for c in candidates])
        moved = predict(fit.machine, run, fit.mode, period=period, extra_force=_STEP * forces)
        still = predict(fit.machine, run, fit.mode, period=period, extra_force=np.zeros_like(forces[:1]))
        columns = residuals(fit.machine, run, data, moved) - residuals(fit.machine, run, data, still)
        stacked = np.vstack([jacobian, columns / _STEP, base[:1]])
        return stacked @ stacked.T

    gram = np.sum(list(over_runs(products, data)), axis=0)
    hessian = gram[:own, :own] + 1e-9 * np.diag(np.diag(gram)[:own])
    mimic = np.linalg.lstsq(hessian, gram[:own, own:], rcond=1e-12)[0]
    left = gram[own:, own:] - gram[own:, :own] @ mimic
    found = []
    for k, candidate in enumerate(candidates):
        alone, before = left[k, k], gram[own + k, own + k]
        if alone <= 1e-6 * before or before == 0.0:
            found.append(Screened(candidate, 0.0, 0.0))
            continue
        amount = -left[k, others] / alone
        lower, upper = (getattr(candidate.effect.parameter(candidate.amplitude), b) for b in ("lower", "upper"))
        amplitude = float(np.clip(amount * candidate.unit_size, lower, upper))
        kept = amplitude / candidate.unit_size
        gain = -2 * kept * left[k, others] - kept**2 * alone
        found.append(Screened(candidate, max(0.0, float(gain)), amplitude))
    return sorted(found, key=lambda s: -s.gain)
