"""What an exact machine leaves in predictions of a log that is slower than its controller.

Statistics of voltage errors take the innovations of the sensors for independent. But the observer feeds the
noise of every sensor back into the motion of all of them: that of a laser moves the carriage of a stage, the
belts pull the motors after it, and their encoders, which resolve much less than this noise, show an error
that no machine lacks. In a fast log, corrections are small, and a narrow observer suits an exact machine. In
a slow log, they are large, and an observer is needed because the errors of voltages add up in a simulation.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from ...arrays import Array
from ...machine import Machine
from ...preparation.dataset import Dataset, PreparedRecording
from .prediction import POLISH_STEP, map_runs, sensor_innovation_variance, whitened
from .start_uncertainty import prediction_residuals, uncertain_starts

_DRAWS = 4  # of the noise of all values of a run; their sum of squares is 2 % accurate with 1000 values


def expected_chi2(machine: Machine, data: Dataset, bandwidth: float) -> float:
    """Return the chi-squared per sample of predictions by a machine that lacks nothing.

    To first order, other noise changes a residual by as much as the noise has added to it.

    Args:
        machine: Machine that predicts.
        data: Runs that are predicted, with the errors of their voltages.
        bandwidth: Bandwidth of the observer, rad/s.

    Returns:
        Chi-squared, dimensionless: 1 if no sensor moves the predictions of the others. Not finite if the
        machine diverges.
    """
    rng = np.random.default_rng(0)
    starts = uncertain_starts(machine, data.runs)
    noises = {run.name: rng.normal(size=(_DRAWS, *run.outputs.shape)) for run in data.runs}
    independent = np.sqrt(sensor_innovation_variance(machine, data.period, bandwidth))

    def of_run(run: PreparedRecording) -> float:
        """Return by how much noise adds more to the sum of squares than independent innovations do."""

        def residual(other: PreparedRecording) -> Array:
            return prediction_residuals(
                machine, other, data, bandwidth, start=starts[run.name], longest_step=POLISH_STEP
            )

        given, more = residual(run), 0.0
        for noise in noises[run.name]:
            noisy = dataclasses.replace(run, outputs=run.outputs + run.noise * noise)
            innovations = (np.sqrt(run.weights) * independent * noise).reshape(1, -1)
            more += float(np.sum((residual(noisy) - given) ** 2))
            more -= float(np.sum(whitened(innovations, run, bandwidth) ** 2))
        return more / _DRAWS

    return 1.0 + sum(map_runs(of_run, data)) / data.count
