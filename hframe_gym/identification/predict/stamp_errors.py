"""What rounded time stamps do to predictions of a run whose samples have no regular clock.

A stamp that is rounded to 0.1 ms moves the change of a voltage by up to 0.05 ms, and with it everything that
follows: where no spring holds a machine, each such error moves its later positions by the same distance, so
that they add up along a run. The measurement of a row was taken at another time than its stamp says as well.
A machine that is exact leaves all of this.

How much it is follows from predictions at other times that are rounded to the same stamps.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from ...arrays import Array
from ...machine import Machine
from ...preparation.clock.regular_clock import stamp_quantum
from ...preparation.dataset import Dataset, PreparedRecording
from .prediction import POLISH_STEP, map_runs, predict, prediction_error

_DRAWS = 8  # of the times of all rows; the rms of what they change is 15 % accurate in a run
# Quanta per sampling period, at least. Stamps in whole periods do not tell rounding from missing rows.
_FINER = 2.0


def stamp_deviation(run: PreparedRecording, data: Dataset) -> float:
    """Return the standard deviation of a run's stamps that both their rounding and fast motion show.

    Args:
        run: Run with its times as they are predicted.
        data: Data set of the run, for the jitter of the clock that fast motion shows.

    Returns:
        Standard deviation, s; 0 where stamps are not rounded, or motion shows no errors of them.
    """
    logged = run.time_s[~run.dropped]
    quantum = stamp_quantum(logged) if data.jitter and len(logged) > 1 else 0.0
    if _FINER * quantum > float(np.median(np.diff(run.time_s))):
        return 0.0
    return min(quantum / math.sqrt(12.0), data.jitter)


def has_stamp_errors(data: Dataset) -> bool:
    """Return whether the stamps of a run are rounded, and fast motion shows it."""
    return any(stamp_deviation(run, data) > 0.0 for run in data.runs)


def prediction_changes(machine: Machine, data: Dataset, bandwidth: float) -> Array:
    """Return by how much rounded stamps change the errors of a machine's predictions, rms over the runs.

    Args:
        machine: Machine that predicts.
        data: Runs that are predicted.
        bandwidth: Bandwidth of the observer, rad/s; 0 for a simulation.

    Returns:
        Changes in the sensors' units, shape (sensors,); zeros if no stamps are rounded, infinite for a
        machine that diverges.
    """
    rng = np.random.default_rng(0)
    half = {run.name: math.sqrt(3.0) * stamp_deviation(run, data) for run in data.runs}
    moves = {
        run.name: rng.uniform(-half[run.name], half[run.name], (_DRAWS, len(run.time_s))) for run in data.runs
    }

    def of_run(run: PreparedRecording) -> Array:
        """Return the sums over rows and draws of the squared changes, shape (sensors,)."""
        errors = []
        for move in (np.zeros(len(run.time_s)), *moves[run.name]):
            moved = dataclasses.replace(run, time_s=run.time_s + move)
            motion = predict(machine, moved, bandwidth, period=data.period, longest_step=POLISH_STEP)
            errors.append(prediction_error(run, data, motion.readings)[0])
        with np.errstate(invalid="ignore", over="ignore"):
            changes = (np.array(errors[1:]) - errors[0]) ** 2  # 0 where not measured
        return np.asarray(np.sum(np.where(np.isfinite(changes), changes, np.inf), axis=(0, 1)))

    measured = sum(np.isfinite(run.outputs).sum(axis=0) for run in data.runs)
    return np.asarray(np.sqrt(sum(map_runs(of_run, data)) / np.maximum(_DRAWS * measured, 1)))
