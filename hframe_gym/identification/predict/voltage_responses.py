"""Responses of predictions to the voltages of single rows, which may be missing or wrong in a log."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from ...arrays import Array
from ...machine import Machine, rigid_basis
from ...preparation.dataset import Dataset, PreparedRecording
from .prediction import LONGEST_OBSERVER_PERIOD, POLISH_STEP, mechanical_rows_per_block, predict, residuals

Rows = NDArray[np.intp]
# Product of the observer's bandwidth and the time after which it has corrected the response to a row; the
# bandwidth of lasers beside encoders is 5/12 of it.
SETTLED = 18.0
_VALUES = 4_000_000  # measurements that are predicted together; limits the memory to some hundred megabytes
_PULSE = 0.1  # V, for the linearization


def voltage_responses(
    machine: Machine,
    run: PreparedRecording,
    data: Dataset,
    rows: Rows,
    bandwidth: float,
    *,
    per_block: int | None = None,
    settled: float = SETTLED,
    longest_step: float = POLISH_STEP,
    most_values: int = _VALUES,
) -> tuple[sparse.csr_array, Array]:
    """Return the derivative of the residual with respect to the voltages in some rows, and the residual.

    Rows whose responses do not overlap are perturbed in the same prediction, to save time. Their directions
    alternate, which keeps the mean of the responses small: it is subtracted from every residual as an error
    of the sensor's zero.

    Args:
        machine: Machine that predicts.
        run: Run to predict, n samples.
        data: Data set of the run.
        rows: Indices of the rows whose voltages may be wrong, in ascending order, shape (r,).
        bandwidth: Bandwidth of the observer, rad/s.
        per_block: Rows of the residual that are combined into one. Default: those within 4 ms.
        settled: Product of bandwidth and time after which a response counts as corrected, dimensionless.
        longest_step: Maximum integration step, s.
        most_values: Measurements that are predicted together, at most, unless one perturbation has more.

    Returns:
        Jacobian, 1/V, shape (m, r * drives), all drives of a row before the next one, and residual,
        dimensionless, shape (m,), with one value per sensor in each (combined) row, m in total.

    References:
        Curtis, Powell and Reid (1974), on the estimation of sparse Jacobian matrices.
    """
    drives = run.inputs.shape[1]
    length = _response_length(machine, run, data, bandwidth, settled)
    groups, pulses = _groups(rows, length)
    per_block = min(per_block or mechanical_rows_per_block(data), len(run.time_s))
    blocks, sensors = len(run.time_s) // per_block, run.outputs.shape[1]
    measured = np.isfinite(run.outputs[: blocks * per_block]).reshape(blocks, per_block, sensors).mean(axis=1)
    # For unit noise where cells of a block are blank.
    scales = 1.0 / np.sqrt(np.where(measured > 0.0, measured, 1.0))

    def predicted(inputs: Array) -> Array:
        """Return residuals for several histories of the voltages, shape (histories, blocks, sensors)."""
        motion = predict(
            machine, run, bandwidth, period=data.period, inputs=inputs, longest_step=longest_step
        )
        return residuals(run, data, motion.readings, per_block).reshape(len(inputs), blocks, sensors) * scales

    residual = predicted(run.inputs[None])[0]
    begins, ends = rows // per_block, np.minimum(-(-(rows + length) // per_block), blocks)
    pointers = np.concatenate([[0], np.cumsum(np.repeat((ends - begins) * sensors, drives))])
    values = np.zeros(pointers[-1])
    together = _groups_together(most_values, run.outputs.size * drives)
    for first in range(0, int(groups.max()) + 1, together):
        members = np.flatnonzero((groups >= first) & (groups < first + together))
        inputs = np.tile(run.inputs, (int(groups[members].max() + 1 - first) * drives, 1, 1))
        predictions = (groups[members, None] - first) * drives + np.arange(drives)  # (members, drives)
        inputs[predictions, rows[members, None], np.arange(drives)] += pulses[members, None]
        responses = predicted(inputs) - residual
        for k, of_row in zip(members, predictions, strict=True):
            response = responses[of_row, begins[k] : ends[k]] / pulses[k]  # (drives, blocks, sensors)
            values[pointers[k * drives] : pointers[(k + 1) * drives]] = response.ravel()
    firsts = np.repeat(begins * sensors, drives) - pointers[:-1]
    positions = np.arange(pointers[-1], dtype=np.int32)  # half the memory of the default
    positions += np.repeat(firsts, np.diff(pointers)).astype(np.int32)
    shape = (residual.size, len(rows) * drives)
    return sparse.csc_array((values, positions, pointers), shape=shape).tocsr(), residual.ravel()


def _groups_together(most_values: int, values: int) -> int:
    """Return how many groups, with that many values each, are predicted at once."""
    return max(1, most_values // values)


def _response_length(
    machine: Machine, run: PreparedRecording, data: Dataset, bandwidth: float, settled: float
) -> int:
    """Return after how many rows the observer has corrected the response to the voltage of a row.

    It corrects in measured rows only. The sensors that measure most often and together see every motion of
    the machine that stretches no belt count.
    """
    seen = machine.sensor_matrix @ rigid_basis(machine)  # (sensors, motions)
    measured = np.isfinite(run.outputs).mean(axis=0)  # fraction of the rows, of each sensor
    rank = np.linalg.matrix_rank(seen[measured > 0.0])
    fraction = max(f for f in measured[measured > 0.0] if np.linalg.matrix_rank(seen[measured >= f]) == rank)
    return max(1, round(settled / (bandwidth * min(data.period, LONGEST_OBSERVER_PERIOD) * fraction)))


def _groups(rows: Rows, length: int) -> tuple[Rows, Array]:
    """Return groups of rows at least a length apart, and pulses in alternating directions, V, (r,) each."""
    groups, pulses = np.zeros(len(rows), dtype=int), np.full(len(rows), _PULSE)
    last = deque[int]()  # for each group, the index of its last row; the earliest first
    for k, row in enumerate(rows):
        if last and row - rows[last[0]] >= length:
            before = last.popleft()
            groups[k], pulses[k] = groups[before], -pulses[before]
        else:
            groups[k] = len(last)
        last.append(k)
    return groups, pulses
