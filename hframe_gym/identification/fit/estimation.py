"""Estimation of a machine's parameters.

The Levenberg-Marquardt method fits the parameters. They have a weak Gaussian prior around the declared
machine, so that parameters that the data do not determine keep their declared values. Every iteration
linearizes the residual by one batched simulation and tries several dampings in another. Dry friction needs no
smoothing: its exact solution depends continuously on the parameters.

An observer may correct a prediction by the measurements at every sample; its bandwidth, rad/s, states how
strongly. Bandwidth 0 means no observer, a simulation. The cost is the sum of squared residuals in units of
the sensors' noise.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from ...arrays import Array
from ...machine import Machine
from ...preparation.dataset import Dataset, PreparedRecording, RunObserver
from ..budget import goes_on
from ..judge.error import FitError
from ..predict.free_parameters import FreeParameter, bounded_step, prior_precision, step_in_values, values_at
from ..predict.linearization import DIFFERENCE_STEP, Linearization, ResidualModel, has_impacts
from ..predict.prediction import SEARCH_BANDWIDTH, SEARCH_STEP, innovation_variance, map_runs
from ..predict.start_uncertainty import prediction_residuals, uncertain_starts

# Relative to the diagonal of the Hessian. The step without damping (Gauss-Newton) lets combinations of
# parameters that only the prior determines converge: damping holds them back, because the data determine each
# parameter by itself.
_DAMPINGS = (0.0, 1e-5, 1e-3, 1e-2, 1e-1, 1.0, 1e1, 1e2)
# Changes of theta over which derivatives are computed where parts collide: from the general slope to the
# details.
_IMPACT_DIFFERENCE_STEPS = (0.1, 0.01, DIFFERENCE_STEP)
# Changes of theta at which the cost is compared for a parameter on which measurements depend in steps.
SWITCH_CHANGES: Array = np.float64(0.5) ** np.arange(1, 14)  # 50 to 0.01 % of a threshold
# The same for a parameter on which no prediction depends, such as a limit that is not reached: once it is
# reached, derivatives lead on.
UNREACHED_CHANGES = SWITCH_CHANGES[:5]  # 50 to 3 %
# Factor, dimensionless, from the square of a step's relative error of prediction to the part of its decrease
# of the cost that the next step would add: (1 - found / predicted)^2 where the curvature is wrong, 9/4 of it
# where the cost has a cubic term.
_NEXT_STEP = 2.25
# Decrease of cost / chi2 at which an accurate fit ends; it is 1 at one standard deviation.
CONVERGED_COST = 0.02


@dataclass(frozen=True, eq=False)
class Fit:
    """Result of a fit of k free parameters; two fits are equal only if they are the same object.

    Attributes:
        machine: Fitted machine.
        free: Free parameters, k of them.
        theta: Fitted theta of each, the dimensionless variable defined by `FreeParameter`, shape (k,).
        cost: Sum of squared residuals in units of the noise, without the prior.
        count: Number of independent measured values.
        bandwidth: Bandwidth of the observer that corrected the fitted predictions by the measurements, rad/s;
            0 for a pure simulation.
        information: Fisher information of theta without the prior, shape (k, k).
        longest_step: Maximum integration step of the fitted predictions, s.
        floor: Chi-squared per sample of an exact machine with this observer, dimensionless
            (`innovation_variance`).
        observers: Observers by name of the run, if each run had another one; otherwise empty.
        covariance: Covariance of theta, shape (k, k), of a fit by instrumental variables (`slow_logs`); None
            for least squares.
        change_by_delay: Change of theta due to the delay of the inputs that a fit by instrumental variables
            indicates, shape (k,); None for least squares.
    """

    machine: Machine
    free: tuple[FreeParameter, ...]
    theta: Array
    cost: float
    count: float
    bandwidth: float
    information: Array = field(repr=False)
    longest_step: float = SEARCH_STEP
    floor: float = 1.0
    observers: Mapping[str, RunObserver] = field(default_factory=dict, repr=False)
    covariance: Array | None = field(default=None, repr=False)
    change_by_delay: Array | None = field(default=None, repr=False)

    @property
    def chi2(self) -> float:
        """Chi-squared per sample (mean squared residual / noise variance), 1 if only sensor noise remains."""
        return self.cost / self.count

    @property
    def error(self) -> FitError:
        """Cost, number of values, observer and floor of the fit, as the rules of `judge` compare them."""
        widest = self.bandwidth >= SEARCH_BANDWIDTH
        return FitError(self.cost, self.count, self.bandwidth, widest, self.floor)

    @property
    def mode(self) -> str:
        """Kind of prediction that was fitted, for the log: "observer of 60 rad/s" or "simulation"."""
        return f"observer of {self.bandwidth:g} rad/s" if self.bandwidth else "simulation"

    @property
    def summary(self) -> str:
        """Text for the log, such as "chi-squared per sample 1.23 (observer of 60 rad/s)"."""
        return f"chi-squared per sample {self.chi2:.4g} ({self.mode})"

    @property
    def values(self) -> dict[str, float]:
        """Fitted values of the free parameters, SI, by full name such as `x.coulomb`."""
        return values_at(self.free, self.theta)


def describe_gain(before: Fit, after: Fit) -> str:
    """Describe the benefit of an effect: "reduces chi-squared per sample from 98.99 to 0.79 (simulation)".

    If the fit with the effect ended in a worse minimum, the text says "does not reduce chi-squared per sample
    (500.5, with it 533.5)".

    Args:
        before: Fit without the effect; the text states its observer bandwidth, rad/s, or "simulation" if that
            is 0.
        after: Fit with the effect, at the same bandwidth.

    Returns:
        Text that continues a sentence whose subject is the effect.
    """
    if not after.chi2 < before.chi2:
        return (
            f"does not reduce chi-squared per sample ({before.chi2:.4g}, "
            f"with it {after.chi2:.4g}, {before.mode})"
        )
    return f"reduces chi-squared per sample from {before.chi2:.4g} to {after.chi2:.4g} ({before.mode})"


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
    goal: float = math.inf,
) -> Fit:
    """Fit free parameters of a machine to a data set by the Levenberg-Marquardt method.

    The fit minimizes the cost (sum of squared residuals in units of the noise) plus the penalty of the
    Gaussian priors, which is multiplied by chi-squared per sample (cost / number of measured values) where
    that exceeds 1.

    Args:
        machine: Machine that supplies the model and the values of all other parameters.
        free: The k free parameters with their priors.
        bandwidth: Bandwidth of the observer that corrects predictions by the measurements, rad/s; 0 for a
            simulation.
        theta: Initial theta of each parameter (`FreeParameter`), dimensionless, shape (k,). Default: 0, its
            center.
        iterations: Maximum number of iterations.
        tolerance: Decrease of cost plus penalty per iteration, relative to their sum, below which the search
            ends.
        longest_step: Maximum integration step, s.
        goal: Cost, dimensionless, above which the fit is useless. The search ends early if two predictions
            exceed it: the cost after the remaining iterations, each with the decrease of the last one, and
            the cost that the linear model promises for a step without damping. Default: no early end.

    Returns:
        Fit with the final parameters; its cost is without the penalty, and infinite if the machine diverges.
    """
    theta = np.zeros(len(free)) if theta is None else np.array(theta, float)
    steps: tuple[float | None, ...] = (None, DIFFERENCE_STEP) if any(f.switch for f in free) else (None,)
    for step in _IMPACT_DIFFERENCE_STEPS if has_impacts(machine) else steps:
        model = ResidualModel(machine, tuple(free), data, bandwidth, longest_step, difference_step=step)
        theta, cost, information = _descend(model, theta, iterations, tolerance, goal)
    machine = model.machine_at(theta)
    floor = innovation_variance(machine, data, bandwidth)[0]
    return Fit(machine, model.free, theta, cost, data.count, bandwidth, information, longest_step, floor)


def _descend(
    model: ResidualModel, theta: Array, iterations: int, tolerance: float, goal: float
) -> tuple[Array, float, Array]:
    """Reduce the cost by Levenberg-Marquardt steps, until another one would gain less than the tolerance.

    Trials have the integration step, and the influence of unknown starts, of the expansion point. A machine
    that needs a shorter step may therefore seem good and diverge by itself, so that the descent ends where
    the cost of the machine by itself is lowest: at an expansion point or after the last step.

    Return theta; its cost without the penalty of the prior, infinite if the machine diverges at the start;
    and the Fisher information without the prior at the last expansion point up to there.
    """
    free, prior = model.free, prior_precision(model.free)
    information, cost = np.zeros((len(free), len(free))), math.inf
    least, lowest_point = math.inf, (theta, math.inf, information)
    for iteration in range(iterations):
        if not goes_on() and iteration:  # the first one tells the cost
            break
        expansion = model.linearize(theta)
        equations = expansion.normal_equations
        if not equations.finite:  # this machine diverges, or one with slightly different parameters
            break
        information = equations.information
        # If the mean square error is chi2 times that of the noise, the data are that much less certain; the
        # prior is scaled by chi2 instead, so that it keeps its weight relative to the data.
        precision = prior * max(1.0, equations.chi2)
        initial_cost = cost = equations.cost + float(theta @ precision @ theta)
        if initial_cost < least:
            least, lowest_point = initial_cost, (theta, equations.cost, information)
        hessian, gradient = information + precision, equations.gradient + precision @ theta
        scaling = np.diag(np.diag(hessian))
        steps = np.array([bounded_step(free, theta, hessian + d * scaling, gradient) for d in _DAMPINGS])
        ends = _ends(free, theta, steps)
        costs = _costs(expansion, precision, ends)
        theta, cost = _best_trial(ends, costs, theta, cost)
        promised = -(2.0 * steps @ gradient + np.einsum("bi,ij,bj->b", steps, hessian, steps))
        next_decrease = _next_decrease(promised, initial_cost - costs[: len(steps)])
        for j in (j for j, parameter in enumerate(free) if parameter.switch):
            trials = with_changed_switch(free[j], j, theta, SWITCH_CHANGES)
            theta, cost = _best_trial(trials, _costs(expansion, precision, trials), theta, cost)
            next_decrease = math.inf  # nothing was promised of it
        if min(initial_cost - cost, next_decrease) > tolerance * cost:
            lowest = _lowest_cost(initial_cost, cost, float(promised[0]), iterations - 1 - iteration)
            if lowest - float(theta @ precision @ theta) > goal:
                break
            continue
        before = cost
        for j in np.flatnonzero(np.diag(information) == 0.0).tolist():
            trials = with_changed_switch(free[j], j, theta, UNREACHED_CHANGES)
            theta, cost = _best_trial(trials, _costs(expansion, precision, trials), theta, cost)
        if not before - cost > tolerance * cost:
            break
    if not math.isfinite(cost):
        return lowest_point
    cost = prediction_cost(
        model.machine_at(theta), model.data, model.bandwidth, longest_step=model.longest_step
    )
    penalty = float(theta @ prior @ theta) * max(1.0, cost / model.data.count)
    return (theta, cost, information) if cost + penalty <= least else lowest_point


def _next_decrease(promised: Array, found: Array) -> float:
    """Estimate how much a further step would decrease the cost, by how well the last trials kept promises.

    Both are decreases of the cost, shape (trials,), those of the undamped step first, which leads to the
    minimum if the linear model is exact. The worst of all trials counts: the errors of a long step may cancel
    each other by chance.
    """
    most = float(promised[0])
    if not most > 0.0:
        return 0.0
    error = float(np.max(np.abs(found - promised))) / most
    return _NEXT_STEP * error * error * most if math.isfinite(error) else math.inf


def _lowest_cost(before: float, cost: float, promised: float, remaining: int) -> float:
    """Return the cost to which a fit may come down: by steps like the last, or the promised undamped step.

    Along a curved valley, many short steps precede those that reach its bottom; the linear model sees how
    deep that is.
    """
    return min(cost - remaining * (before - cost), before - promised)


def _costs(expansion: Linearization, precision: Array, trials: Array) -> Array:
    """Return the costs of trials, shape (trials, k), with the prior's penalty, simulated as one batch."""
    return expansion.costs(trials) + np.einsum("bi,ij,bj->b", trials, precision, trials)


def _ends(free: Sequence[FreeParameter], theta: Array, steps: Array) -> Array:
    """Return where steps end, shape (ends, k): all of them in theta, then in values those that end elsewhere.

    Where the data determine a sum of values, such as an inertia of several parts, the valley of low costs is
    straight in values and curved in logarithms; where they determine a ratio or product, it is the reverse.
    In a curved valley, only short steps decrease the cost.
    """
    in_theta, in_values = theta + steps, theta + step_in_values(free, theta, steps)
    differ = np.any(np.abs(in_values - in_theta) > DIFFERENCE_STEP, axis=1)
    return np.vstack([in_theta, in_values[differ]])


def _best_trial(trials: Array, costs: Array, theta: Array, cost: float) -> tuple[Array, float]:
    """Return the trial with the lowest cost and this cost; theta and its cost if no trial has a lower one."""
    best = int(np.argmin(costs))
    return (trials[best], float(costs[best])) if costs[best] < cost else (theta, cost)


def with_changed_switch(parameter: FreeParameter, j: int, theta: Array, changes: Array) -> Array:
    """Return variants of theta in which a parameter without useful derivatives is changed up and down.

    Args:
        parameter: The parameter, such as a threshold (`FreeParameter.switch`).
        j: Its index among the free parameters.
        theta: Dimensionless variables of the k free parameters, shape (k,).
        changes: Amounts that are added to theta and subtracted from it, dimensionless, shape (c,).

    Returns:
        Copies of theta in which element j is larger by the amounts, then those in which it is smaller, both
        clipped to its limits, shape (2 * c, k).
    """
    trials = np.tile(theta, (2 * len(changes), 1))
    trials[:, j] = np.clip(theta[j] + np.concatenate([changes, -changes]), *parameter.theta_limits)
    return trials


def prediction_cost(
    machine: Machine, data: Dataset, bandwidth: float, *, longest_step: float = SEARCH_STEP
) -> float:
    """Return the cost of a machine: the sum of the squared residuals of its predictions over all runs.

    The residuals are measured minus predicted values divided by the standard deviation of the sensors' noise,
    without the part that the uncertain initial state can explain (`prediction_residuals`).

    Args:
        bandwidth: Bandwidth of the observer that corrects predictions by the measurements, rad/s; 0 for a
            simulation.
        longest_step: Maximum integration step, s.

    Returns:
        Cost, dimensionless; infinite if a prediction diverges.
    """
    total = float(sum(prediction_costs(machine, data, bandwidth, longest_step=longest_step)))
    return total if math.isfinite(total) else math.inf


def prediction_costs(
    machine: Machine, data: Dataset, bandwidth: float, *, longest_step: float = SEARCH_STEP
) -> Array:
    """Return the cost of a machine on each run (`prediction_cost` is their sum).

    Args:
        bandwidth: Bandwidth of the observer that corrects predictions by the measurements, rad/s; 0 for a
            simulation.
        longest_step: Maximum integration step, s.

    Returns:
        Costs, dimensionless, shape (runs,); not finite where a prediction diverges.
    """
    starts = uncertain_starts(machine, data.runs)

    def of_run(run: PreparedRecording) -> float:
        with np.errstate(over="ignore"):
            start = starts[run.name]
            residual = prediction_residuals(
                machine, run, data, bandwidth, start=start, longest_step=longest_step
            )
            return float(np.sum(residual**2))

    return np.array(list(map_runs(of_run, data)))
