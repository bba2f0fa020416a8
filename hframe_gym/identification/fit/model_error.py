"""Fits with the observer that the error of a model beyond the sensors' noise requires.

No model of a real machine is exact. A small force that no effect of the library describes (a residue)
accumulates in a simulation to many times the sensors' noise, and effects that do not exist can reproduce
parts of this error. An observer corrects the prediction by the measurements, as the steady-state Kalman
filter for a random force would. The bandwidth, rad/s, that maximizes the likelihood of the innovations
(errors before each correction) corresponds to the size of the residue; after every effect it is chosen anew.
No residue: no observer (simulation, bandwidth 0).

The cost is the sum of squared residuals in units of the sensors' noise; chi-squared per sample is its mean.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

from ...machine import Machine
from ...preparation.dataset import Dataset
from ..budget import goes_on
from ..judge.observer import best_in_simulation, likeliest
from ..predict.prediction import (
    NARROWEST_WITH_VOLTAGE_ERRORS,
    POLISH_STEP,
    SEARCH_BANDWIDTH,
    SEARCH_STEP,
    SIMULATION,
    innovation_variance,
)
from .cross_validation import cross_validated_cost
from .estimation import CONVERGED_COST, Fit, fit, prediction_cost

# Bandwidths that are compared, rad/s. The likelihood changes little between neighbors.
BANDWIDTHS = (SEARCH_BANDWIDTH, 30.0, 15.0, 7.0, 3.0, SIMULATION)
_SEARCH_STEP_NARROW = 0.25e-3  # s; with a narrow observer, the errors of longer integration steps accumulate


def search_step(bandwidth: float, data: Dataset) -> float:
    """Return the maximum integration step, s, that is accurate enough in the search for effects.

    Args:
        bandwidth: Bandwidth of the observer that corrects predictions by the measurements, rad/s; 0 for a
            simulation.

    Returns:
        0.5 ms at 60 rad/s; 0.25 ms below, where integration errors accumulate. With an observer, 0.5 ms also
        for interpolated voltages, because their errors are much larger than those of the integration.
    """
    uncertain = data.has_voltage_errors and bandwidth >= NARROWEST_WITH_VOLTAGE_ERRORS
    return SEARCH_STEP if uncertain or bandwidth >= SEARCH_BANDWIDTH else _SEARCH_STEP_NARROW


def bandwidths_for(data: Dataset) -> tuple[float, ...]:
    """Return the observer bandwidths at which a data set can be fitted, rad/s, descending.

    They are 60, 30, 15, 7, 3 and 0, a simulation; for interpolated voltages, whose errors add up below, only
    those from 15 on.

    Args:
        data: Runs to fit.
    """
    if not data.has_voltage_errors:
        return BANDWIDTHS
    return tuple(b for b in BANDWIDTHS if b >= NARROWEST_WITH_VOLTAGE_ERRORS)


def has_narrowest_observer(fitted: Fit, data: Dataset) -> bool:
    """Return whether a fit already has the smallest observer bandwidth that suits the data.

    Args:
        fitted: Fit at one of the bandwidths of `bandwidths_for`.
    """
    return fitted.bandwidth <= bandwidths_for(data)[-1]


def likelihood_loss(fitted: Fit, data: Dataset) -> float:
    """Return -2 log(likelihood) of the innovations per measured value, without constants.

    Innovations are measured minus predicted values, where an observer corrects the prediction by the
    measurements. Their expected variance is that of a steady-state Kalman filter, the variance of the
    sensor's noise / (1 - K) with the position gain K. It depends on the bandwidth; therefore this loss, not
    the cost, compares fits at different observer bandwidths.

    Args:
        fitted: Fit at any observer bandwidth.

    Returns:
        Loss, dimensionless; 1 for an exact model in simulation with white noise of the assumed size. The
        difference of two losses times the number of measured values is -2 log(likelihood ratio).

    References:
        Ljung (1999), "System Identification", section 7.4.
    """
    variance, log_variance = innovation_variance(fitted.machine, data, fitted.bandwidth)
    return fitted.chi2 / variance + log_variance


def cost_of_loss(loss: float, machine: Machine, data: Dataset, bandwidth: float) -> float:
    """Convert a likelihood loss to a sum of squared residuals, the inverse of `likelihood_loss`.

    A fit can thus end when its cost exceeds that of a required likelihood.

    Args:
        loss: Loss (`likelihood_loss`), dimensionless.
        machine: Fitted machine.
        bandwidth: Bandwidth of the observer, rad/s; 0 for a simulation.

    Returns:
        Cost that a fit with this loss has: sum of squared residuals in units of the noise, dimensionless.
    """
    variance, log_variance = innovation_variance(machine, data, bandwidth)
    return (loss - log_variance) * variance * data.count


def narrower_observer(fitted: Fit, data: Dataset) -> Fit:
    """Fit a machine again with weaker feedback of measurements: an observer of the next smaller bandwidth.

    Args:
        fitted: Fit at one of the bandwidths of `bandwidths_for`, but not at the smallest
            (`has_narrowest_observer`).

    Returns:
        Fit at the next bandwidth; after 3 rad/s, in a simulation.
    """
    bandwidths = bandwidths_for(data)
    return continue_fit(fitted, data, bandwidths[bandwidths.index(fitted.bandwidth) + 1])


def likelihood_deficit(fitted: Fit, reference: Fit, data: Dataset) -> float:
    """Return by how much chi-squared per sample of a fit must fall to make it as likely as a reference.

    An effect that is added to a less likely fit must reduce chi-squared by this amount in addition.

    Args:
        fitted: Fit at any observer bandwidth.
        reference: Fit of the same machine at another observer bandwidth (of the feedback of measurements).

    Returns:
        Reduction of chi-squared per sample, dimensionless; 0 if the fit is at least as likely.
    """
    loss = likelihood_loss(fitted, data) - likelihood_loss(reference, data)
    return max(0.0, loss) * fitted.floor


def fit_with_model_error(fitted: Fit, data: Dataset) -> Fit:
    """Fit again at the observer bandwidth that maximizes the likelihood of the data.

    An observer corrects the prediction by the measurements; the larger the error of the model, the larger the
    bandwidth must be. Starting from the bandwidth of `fitted`, smaller ones and the simulation (no observer)
    are tried as `judge.observer.likeliest` asks for them.

    Args:
        fitted: Fit (machine, parameters, cost) at 60, 30, 15, 7, 3 or 0 rad/s (`BANDWIDTHS`; 0: simulation).

    Returns:
        Most likely fit.
    """
    if has_narrowest_observer(fitted, data):
        return fitted
    narrowest = bandwidths_for(data)[-1]
    goal = cost_of_loss(likelihood_loss(fitted, data), fitted.machine, data, narrowest)
    simulated = continue_fit(fitted, data, narrowest, goal=goal)
    fits = ((narrower, likelihood_loss(narrower, data)) for narrower in _narrowing(fitted, data))
    return likeliest(fits, (simulated, likelihood_loss(simulated, data)))


def _narrowing(fitted: Fit, data: Dataset) -> Iterator[Fit]:
    """Return a fit, then fits with narrower and narrower observers, each of which continues the one before.

    Where the time of a stage ends that must deliver a machine, none follows.
    """
    yield fitted
    bandwidths = bandwidths_for(data)
    for bandwidth in bandwidths[bandwidths.index(fitted.bandwidth) + 1 : -1]:
        if not goes_on():
            return
        fitted = continue_fit(fitted, data, bandwidth)
        yield fitted


def polish(fitted: Fit, data: Dataset, *, goal: float = math.inf) -> Fit:
    """Fit again until convergence, with the shortest integration step, 0.125 ms, whose error is negligible.

    Args:
        fitted: Fit to refine; its parameters are the starting values.
        goal: Cost, dimensionless, above which the fit is of no use (`fit`).
    """
    model, accurate = (fitted.machine, fitted.free, data, fitted.bandwidth), CONVERGED_COST / data.count
    return fit(*model, theta=fitted.theta, tolerance=accurate, longest_step=POLISH_STEP, goal=goal)


def refined_in_simulation(fitted: Fit, data: Dataset) -> Fit:
    """Fit the parameters again with less feedback of measurements, so that the machine simulates better.

    The final machine is used in simulation, whereas an observer (feedback of the measurements) hides slow
    errors of a fit, and with them information about the parameters. Fits at all smaller bandwidths are
    therefore compared by the product of two costs (sums of squared residuals): of the simulation, and of the
    prediction with the bandwidth of `fitted` (`judge.observer.best_in_simulation`).

    Args:
        fitted: Final fit at any observer bandwidth.

    Returns:
        Fit of the same parameters with the smallest product, polished. `fitted` itself if no fit is better,
        if it is a simulation, if there is only one run, which permits no cross-validation, if the errors of
        interpolated voltages add up in a simulation, or if the time of a stage that must deliver is used up.
    """
    if fitted.bandwidth == SIMULATION or len(data.runs) == 1 or data.has_voltage_errors or not goes_on():
        return fitted

    def cost(machine: Machine, bandwidth: float) -> float:
        return prediction_cost(machine, data, bandwidth, longest_step=POLISH_STEP)

    def product(narrower: Fit) -> float:
        return cost(narrower.machine, SIMULATION) * cost(narrower.machine, fitted.bandwidth)

    def simulated(best: Fit, least: float) -> tuple[Fit, float]:
        # No parameters have a lower cost in prediction than the fit, and none in runs to which they were not
        # fitted than in those to which they were.
        goal = least / fitted.cost
        again = continue_fit(best, data, SIMULATION, goal=goal)
        if not again.cost < goal:
            return again, math.inf
        return again, cross_validated_cost(again, data) * cost(again.machine, fitted.bandwidth)

    best = best_in_simulation(
        ((narrower, product(narrower)) for narrower in _narrowing(fitted, data)), simulated
    )
    return best if best is fitted else polish(best, data)


def continue_fit(fitted: Fit, data: Dataset, bandwidth: float, *, goal: float = math.inf) -> Fit:
    """Continue a fit from its parameters, with other data or at another observer bandwidth.

    Args:
        fitted: Earlier fit; its parameters are the starting values.
        bandwidth: Bandwidth of the observer that corrects predictions by the measurements, rad/s; 0 for a
            simulation.
        goal: Cost, dimensionless, above which the fit is of no use (`fit`).

    Returns:
        Fit with the step of `search_step`.
    """
    start, step = (fitted.machine, fitted.free, data, bandwidth), search_step(bandwidth, data)
    return fit(*start, theta=fitted.theta, longest_step=step, goal=goal)
