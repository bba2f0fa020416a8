"""Average measured motion and inputs over windows, to compare forces and motion without a simulation."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.integrate import cumulative_trapezoid

from ...arrays import Array
from ...recordings import bridge_blanks
from ..dataset import PreparedRecording

_OVERLAP = 2  # grid points of the balance per window


class MotionWindows(NamedTuple):
    """Measured motion and inputs of one run, averaged over windows.

    Attributes:
        position: Mean measurements, in the sensors' units, NaN where not measured, shape (rows, sensors).
        velocity: Their first derivatives, in these units per s, shape (rows, sensors).
        acceleration: Their second derivatives, in these units per s^2, shape (rows, sensors).
        inputs: Means of the inputs with the same weights as the accelerations, V, shape (rows, drives).
    """

    position: Array
    velocity: Array
    acceleration: Array
    inputs: Array


def motion_windows(run: PreparedRecording, span: float) -> MotionWindows:
    """Average a run over windows and differentiate it.

    A second difference of positions is the mean acceleration with triangular weights. The inputs are averaged
    with the same weights, so that both sides of the balance agree exactly, however fast the inputs change.

    Args:
        span: Length of a window, s.

    Returns:
        Means and derivatives, with two rows per window; no rows for a run that is shorter than three windows.
    """
    time_s = run.time_s - run.time_s[0]
    grid = np.arange(span / 2, time_s[-1] - span / 2, span / _OVERLAP)
    if len(grid) <= 2 * _OVERLAP:
        empty = np.zeros((0, run.outputs.shape[1]))
        return MotionWindows(empty, empty, empty, np.zeros((0, run.inputs.shape[1])))
    bridged = bridge_blanks(run.outputs, time_s, 1.01 * span)
    # Integral of the inputs, which are held from row to row, or change several times on a line to the next
    # row.
    changes = 0.5 * (1.0 - 1.0 / run.updates) * np.diff(run.inputs, axis=0)
    first = np.pad(
        np.cumsum((run.inputs[:-1] + changes) * np.diff(time_s)[:, None], axis=0), ((1, 0), (0, 0))
    )
    second = cumulative_trapezoid(first, time_s, axis=0, initial=0.0)

    def mean(values: Array) -> Array:
        """Return the mean over a window around each grid point."""
        integral = cumulative_trapezoid(values, time_s, axis=0, initial=0.0)
        before, after = (_at(grid + side * span / 2, time_s, integral) for side in (-1.0, 1.0))
        return (after - before) / span

    outputs = mean(np.where(np.isfinite(bridged), bridged, 0.0))
    outputs[mean(np.isnan(bridged).astype(float)) > 0.0] = np.nan
    twice = mean(second)

    def shifted(rows: int) -> Array:
        """Return mean outputs that many grid points later, from the third grid point to the third last."""
        return outputs[_OVERLAP + rows : len(outputs) - _OVERLAP + rows]

    # Weights that spread as far in time as those of the accelerations, so that fast motion falsifies no
    # coefficient.
    position = (shifted(-1) + shifted(0) + shifted(1)) / 3
    velocity = (shifted(2) - shifted(-2)) / (6 * span) + (shifted(1) - shifted(-1)) * 2 / (3 * span)
    acceleration = (shifted(2) - 2 * shifted(0) + shifted(-2)) / span**2
    inputs = (twice[2 * _OVERLAP :] - 2 * twice[_OVERLAP:-_OVERLAP] + twice[: -2 * _OVERLAP]) / span**2
    return MotionWindows(position, velocity, acceleration, inputs)


def _at(times: Array, time_s: Array, values: Array) -> Array:
    """Return columns of values interpolated at other times."""
    return np.column_stack([np.interp(times, time_s, column) for column in values.T])
