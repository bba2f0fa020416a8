"""Whether a state estimator should take encoders for sensors that drift, decided from recordings.

An estimator predicts each measurement from all before. Where a belt creeps over its pulley, climbs its teeth or runs on
an eccentric one, and the machine file lacks that, the measurements of a recorded run are more probable under an
estimator that also estimates errors of the encoders. Where they do not drift, these errors only make its predictions
less certain, and the measurements less probable: the comparison needs no threshold.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from typing_extensions import override

from ...arrays import Array
from ...errors import InputError
from ...machine import Machine
from ...recordings import Recording
from .state_estimator import StateEstimator

SAME_TIME_S = 1e-9  # s; times that differ by less are equal: sums of periods are rounded


def encoders_drift(machine: Machine, recordings: Sequence[Recording], period: float) -> bool:
    """Decide whether the encoders drift: whether `StateEstimator(..., drifting_encoders=True)` predicts runs better.

    Args:
        machine: Machine of the estimator, with the sensors of the recordings.
        recordings: Runs to which the machine was not fitted. They begin at rest, and show what the controller will
            observe: sensors with the same zeros.
        period: Control period, s.

    Returns:
        Whether the measurements of all runs, one a period, are more probable if errors of the encoders are estimated.

    Raises:
        InputError: If there are no recordings, one lacks a measurement or is shorter than a period, or a state
            estimator refuses machine or period.
    """
    if not recordings:
        raise InputError("encoders_drift needs at least one recording of the machine")
    drifting, exact = (
        sum(_Replayed(machine, period, drifts).log_likelihood_of(recording) for recording in recordings)
        for drifts in (True, False)
    )
    return drifting > exact


class _Replayed(StateEstimator):
    """State estimator that follows a recorded run, whose voltages also change between the control periods.

    Their means over the periods would move the tool by tenths of a millimeter less or more.
    """

    def __init__(self, machine: Machine, period: float, drifting_encoders: bool) -> None:
        super().__init__(machine, period, drifting_encoders=drifting_encoders)
        self._history = np.zeros(0), np.zeros((0, 0, 0))

    @override
    def _arrived_history(self) -> tuple[Array, Array]:
        return self._history

    def log_likelihood_of(self, recording: Recording) -> float:
        """Return the logarithm of the density of a run's measurements, one a control period."""
        begins_s, total = float(recording.time_s[0]), 0.0
        periods = int((recording.time_s[-1] - begins_s + SAME_TIME_S) / self.period)
        if periods < 1:
            raise InputError(
                f"{recording.name} takes less than a control period, {self.period:g} s: leave it out"
            )
        for now_s in begins_s + self.period * np.arange(periods + 1):
            self._history = self._recorded_history(recording, float(now_s))
            row = int(np.abs(recording.time_s - now_s).argmin())
            self.update(recording.outputs[row : row + 1])
            total += float(self.log_likelihood[0])
        return total

    def _recorded_history(self, recording: Recording, now_s: float) -> tuple[Array, Array]:
        """Return the voltages that reached the drives in the period before a time, as `DeadTime.arrived_history`."""
        end_s = now_s - self._dead_time.delay_s
        start_s = end_s - self.period
        first, last = np.searchsorted(
            recording.time_s, [start_s + SAME_TIME_S, end_s - SAME_TIME_S], side="right"
        )
        times = np.concatenate([[0.0], recording.time_s[first:last] - start_s, [self.period]])
        # The last voltage counts at both its ends, and the first one also before the run.
        rows = np.maximum(np.minimum(np.arange(first - 1, last + 1), last - 1), 0)
        return times, recording.inputs[rows][None]
