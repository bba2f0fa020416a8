"""Estimate the voltages in rows that the logger dropped, from the motion that followed.

Interpolation knows nothing of a voltage that stepped within a gap. One row of 1 ms with the wrong voltage
displaces a machine by many times the noise of its sensors, so that even the true machine would seem to lack
an effect. The voltages are therefore unknowns beside the parameters of the machine. They minimize the sum of
squared residuals and of squared deviations from interpolation, each divided by its variance (maximum a
posteriori). Gauss-Newton steps find this minimum. A step that does not reduce the sum is shortened: friction
may hold the machine at one voltage and not at the next, so that the response is not linear.

A command that rests between its changes may have kept its last value over the gaps, as where the controller
itself was late. If the motion is then predicted better, held values take the place of interpolated ones, also
in gaps that are too long for an estimate. They need no estimate, which would take up what a wrong machine
lacks, unless it leaves clearly less of the motion: then a step lies within a gap after all.
"""

from __future__ import annotations

import dataclasses
import math
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy import optimize, sparse
from scipy.interpolate import CubicSpline
from scipy.sparse.linalg import spsolve

from ...arrays import Array
from ...line_log import LineLog
from ...machine import Machine
from ...preparation.dataset import Dataset, PreparedRecording
from ..judge.error import FitError
from ..judge.voltages import commands_are_held_over_gaps, may_change_between_rows, replaces_held_commands
from ..predict.free_parameters import default_free_parameters
from ..predict.prediction import SEARCH_BANDWIDTH, innovation_variance, map_runs
from ..predict.voltage_responses import voltage_responses
from .estimation import fit, prediction_cost, prediction_costs
from .model_error import continue_fit
from .voltage_updates import successive_changes

Rows = NDArray[np.intp]
_VOLTAGE_ITERATIONS = 5  # of voltages in dropped rows and parameters in turn
_LONGEST_GAP = 20  # rows; voltages in longer gaps stay interpolated or held
_BANDWIDTHS = (SEARCH_BANDWIDTH, SEARCH_BANDWIDTH / 4.0)  # rad/s
_SMALLEST_ERROR = 1e-6  # V, of interpolation
_MIN_PREDICTIONS = 10  # recorded rows that show how accurate interpolation is
_EVALUATIONS = 8  # of the posterior density, at most
_SHORTER = 0.3  # factor for a step that does not increase the posterior density
# Decrease of twice the negative logarithm of the posterior density below which the iterations end.
_SMALLEST_DECREASE = 0.01
_UNCHANGED = 0.05  # change relative to the error of interpolation that is not worth another fit


class LostVoltages(NamedTuple):
    """Runs with the voltages in rows that the logger dropped.

    Attributes:
        fitted: The fitted runs, with estimated voltages.
        held_out: The held-out runs, with estimated voltages.
        held: Whether the commands keep their last value over the gaps.
    """

    fitted: Dataset
    held_out: Dataset
    held: bool = False


def with_lost_voltages(machine: Machine, data: Dataset, held_out: Dataset, log: LineLog) -> LostVoltages:
    """Estimate the voltages in rows that the logger dropped, with a machine fitted to the fitted runs.

    Machine and voltages are estimated in turn, until the voltages hardly change.

    Args:
        machine: Machine as declared.
        data: Runs to fit.
        held_out: Runs that are not fitted; their voltages follow from the same machine.
        log: Called with a line of text if voltages are estimated, and if they are held over gaps.

    Returns:
        Both data sets with the estimated voltages, and whether the commands are held over the gaps. A data
        set without dropped rows is returned as it is.
    """
    unknown = _count_unknown_rows(data) + _count_unknown_rows(held_out)
    if not unknown and not _may_be_held(data):
        return LostVoltages(data, held_out)
    fitted = fit(machine, default_free_parameters(machine), data, SEARCH_BANDWIDTH)
    for _ in range(_VOLTAGE_ITERATIONS):
        refined = estimate_lost_voltages(data, fitted.machine)
        if refined is data:
            break
        data, fitted = refined, continue_fit(fitted, refined, SEARCH_BANDWIDTH)
    if unknown:
        log(f"voltages of {unknown} dropped rows are estimated from the measurements")
    if held := _is_held(data, fitted.machine):
        log("the commands keep their last value over the gaps of the log: that predicts the motion better")
    return LostVoltages(data, estimate_lost_voltages(held_out, fitted.machine), held)


def held_over_gaps(data: Dataset) -> Dataset:
    """Copy a data set so that commands keep the value of the last recorded row in dropped rows.

    Elsewhere such commands are interpolated.
    """
    return dataclasses.replace(data, runs=tuple(_bridged(run, held=True) for run in data.runs))


def estimate_lost_voltages(data: Dataset, machine: Machine) -> Dataset:
    """Copy a data set, with the voltages in dropped rows estimated from the measurements by a fitted machine.

    The expected voltages are interpolated linearly or by a cubic spline. Both are tried on recorded rows,
    each of which is predicted from neighbors as far away as the ends of the gap; the better one is used. If
    the motion says that the commands were held over the gaps, the last values are expected. The errors of
    these predictions give the expected deviation of the voltages. What the machine does not explain counts as
    noise.

    Args:
        data: Data set in whose gaps of up to 20 rows voltages are estimated, and held or interpolated in
            longer ones.
        machine: Fitted machine with its effects.

    Returns:
        Copy with corrected voltages; `data` itself if no row was dropped, or if all voltages change by at
        most 5 % of the standard deviation of the interpolation error.
    """
    if not any(run.dropped.any() for run in data.runs):
        return data
    held = _is_held(data, machine)
    results = list(map_runs(lambda run: _with_estimated_voltages(machine, run, data, held), data))
    if max(change for _, change in results) <= _UNCHANGED:
        return data
    return dataclasses.replace(data, runs=tuple(run for run, _ in results))


class _Unknowns(NamedTuple):
    """Voltages in r dropped rows before the motion is considered.

    Attributes:
        rows: Dropped rows, in ascending order, shape (r,).
        expected: Interpolated voltages, V, shape (r, drives).
        deviations: Standard deviations of the errors of interpolation, V, shape (r, drives).
    """

    rows: Rows
    expected: Array
    deviations: Array


def _may_be_held(data: Dataset) -> bool:
    """Return whether the commands may have kept their values in gaps: they rest between their changes."""
    dropped = any(run.dropped.any() for run in data.runs)
    return dropped and data.updates == 1 and not may_change_between_rows(successive_changes(data))


def _is_held(data: Dataset, machine: Machine) -> bool:
    """Return whether the motion says that the commands kept their last values in the gaps."""
    if not _may_be_held(data):
        return False
    costs = []
    for held in (True, False):
        bridged = dataclasses.replace(data, runs=tuple(_bridged(run, held) for run in data.runs))
        costs.append(prediction_costs(machine, bridged, SEARCH_BANDWIDTH))
    return commands_are_held_over_gaps(*costs)


def _bridged(run: PreparedRecording, held: bool) -> PreparedRecording:
    """Return a run whose dropped rows have the last recorded voltages, or linearly interpolated ones."""
    known = np.flatnonzero(~run.dropped)
    if held:
        inputs = run.inputs[known[np.searchsorted(known, np.arange(len(run.dropped)), side="right") - 1]]
    else:
        inputs = np.column_stack([np.interp(run.time_s, run.time_s[known], v[known]) for v in run.inputs.T])
    return dataclasses.replace(run, inputs=inputs)


def _count_unknown_rows(data: Dataset) -> int:
    """Return how many rows were dropped, in gaps of up to 20, in runs with measurements."""
    return sum(len(_short_gaps(run.dropped)[0]) for run in data.runs if np.isfinite(run.outputs).any())


def _with_estimated_voltages(
    machine: Machine, run: PreparedRecording, data: Dataset, held: bool
) -> tuple[PreparedRecording, float]:
    """Return a run with estimated voltages, and their largest change relative to the error of interpolation.

    In gaps that are too long for an estimate, voltages are held or interpolated; their error is not known.

    A narrower observer lets the response to a voltage last longer, which determines it better if the machine
    has no large error. Of two bandwidths, the one that gives more information is used.
    """
    if not run.dropped.any() or not np.isfinite(run.outputs).any():
        return run, 0.0
    rows, lengths = _short_gaps(run.dropped)
    inputs = _bridged(run, held).inputs
    inputs[rows] = run.inputs[rows]
    changed = not np.allclose(inputs, run.inputs, rtol=0.0, atol=_SMALLEST_ERROR)  # in long gaps
    if not len(rows):
        return dataclasses.replace(run, inputs=inputs), math.inf if changed else 0.0
    expected, deviations = _interpolated(run, rows, lengths, held)
    certain = np.all(deviations <= _SMALLEST_ERROR, axis=1)
    inputs[rows[certain]] = expected[certain]
    estimated, most = dataclasses.replace(run, inputs=inputs), -np.inf
    unknowns = _Unknowns(rows[~certain], expected[~certain], deviations[~certain])
    for bandwidth in _BANDWIDTHS if len(unknowns.rows) else ():
        candidate, information = _most_probable(machine, estimated, data, unknowns, bandwidth)
        if information > most:
            estimated, most = candidate, information
    if held:
        bridged = _bridged(run, held)
        alone = [dataclasses.replace(data, runs=(filled,)) for filled in (estimated, bridged)]
        if not replaces_held_commands(*(_error(machine, filled) for filled in alone)):
            estimated = bridged
    change = float(np.max(np.abs(estimated.inputs - run.inputs)[rows] / deviations))
    return estimated, math.inf if changed else change


def _error(machine: Machine, data: Dataset) -> FitError:
    """Return the error of the predictions with the widest observer."""
    floor, _ = innovation_variance(machine, data, SEARCH_BANDWIDTH)
    cost = prediction_cost(machine, data, SEARCH_BANDWIDTH)
    return FitError(cost, data.count, SEARCH_BANDWIDTH, widest=True, floor=floor)


def _most_probable(
    machine: Machine, run: PreparedRecording, data: Dataset, unknowns: _Unknowns, bandwidth: float
) -> tuple[PreparedRecording, float]:
    """Return a run with the most probable voltages in dropped rows, and how much information determines them.

    It is the sum of the logarithms of the information about each, -inf if the prediction diverges.
    """
    best, lowest, logarithm = run, np.inf, -np.inf
    step = np.zeros(unknowns.expected.shape)  # V
    for _ in range(_EVALUATIONS):
        cost, gradient, information = _posterior(machine, run, data, unknowns, bandwidth)
        if cost < lowest:
            step = spsolve(information.tocsc(), gradient).reshape(step.shape)
            converged = lowest - cost < _SMALLEST_DECREASE
            best, lowest, logarithm = run, cost, float(np.sum(np.log(information.diagonal())))
        else:
            step, converged = _SHORTER * step, cost - lowest < _SMALLEST_DECREASE
        if converged or lowest == np.inf:
            break
        inputs = best.inputs.copy()
        inputs[unknowns.rows] -= step
        run = dataclasses.replace(best, inputs=inputs)
    return best, logarithm


def _posterior(
    machine: Machine, run: PreparedRecording, data: Dataset, unknowns: _Unknowns, bandwidth: float
) -> tuple[float, Array, sparse.csr_array]:
    """Return how improbable the voltages of a run are, and the linear system of a Gauss-Newton step.

    The cost is -2 times the logarithm of the posterior density plus a constant, at the most likely variance
    of the noise; inf if the prediction diverges. Then follow half of its gradient, 1/V, and the information
    about the voltages, 1/V^2.
    """
    weights = 1.0 / unknowns.deviations.ravel() ** 2
    prior = sparse.csr_array(sparse.diags_array(weights))
    jacobian, residual = voltage_responses(machine, run, data, unknowns.rows, bandwidth)
    if not (np.isfinite(residual).all() and np.isfinite(jacobian.data).all()):
        return np.inf, np.zeros(len(weights)), prior
    count = max(int(np.count_nonzero(residual)), 1)
    squares = float(residual @ residual)
    # in units of the sensors' noise; what the machine does not explain is noise
    variance = max(1.0, squares / count)
    difference = (run.inputs[unknowns.rows] - unknowns.expected).ravel()  # V
    cost = count * math.log(variance) + squares / variance + float(weights @ difference**2)
    return (
        cost,
        jacobian.T @ residual / variance + weights * difference,
        jacobian.T @ jacobian / variance + prior,
    )


def _short_gaps(dropped: NDArray[np.bool_]) -> tuple[Rows, Rows]:
    """Return the dropped rows in gaps of up to 20 rows, and the length of the gap of each, in rows."""
    # in a short run, few rows show how accurate interpolation is
    longest = min(_LONGEST_GAP, len(dropped) // 8)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], dropped, [False]])))
    gaps = [(first, end) for first, end in edges.reshape(-1, 2) if end - first <= longest]
    rows = [np.arange(first, end) for first, end in gaps]
    lengths = [np.full(end - first, end - first) for first, end in gaps]
    empty = np.zeros(0, dtype=np.intp)
    return np.concatenate([empty, *rows]), np.concatenate([empty, *lengths])


def _interpolated(run: PreparedRecording, rows: Rows, lengths: Rows, held: bool) -> tuple[Array, Array]:
    """Return expected voltages in dropped rows, and their errors' standard deviations, V, (rows, drives)."""
    voltages, deviations = np.zeros((2, len(rows), run.inputs.shape[1]))
    for length in np.unique(lengths):
        k = lengths == length
        for j, values in enumerate(run.inputs.T):
            recorded = np.where(run.dropped, np.nan, values)
            voltages[k, j], deviations[k, j] = _interpolated_drive(
                run.time_s, recorded, rows[k], int(length), held
            )
    return voltages, np.maximum(deviations, _SMALLEST_ERROR)


def _interpolated_drive(
    time_s: Array, recorded: Array, rows: Rows, length: int, held: bool
) -> tuple[Array, Array]:
    """Return expected voltages in gaps of `length` rows, and their errors' standard deviations, V, (r,).

    Expected are the last recorded values if they are held, else interpolated ones. Recorded rows are
    predicted like the middle of a gap. The square of the error is a constant plus a multiple of the squared
    change of the voltage across the gap: where a stepping voltage is equal on both sides, it hardly errs. If
    fewer than ten rows can be predicted where the voltage changes, the deviation is the change across the
    gap.
    """
    distance = (length + 2) // 2  # of the middle of a gap from its ends, in rows
    # Rows before and after each row: the nearest that are known, and those at twice their distance.
    far_before, before, actual, after, far_after = sliding_window_view(recorded, 4 * distance + 1)[
        :, ::distance
    ].T
    mean = 0.5 * (before + after)
    polynomial = (8.0 * mean - far_before - far_after) / 6.0  # of third degree
    errors = np.array([mean - actual, polynomial - actual, before - actual]) ** 2
    usable = np.isfinite(errors[1])
    known = np.flatnonzero(np.isfinite(recorded))
    linear = np.interp(time_s[rows], time_s[known], recorded[known])
    following = np.searchsorted(known, rows)
    last = recorded[known[following - 1]]
    change = recorded[known[following]] - last
    steady = (far_before == before) & (before == actual) & (actual == after) & (after == far_after)
    if np.count_nonzero(usable & ~steady) < _MIN_PREDICTIONS:
        return last if held else linear, np.abs(change)
    if held:
        best, voltages = 2, last
    else:
        best = int(np.argmin(errors[:2, usable].sum(axis=1)))
        voltages = CubicSpline(time_s[known], recorded[known])(time_s[rows]) if best else linear
    regressors = np.column_stack([np.ones(usable.sum()), (after - before)[usable] ** 2])
    constant, factor = optimize.nnls(regressors, errors[best, usable])[0]
    return voltages, np.sqrt(constant + factor * change**2)
