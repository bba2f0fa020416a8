"""Estimate a machine's parameters with the Levenberg-Marquardt method.

Parameters have a mild Gaussian prior around the declared machine, so that what the data do not determine stays as
declared.  Every iteration linearizes the residual by one batched simulation and tries several dampings in another.
Dry friction needs no smoothing: its exact solution depends continuously on the parameters.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ..machine import Machine
from .dataset import Dataset, PreparedRecording
from .free_parameters import FreeParameter, default_free_parameters, prior_precision, typical_force, values_at
from .linearization import ResidualModel
from .prediction import SEARCH_STEP, Mode, map_runs, predict, residuals

Array = NDArray[np.float64]

# A parameter may move this many standard deviations of its prior; beyond, the model is wrong.
_MAXIMUM_DEVIATION = 4.0
_DAMPINGS = 10.0 ** np.array([-6.0, -4.0, -3.0, -2.0, -1.0, 0.0, 1.0, 2.0])


@dataclass(frozen=True)
class Fit:
    """Result of a fit.

    Attributes:
        machine: Fitted machine.
        free: Free parameters.
        theta: Their fitted coordinates, shape (k,).
        cost: Sum of squared residuals in units of the noise, without the prior.
        count: Number of measured values.
        mode: Prediction mode of the fit.
        information: Fisher information of theta without the prior, shape (k, k).
    """

    machine: Machine
    free: tuple[FreeParameter, ...]
    theta: Array
    cost: float
    count: int
    mode: Mode
    information: Array = field(repr=False)

    @property
    def chi2(self) -> float:
        """Cost per measured value: one when only the sensors' noise remains."""
        return self.cost / self.count

    @property
    def values(self) -> dict[str, float]:
        """Fitted values by full parameter name."""
        return values_at(self.free, self.theta)


def fit(
    machine: Machine,
    free: Sequence[FreeParameter],
    data: Dataset,
    mode: Mode,
    *,
    theta: Array | None = None,
    iterations: int = 25,
    tolerance: float = 1e-4,
    longest_step: float = SEARCH_STEP,
) -> Fit:
    """Fit free parameters of a machine to a data set.

    Args:
        machine: Machine that supplies everything but the free parameters.
        free: Free parameters.
        data: Runs to fit.
        mode: "one_step" or "simulation".
        theta: Initial guess, shape (k,); default: the centers of the free parameters.
        iterations: Maximum number of iterations.
        tolerance: Relative decrease of the cost per iteration below which the search ends.
        longest_step: Maximum integration step, s.

    Returns:
        The best parameters.
    """
    model = ResidualModel(machine, tuple(free), data, mode, longest_step)
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
    return Fit(model.machine_at(theta), model.free, theta, data_cost, data.count, mode, information)


def prediction_cost(machine: Machine, data: Dataset, mode: Mode, *, longest_step: float = SEARCH_STEP) -> float:
    """Return the sum of squared prediction errors of a machine in units of the noise.

    Args:
        machine: Machine that predicts.
        data: Runs to predict.
        mode: "one_step" or "simulation".
        longest_step: Maximum integration step, s.

    Returns:
        The cost; infinite if a prediction diverges.
    """

    def of_run(run: PreparedRecording) -> float:
        motion = predict(machine, run, mode, period=data.period, longest_step=longest_step)
        return float(np.sum(residuals(run, data, motion.readings) ** 2))

    total = sum(map_runs(of_run, data))
    return total if math.isfinite(total) else math.inf


# Aliases until all packages use the new names.
cost_of = prediction_cost
over_runs = map_runs
__all__ = [
    "Fit",
    "FreeParameter",
    "cost_of",
    "default_free_parameters",
    "fit",
    "over_runs",
    "prediction_cost",
    "typical_force",
]
