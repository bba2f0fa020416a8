"""Whether a state estimator should take encoders for sensors that drift, decided from recordings.

An estimator predicts each measurement from all before. Where a belt creeps over its pulley, climbs its teeth
or runs on an eccentric one, and the machine file lacks that, the measurements of a recorded run are more
probable under an estimator that also estimates errors of the encoders. Where they do not drift, these errors
only make its predictions less certain, and the measurements less probable: the comparison needs no threshold.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...arrays import Array
from ...errors import InputError
from ...machine import Machine
from ...recordings import Recording
from .state_estimator import StateEstimator

SAME_TIME_S = 1e-9  # s; times that differ by less are equal: sums of periods are rounded


def encoders_drift(machine: Machine, recordings: Sequence[Recording], period: float) -> bool:
    """Decide from recordings whether a state estimator should assume drifting encoders.

    It should if this makes the measurements of the runs more probable.

    Args:
        machine: Machine of the estimator, with the sensors of the recordings.
        recordings: Runs to which the machine was not fitted. They begin at rest, and their sensors have the
            zeros that the controller will observe.
        period: Control period, s.

    Returns:
        Whether an estimator with `drifting_encoders` gives the measurements of all runs, one per period, a
        higher probability.

    Raises:
        InputError: If there are no recordings, one lacks a measurement or is shorter than a period, or a
            state estimator refuses machine or period.
    """
    if not recordings:
        raise InputError("encoders_drift needs at least one recording of the machine")
    drifting, exact = (
        sum(
            _log_likelihood(StateEstimator(machine, period, drifting_encoders=drifts), run)
            for run in recordings
        )
        for drifts in (True, False)
    )
    return drifting > exact


def _log_likelihood(estimator: StateEstimator, recording: Recording) -> float:
    """Return the log density of a run's measurements, one a control period, for a new estimator."""
    begins_s, period, total = float(recording.time_s[0]), estimator.period, 0.0
    periods = int((recording.time_s[-1] - begins_s + SAME_TIME_S) / period)
    if periods < 1:
        raise InputError(f"{recording.name} takes less than a control period, {period:g} s: leave it out")
    for now_s in begins_s + period * np.arange(periods + 1):
        row = int(np.abs(recording.time_s - now_s).argmin())
        arrived = _arrived(recording, float(now_s) - estimator.delay_s, period)
        estimator.update(recording.outputs[row : row + 1], arrived)
        total += float(estimator.log_likelihood[0])
    return total


def _arrived(recording: Recording, end_s: float, period: float) -> tuple[Array, Array]:
    """Return the voltages of the period before a time, as `DeadTime.arrived_history` does.

    They also change between the control periods. Their means over the periods would move the tool by tenths
    of a millimeter less or more.
    """
    start_s = end_s - period
    first, last = np.searchsorted(
        recording.time_s, [start_s + SAME_TIME_S, end_s - SAME_TIME_S], side="right"
    )
    times = np.concatenate([[0.0], recording.time_s[first:last] - start_s, [period]])
    # The last voltage counts at both its ends, and the first one also before the run.
    rows = np.maximum(np.minimum(np.arange(first - 1, last + 1), last - 1), 0)
    return times, recording.inputs[rows][None]
