"""Find the quantization step (quantum) of a channel: encoders, counters, converters measure multiples."""

from __future__ import annotations

import numpy as np

from ..arrays import Array

_MIN_STEPS = 10  # Fewer changes of a channel do not show a quantum.
_REFINEMENT = 4.0  # factor by which the distance grows over which quanta are counted
_SAME_LEVEL = 1e-10  # of the range of the values; levels that are closer differ by the rounding of a computer
_ON_GRID = 0.1  # distance from the nearest multiple, in quanta
_MOST = 0.95  # fraction of the values that must be near a multiple


def quantum_of(values: Array) -> float:
    """Estimate the quantization step (quantum) of one channel from one run.

    The quantum is the small change of which nearly all changes from row to row, and the distances of nearly
    all values from each other, are integer multiples. At a steady speed, all changes are nearly equal without
    any quantum; the distances then add up the small differences.

    Args:
        values: Measurements, m or rad, shape (n,), NaN where not measured.

    Returns:
        Quantum, m or rad; 0 if the changes are not multiples of a quantum, or too few.
    """
    measured = values[np.isfinite(values)]
    steps = np.abs(np.diff(measured))
    steps = steps[steps > 0]
    if len(steps) < _MIN_STEPS:
        return 0.0
    smallest = float(np.percentile(steps, 2))
    if not _multiples(steps, smallest):
        return 0.0
    levels = np.unique(measured)
    return smallest if _fitted_quantum(levels - levels[0], smallest) > 0.0 else 0.0


def exact_quantum(values: Array, declared: float = 0.0) -> float:
    """Determine a quantization step so accurately that thousands of steps can be counted.

    The smallest change of values in a file has the relative error of their rounding, which is too large to
    distinguish 4096 steps from 4000 in a file with few digits. The step is therefore fitted to larger and
    larger differences.

    Args:
        values: Values of one channel, NaN where not measured, shape (n,).
        declared: Declared resolution, in the unit of the values; 0 if there is none.

    Returns:
        Step of which the differences from the lowest value are integer multiples, to a tenth of the step and
        for more than 95 % of the different values, in their unit; 0 if there is none, or if there are fewer
        than 10 different values. The fit starts from the declared resolution. If that yields no step, it
        starts from the smallest changes between successive rows, and then from the smallest differences
        between any rows, because in fast motion no two successive values differ by a single step.
    """
    levels = np.unique(values[np.isfinite(values)])
    if len(levels) < _MIN_STEPS:
        return 0.0
    distances = levels - levels[0]
    gaps = np.diff(levels)
    gaps = gaps[gaps > _SAME_LEVEL * distances[-1]]
    for start in (declared, quantum_of(values), float(np.percentile(gaps, 2))):
        quantum = _fitted_quantum(distances, start) if start > 0.0 else 0.0
        if quantum > 0.0:
            return quantum
    return 0.0


def _fitted_quantum(distances: Array, quantum: float) -> float:
    """Return the quantum that divides ascending distances from the lowest level; 0 if none does."""
    span = _REFINEMENT * quantum
    while True:
        near = distances[distances <= span]
        steps = np.rint(near / quantum)
        if steps.any():
            quantum = float(near @ steps / (steps @ steps))
        if span >= distances[-1]:
            break
        span *= _REFINEMENT
    return quantum if _multiples(distances, quantum) else 0.0


def _multiples(values: Array, quantum: float) -> bool:
    """Return whether nearly all values are integer multiples of a quantum."""
    deviation = np.abs(values / quantum - np.rint(values / quantum))
    return bool(np.mean(deviation < _ON_GRID) > _MOST)
