"""Fit parameters with another observer for each run, because the error of a model differs from run to run.

Jitter of the clock, for example, acts where voltages change; a missing force acts where the machine moves.
One observer for all runs is too slow for some of them and wastes information from the others. Observers and
parameters are therefore chosen together, by maximum likelihood.

Notation: theta (k,) are the optimizer's variables of the k free parameters. n is a run's number of measured
values, c the sum of its squared innovations in units of the sensors' noise, and v the variance of the
innovations of an exact machine in these units (`innovation_variance`). s = max(1, c / (n v)) is the factor by
which their variance is larger.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from ...arrays import Array
from ...preparation.dataset import Dataset, RunObserver
from ..budget import goes_on
from ..judge.run import accepts_run_observers
from ..predict.free_parameters import bounded_step, prior_precision
from ..predict.linearization import ResidualModel
from ..predict.normal_equations import NormalEquations
from ..predict.prediction import POLISH_STEP, SIMULATION, innovation_variance
from .estimation import Fit, prediction_cost, prediction_costs
from .model_error import bandwidths_for, polish, search_step

Observers = dict[str, RunObserver]

_ROUNDS = 3  # of choosing observers and fitting; the second rarely changes anything
_WEIGHTINGS = 4  # of the runs by their variances, and parameters in turn, in a linearized model
_CONVERGED = 1.0  # decrease of -2 log(likelihood) that is negligible; it is 1 at one standard deviation


def fit_run_by_run(fitted: Fit, data: Dataset) -> Fit:
    """Fit the parameters again, with the observer that is most likely for each run.

    Args:
        fitted: Final fit at any observer bandwidth.

    Returns:
        Fit of the same parameters, with the runs' observers in `observers` and the cost at the bandwidth of
        `fitted`. `fitted` itself if no other observers are more likely, if the new machine simulates the runs
        much worse (mean square errors that are, in the geometric mean over the runs, doubled), or if the time
        of a stage that must deliver is used up.
    """
    best, chosen = fitted, dict.fromkeys((run.name for run in data.runs), RunObserver(fitted.bandwidth))
    least = _loss(fitted, data, chosen)
    for _ in range(_ROUNDS):
        if not goes_on():
            break
        observers = _likeliest_observers(best, data)
        if observers is None or _bandwidths(observers) == _bandwidths(chosen):
            break
        refined = polish(best, data.with_observers(observers))
        loss = _loss(refined, data, observers)
        if not loss < least - _CONVERGED:
            break
        best, chosen, least = refined, observers, loss
    if best is fitted:
        return fitted
    simulated, before = (
        prediction_costs(f.machine, data, SIMULATION, longest_step=POLISH_STEP) for f in (best, fitted)
    )
    if not accepts_run_observers(float(np.mean(np.log(simulated / before)))):
        return fitted
    cost = prediction_cost(best.machine, data, fitted.bandwidth, longest_step=POLISH_STEP)
    return dataclasses.replace(best, cost=cost, observers=chosen)


def _bandwidths(observers: Observers) -> list[float]:
    return [observer.bandwidth for observer in observers.values()]


def _variances(fitted: Fit, data: Dataset, bandwidth: float) -> Array:
    """Return v and the mean of log v of every run at a bandwidth, rad/s, shape (runs, 2)."""
    return np.array([innovation_variance(fitted.machine, run, bandwidth) for run in data.single_runs()])


def _losses(costs: Array, counts: Array, variances: Array) -> tuple[Array, Array]:
    """Return the losses, n (log s + c / (n v s) + log v), and s of every run, shape (runs,) each.

    c are the costs, n the counts; variances (runs, 2) are v and the mean of log v.
    """
    with np.errstate(invalid="ignore"):
        ratio = costs / (counts * variances[:, 0])
        inflation = np.maximum(ratio, 1.0)
        return counts * (np.log(inflation) + ratio / inflation + variances[:, 1]), inflation


def _loss(fitted: Fit, data: Dataset, observers: Observers) -> float:
    """Return -2 log(likelihood x prior) of a fit, with a factor s for every run, without constants."""
    counts = np.array([run.count for run in data.runs])
    bandwidths = np.array(_bandwidths(observers))
    total = float(fitted.theta @ prior_precision(fitted.free) @ fitted.theta)
    for bandwidth in np.unique(bandwidths):
        of_bandwidth = data.with_runs(
            [r.name for r, b in zip(data.runs, bandwidths, strict=True) if b == bandwidth]
        )
        costs = prediction_costs(fitted.machine, of_bandwidth, float(bandwidth), longest_step=POLISH_STEP)
        variances = _variances(fitted, of_bandwidth, float(bandwidth))
        total += float(_losses(costs, counts[bandwidths == bandwidth], variances)[0].sum())
    return total


def _likeliest_observers(fitted: Fit, data: Dataset) -> Observers | None:
    """Return each run's most likely observer, by its name, with the parameters that these observers imply.

    Predictions are linearized around the fit once per bandwidth. From each bandwidth for all runs, one run
    after the other takes the bandwidth that increases the likelihood, until none does. None if all
    linearizations diverge.
    """
    model = _LinearizedFits(fitted, data)
    starts = [[index] * len(data.runs) for index in range(len(model.bandwidths)) if model.usable[index].all()]
    if not starts:
        return None
    choice = min((model.improved(start) for start in starts), key=lambda indices: model.loss(indices)[0])
    inflation = model.loss(choice)[1]
    chosen = zip(data.runs, choice, inflation, strict=True)
    return {run.name: RunObserver(model.bandwidths[index], float(s)) for run, index, s in chosen}


class _LinearizedFits:
    """Likelihood of runs at any combination of observer bandwidths, linearized around a fit.

    Attributes:
        bandwidths: Bandwidths of the observers, rad/s.
        usable: Whether the prediction of a run at a bandwidth is finite near the fit,
            shape (bandwidths, runs).
    """

    def __init__(self, fitted: Fit, data: Dataset) -> None:
        self._fitted, self._prior = fitted, prior_precision(fitted.free)
        self.bandwidths = bandwidths_for(data)
        self._equations = [self._at(bandwidth, data) for bandwidth in self.bandwidths]
        self.usable = np.array([[equations.finite for equations in runs] for runs in self._equations])
        self._variances = np.array([_variances(fitted, data, bandwidth) for bandwidth in self.bandwidths])
        self._counts = np.array([run.count for run in data.runs])
        self._known: dict[tuple[int, ...], tuple[float, Array]] = {}  # results of `loss`

    def _at(self, bandwidth: float, data: Dataset) -> tuple[NormalEquations, ...]:
        step = search_step(bandwidth, data)
        model = ResidualModel(self._fitted.machine, self._fitted.free, data, bandwidth, step)
        return model.linearize(self._fitted.theta).by_run

    def loss(self, choice: Sequence[int]) -> tuple[float, Array]:
        """Fit the linearized model; return its -2 log(likelihood x prior) and s of every run, shape (runs,).

        Args:
            choice: Index of the bandwidth of every run.
        """
        key = tuple(choice)
        if key not in self._known:
            self._known[key] = self._loss(choice)
        return self._known[key]

    def _loss(self, choice: Sequence[int]) -> tuple[float, Array]:
        """Return `loss`."""
        fitted, runs = self._fitted, range(len(choice))
        equations = [self._equations[index][run] for run, index in enumerate(choice)]
        variances = self._variances[list(choice), runs]
        step = np.zeros(len(fitted.theta))
        for _ in range(_WEIGHTINGS):
            costs = [e.cost_after(step) for e in equations]
            losses, inflation = _losses(np.maximum(costs, 0.0), self._counts, variances)
            weights = 1.0 / (variances[:, 0] * inflation)
            information = sum(w * e.information for w, e in zip(weights, equations, strict=True))
            gradient = sum(w * e.gradient for w, e in zip(weights, equations, strict=True))
            step = bounded_step(
                fitted.free, fitted.theta, information + self._prior, gradient + self._prior @ fitted.theta
            )
        theta = fitted.theta + step
        return float(losses.sum() + theta @ self._prior @ theta), inflation

    def improved(self, choice: Sequence[int]) -> list[int]:
        """Change the bandwidth of single runs while the likelihood increases; return the indices of all runs.

        Args:
            choice: Index of the bandwidth of every run, from which the search starts.
        """
        best = list(choice)
        least = self.loss(best)[0]
        changed = True
        while changed:
            changed = False
            for run in range(len(best)):
                for index in np.flatnonzero(self.usable[:, run]):
                    trial = [*best[:run], int(index), *best[run + 1 :]]
                    loss = self.loss(trial)[0]
                    if loss < least - _CONVERGED:
                        best, least, changed = trial, loss, True
        return best
