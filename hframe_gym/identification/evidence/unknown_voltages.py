"""What the unknown voltages between the rows of a slow log may explain of the error.

Interpolated voltages miss some of what a controller does between two rows, in the same way in all runs.
Neither chance nor other runs tell such an error from an effect:

- The voltages may change more or less often between the rows than assumed, or follow straight lines or
  splines.
- A controller answers the motion between the rows, such as vibrations on belts, of which the interpolated
  rows show less. A damping of the belts that is not there describes what the controller damps.

What each of these changes in the predictions is a regressor, of which the amount is unknown and the same in
all runs. An effect must reduce the error beside all of them (`judge.effect`). They are fitted together with
the parameters, to first order: one step from the fit without the effect, and one from the fit with it.
"""

from __future__ import annotations

import dataclasses
import math
from typing import NamedTuple

import numpy as np
from scipy.optimize import lsq_linear

from ...arrays import Array
from ...dynamics.simulation import Motion
from ...machine import Machine
from ...preparation.dataset import Dataset, PreparedRecording
from ...preparation.inputs.interpolated_voltages import updated_inputs
from ..fit.estimation import Fit
from ..predict.free_parameters import prior_precision
from ..predict.linearization import ResidualModel
from ..predict.normal_equations import NormalEquations
from ..predict.prediction import POLISH_STEP, SIMULATION, map_runs, predict
from ..predict.voltage_errors import interpolation_variance

# Largest amount of a regressor. The true voltages lie between the interpolations and may do as much again;
# errors of interpolated voltages are known within a factor of two.
_LARGEST = 2.0
_OTHERS = 3  # other interpolations
_ANSWER = 0.1  # V at most, for the linearization
_STEPS = 8  # of the trapezoidal rule from row to row, over which interpolated motion is smooth
# Keeps products regular where parameters, or regressors, have the same influence on the measurements.
_RIDGE = 1e-9


class _Part(NamedTuple):
    """Products of a run.

    Attributes:
        equations: Of the residual, the parameters and the regressors.
        missed: Sums of the squared motion that interpolation misses, shape (2 * drives,).
        errors: Sums of the variances of the interpolated voltages, V^2, shape (2 * drives,).
    """

    equations: NormalEquations
    missed: Array
    errors: Array


def cost_beside_voltages(fitted: Fit, data: Dataset) -> float:
    """Return the cost that remains after unknown voltages between rows explain what they can.

    These may have been otherwise in three ways: with one more change per row, along straight lines or splines
    between the rows, and as answers of the controller to the motion that interpolated rows miss. The change
    of the predictions by each, multiplied by an unknown amount, and the parameters of the fit are chosen
    together, to first order, so that the cost plus the penalty of the parameters' prior is smallest.

    Args:
        fitted: Fit around whose parameters the predictions are linearized.
        data: Runs that were fitted, whose voltages change between the rows.

    Returns:
        Cost with this penalty, dimensionless; not a number if a simulation diverges.
    """
    model = ResidualModel(fitted.machine, fitted.free, data, fitted.bandwidth, fitted.longest_step)
    point = model.at(fitted.theta)

    def of_run(run: PreparedRecording) -> _Part | None:
        start = point.starts[run.name].state
        missed = missed_motion(model.machine, run, start, data.period)
        if missed is None:
            return None

        def responses(run: PreparedRecording, _: Motion) -> Array:
            return _responses(model, run, missed, start)

        rows = point.linearize_run(run, responses)
        equations = NormalEquations.from_rows(rows.jacobian, rows.residual, rows.responses)
        errors = interpolation_variance(run.without_clock_answers()).sum(axis=0)
        return _Part(equations, np.sum(missed**2, axis=1), np.tile(errors, 2))

    parts = [part for part in map_runs(of_run, data) if part is not None]
    if len(parts) < len(data.runs):
        return math.nan
    total = NormalEquations.total(part.equations for part in parts)
    missed = np.sum([part.missed for part in parts], axis=0)
    errors = np.sum([part.errors for part in parts], axis=0)
    prior = prior_precision(fitted.free)
    total = dataclasses.replace(
        total,
        gradient=total.gradient + prior @ fitted.theta,
        cost=total.cost + float(fitted.theta @ prior @ fitted.theta),
    )
    if not (total.finite and np.isfinite(total.response_information).all()):
        return math.nan
    # Controllers answer by no more than what interpolated voltages miss.
    answers = np.sqrt(np.divide(errors, missed, out=np.zeros_like(errors), where=missed > 0.0))
    return _least_cost(total, prior, np.concatenate([np.ones(_OTHERS), answers]))


def _least_cost(total: NormalEquations, prior: Array, units: Array) -> float:
    """Return the least cost for all parameters, and amounts of regressors in these units up to `_LARGEST`."""
    ridge = np.diag(_RIDGE * np.diag(total.information))
    reduced = total.eliminate_parameters(prior + ridge)
    by_parameters = total.gradient @ np.linalg.solve(total.information + prior + ridge, total.gradient)
    information = reduced.response_information * np.outer(units, units)
    slope = reduced.response_gradient * units
    # Least squares with this information and gradient, without directions in which nothing changes.
    values, vectors = np.linalg.eigh(information)
    kept = values > _RIDGE * max(values.max(), 1.0)
    roots, directions = np.sqrt(values[kept]), vectors[:, kept].T
    if not kept.any():
        return float(total.cost - by_parameters)
    found = lsq_linear(roots[:, None] * directions, -(directions @ slope) / roots, (-_LARGEST, _LARGEST)).x
    return float(total.cost - by_parameters + found @ (2.0 * slope + information @ found))


def _responses(model: ResidualModel, run: PreparedRecording, missed: Array, start: Array) -> Array:
    """Return what other voltages change in the residual of a run, shape (regressors, rows)."""

    def residual(other: PreparedRecording, inputs: Array | None = None) -> Array:
        predicted = predict(
            model.machine,
            other,
            model.bandwidth,
            period=model.data.period,
            inputs=inputs,
            initial_state=start,
            longest_step=model.longest_step,
        )
        return model.residuals(run, predicted.readings)

    others = (
        dataclasses.replace(run, updates=run.updates + 1),
        dataclasses.replace(run, interpolation="straight"),
        dataclasses.replace(run, interpolation="spline"),
    )
    assumed = residual(run)[0]
    changes = [residual(other)[0] - assumed for other in others]
    largest = np.abs(missed).max(axis=1)
    gains = _ANSWER / np.where(largest > 0.0, largest, 1.0)
    inputs = np.tile(run.inputs, (1 + len(gains), 1, 1))
    for k, gain in enumerate(gains):
        inputs[1 + k, :-1, k % run.inputs.shape[1]] += gain * missed[k]
    # An answer is a mean voltage from row to row.
    held = residual(dataclasses.replace(run, updates=1), inputs)
    return np.vstack([*changes, (held[1:] - held[0]) / gains[:, None]])


def missed_motion(machine: Machine, run: PreparedRecording, start: Array, period: float) -> Array | None:
    """Return the mean motion from each row to the next, minus the mean of the motion interpolated from rows.

    Positions and speeds are interpolated as the voltages of the run are. The motion is simulated without an
    observer, which would add corrections in the rows.

    Args:
        machine: Machine to simulate.
        run: Run of n samples.
        start: State at the first sample, SI, shape (2 * coordinates + effect states,).
        period: Sampling period, s.

    Returns:
        Differences: of the speed of what each drive moves, m/s or rad/s, then of its position, m or rad,
        shape (2 * drives, n - 1); None if the simulation diverges.
    """
    motion = predict(
        machine, run, SIMULATION, period=period, initial_state=start, longest_step=POLISH_STEP, states=True
    )
    names = [c.name for c in machine.coordinates]
    moved = [names.index(drive.coordinate) for drive in machine.drives]
    positions, speeds = motion.positions[0][:, moved], motion.velocities[0][:, moved]
    if not (np.isfinite(positions).all() and np.isfinite(speeds).all()):
        return None
    steps = np.diff(run.time_s)[:, None]
    mean_speeds = np.diff(positions, axis=0) / steps
    # Of the cubic with these positions and speeds in both rows.
    mean_positions = 0.5 * (positions[1:] + positions[:-1]) - steps / 12.0 * np.diff(speeds, axis=0)
    missed = (
        mean_speeds - _interpolated_means(run, speeds),
        mean_positions - _interpolated_means(run, positions),
    )
    return np.hstack(missed).T


def _interpolated_means(run: PreparedRecording, rows: Array) -> Array:
    """Return the means from row to row of values, shape (n, values), interpolated as voltages are."""
    between = updated_inputs(run.time_s, rows, _STEPS, run.interpolation)
    trapezoids = 0.5 * (between[1:] + between[:-1])
    return np.asarray(trapezoids.reshape(-1, _STEPS, rows.shape[1]).mean(axis=1))
