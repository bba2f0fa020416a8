"""Predict held-out runs with an observer, so that errors do not grow along the run as they do in a simulation."""

from __future__ import annotations

import dataclasses

import numpy as np

from ...arrays import Array
from ...preparation.dataset import Dataset, PreparedRecording
from ..fit.model_error import BANDWIDTHS
from ..fit.start_estimation import refine_dataset
from ..judge.delivery import PredictionsByRun
from ..judge.verdict import JUDGING_BANDWIDTH
from ..predict.prediction import POLISH_STEP, SIMULATION, map_runs, sensor_innovation_variance
from ..predict.start_uncertainty import prediction_residuals, uncertain_starts
from .machine_errors import ModelEvaluation

# rad/s; the slowest observer of a fit shows the slow forces that a faster one hides.
_SLOWEST = min(b for b in BANDWIDTHS if b != SIMULATION)


def predictions_by_run(model: ModelEvaluation, held_out: Dataset, fitted: Dataset) -> PredictionsByRun:
    """Return how well a machine predicts each held-out run, by sensor.

    The noise is that at rest: jitter of the clock is estimated from the motion, and an error may be mistaken for it.

    Args:
        model: Machine with the zeros of its encoders.
        held_out: Held-out runs.
        fitted: Runs that the machine was fitted to.
    """
    refined = refine_dataset(held_out, model.machine, fitted)
    noise = held_out.noise
    runs = [dataclasses.replace(r, noise=np.broadcast_to(noise, r.noise.shape)) for r in refined.runs]
    data = dataclasses.replace(refined, runs=tuple(runs))
    return PredictionsByRun(*(_chi2(model, data, b) for b in (JUDGING_BANDWIDTH, _SLOWEST)))


def _chi2(model: ModelEvaluation, data: Dataset, bandwidth: float) -> Array:
    """Return chi-squared per sample / an exact machine's (runs, sensors); NaN: not measured, infinite: diverges."""
    starts = uncertain_starts(model.machine, data.runs)
    exact = sensor_innovation_variance(model.machine, data.period, bandwidth)

    def of_run(run: PreparedRecording) -> Array:
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            residual = prediction_residuals(
                model.machine, run, data, bandwidth, start=starts[run.name], longest_step=POLISH_STEP
            )
            squares = np.square(residual.reshape(len(run.weights), -1)).sum(axis=0)
            counts = run.weights.sum(axis=0)
            squares[np.isnan(squares)] = np.inf  # the prediction diverges
            return np.where(counts > 0.0, squares / counts / exact, np.nan)

    return np.array(list(map_runs(of_run, data)))
