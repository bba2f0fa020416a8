"""Estimation of a machine's parameters, their uncertainty, and the reasons to doubt them.

The Levenberg-Marquardt method fits the parameters. They have a mild Gaussian prior around the declared machine, so that
what the data do not determine stays as declared. Every iteration linearizes the residual by one batched simulation and
tries several dampings in another. Dry friction needs no smoothing: its exact solution depends continuously on the
parameters.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ..machine import Machine, Uncertainty
from .dataset import Dataset, PreparedRecording
from .free_parameters import FreeParameter, default_free_parameters, prior_precision, values_at
from .linearization import NormalEquations, ResidualModel
from .prediction import SEARCH_STEP, initial_state_projection, map_runs, predict, residuals

Array = NDArray[np.float64]

# A parameter may move this many standard deviations of its prior; beyond, the model is wrong.
_MAXIMUM_DEVIATION = 4.0
_DAMPINGS = 10.0 ** np.array([-6.0, -4.0, -3.0, -2.0, -1.0, 0.0, 1.0, 2.0])


@dataclass(frozen=True)
class Fit:
    """Result of a fit of k free parameters.

    Attributes:
        machine: Fitted machine.
        free: Free parameters, k of them.
        theta: Fitted theta of each, the dimensionless variable defined by `FreeParameter`, shape (k,).
        cost: Sum of squared residuals in units of the noise, without the prior.
        count: Number of measured values.
        bandwidth: Observer bandwidth of the predictions that were fitted, rad/s, see `prediction`.
        information: Fisher information of theta without the prior, shape (k, k).
    """

    machine: Machine
    free: tuple[FreeParameter, ...]
    theta: Array
    cost: float
    count: int
    bandwidth: float
    information: Array = field(repr=False)

    @property
    def chi2(self) -> float:
        """Chi-squared per sample: cost per measured value, 1 if only the sensors' noise remains."""
        return self.cost / self.count

    @property
    def values(self) -> dict[str, float]:
        """Fitted values, SI, by full parameter name such as `x.coulomb`."""
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

    Args:
        machine: Machine that supplies the model and the values of all other parameters.
        free: The k free parameters with their Gaussian priors.
        data: Runs to fit.
        bandwidth: Observer bandwidth of the predictions, rad/s, see `prediction`.
        theta: Initial guess of the free parameters' theta, shape (k,). Default: zero, their central values.
        iterations: Maximum number of iterations.
        tolerance: Relative decrease of the cost per iteration below which the search ends.
        longest_step: Maximum integration step, s.

    Returns:
        Fit at the lowest cost that was found. Theta stays within four prior standard deviations.
    """
    model = ResidualModel(machine, tuple(free), data, bandwidth, longest_step)
    theta = np.zeros(len(free)) if theta is None else np.array(theta, float)
    prior = precision = prior_precision(free)
    bounds = _MAXIMUM_DEVIATION * np.array([f.prior for f in free])
    information = np.zeros((len(free), len(free)))
    cost = math.inf
    for _ in range(iterations):
        expansion = model.linearize(theta)
        equations = expansion.normal_equations
        information = equations.information
        # A model whose error is chi2 times the noise makes its data that much less certain: the prior keeps its weight.
        precision = prior * max(1.0, equations.chi2)
        cost = equations.cost + float(theta @ precision @ theta)
        hessian = information + precision
        gradient = equations.gradient + precision @ theta
        steps = [np.linalg.solve(hessian + damping * np.diag(np.diag(hessian)), gradient) for damping in _DAMPINGS]
        trials = np.clip(theta - np.array(steps), -bounds, bounds)  # (dampings, k)
        trial_costs = expansion.costs(trials) + np.einsum("bi,ij,bj->b", trials, precision, trials)
        best = int(np.argmin(trial_costs))
        if not trial_costs[best] < cost:
            break
        decrease = cost - trial_costs[best]
        theta, cost = trials[best], float(trial_costs[best])
        if decrease < tolerance * cost:
            break
    data_cost = cost - float(theta @ precision @ theta)
    return Fit(model.machine_at(theta), model.free, theta, data_cost, data.count, bandwidth, information)


def prediction_cost(machine: Machine, data: Dataset, bandwidth: float, *, longest_step: float = SEARCH_STEP) -> float:
    """Return the sum of a machine's squared prediction errors, each divided by the sensor's noise.

    The unknown initial stretch of the belts is projected out, as in a fit.

    Args:
        machine: Machine that predicts.
        data: Runs to predict.
        bandwidth: Observer bandwidth of the predictions, rad/s, see `prediction`.
        longest_step: Maximum integration step, s.

    Returns:
        Cost, dimensionless, summed over all values of all runs; infinite if a prediction diverges.
    """

    def of_run(run: PreparedRecording) -> float:
        motion = predict(machine, run, bandwidth, period=data.period, longest_step=longest_step)
        residual = residuals(run, data, motion.readings)
        projection = initial_state_projection(machine, run, data, bandwidth, longest_step=longest_step)
        return float(np.sum((residual if projection is None else projection(residual)) ** 2))

    total = sum(map_runs(of_run, data))
    return total if math.isfinite(total) else math.inf


_BLOCK_S = 0.2  # s; longer than the correlation of the residual
# Thresholds beyond which a parameter is reported as doubtful.
_POOR_RELATIVE_STD = 0.2
_POOR_PHASE_STD = 0.3  # rad
_HIGH_CORRELATION = 0.95
# A standard deviation beyond this fraction of the prior's: the data hardly added to the declared value.
_PRIOR_DOMINATES = 0.6
_BOUND_TOLERANCE = 1e-6  # relative


def with_uncertainty(fitted: Fit, data: Dataset) -> Machine:
    """Estimate the covariance of the fitted parameters and attach it to the machine.

    The sandwich covariance H^-1 M H^-1 holds for residuals that are not white: H is the Fisher information with the
    prior, M the covariance of the gradient, estimated from sums over blocks of 0.2 s, which preserve the correlation
    inside each block. White residuals of the assumed size give M = H and so H^-1; no smaller variance is reported.

    Args:
        fitted: Fit of the parameters.
        data: Runs that were fitted.

    Returns:
        The fitted machine; its `uncertainty` holds the covariance of the free parameters' values, SI.

    References:
        White (1982), "Maximum likelihood estimation of misspecified models".
    """
    model = ResidualModel(fitted.machine, fitted.free, data, fitted.bandwidth)
    sensors = len(fitted.machine.sensors)
    values_per_block = max(1, round(_BLOCK_S / data.period)) * sensors

    def of_run(run: PreparedRecording) -> tuple[NormalEquations, Array]:
        linear = model.linearize_run(run, fitted.theta)
        scores = linear.jacobian * linear.residual  # (k, n * sensors)
        block_scores = np.add.reduceat(scores, np.arange(0, scores.shape[1], values_per_block), axis=1)
        return NormalEquations.from_rows(linear.jacobian, linear.residual), block_scores

    parts = list(map_runs(of_run, data))
    prior = prior_precision(fitted.free)
    inverse_hessian = np.linalg.inv(NormalEquations.total(equations for equations, _ in parts).information + prior)
    block_scores = np.concatenate([scores for _, scores in parts], axis=1)  # (k, blocks)
    block_scores -= block_scores.mean(axis=1, keepdims=True)
    covariance = inverse_hessian @ (block_scores @ block_scores.T + prior) @ inverse_hessian
    deflation = np.sqrt(np.diag(inverse_hessian) / np.maximum(np.diag(covariance), 1e-300))
    covariance *= np.outer(np.maximum(deflation, 1.0), np.maximum(deflation, 1.0))
    slopes = np.array([f.slope(t) for f, t in zip(fitted.free, fitted.theta, strict=True)])
    covariance *= np.outer(slopes, slopes)
    uncertainty = Uncertainty(tuple(f.name for f in fitted.free), (covariance + covariance.T) / 2)
    return fitted.machine.replace(uncertainty=uncertainty)


def parameter_doubts(machine: Machine, declared: Machine) -> dict[str, list[str]]:
    """List for each identified parameter why its value may be unreliable.

    Reasons are a value at its bound, a large standard deviation, a value that the prior determines, and a correlation
    above 0.95 with another parameter.

    Args:
        machine: Identified machine with its uncertainty.
        declared: Machine as it was declared, which defines the priors.

    Returns:
        By full parameter name, phrases for the report; an empty list for a reliable parameter. Empty if the machine
        has no uncertainty.
    """
    if machine.uncertainty is None:
        return {}
    doubts: dict[str, list[str]] = {name: [] for name in machine.uncertainty.names}
    _add_bound_doubts(machine, doubts)
    _add_precision_doubts(machine, machine.uncertainty, declared, doubts)
    _add_correlation_doubts(machine.uncertainty, doubts)
    return doubts


def _add_bound_doubts(machine: Machine, doubts: dict[str, list[str]]) -> None:
    """Add effect parameters whose value is at a bound of its range."""
    for effect in machine.effects:
        for p in effect.definition.parameters:
            name, value = f"{effect.label}.{p.name}", effect.parameters[p.name]
            tolerance = _BOUND_TOLERANCE * max(abs(value), p.scale)
            if name in doubts and (value - p.lower < tolerance or p.upper - value < tolerance):
                doubts[name].append("at a bound")


def _add_precision_doubts(
    machine: Machine, uncertainty: Uncertainty, declared: Machine, doubts: dict[str, list[str]]
) -> None:
    """Add parameters with a large standard deviation, and those that the prior determines rather than the data."""
    priors = {f.name: f for f in default_free_parameters(declared)}
    roles = {f"{e.label}.{p.name}": p.role for e in machine.effects for p in e.definition.parameters}
    for name, reasons in doubts.items():
        value, std = machine.parameters[name], uncertainty.std(name) or 0.0
        prior = priors.get(name)
        limit = _POOR_PHASE_STD if roles.get(name) == "phase" else _POOR_RELATIVE_STD * abs(value)
        prior_unit = 0.0 if prior is None else abs(value) if prior.scale is None else prior.scale
        if prior is not None and std > _PRIOR_DOMINATES * prior.prior * prior_unit:
            reasons.append("determined by the declared value more than by the data")
        elif std > limit:
            reasons.append("poorly determined")


def _add_correlation_doubts(uncertainty: Uncertainty, doubts: dict[str, list[str]]) -> None:
    """Add pairs of parameters that are almost perfectly correlated."""
    names, covariance = uncertainty.names, uncertainty.covariance
    std = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    correlation = covariance / np.outer(std, std)
    np.fill_diagonal(correlation, 0.0)
    for i, name in enumerate(names):
        partners = [
            f"{correlation[i, j]:+.3f} with {names[j]}"
            for j in np.flatnonzero(np.abs(correlation[i]) > _HIGH_CORRELATION)
        ]
        if partners:
            doubts[name].append(f"correlation {', '.join(partners)}")
