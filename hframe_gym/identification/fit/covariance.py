"""Estimation of the covariance of fitted parameters, from the residual of the fit.

The residual is the difference of measurements and predictions in units of the sensors' noise. Where a machine
is not exactly right, it is correlated in time, so that it determines the parameters less well than white
noise would permit.
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np
from scipy.special import ndtri, stdtrit

from ...arrays import Array
from ...dynamics.simulation import Motion
from ...machine import Machine, Uncertainty
from ...preparation.dataset import Dataset, PreparedRecording
from ..predict.free_parameters import parameter_table, prior_precision
from ..predict.linearization import ResidualModel, has_impacts
from ..predict.prediction import POLISH_STEP, block_size, map_runs, predict, residuals, whitened
from ..predict.start_uncertainty import (
    InitialStateProjection,
    UncertainStart,
    predict_with_displaced_starts,
    uncertain_starts,
)
from .estimation import SWITCH_CHANGES, Fit, with_changed_switch

BLOCK_S = 0.5  # s; longer than the correlation of the residual, vibrations included
_MAX_LEVERAGE = 0.99  # Largest fraction of the information in one block for which its residual is corrected.
# theta; over shorter central differences, the curvature of the exponential is negligible.
_MAX_DIFFERENCE = 0.01
# Standard deviation of the delay between inputs and measurements, in sampling periods. The times of
# recordings are no more accurate than that, and 1 % changes the identified inertia of a motor by more than
# the sensors' noise does.
DELAY_STD = 0.005
_DELAY_DIFFERENCE = 0.05  # sampling periods


class _RunPart(NamedTuple):
    """Linearized residual of one run in b blocks of consecutive rows, along k directions.

    Attributes:
        information: Products of the responses to the directions in each block, shape (b, k, k).
        scores: Products of the responses and the residual in each block, shape (b, k).
        delay_products: Products of the response to a delay of the inputs by one sampling period with the
            responses, shape (k,).
        delay_information: Square sum of the response to that delay.
        delay_score: Product of the response to that delay and the residual.
    """

    information: Array
    scores: Array
    delay_products: Array
    delay_information: float
    delay_score: float


def with_uncertainty(
    fitted: Fit, data: Dataset, *, indicated_delay: bool = True, deviations: Array | None = None
) -> Machine:
    """Estimate the covariance of the fitted parameters and attach it to the machine.

    The covariance is the sum of up to four parts:

    - Residual: the sandwich estimator over blocks of 0.5 s, inside which the residual may be correlated in
      time. The correction CR2 compensates for the part of each block's residual that the fit removed. For a
      small number of blocks, standard deviations are multiplied by the ratio of the 95 % quantiles of
      Student's t and the normal distribution, so that the value +- 1.96 standard deviations is a 95 %
      interval.
    - Prior: combinations of parameters that the data do not determine keep the standard deviation of the
      prior.
    - Delay: the change of the parameters if the inputs act later than recorded. The variance of this delay is
      (0.005 T)^2 + d^2, with the sampling period T and the delay d that the residual indicates.
    - Deviations: the mean square of `deviations`, if given. It is no variance of random errors; tests of
      chance therefore leave it out.

    The sum of the first two parts is at least the variance that white noise of the assumed size causes.

    Derivatives are central differences along the principal axes of the Fisher information: along single
    parameters, rounding would make viscous friction and back-EMF seem separable. A threshold
    (`FreeParameter.switch`) has no derivative. It is raised and lowered until the cost rises by more than 1,
    or by chi-squared per sample where that exceeds 1; its standard deviation is at least this change. A fit
    by instrumental variables contains its covariance already.

    Args:
        fitted: Fit of k parameters: machine, parameter values and cost.
        indicated_delay: Whether d is included. It is not if the question is whether inputs act later than
            recorded.
        deviations: Deviations of theta in m other fits that should agree (`slow_logs.deviations_of_fits`),
            shape (m, k). Default: none.

    Returns:
        The fitted machine; its `uncertainty` holds the covariance of the k free parameters, SI, shape (k, k).
        It is None if a prediction with the fitted parameters diverges, and as before if no parameter is free.

    References:
        White (1982), "Maximum likelihood estimation of misspecified models".
        Bell and McCaffrey (2002), "Bias reduction in standard errors for linear regression with multi-stage
        samples".
    """
    if not fitted.free:
        return fitted.machine
    between = np.zeros((len(fitted.free), len(fitted.free)))
    if deviations is not None and len(deviations):
        between = deviations.T @ deviations / len(deviations)
    if fitted.covariance is not None:
        if indicated_delay and fitted.change_by_delay is not None:
            between += np.outer(fitted.change_by_delay, fitted.change_by_delay)
        return _with_covariance(fitted, fitted.covariance + between)
    data = data.with_observers(fitted.observers)
    directions = _directions(fitted, data, prior_precision(fitted.free))  # (k, k), one per column
    starts = uncertain_starts(fitted.machine, data.runs)
    parts = list(map_runs(lambda run: _linearize(fitted, run, data, directions, starts[run.name]), data))
    information = np.concatenate([part.information for part in parts])  # J^T J of each block, (blocks, k, k)
    scores = np.concatenate([part.scores for part in parts])  # J^T r of each block, (blocks, k)
    if not (np.isfinite(information).all() and np.isfinite(scores).all()):
        return fitted.machine.replace(uncertainty=None)
    prior = (
        directions.T @ prior_precision(fitted.free) @ directions
    )  # from here on in multiples of the directions
    inverse = np.linalg.inv(information.sum(axis=0) + prior)
    eigenvalues, axes = np.linalg.eigh(inverse)
    root = (axes * np.sqrt(np.maximum(eigenvalues, 0.0))) @ axes.T  # symmetric square root of `inverse`
    # A fit reduces the residual of a block by the square root of 1 minus the block's fraction of the
    # information.
    leverage, axes = np.linalg.eigh(root @ information @ root)  # (blocks, k), (blocks, k, k)
    along_axes = np.einsum("bij,bi->bj", axes, scores @ root) / np.sqrt(
        1.0 - np.clip(leverage, 0.0, _MAX_LEVERAGE)
    )
    changes = (
        np.einsum("bij,bj->bi", axes, along_axes) @ root
    )  # of the estimate by each block's residual, (blocks, k)
    changes = changes @ directions.T * student_widening(information, directions @ inverse)
    covariance = changes.T @ changes + directions @ inverse @ prior @ inverse @ directions.T
    white = directions @ inverse @ directions.T  # no variance is smaller than that; correlations are kept
    inflation = np.sqrt(np.maximum(np.diag(white) / np.maximum(np.diag(covariance), 1e-300), 1.0))
    covariance *= np.outer(inflation, inflation)
    of_delay = (
        directions @ inverse @ np.sum([part.delay_products for part in parts], axis=0)
    )  # per sampling period
    delay_variance = DELAY_STD**2 + (_estimated_delay(parts, inverse) ** 2 if indicated_delay else 0.0)
    covariance += delay_variance * np.outer(of_delay, of_delay)
    covariance += np.diag(np.where([f.switch for f in fitted.free], np.diag(directions), 0.0) ** 2)
    return _with_covariance(fitted, covariance + between)


def _with_covariance(fitted: Fit, covariance: Array) -> Machine:
    """Return the fitted machine with the covariance of theta, shape (k, k), in units of the parameters."""
    slopes = np.array([f.slope(t) for f, t in zip(fitted.free, fitted.theta, strict=True)])
    covariance = covariance * np.outer(slopes, slopes)
    uncertainty = Uncertainty(tuple(f.name for f in fitted.free), (covariance + covariance.T) / 2)
    return fitted.machine.replace(uncertainty=uncertainty)


def student_widening(information: Array, estimator: Array) -> Array:
    """Return the factor by which standard deviations grow because few blocks of samples determine them.

    It is the 97.5 % quantile of Student's t / that of the normal distribution, for the effective number of
    blocks that determine a parameter (Satterthwaite).

    Args:
        information: Fisher information in each block, of the k parameters or of amounts along k directions,
            dimensionless, shape (blocks, k, k).
        estimator: Change of the estimate by a change of half the gradient of the cost (J^T r), dimensionless,
            shape (k, k).

    Returns:
        Factors, dimensionless, at least 1, shape (k,).
    """
    variances = np.einsum("jm,bmn,jn->bj", estimator, information, estimator, optimize=True)  # by each block
    effective = np.sum(variances, axis=0) ** 2 / np.maximum(np.sum(variances**2, axis=0), 1e-300)
    return np.asarray(stdtrit(np.maximum(effective, 1.0), 0.975) / ndtri(0.975))


def _directions(fitted: Fit, data: Dataset, prior: Array) -> Array:
    """Return the changes of theta over which differences are taken, one per column, shape (k, k).

    Thresholds change alone, each by the amount that data determine; all other parameters along the principal
    axes.
    """
    switches = np.array([f.switch for f in fitted.free], dtype=bool)
    directions, smooth = np.zeros_like(prior), np.ix_(~switches, ~switches)
    directions[smooth] = principal_directions(fitted.information[smooth], prior[smooth])
    if has_impacts(fitted.machine):  # the residual is rugged over shorter differences
        directions[:, ~switches] *= _MAX_DIFFERENCE / np.abs(directions[:, ~switches]).max(axis=0)
    if not switches.any():
        return directions
    model = ResidualModel(fitted.machine, fitted.free, data, fitted.bandwidth, POLISH_STEP)
    expansion = model.linearize(fitted.theta)
    cost, noise = expansion.normal_equations.cost, max(1.0, expansion.normal_equations.chi2)
    for j in np.flatnonzero(switches):
        costs = expansion.costs(with_changed_switch(fitted.free[j], int(j), fitted.theta, SWITCH_CHANGES))
        clear = (costs - cost).reshape(2, -1).min(axis=0) > noise  # for larger and for smaller values
        directions[j, j] = SWITCH_CHANGES[clear].min(initial=1.0 / np.sqrt(prior[j, j]))
    return directions


def principal_directions(information: Array, prior: Array) -> Array:
    """Return changes of theta along the principal axes of its posterior, as long as one standard deviation.

    The axes are orthogonal in the metric of the prior's precision.

    Args:
        information: Fisher information of theta, which need not be accurate, dimensionless, shape (k, k).
        prior: Precision (inverse covariance) of the prior of theta, dimensionless, shape (k, k).

    Returns:
        Directions, dimensionless, one per column, shape (k, k). One with an element above 0.01 in magnitude
        is shortened to 0.01, within which the residual is linear.
    """
    root = np.linalg.cholesky(np.linalg.inv(prior))
    eigenvalues, axes = np.linalg.eigh(root.T @ information @ root)
    directions = root @ axes / np.sqrt(1.0 + np.maximum(eigenvalues, 0.0))
    longest = np.abs(directions).max(axis=0, initial=0.0)
    shortened: Array = directions * np.minimum(1.0, _MAX_DIFFERENCE / np.maximum(longest, 1e-300))
    return shortened


def _linearize(
    fitted: Fit, run: PreparedRecording, data: Dataset, directions: Array, start: UncertainStart
) -> _RunPart:
    """Linearize a run's residual, predicted from a given start, along directions (k, k), one per column."""
    machine = fitted.machine
    thetas = np.vstack([fitted.theta, fitted.theta + directions.T, fitted.theta - directions.T])
    motion = predict_with_displaced_starts(
        machine,
        run,
        fitted.bandwidth,
        start,
        period=data.period,
        parameters=parameter_table(machine, fitted.free, thetas),
        longest_step=POLISH_STEP,
    )
    # Zero-order-held inputs that are delayed by a fraction of a sample have this mean over each sample.
    delayed_inputs = run.inputs.copy()
    delayed_inputs[1:] -= _DELAY_DIFFERENCE * np.diff(run.inputs, axis=0)
    delayed = dataclasses.replace(run, inputs=delayed_inputs)
    delayed_motion = predict(
        machine,
        delayed,
        fitted.bandwidth,
        period=data.period,
        initial_state=start.state,
        longest_step=POLISH_STEP,
    )

    def residual_of(predicted: Motion) -> Array:
        return whitened(residuals(run, data, predicted.readings), run, fitted.bandwidth)

    rows, displaced = np.split(residual_of(motion), [len(thetas)])
    projection = InitialStateProjection.from_displaced(rows[0], displaced, start.differences)
    rows = np.vstack([rows, residual_of(delayed_motion)])
    # Where the simulation diverges with changed parameters, the residual counts as unchanged.
    rows = np.where(np.isfinite(rows).all(axis=1, keepdims=True), rows, rows[0])
    if projection is not None:
        rows = projection(rows)
    k = len(fitted.free)
    responses = (rows[1 : k + 1] - rows[k + 1 : 2 * k + 1]) / 2.0  # (k, rows)
    delay = (rows[-1] - rows[0]) / _DELAY_DIFFERENCE
    size = block_size(BLOCK_S, machine, data)
    blocks = [slice(first, first + size) for first in range(0, rows.shape[1], size)]
    return _RunPart(
        np.array([responses[:, block] @ responses[:, block].T for block in blocks]),
        np.array([responses[:, block] @ rows[0, block] for block in blocks]),
        responses @ delay,
        float(delay @ delay),
        float(delay @ rows[0]),
    )


def _estimated_delay(parts: list[_RunPart], inverse: Array) -> float:
    """Return the delay of the inputs, in sampling periods, that minimizes the residual of the fit."""
    products, scores = (
        np.sum(values, axis=0)
        for values in zip(*((p.delay_products, p.scores.sum(axis=0)) for p in parts), strict=True)
    )
    information = sum(part.delay_information for part in parts) - products @ inverse @ products
    score = sum(part.delay_score for part in parts) - products @ inverse @ scores
    return float(-score / (max(information, 0.0) + 1.0 / DELAY_STD**2))
