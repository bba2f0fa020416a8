"""Estimate the voltages in rows that the logger dropped, from the motion that followed.

Interpolation knows nothing of a voltage that stepped within a gap. One row of 1 ms with the wrong voltage displaces a
machine by many times the noise of its sensors, so that even the true machine would seem to lack an effect. The voltages
are therefore unknowns beside the parameters of the machine: a prediction is linearized in them, and they minimize the
sum of squared residuals and of their deviations from interpolation (maximum a posteriori).
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy import optimize, sparse
from scipy.interpolate import CubicSpline
from scipy.sparse.linalg import spsolve

from ..machine import Machine
from .dataset import Dataset, PreparedRecording
from .prediction import SEARCH_BANDWIDTH, map_runs, predict, residuals

Array = NDArray[np.float64]
Rows = NDArray[np.intp]
_LONGEST_GAP = 20  # rows; voltages in longer gaps stay interpolated
_BANDWIDTHS = (SEARCH_BANDWIDTH, SEARCH_BANDWIDTH / 4.0)  # rad/s
_RESPONSE = 18.0  # product of the bandwidth and the time after which the observer has corrected the response to a row
_SMALLEST_ERROR = 1e-6  # V, of interpolation
_PULSE = 0.1  # V, for the linearization
_ITERATIONS = 3
_UNCHANGED = 0.05  # change relative to the error of interpolation that is not worth another fit


def estimate_lost_voltages(data: Dataset, machine: Machine) -> Dataset:
    """Copy a data set, with the voltages in dropped rows estimated from the measurements by a fitted machine.

    Voltages are expected to be those of linear interpolation or of a cubic spline, whichever predicts recorded rows
    better from neighbors at the distance that the gap has; the errors of these predictions show how far the voltages
    may deviate. What the machine does not explain counts as noise.

    Args:
        data: Data set (times, voltages, measurements, SI) in whose gaps of up to 20 rows voltages are estimated.
        machine: Fitted machine with its effects (deviations from the nominal model).

    Returns:
        Copy with corrected voltages, V, shape (n, drives) for each run; `data` itself if no row was dropped, or if all
        voltages change by less than 5 % of the error of interpolation.
    """
    if not any(run.dropped.any() for run in data.runs):
        return data
    results = list(map_runs(lambda run: _with_estimated_voltages(machine, run, data), data))
    if max(change for _, change in results) <= _UNCHANGED:
        return data
    return dataclasses.replace(data, runs=tuple(run for run, _ in results))


def _with_estimated_voltages(
    machine: Machine, run: PreparedRecording, data: Dataset
) -> tuple[PreparedRecording, float]:
    """Return a run with estimated voltages, and their largest change relative to the error of interpolation.

    A narrower observer lets the response to a voltage last longer, which determines it better if the machine has no
    large error. Of two bandwidths, the one that gives more information is used.
    """
    rows, lengths = _short_gaps(run.dropped)
    if not len(rows) or not np.isfinite(run.outputs).any():
        return run, 0.0
    expected, deviations = _interpolated(run, rows, lengths)
    estimated, most = run, -np.inf
    for bandwidth in _BANDWIDTHS:
        candidate, information = _estimated(machine, estimated, data, rows, expected, deviations, bandwidth)
        if information > most:
            estimated, most = candidate, information
    return estimated, float(np.max(np.abs(estimated.inputs - run.inputs)[rows] / deviations))


def _estimated(
    machine: Machine,
    run: PreparedRecording,
    data: Dataset,
    rows: Rows,
    expected: Array,
    deviations: Array,
    bandwidth: float,
) -> tuple[PreparedRecording, float]:
    """Return a run with the most probable voltages in dropped rows, and how much information determines them.

    Args:
        machine: Machine that predicts.
        run: Run with a first estimate of the voltages.
        data: Data set of the run.
        rows: Dropped rows, shape (r,).
        expected: Interpolated voltages, V, shape (r, drives).
        deviations: Standard deviations of the errors of interpolation, V, shape (r, drives).
        bandwidth: Bandwidth of the observer that corrects the prediction, rad/s.

    Returns:
        The run with its voltages, and the sum of the logarithms of the information about each, -inf if the prediction
        diverges.
    """
    weights = 1.0 / deviations.ravel() ** 2
    logarithm = -np.inf
    for _ in range(_ITERATIONS):
        jacobian, residual = _linearize(machine, run, data, rows, bandwidth)
        if not (np.isfinite(residual).all() and np.isfinite(jacobian.data).all()):
            return run, -np.inf
        variance = max(1.0, float(np.sum(residual**2)) / max(int(np.count_nonzero(residual)), 1))
        information = jacobian.T @ jacobian / variance + sparse.diags_array(weights)
        gradient = jacobian.T @ residual / variance + weights * (run.inputs[rows] - expected).ravel()
        inputs = run.inputs.copy()
        inputs[rows] -= spsolve(information.tocsc(), gradient).reshape(expected.shape)
        run = dataclasses.replace(run, inputs=inputs)
        logarithm = float(np.sum(np.log(information.diagonal())))
    return run, logarithm


def _short_gaps(dropped: NDArray[np.bool_]) -> tuple[Rows, Rows]:
    """Return the dropped rows in gaps of up to 20 rows, and the length of the gap of each, in rows."""
    longest = min(_LONGEST_GAP, len(dropped) // 8)  # in a short run, few rows show how accurate interpolation is
    edges = np.flatnonzero(np.diff(np.concatenate([[False], dropped, [False]])))
    gaps = [(first, end) for first, end in edges.reshape(-1, 2) if end - first <= longest]
    rows = [np.arange(first, end) for first, end in gaps]
    lengths = [np.full(end - first, end - first) for first, end in gaps]
    empty = np.zeros(0, dtype=np.intp)
    return np.concatenate([empty, *rows]), np.concatenate([empty, *lengths])


def _interpolated(run: PreparedRecording, rows: Rows, lengths: Rows) -> tuple[Array, Array]:
    """Return interpolated voltages in dropped rows, and the standard deviations of their errors, V, (rows, drives)."""
    voltages, deviations = np.zeros((2, len(rows), run.inputs.shape[1]))
    for length in np.unique(lengths):
        k = lengths == length
        for j, values in enumerate(run.inputs.T):
            recorded = np.where(run.dropped, np.nan, values)
            voltages[k, j], deviations[k, j] = _interpolated_drive(run.time_s, recorded, rows[k], int(length))
    return voltages, np.maximum(deviations, _SMALLEST_ERROR)


def _interpolated_drive(time_s: Array, recorded: Array, rows: Rows, length: int) -> tuple[Array, Array]:
    """Return interpolated voltages in gaps of one length, and the standard deviations of their errors, V.

    Recorded rows are predicted like the middle of a gap. The square of the error is a constant plus a multiple of the
    squared change of the voltage across the gap: where a stepping voltage is equal on both sides, it hardly errs.

    Args:
        time_s: Sample times, s, shape (n,).
        recorded: Voltage of a drive, V, NaN in dropped rows, shape (n,).
        rows: Dropped rows, shape (r,).
        length: Length of the gaps that they belong to, in rows.

    Returns:
        Voltages and standard deviations, V, shape (r,) each; zero deviations if too few rows are recorded.
    """
    distance = (length + 2) // 2  # of the middle of a gap from its ends, in rows
    # Rows before and after each row: the nearest that are known, and those at twice their distance.
    far_before, before, actual, after, far_after = sliding_window_view(recorded, 4 * distance + 1)[:, ::distance].T
    mean = 0.5 * (before + after)
    polynomial = (8.0 * mean - far_before - far_after) / 6.0  # of third degree
    errors = np.array([mean - actual, polynomial - actual]) ** 2
    usable = np.isfinite(errors[1])
    known = np.flatnonzero(np.isfinite(recorded))
    linear = np.interp(time_s[rows], time_s[known], recorded[known])
    if not usable.any():
        return linear, np.zeros(len(rows))
    best = int(np.argmin(errors[:, usable].sum(axis=1)))
    voltages = CubicSpline(time_s[known], recorded[known])(time_s[rows]) if best else linear
    regressors = np.column_stack([np.ones(usable.sum()), (after - before)[usable] ** 2])
    following = np.searchsorted(known, rows)
    change = recorded[known[following]] - recorded[known[following - 1]]
    constant, factor = optimize.nnls(regressors, errors[best, usable])[0]
    return voltages, np.sqrt(constant + factor * change**2)


def _linearize(
    machine: Machine, run: PreparedRecording, data: Dataset, rows: Rows, bandwidth: float
) -> tuple[sparse.csr_array, Array]:
    """Return the derivative of the residual with respect to the voltages in dropped rows, and the residual.

    Rows whose responses do not overlap are perturbed in the same prediction.

    Args:
        machine: Machine that predicts.
        run: Run to predict, n samples.
        data: Data set of the run.
        rows: Dropped rows, in ascending order, shape (r,).
        bandwidth: Bandwidth of the observer that corrects the prediction, rad/s.

    Returns:
        Jacobian, 1/V, shape (n * sensors, r * drives), and residual, dimensionless, shape (n * sensors,).

    References:
        Curtis, Powell and Reid (1974), on the estimation of sparse Jacobian matrices.
    """
    count, drives = run.inputs.shape
    length = max(1, round(_RESPONSE / bandwidth / data.period))  # of a response, in rows
    groups, last = np.zeros(len(rows), dtype=int), list[int]()
    for k, row in enumerate(rows):
        free = (g for g, previous in enumerate(last) if row - previous >= length)
        groups[k] = next(free, len(last))
        last[groups[k] : groups[k] + 1] = [row]
    inputs = np.tile(run.inputs, (1 + len(last) * drives, 1, 1))
    predictions = 1 + groups[:, None] * drives + np.arange(drives)  # (r, drives); the first one is not perturbed
    for j in range(drives):
        inputs[predictions[:, j], rows, j] += _PULSE
    motion = predict(machine, run, bandwidth, period=data.period, inputs=inputs)
    residual = residuals(run, data, motion.readings).reshape(len(inputs), count, -1)  # (predictions, n, sensors)
    sensors = residual.shape[2]
    ends = np.minimum(rows + length, count)
    columns: list[Array] = [
        ((residual[p, row:end] - residual[0, row:end]) / _PULSE).ravel()
        for row, end, of_row in zip(rows, ends, predictions, strict=True)
        for p in of_row
    ]
    indices = [
        np.arange(row * sensors, end * sensors) for row, end in zip(rows, ends, strict=True) for _ in range(drives)
    ]
    pointers = np.concatenate([[0], np.cumsum([len(column) for column in columns])])
    shape = (count * sensors, len(columns))
    jacobian = sparse.csc_array((np.concatenate(columns), np.concatenate(indices), pointers), shape=shape)
    return jacobian.tocsr(), residual[0].ravel()
