"""Loops over predictions that compare them with the measurements: one pass each, without intermediate arrays.

The values of a few rows, all sensors of a row before the next one, are processed together: a loop over them
is long enough for the processor's vector instructions, one over the sensors is not. It counts from the first
value of slices, because an index that may be negative prevents these instructions.
"""
# mypy: ignore-errors

from __future__ import annotations

import numpy as np

from ...dynamics.codegen.compiled import compiled, compiled_only

_ROWS_TOGETHER = 16  # with four sensors, 64 values: eight registers of 512 bits


@compiled
def mean_errors(measured, predicted, weights, begin: int, end: int):
    """Return the weighted means over some rows of measured minus predicted values, shape (batch, sensors).

    Args:
        measured: Measurements, in the sensors' units, any number where not measured, shape (n, sensors).
        predicted: Predicted measurements, in the sensors' units, shape (batch, n, sensors).
        weights: Weights of the measurements, dimensionless, 0 where not measured, shape (n, sensors).
        begin: First row.
        end: Row after the last one.

    Returns:
        Means in the sensors' units; 0 for a sensor that was not measured in these rows.
    """
    batch, _, sensors = predicted.shape
    means = np.zeros((batch, sensors))
    totals = np.zeros(sensors)
    for i in range(begin, end):
        for j in range(sensors):
            totals[j] += weights[i, j]
    measured, weights = measured[begin:end].reshape(-1), weights[begin:end].reshape(-1)
    together = _ROWS_TOGETHER * sensors
    sums = np.empty(together)
    for b in range(batch):
        values = predicted[b, begin:end].reshape(-1)
        sums[:] = 0.0
        for first in range(0, len(values), together):
            value = values[first : first + together]
            measurement, weight = measured[first : first + together], weights[first : first + together]
            for k in range(len(value)):
                sums[k] += weight[k] * (measurement[k] - value[k])
        for k in range(together):
            means[b, k % sensors] += sums[k]
        for j in range(sensors):
            means[b, j] /= max(totals[j], 1e-12)
    return means


@compiled
def scaled_errors(measured, predicted, zeros, scales, rows_per_block: int):
    """Return (measured - predicted - zero) * scale, summed by blocks of rows, shape (batch, blocks, sensors).

    Args:
        measured: Measurements, in the sensors' units, any number where not measured, shape (n, sensors).
        predicted: Predicted measurements, in the sensors' units, shape (batch, n, sensors).
        zeros: Errors of the sensors' zeros, in the sensors' units, shape (batch, sensors).
        scales: Factor of each measurement, any unit, 0 where not measured, shape (n, sensors).
        rows_per_block: Number of consecutive rows in a block; rows after the last complete block are left
            out.
    """
    if rows_per_block == 1:
        return _errors_of_rows(measured, predicted, zeros, scales)
    batch, rows, sensors = predicted.shape
    blocks = rows // rows_per_block
    errors = np.empty((batch, blocks, sensors))
    for b in range(batch):
        for k in range(blocks):
            for j in range(sensors):
                error = 0.0
                for i in range(k * rows_per_block, (k + 1) * rows_per_block):
                    error += (measured[i, j] - predicted[b, i, j] - zeros[b, j]) * scales[i, j]
                errors[b, k, j] = error
    return errors


@compiled_only
def _errors_of_rows(measured, predicted, zeros, scales):
    """Return (measured - predicted - zero) * scale, shape (batch, n, sensors)."""
    sensors = predicted.shape[2]
    errors = np.empty(predicted.shape)
    measured, scales = measured.reshape(-1), scales.reshape(-1)
    together = _ROWS_TOGETHER * sensors
    zero = np.empty(together)
    for b in range(len(errors)):
        for k in range(together):
            zero[k] = zeros[b, k % sensors]
        values, of_rows = predicted[b].reshape(-1), errors[b].reshape(-1)
        for first in range(0, len(values), together):
            value, error = values[first : first + together], of_rows[first : first + together]
            measurement, scale = measured[first : first + together], scales[first : first + together]
            for k in range(len(value)):
                error[k] = (measurement[k] - value[k] - zero[k]) * scale[k]
    return errors
