"""Predict held-out runs with an observer, which keeps errors from growing along the run."""

from __future__ import annotations

import dataclasses

import numpy as np

from ...arrays import Array
from ...preparation.dataset import Dataset, PreparedRecording
from ..fit.start_estimation import refine_dataset
from ..judge.verdict import JUDGING_BANDWIDTH
from ..predict.prediction import POLISH_STEP, map_runs, sensor_innovation_variance
from ..predict.start_uncertainty import prediction_residuals, uncertain_starts
from .machine_errors import ModelEvaluation


def predictions_by_run(model: ModelEvaluation, held_out: Dataset, fitted: Dataset) -> Array:
    """Compute the squared prediction errors on each held-out run, by sensor, relative to an exact machine.

    The observer is the one that judges effects, of 15 rad/s (`JUDGING_BANDWIDTH`). The noise is that at rest:
    jitter of the clock is estimated from the motion, and an error may be mistaken for it.

    Args:
        model: Machine with the zeros of its encoders.
        held_out: Held-out runs.
        fitted: Runs that the machine was fitted to; the zeros of encoders may follow from them.

    Returns:
        Mean squared error in units of the noise / that of an exact machine, dimensionless, shape (runs,
        sensors); NaN if not measured, infinite if a prediction diverges.
    """
    refined = refine_dataset(held_out, model.machine, fitted)
    noise = held_out.noise
    runs = [dataclasses.replace(r, noise=np.broadcast_to(noise, r.noise.shape)) for r in refined.runs]
    data = dataclasses.replace(refined, runs=tuple(runs))
    starts = uncertain_starts(model.machine, data.runs)
    exact = sensor_innovation_variance(model.machine, data.period, JUDGING_BANDWIDTH)

    def of_run(run: PreparedRecording) -> Array:
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            residual = prediction_residuals(
                model.machine, run, data, JUDGING_BANDWIDTH, start=starts[run.name], longest_step=POLISH_STEP
            )
            squares = np.square(residual.reshape(len(run.weights), -1)).sum(axis=0)
            counts = run.weights.sum(axis=0)
            squares[np.isnan(squares)] = np.inf  # the prediction diverges
            return np.where(counts > 0.0, squares / counts / exact, np.nan)

    return np.array(list(map_runs(of_run, data)))


def largest(errors: Array) -> float:
    """Return the largest error, dimensionless, ignoring NaN; infinite if there is none above 0.

    Without measurements, nothing shows that the predictions are good.

    Args:
        errors: Errors by run and sensor, dimensionless, shape (runs, sensors); NaN if not measured.
    """
    return float(np.max(errors[~np.isnan(errors)], initial=0.0)) or np.inf
