"""What an exact machine leaves in predictions of a log that is slower than its controller.

Statistics of voltage errors take the innovations of the sensors for independent. But the observer feeds the
noise of every sensor back into the motion of all of them: that of a laser moves the carriage of a stage, the
belts pull the motors after it, and their encoders, which resolve much less than this noise, show an error
that no machine lacks. In a fast log, corrections are small, and a narrow observer suits an exact machine. In
a slow log, they are large, and an observer is needed because the errors of voltages add up in a simulation.
"""

from __future__ import annotations

import dataclasses
from itertools import combinations

import numpy as np

from ...arrays import Array
from ...machine import Machine
from ...preparation.clock.jitter import shared_jitter
from ...preparation.dataset import Dataset, PreparedRecording
from .prediction import POLISH_STEP, map_runs, sensor_innovation_variance, whitened
from .start_uncertainty import prediction_residuals, uncertain_starts

_DRAWS = 4  # of the noise of all values of a run; their sum of squares is 2 % accurate with 1000 values


def certain_jitter(machine: Machine, *sets: Dataset) -> float:
    """Return the jitter of the clock that two encoders confirm, s; 0 without two of them.

    What looks like jitter at a single sensor may be a force that a model lacks, or what unknown voltages do
    between the rows.

    Args:
        machine: Machine, for its sensors.
        *sets: Data sets with all runs of a session.
    """
    runs = [run for data in sets for run in data.runs]
    encoders = [j for j, sensor in enumerate(machine.sensors) if sensor.of_position and sensor.incremental]
    times = [run.time_s for run in runs]
    by_sensor = {j: [run.outputs[:, j] for run in runs] for j in encoders}
    shared = (shared_jitter(times, by_sensor[i], by_sensor[j]) for i, j in combinations(encoders, 2))
    return min(min(shared, default=0.0), *(data.jitter for data in sets))


def expected_chi2(machine: Machine, data: Dataset, bandwidth: float, jitter: float = 0.0) -> float:
    """Return the chi-squared per sample of predictions by a machine that lacks nothing.

    To first order, other noise changes a residual by as much as the noise has added to it.

    Args:
        machine: Machine that predicts.
        data: Runs that are predicted, with the errors of their voltages.
        bandwidth: Bandwidth of the observer, rad/s.
        jitter: Standard deviation of the times at which rows were sampled around their stamps, s.

    Returns:
        Chi-squared, dimensionless: 1 if no sensor moves the predictions of the others. Not finite if the
        machine diverges.
    """
    rng = np.random.default_rng(0)
    starts = uncertain_starts(machine, data.runs)
    noises = {run.name: rng.normal(size=(_DRAWS, *run.outputs.shape)) for run in data.runs}
    late = {run.name: jitter * rng.normal(size=(_DRAWS, len(run.time_s), 1)) for run in data.runs}
    independent = np.sqrt(sensor_innovation_variance(machine, data.period, bandwidth))

    def of_run(run: PreparedRecording) -> float:
        """Return by how much noise adds more to the sum of squares than independent innovations do."""

        def residual(other: PreparedRecording) -> Array:
            return prediction_residuals(
                machine, other, data, bandwidth, start=starts[run.name], longest_step=POLISH_STEP
            )

        given, more = residual(run), 0.0
        speeds = np.nan_to_num(np.gradient(run.outputs, run.time_s, axis=0))
        for noise, lateness in zip(noises[run.name], late[run.name], strict=True):
            noisy = dataclasses.replace(run, outputs=run.outputs + run.noise * noise + speeds * lateness)
            innovations = (np.sqrt(run.weights) * independent * noise).reshape(1, -1)
            more += float(np.sum((residual(noisy) - given) ** 2))
            more -= float(np.sum(whitened(innovations, run, bandwidth) ** 2))
        return more / _DRAWS

    return 1.0 + sum(map_runs(of_run, data)) / data.count
