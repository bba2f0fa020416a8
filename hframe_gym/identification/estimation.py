"""Estimation of a machine's parameters.

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

from ..machine import Machine
from .dataset import Dataset, PreparedRecording
from .free_parameters import FreeParameter, prior_precision, values_at
from .linearization import ResidualModel
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
