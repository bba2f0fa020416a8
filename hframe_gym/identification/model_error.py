"""The error of a model beyond the sensors' noise: its size, and whether an effect stands out from it.

No model of a real machine is exact. A small force that no effect of the library describes (a residue) accumulates in a
simulation to many times the sensors' noise, and effects that do not exist imitate parts of it. Three means keep them
apart:

- The observer of the prediction stands for the residue. Its bandwidth is that of the steady-state Kalman filter for a
  random force, so the bandwidth that maximizes the likelihood of the innovations estimates the residue's size. A model
  without residue needs no observer; every effect is judged at the bandwidth that remains once it is part of the model.
- An effect must be larger than the residue: its force is compared with the force by which the observer corrects the
  prediction.
- An effect must be confirmed by runs to which its parameters were not fitted (leave-one-run-out, linearized).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from .criteria import SelectionCriteria
from .dataset import Dataset, PreparedRecording
from .estimation import Fit, fit, prediction_cost
from .free_parameters import bounded_step, prior_precision
from .linearization import NormalEquations, ResidualModel
from .prediction import (
    POLISH_STEP,
    SEARCH_BANDWIDTH,
    SEARCH_STEP,
    SIMULATION,
    map_runs,
    sensor_bandwidths,
)

Array = NDArray[np.float64]

# Bandwidths that are compared, rad/s. The likelihood changes little between neighbors.
BANDWIDTHS = (SEARCH_BANDWIDTH, 30.0, 15.0, 7.0, 3.0, SIMULATION)
_FOLDS = 3  # parts of the runs that are left out in turn, where fits are repeated
_MIN_RUNS, _PIECES = 4, 8  # fewer runs are divided into that many pieces for cross-validation
_MIN_AGREEING = 2  # runs that must agree with each other for another one to contradict them
CONTRADICTION = 10.0  # times the chi-squared of the other runs; effects that single runs excite reach 30
_SEARCH_STEP_NARROW = 0.25e-3  # s; a narrow observer does not forgive the error of longer integration steps


def search_step(bandwidth: float) -> float:
    """Return the integration step that suffices in the search for effects (deviations from the nominal model).

    Args:
        bandwidth: Bandwidth of the observer that corrects predictions by the measurements, rad/s; 0 for a simulation.

    Returns:
        Maximum integration step, s; shorter for a narrow bandwidth, at which integration errors accumulate.
    """
    return SEARCH_STEP if bandwidth >= SEARCH_BANDWIDTH else _SEARCH_STEP_NARROW


def information_loss(fitted: Fit, data: Dataset) -> float:
    """Return minus twice the log-likelihood of the innovations per measured value, without constants.

    Innovations are measured minus predicted values, where an observer corrects the prediction by the measurements.
    Those of a steady-state Kalman filter with position gain K have 1 / (1 - K) times the variance of the sensor's
    noise. The loss makes fits at different observer bandwidths comparable.

    Args:
        fitted: Fit at any observer bandwidth.
        data: Runs that were fitted (times, voltages, measurements, SI).

    Returns:
        Loss, dimensionless; 1 for an exact model in simulation with white noise of the assumed size. Differences times
        the number of measured values are likelihood ratios.

    References:
        Ljung (1999), "System Identification", section 7.4.
    """
    variance, log_variance = _innovation_variance(fitted, data)
    return fitted.chi2 / variance + log_variance


def _innovation_variance(fitted: Fit, data: Dataset) -> tuple[float, float]:
    """Return the mean variance of the innovations of an exact model, relative to the noise, and that of its log."""
    # Position gain K of a critically damped observer: twice the bandwidth times the sampling period.
    gains = 2.0 * sensor_bandwidths(fitted.machine, fitted.bandwidth) * data.period
    variance = 1.0 / (1.0 - np.minimum(gains, 0.9))  # (sensors,)
    counts = np.sum([run.counted.sum(axis=0) for run in data.runs], axis=0)  # (sensors,)
    weights = counts / counts.sum()
    return float(weights @ variance), float(weights @ np.log(variance))


def narrower_observer(fitted: Fit, data: Dataset) -> Fit:
    """Fit a machine with the next narrower one of the observers that correct predictions by the measurements.

    Args:
        fitted: Fit at one of the bandwidths `BANDWIDTHS` above 0.
        data: Runs that were fitted (times, voltages, measurements, SI).

    Returns:
        Fit (machine, parameters theta, shape (k,), cost) at the next smaller bandwidth, rad/s.
    """
    return at_bandwidth(fitted, BANDWIDTHS[BANDWIDTHS.index(fitted.bandwidth) + 1], data)


def likelihood_deficit(fitted: Fit, reference: Fit, data: Dataset) -> float:
    """Return by how much chi-squared per sample of a fit must fall to make it as likely as another one.

    Args:
        fitted: Fit at any observer bandwidth.
        reference: Fit of the same machine with another observer to correct predictions by the measurements.
        data: Runs that were fitted (times, voltages, measurements, SI).

    Returns:
        Reduction of chi-squared per sample, dimensionless; 0 if the fit is at least as likely.
    """
    loss = information_loss(fitted, data) - information_loss(reference, data)
    return max(0.0, loss) * _innovation_variance(fitted, data)[0]


def fit_with_model_error(fitted: Fit, data: Dataset) -> Fit:
    """Fit again at the observer bandwidth that maximizes the likelihood of the data.

    An observer corrects the prediction by the measurements; the larger the error of the model, the wider the bandwidth
    that it needs. Bandwidths below that of the given fit are tried while the likelihood increases, and the simulation
    (no observer) in any case, because the likelihood may have a second maximum there: an observer disturbs phases in
    which friction holds the machine at rest, a simulation does not.

    Args:
        fitted: Fit (machine, parameters, cost) at one of the bandwidths `BANDWIDTHS`.
        data: Runs that were fitted (times, voltages, measurements, SI).

    Returns:
        Fit with the smallest loss, see `information_loss`: machine, theta, shape (k,), cost and bandwidth, rad/s.
    """
    if fitted.bandwidth == SIMULATION:
        return fitted
    simulated = at_bandwidth(fitted, SIMULATION, data)
    best, least_loss = fitted, information_loss(fitted, data)
    for bandwidth in BANDWIDTHS[BANDWIDTHS.index(fitted.bandwidth) + 1 : -1]:
        narrower = at_bandwidth(best, bandwidth, data)
        loss = information_loss(narrower, data)
        if not loss < least_loss:
            break
        best, least_loss = narrower, loss
    return simulated if information_loss(simulated, data) < least_loss else best


def polish(fitted: Fit, data: Dataset) -> Fit:
    """Fit again with the shortest integration step, at the same bandwidth of the observer that corrects predictions.

    Args:
        fitted: Fit to refine.
        data: Runs that were fitted (times, voltages, measurements, SI).

    Returns:
        Fit (machine, parameters theta, shape (k,), cost) from the parameters of the given one, without the integration
        error of the search.
    """
    return fit(fitted.machine, fitted.free, data, fitted.bandwidth, theta=fitted.theta, longest_step=POLISH_STEP)


def refined_in_simulation(fitted: Fit, data: Dataset) -> Fit:
    """Fit a machine so that its simulation has the smallest error, as far as cross-validation confirms it.

    An observer hides slow errors from the fit, and with them what they say about the parameters. It protects the search
    from the model's error; the final machine is used in simulation. Compared are the fit with this observer, fits with
    narrower ones, and the fit in simulation. The parameters of the last one adapt to the model's error, so that its
    error on runs that it was not fitted to counts.

    Args:
        fitted: Final fit at any observer bandwidth.
        data: Runs that were fitted.

    Returns:
        Fit of the same k parameters (theta of shape (k,)) whose simulation has the smallest error, with the shortest
        integration step; the given one if none is better, or for a single run, which cannot confirm another fit.
    """
    if fitted.bandwidth == SIMULATION or len(data.runs) == 1:
        return fitted
    best, narrower = fitted, fitted
    least = prediction_cost(fitted.machine, data, SIMULATION, longest_step=POLISH_STEP)
    for bandwidth in BANDWIDTHS[BANDWIDTHS.index(fitted.bandwidth) + 1 : -1]:
        narrower = at_bandwidth(narrower, bandwidth, data)
        cost = prediction_cost(narrower.machine, data, SIMULATION, longest_step=POLISH_STEP)
        if cost < least:
            best, least = narrower, cost
    simulated = at_bandwidth(best, SIMULATION, data)
    if _cross_validated_cost(simulated, data) < least:
        best = simulated
    return best if best is fitted else polish(best, data)


def _cross_validated_cost(fitted: Fit, data: Dataset) -> float:
    """Return the cost of all runs, each with parameters that were fitted to runs of the other two thirds."""
    names = [run.name for run in data.runs]
    folds = [names[first::_FOLDS] for first in range(min(_FOLDS, len(names)))]
    step = search_step(fitted.bandwidth)
    total = 0.0
    for left_out in folds:
        others = data.with_runs([name for name in names if name not in left_out])
        refitted = fit(fitted.machine, fitted.free, others, fitted.bandwidth, theta=fitted.theta, longest_step=step)
        total += prediction_cost(refitted.machine, data.with_runs(left_out), fitted.bandwidth, longest_step=POLISH_STEP)
    return total


def leave_one_out_gain(without: Fit, with_effect: Fit, data: Dataset) -> float:
    """Return by how much an effect reduces the cost of every run if the other runs alone determine the parameters.

    The cost is the sum of squared residuals in units of the noise. Both models are linearized around their fit, where
    leaving out one run moves the parameters by one Newton step. Fewer than four runs are divided into eight pieces in
    all, which are left out instead: the other runs alone might not determine the parameters.

    Args:
        without: Fit without the effect (deviation from the nominal model).
        with_effect: Fit with it, with the same observer to correct predictions by the measurements.
        data: Runs that were fitted (times, voltages, measurements, SI).

    Returns:
        Reduction of chi-squared, dimensionless, summed over all runs. It is at most about the reduction on the fitted
        runs; it is negative if the effect describes single runs rather than the machine.
    """
    return _leave_one_out_cost(without, data) - _leave_one_out_cost(with_effect, data)


def _leave_one_out_cost(fitted: Fit, data: Dataset) -> float:
    """Return the sum of the costs of all runs, each with the parameters that the other runs determine."""
    pieces = 1 if len(data.runs) >= _MIN_RUNS else -(-_PIECES // len(data.runs))  # of each run
    return sum(cost for cost, _ in _left_out_costs(fitted, data, pieces))


def contradicting_run(fitted: Fit, data: Dataset) -> str | None:
    """Find a run that does not agree with a machine on which the other runs agree.

    A loose connector, a slipped belt or another amplifier setting in one run is such a contradiction; so is an effect
    that only one run excites, and only a search for effects can tell one from the other.

    Args:
        fitted: Fitted machine with its observer bandwidth.
        data: Runs that were fitted.

    Returns:
        Name of the run whose chi-squared per sample, with the parameters that the other runs determine, is more than
        ten times theirs, and most; None if there is no such run, or fewer than three runs.
    """
    if len(data.runs) < _MIN_AGREEING + 1:
        return None
    costs = _left_out_costs(fitted, data, 1)
    counts = [run.count for run in data.runs]
    ratios = [
        (cost / count) / (others / (sum(counts) - count)) for (cost, others), count in zip(costs, counts, strict=True)
    ]
    worst = int(np.argmax(ratios))
    return data.runs[worst].name if ratios[worst] > CONTRADICTION else None


def _left_out_costs(fitted: Fit, data: Dataset, pieces: int) -> list[tuple[float, float]]:
    """Return for each piece of the runs the cost of that piece, and of all others, with parameters from the others.

    The model is linearized around the fit, where leaving out a piece moves the parameters by one Newton step
    within the limits of the fit.

    Args:
        fitted: Fitted machine with its observer bandwidth.
        data: Runs that were fitted.
        pieces: Number of pieces into which each run is divided.
    """
    model = ResidualModel(fitted.machine, fitted.free, data, fitted.bandwidth, fitted.longest_step)

    def of_run(run: PreparedRecording) -> list[NormalEquations]:
        rows = model.linearize_run(run, fitted.theta)
        parts = zip(np.array_split(rows.jacobian, pieces, 1), np.array_split(rows.residual, pieces), strict=True)
        return [NormalEquations.from_rows(*part, count=run.count / pieces) for part in parts]

    equations = [piece for of_pieces in map_runs(of_run, data) for piece in of_pieces]
    total = NormalEquations.total(equations)
    if not total.finite:  # the machine diverges
        return [(math.inf, math.inf)] * len(equations)
    precision = prior_precision(fitted.free) * max(1.0, total.chi2)
    costs = []
    for left_out in equations:
        information, gradient = total.information - left_out.information, total.gradient - left_out.gradient
        hessian, slope = information + precision, gradient + precision @ fitted.theta
        step = bounded_step(fitted.free, fitted.theta, hessian, slope)
        costs.append(
            (
                left_out.cost + float(2.0 * left_out.gradient @ step + step @ left_out.information @ step),
                total.cost - left_out.cost + float(2.0 * gradient @ step + step @ information @ step),
            )
        )
    return costs


def explains(fitted: Fit, initial_chi2: float, criteria: SelectionCriteria) -> bool:
    """Return whether a fit leaves only the sensors' noise, or a negligible part of the initial residual.

    Args:
        fitted: Fit whose predictions an observer corrects by the measurements, with the bandwidth that its error
            requires.
        initial_chi2: Chi-squared per sample, dimensionless, of the first fit, without effects.
        criteria: Decision thresholds `explained_chi2` and `explained_fraction`.

    Returns:
        True if nothing noticeable remains.
    """
    return fitted.chi2 < max(criteria.explained_chi2, criteria.explained_fraction * initial_chi2)


def at_bandwidth(fitted: Fit, bandwidth: float, data: Dataset) -> Fit:
    """Fit a machine again at another observer bandwidth, starting from the parameters of an earlier fit.

    Args:
        fitted: Earlier fit.
        bandwidth: Bandwidth of the observer that corrects predictions by the measurements, rad/s; 0 for a simulation.
        data: Runs that were fitted (times, voltages, measurements, SI).

    Returns:
        Fit (machine, parameters theta, shape (k,), cost) at this bandwidth; the given one if it has that bandwidth
        already.
    """
    if fitted.bandwidth == bandwidth:
        return fitted
    step = search_step(bandwidth)
    return fit(fitted.machine, fitted.free, data, bandwidth, theta=fitted.theta, longest_step=step)


def minimum_gain(current: Fit, criteria: SelectionCriteria) -> float:
    """Return the smallest reduction of chi-squared per sample for which an effect is selected.

    Args:
        current: Fit without the effect. The bandwidth of the observer that corrects its predictions selects the
            threshold: that of one-step prediction (60 rad/s), or that of slower observers and simulation.
        criteria: Decision thresholds, which raise the result for short recordings and large residuals.

    Returns:
        Required reduction of chi-squared per sample, dimensionless.
    """
    # Three limits: for the kind of prediction, for the total of few samples, for a fraction of the error beyond noise.
    wide = current.bandwidth >= SEARCH_BANDWIDTH
    min_gain = criteria.min_gain_one_step if wide else criteria.min_gain_simulation
    excess = current.chi2 - 1.0
    return max(min_gain, criteria.min_total_gain / current.count, criteria.min_gain_fraction * excess)
