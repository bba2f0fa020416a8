"""How sure a fit is, where the residual is not white.

Sandwich covariance H^-1 M H^-1 (White 1982): H the information with the prior, M the spread of the gradient summed over
blocks of 0.2 s, which keep whatever correlation the residual has inside them.  For a white residual of the assumed
size M = H and the textbook H^-1 comes out; never less than that is reported.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..machine import Machine, Uncertainty
from .dataset import Dataset, PreparedRecording
from .estimation import Fit, over_runs, parameter_table, prior_precision
from .initial_state_projection import projection
from .prediction import SEARCH_STEP, predict, residuals

Array = NDArray[np.float64]
_STEP = 1e-4
_BLOCK = 0.2  # s


def with_uncertainty(fitted: Fit, data: Dataset) -> Machine:
    """The fitted machine with the covariance of its free parameters, in their own units."""
    free, k = fitted.free, len(fitted.free)
    thetas = np.vstack([fitted.theta, fitted.theta + _STEP * np.eye(k)])
    table = parameter_table(fitted.machine, free, thetas)
    rows = max(1, round(_BLOCK / data.period))
    sensors = len(fitted.machine.sensors)

    def scores(run: PreparedRecording) -> tuple[Array, Array]:
        motion = predict(fitted.machine, run, fitted.mode, period=data.period, parameters=table)
        left = residuals(run, data, motion.readings)
        project = projection(fitted.machine, run, data, fitted.mode, SEARCH_STEP)
        left = left if project is None else project(left)
        jacobian = (left[1:] - left[0]) / _STEP
        product = jacobian * left[0]
        edges = np.arange(0, product.shape[1], rows * sensors)
        return jacobian @ jacobian.T, np.add.reduceat(product, edges, axis=1)

    parts = list(over_runs(scores, data))
    prior = prior_precision(free)
    information = np.sum([p[0] for p in parts], axis=0)
    blocks = np.concatenate([p[1] for p in parts], axis=1)
    blocks -= blocks.mean(axis=1, keepdims=True)
    inverse = np.linalg.inv(information + prior)
    covariance = inverse @ (blocks @ blocks.T + prior) @ inverse
    least = np.sqrt(np.diag(inverse) / np.maximum(np.diag(covariance), 1e-300))
    covariance *= np.outer(np.maximum(least, 1.0), np.maximum(least, 1.0))
    slope = np.array([f.slope(t) for f, t in zip(free, fitted.theta, strict=True)])
    covariance *= np.outer(slope, slope)
    uncertainty = Uncertainty(tuple(f.name for f in free), (covariance + covariance.T) / 2)
    return fitted.machine.replace(uncertainty=uncertainty)
