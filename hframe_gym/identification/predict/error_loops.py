"""Loops over predictions that compare them with the measurements: one pass each, without intermediate arrays."""
# mypy: ignore-errors

from __future__ import annotations

import numpy as np

from ...dynamics.codegen.compiled import compiled


@compiled
def mean_errors(measured, predicted, weights, begin: int, end: int):
    """Return the weighted means over some rows of measured minus predicted values, shape (batch, sensors).

    Args:
        measured: Measurements, in the sensors' units, any number where not measured, shape (n, sensors).
        predicted: Predicted measurements, in the sensors' units, shape (batch, n, sensors).
        weights: Weights of the measurements, dimensionless, 0 where not measured, shape (n, sensors).
        begin: First row.
        end: Row after the last one.
    """
    batch, _, sensors = predicted.shape
    means = np.zeros((batch, sensors))
    totals = np.zeros(sensors)
    for i in range(begin, end):
        for j in range(sensors):
            totals[j] += weights[i, j]
    for b in range(batch):
        for i in range(begin, end):
            for j in range(sensors):
                means[b, j] += weights[i, j] * (measured[i, j] - predicted[b, i, j])
        for j in range(sensors):
            means[b, j] /= max(totals[j], 1e-12)
    return means


@compiled
def scaled_errors(measured, predicted, zeros, scales, rows_per_block: int):
    """Return (measured - predicted - zero) * scale, summed over blocks of rows, shape (batch, blocks, sensors).

    Args:
        measured: Measurements, in the sensors' units, any number where not measured, shape (n, sensors).
        predicted: Predicted measurements, in the sensors' units, shape (batch, n, sensors).
        zeros: Errors of the sensors' zeros, in the sensors' units, shape (batch, sensors).
        scales: Scales, any unit, shape (n, sensors).
        rows_per_block: Number of consecutive rows in a block; rows after the last complete block are left out.
    """
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
