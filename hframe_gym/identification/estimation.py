"""Estimation of a machine's parameters and of their covariance.

The Levenberg-Marquardt method fits the parameters. They have a weak Gaussian prior around the declared machine, so that
parameters that the data do not determine keep their declared values. Every iteration linearizes the residual by one
batched simulation and tries several dampings in another. Dry friction needs no smoothing: its exact solution depends
continuously on the parameters.

An observer may correct a prediction by the measurements at every sample; its bandwidth, rad/s, states how strongly.
Bandwidth 0 means no observer, a simulation. The cost is the sum of squared residuals in units of the sensors' noise.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri, stdtrit

from ..machine import Machine, Uncertainty
from .dataset import Dataset, PreparedRecording
from .free_parameters import FreeParameter, bounded_step, parameter_table, prior_precision, values_at
from .linearization import ResidualModel
from .prediction import POLISH_STEP, SEARCH_STEP, block_size, map_runs, predict, residuals
from .start_uncertainty import initial_state_projection, prediction_residuals

Array = NDArray[np.float64]

# Relative to the diagonal of the Hessian. The step without damping (Gauss-Newton) lets combinations of parameters that
# only the prior determines converge: damping holds them back, because the data determine each parameter by itself.
_DAMPINGS = (0.0, 1e-5, 1e-3, 1e-2, 1e-1, 1.0, 1e1, 1e2)


@dataclass(frozen=True)
class Fit:
    """Result of a fit of k free parameters.

    Attributes:
        machine: Fitted machine.
        free: Free parameters, k of them.
        theta: Fitted theta of each, the dimensionless variable defined by `FreeParameter`, shape (k,).
        cost: Sum of squared residuals in units of the noise, without the prior.
        count: Number of independent measured values.
        bandwidth: Bandwidth of the observer that corrected the fitted predictions by the measurements, rad/s; 0 for a
            pure simulation.
        information: Fisher information of theta without the prior, shape (k, k).
        longest_step: Maximum integration step of the fitted predictions, s.
    """

    machine: Machine
    free: tuple[FreeParameter, ...]
    theta: Array
    cost: float
    count: float
    bandwidth: float
    information: Array = field(repr=False)
    longest_step: float = SEARCH_STEP

    @property
    def chi2(self) -> float:
        """Chi-squared per sample (mean squared residual / noise variance), 1 if only the sensors' noise remains."""
        return self.cost / self.count

    @property
    def mode(self) -> str:
        """Kind of prediction that was fitted, for the log: "observer of 60 rad/s" or "simulation"."""
        return f"observer of {self.bandwidth:g} rad/s" if self.bandwidth else "simulation"

    @property
    def values(self) -> dict[str, float]:
        """Fitted values of the free parameters, SI, by full name such as `x.coulomb`."""
        return values_at(self.free, self.theta)


def fit(
    machine: Machine,
    free: Sequence[FreeParameter],
    data: Dataset,
    bandwidth: float,
    *,
    theta: Array | None = None,
    iterations: int = 25,
    tolerance: float = 1e-4,
    longest_step: float = SEARCH_STEP,
) -> Fit:
    """Fit free parameters of a machine to a data set by the Levenberg-Marquardt method.

    The fit minimizes the cost (sum of squared residuals in units of the noise) plus the penalty of the Gaussian priors,
    which is multiplied by chi-squared per sample (cost / number of measured values) where that exceeds 1.

    Args:
        machine: Machine that supplies the model and the values of all other parameters.
        free: The k free parameters with their priors.
        data: Runs to fit (times, voltages, measurements).
        bandwidth: Bandwidth of the observer that corrects predictions by the measurements, rad/s; 0 for a simulation.
        theta: Initial theta of each parameter (`FreeParameter`), dimensionless, shape (k,). Default: 0, its center.
        iterations: Maximum number of iterations.
        tolerance: Decrease of cost plus penalty per iteration, relative to their sum, below which the search ends.
        longest_step: Maximum integration step, s.

    Returns:
        Fit where the search ended: theta, shape (k,), and cost without the penalty, infinite if the machine diverges.
    """
    model = ResidualModel(machine, tuple(free), data, bandwidth, longest_step)
    theta = np.zeros(len(free)) if theta is None else np.array(theta, float)
    prior = prior_precision(free)
    information = np.zeros((len(free), len(free)))
    cost = math.inf
    for _ in range(iterations):
        expansion = model.linearize(theta)
        equations = expansion.normal_equations
        if not equations.finite:  # this machine diverges, or one with slightly different parameters
            break
        information = equations.information
        # If the mean square error is chi2 times that of the noise, the data are that much less certain; the prior is
        # scaled by chi2 instead, so that it keeps its weight relative to the data.
        precision = prior * max(1.0, equations.chi2)
        cost = equations.cost + float(theta @ precision @ theta)
        hessian, gradient = information + precision, equations.gradient + precision @ theta
        # Steps of all dampings are simulated as one batch; the one with the lowest cost is taken.
        scaling = np.diag(np.diag(hessian))
        trials = theta + [bounded_step(free, theta, hessian + d * scaling, gradient) for d in _DAMPINGS]
        trial_costs = expansion.costs(trials) + np.einsum("bi,ij,bj->b", trials, precision, trials)
        best = int(np.argmin(trial_costs))
        if not trial_costs[best] < cost:
            break
        decrease = cost - trial_costs[best]
        theta, cost = trials[best], float(trial_costs[best])
        if decrease < tolerance * cost:
            break
    machine = model.machine_at(theta)
    if math.isfinite(cost):  # costs of trials have the influence of unknown starts linearized before the step
        cost = prediction_cost(machine, data, bandwidth, longest_step=longest_step)
    return Fit(machine, model.free, theta, cost, data.count, bandwidth, information, longest_step)


def prediction_cost(machine: Machine, data: Dataset, bandwidth: float, *, longest_step: float = SEARCH_STEP) -> float:
    """Return the cost of a machine: the sum of the squared residuals of its predictions over all runs.

    The residuals are measured minus predicted values divided by the standard deviation of the sensors' noise, without
    the part that the uncertain initial state can explain (`prediction_residuals`).

    Args:
        machine: Machine that predicts.
        data: Runs to predict (times, voltages, measurements).
        bandwidth: Bandwidth of the observer that corrects predictions by the measurements, rad/s; 0 for a simulation.
        longest_step: Maximum integration step, s.

    Returns:
        Cost, dimensionless; infinite if a prediction diverges.
    """

    def of_run(run: PreparedRecording) -> float:
        with np.errstate(over="ignore"):
            return float(np.sum(prediction_residuals(machine, run, data, bandwidth, longest_step=longest_step) ** 2))

    total = sum(map_runs(of_run, data))
    return total if math.isfinite(total) else math.inf


BLOCK_S = 0.5  # s; longer than the correlation of the residual, vibrations included
_MAX_LEVERAGE = 0.99  # Largest fraction of the information in one block for which its residual is corrected.
_MAX_DIFFERENCE = 0.01  # Theta; over shorter central differences, the curvature of the exponential is negligible.
# Standard deviation of the delay between inputs and measurements, in sampling periods. The times of recordings are no
# more accurate than that, and 1 % changes the identified inertia of a motor by more than the sensors' noise does.
_DELAY_STD = 0.005
_DELAY_DIFFERENCE = 0.05  # sampling periods


class _RunPart(NamedTuple):
    """Linearized residual of one run in b blocks of consecutive rows, along k directions.

    Attributes:
        information: Products of the responses to the directions in each block, shape (b, k, k).
        scores: Products of the responses and the residual in each block, shape (b, k).
        delay_products: Products of the response to a delay of the inputs by one sampling period with the responses,
            shape (k,).
        delay_information: Square sum of the response to that delay.
        delay_score: Product of the response to that delay and the residual.
    """

    information: Array
    scores: Array
    delay_products: Array
    delay_information: float
    delay_score: float


def with_uncertainty(fitted: Fit, data: Dataset) -> Machine:
    """Estimate the covariance of the fitted parameters and attach it to the machine.

    The covariance is the sum of three parts:

    - Residual: the sandwich estimator over blocks of 0.5 s, inside which the residual may be correlated in time. The
      correction CR2 compensates for the part of each block's residual that the fit removed. For a small number of
      blocks, standard deviations are multiplied by the ratio of the 95 % quantiles of Student's t and the normal
      distribution, so that the value +- 1.96 standard deviations is a 95 % interval.
    - Prior: combinations of parameters that the data do not determine keep the standard deviation of the prior.
    - Delay: the change of the parameters if the inputs act later than recorded. The variance of this delay is 0.5 % of
      a sampling period, squared, plus the square of the delay that the residual indicates.

    The sum of the first two parts is at least the variance that white noise of the assumed size causes.

    Derivatives are central differences along the principal axes of the Fisher information. Along single parameters,
    rounding errors would make parameters of equal influence, such as viscous friction and back-EMF, seem separable.

    Args:
        fitted: Fit of k parameters: machine, parameter values and cost.
        data: Runs that were fitted (times, voltages, measurements, SI).

    Returns:
        The fitted machine; its `uncertainty` holds the covariance of the k free parameters, SI, shape (k, k). It is
        None if a prediction with the fitted parameters diverges.

    References:
        White (1982), "Maximum likelihood estimation of misspecified models".
        Bell and McCaffrey (2002), "Bias reduction in standard errors for linear regression with multi-stage samples".
    """
    prior = prior_precision(fitted.free)
    directions = _principal_directions(fitted.information, prior)  # (k, k), one per column
    parts = list(map_runs(lambda run: _linearize(fitted, run, data, directions), data))
    information = np.concatenate([part.information for part in parts])  # J^T J of each block, (blocks, k, k)
    scores = np.concatenate([part.scores for part in parts])  # J^T r of each block, (blocks, k)
    if not (np.isfinite(information).all() and np.isfinite(scores).all()):
        return fitted.machine.replace(uncertainty=None)
    prior = directions.T @ prior @ directions  # from here on in multiples of the directions
    inverse = np.linalg.inv(information.sum(axis=0) + prior)
    eigenvalues, axes = np.linalg.eigh(inverse)
    root = (axes * np.sqrt(np.maximum(eigenvalues, 0.0))) @ axes.T  # symmetric square root of `inverse`
    # A fit reduces the residual of a block by the square root of 1 minus the block's fraction of the information.
    leverage, axes = np.linalg.eigh(root @ information @ root)  # (blocks, k), (blocks, k, k)
    along_axes = np.einsum("bij,bi->bj", axes, scores @ root) / np.sqrt(1.0 - np.clip(leverage, 0.0, _MAX_LEVERAGE))
    changes = np.einsum("bij,bj->bi", axes, along_axes) @ root  # of the estimate by each block's residual, (blocks, k)
    changes = changes @ directions.T * _student_widening(information, directions @ inverse)
    covariance = changes.T @ changes + directions @ inverse @ prior @ inverse @ directions.T
    white = directions @ inverse @ directions.T
    # No variance is smaller than that of white noise; correlations are kept.
    inflation = np.sqrt(np.maximum(np.diag(white) / np.maximum(np.diag(covariance), 1e-300), 1.0))
    covariance *= np.outer(inflation, inflation)
    of_delay = directions @ inverse @ np.sum([part.delay_products for part in parts], axis=0)  # per sampling period
    delay_variance = _DELAY_STD**2 + _estimated_delay(parts, inverse) ** 2
    covariance += delay_variance * np.outer(of_delay, of_delay)
    # From theta to the parameters' values, by the derivative of each value with respect to its theta.
    slopes = np.array([f.slope(t) for f, t in zip(fitted.free, fitted.theta, strict=True)])
    covariance *= np.outer(slopes, slopes)
    uncertainty = Uncertainty(tuple(f.name for f in fitted.free), (covariance + covariance.T) / 2)
    return fitted.machine.replace(uncertainty=uncertainty)


def _student_widening(information: Array, estimator: Array) -> Array:
    """Return by which factor few blocks widen the 95 % interval of each parameter, shape (k,), at least 1.

    The degrees of freedom are the effective number of blocks that determine a parameter (Satterthwaite).

    Args:
        information: Information of each block, shape (blocks, k, k).
        estimator: Change of the parameters per unit of the products of responses and residual, shape (k, k).
    """
    variances = np.einsum("jm,bmn,jn->bj", estimator, information, estimator, optimize=True)  # by each block
    effective = np.sum(variances, axis=0) ** 2 / np.maximum(np.sum(variances**2, axis=0), 1e-300)
    return np.asarray(stdtrit(np.maximum(effective, 1.0), 0.975) / ndtri(0.975))


def _principal_directions(information: Array, prior: Array) -> Array:
    """Return the principal axes of the posterior of theta, in the metric of the prior.

    Args:
        information: Fisher information of theta, which need not be accurate, shape (k, k).
        prior: Precision of the prior of theta, shape (k, k).

    Returns:
        Directions, one per column, shape (k, k); each as long as one standard deviation, or shorter where the
        residual would not be linear over that length.
    """
    root = np.linalg.cholesky(np.linalg.inv(prior))
    eigenvalues, axes = np.linalg.eigh(root.T @ information @ root)
    directions = root @ axes / np.sqrt(1.0 + np.maximum(eigenvalues, 0.0))
    longest = np.abs(directions).max(axis=0, initial=0.0)
    shortened: Array = directions * np.minimum(1.0, _MAX_DIFFERENCE / np.maximum(longest, 1e-300))
    return shortened


def _linearize(fitted: Fit, run: PreparedRecording, data: Dataset, directions: Array) -> _RunPart:
    """Linearize the residual of one run along directions (k, k), one per column."""
    machine = fitted.machine
    initial_state = run.initial_state(machine)
    thetas = np.vstack([fitted.theta, fitted.theta + directions.T, fitted.theta - directions.T])
    table = parameter_table(machine, fitted.free, thetas)

    def residual(of_run: PreparedRecording, parameters: Array | None = None) -> Array:
        """Return the residuals of the run, (batch, rows), from one initial state for all parameters."""
        motion = predict(
            machine,
            of_run,
            fitted.bandwidth,
            period=data.period,
            parameters=parameters,
            initial_state=initial_state,
            longest_step=POLISH_STEP,
        )
        return residuals(of_run, data, motion.readings)

    # Zero-order-held inputs that are delayed by a fraction of a sample have this mean over each sample.
    delayed = run.inputs.copy()
    delayed[1:] -= _DELAY_DIFFERENCE * np.diff(run.inputs, axis=0)
    rows = np.vstack([residual(run, table), residual(dataclasses.replace(run, inputs=delayed))])
    # Where the simulation diverges with changed parameters, the residual counts as unchanged.
    rows = np.where(np.isfinite(rows).all(axis=1, keepdims=True), rows, rows[0])
    projection = initial_state_projection(
        machine, run, data, fitted.bandwidth, initial_state=initial_state, longest_step=POLISH_STEP
    )
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
    """Return the delay of the inputs, in sampling periods, that minimizes the residual of the fit.

    Args:
        parts: Linearized residual of every run.
        inverse: Inverse of the information with the prior, along the directions, shape (k, k).
    """
    products, scores = (
        np.sum(values, axis=0)
        for values in zip(*((p.delay_products, p.scores.sum(axis=0)) for p in parts), strict=True)
    )
    information = sum(part.delay_information for part in parts) - products @ inverse @ products
    score = sum(part.delay_score for part in parts) - products @ inverse @ scores
    return float(-score / (max(information, 0.0) + 1.0 / _DELAY_STD**2))
