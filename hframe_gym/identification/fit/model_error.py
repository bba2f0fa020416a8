"""The error of a model beyond the sensors' noise: its size, and whether an effect is larger.

No model of a real machine is exact. A small force that no effect of the library describes (a residue) accumulates in a
simulation to many times the sensors' noise, and effects that do not exist can reproduce parts of this error. Three
measures distinguish true effects from the residue:

- An observer corrects the prediction by the measurements, as the steady-state Kalman filter for a random force would.
  The bandwidth, rad/s, that maximizes the likelihood of the innovations (errors before each correction) corresponds to
  the size of the residue; after every effect it is chosen anew. No residue: no observer (simulation, bandwidth 0).
- An effect must be larger than the residue: its force is compared with the force by which the observer corrects the
  prediction.
- An effect must be confirmed by runs to which its parameters were not fitted (leave-one-run-out). One step of the
  linear model leads to the parameters without a run; where that speaks against the effect, all are fitted again.

The cost is the sum of squared residuals in units of the sensors' noise; chi-squared per sample is its mean.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from ...arrays import Array
from ...effects.smooth_table import TABLE_FAMILY
from ...machine import Machine
from ...preparation.dataset import Dataset
from ..budget import goes_on
from ..judge import run as judge
from ..judge.observer import best_in_simulation, likeliest
from ..judge.run import MIN_RUNS_COMPARED
from ..predict.free_parameters import FreeParameter
from ..predict.linearization import ResidualModel
from ..predict.normal_equations import NormalEquations
from ..predict.prediction import (
    NARROWEST_WITH_VOLTAGE_ERRORS,
    POLISH_STEP,
    SEARCH_BANDWIDTH,
    SEARCH_STEP,
    SIMULATION,
    innovation_variance,
)
from .estimation import (
    Fit,
    costs_of_some_left_out,
    cross_validation,
    cross_validation_of_some,
    equations_of_pieces,
    fit,
    prediction_cost,
    thetas_left_out,
)

# Decrease of cost / chi2 at which a polished fit ends; it is 1 at one standard deviation.
_CONVERGED_COST = 0.02
# Bandwidths that are compared, rad/s. The likelihood changes little between neighbors.
BANDWIDTHS = (SEARCH_BANDWIDTH, 30.0, 15.0, 7.0, 3.0, SIMULATION)
_FOLDS = 3  # parts of the runs that are left out in turn where the error of a simulation is cross-validated
_MIN_RUNS, _PIECES = 4, 8  # fewer runs are divided into that many pieces for cross-validation
_SEARCH_STEP_NARROW = 0.25e-3  # s; with a narrow observer, the errors of longer integration steps accumulate


def search_step(bandwidth: float, data: Dataset) -> float:
    """Return the integration step that suffices in the search for effects.

    Args:
        bandwidth: Bandwidth of the observer that corrects predictions by the measurements, rad/s; 0 for a simulation.
        data: Runs to predict.

    Returns:
        Maximum integration step, s: 0.5 ms at 60 rad/s; 0.25 ms below, where integration errors accumulate. With an
        observer, 0.5 ms also where voltages are interpolated, whose errors are so much larger that chi-squared per
        sample changes by 0.0002.
    """
    uncertain = data.has_voltage_errors and bandwidth >= NARROWEST_WITH_VOLTAGE_ERRORS
    return SEARCH_STEP if uncertain or bandwidth >= SEARCH_BANDWIDTH else _SEARCH_STEP_NARROW


def bandwidths_for(data: Dataset) -> tuple[float, ...]:
    """Return the bandwidths of the observers that suit a data set, rad/s, descending.

    Args:
        data: Runs to fit. Errors of interpolated voltages add up in a simulation; they need an observer.
    """
    if not data.has_voltage_errors:
        return BANDWIDTHS
    return tuple(b for b in BANDWIDTHS if b >= NARROWEST_WITH_VOLTAGE_ERRORS)


def has_narrowest_observer(fitted: Fit, data: Dataset) -> bool:
    """Return whether no narrower observer suits the data of a fit.

    Args:
        fitted: Fit at one of the bandwidths of `bandwidths_for`.
        data: Runs that were fitted.
    """
    return fitted.bandwidth <= bandwidths_for(data)[-1]


def likelihood_loss(fitted: Fit, data: Dataset) -> float:
    """Return -2 log(likelihood) of the innovations per measured value, without constants.

    Innovations are measured minus predicted values, where an observer corrects the prediction by the measurements.
    Their expected variance is that of a steady-state Kalman filter, the variance of the sensor's noise / (1 - K) with
    the position gain K. It depends on the bandwidth; therefore this loss, not the cost, compares fits at different
    observer bandwidths.

    Args:
        fitted: Fit at any observer bandwidth.
        data: Runs that were fitted.

    Returns:
        Loss, dimensionless; 1 for an exact model in simulation with white noise of the assumed size. The difference of
        two losses times the number of measured values is -2 log(likelihood ratio).

    References:
        Ljung (1999), "System Identification", section 7.4.
    """
    variance, log_variance = innovation_variance(fitted.machine, data, fitted.bandwidth)
    return fitted.chi2 / variance + log_variance


def cost_of_loss(loss: float, machine: Machine, data: Dataset, bandwidth: float) -> float:
    """Return the cost of a fit that has a loss.

    Args:
        loss: Loss (`likelihood_loss`), dimensionless.
        machine: Fitted machine.
        data: Runs that were fitted.
        bandwidth: Bandwidth of the observer, rad/s; 0 for a simulation.

    Returns:
        Cost, dimensionless.
    """
    variance, log_variance = innovation_variance(machine, data, bandwidth)
    return (loss - log_variance) * variance * data.count


def narrower_observer(fitted: Fit, data: Dataset) -> Fit:
    """Fit a machine again with weaker feedback of measurements: an observer of the next smaller bandwidth.

    Args:
        fitted: Fit at one of the bandwidths 60, 30, 15, 7 and 3 rad/s (`BANDWIDTHS`).
        data: Runs that were fitted.

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
        data: Runs that were fitted.

    Returns:
        Reduction of chi-squared per sample, dimensionless; 0 if the fit is at least as likely.
    """
    loss = likelihood_loss(fitted, data) - likelihood_loss(reference, data)
    return max(0.0, loss) * fitted.floor


def fit_with_model_error(fitted: Fit, data: Dataset) -> Fit:
    """Fit again at the observer bandwidth that maximizes the likelihood of the data.

    An observer corrects the prediction by the measurements; the larger the error of the model, the larger the bandwidth
    must be. Starting from the bandwidth of `fitted`, smaller ones and the simulation (no observer) are tried as
    `judge.observer.likeliest` asks for them.

    Args:
        fitted: Fit (machine, parameters, cost) at 60, 30, 15, 7, 3 or 0 rad/s (`BANDWIDTHS`; 0: simulation).
        data: Runs that were fitted.

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
        data: Runs that were fitted.
        goal: Cost, dimensionless, above which the fit is of no use (`fit`).
    """
    model, accurate = (fitted.machine, fitted.free, data, fitted.bandwidth), _CONVERGED_COST / data.count
    return fit(*model, theta=fitted.theta, tolerance=accurate, longest_step=POLISH_STEP, goal=goal)


def refined_in_simulation(fitted: Fit, data: Dataset) -> Fit:
    """Fit the parameters again with weaker feedback of measurements, so that the machine is better in simulation.

    The final machine is used in simulation, whereas an observer (feedback of the measurements) hides slow errors of a
    fit, and with them information about the parameters. Fits at all smaller bandwidths are therefore compared by the
    product of two costs (sums of squared residuals): of the simulation, and of the prediction with the bandwidth of
    `fitted` (`judge.observer.best_in_simulation`).

    Args:
        fitted: Final fit at any observer bandwidth.
        data: Runs that were fitted.

    Returns:
        Fit of the same parameters with the smallest product, polished. `fitted` itself if no fit is better, if it is a
        simulation, if there is only one run, which permits no cross-validation, if the errors of interpolated
        voltages add up in a simulation, or if the time of a stage that must deliver is used up.
    """
    if fitted.bandwidth == SIMULATION or len(data.runs) == 1 or data.has_voltage_errors or not goes_on():
        return fitted

    def cost(machine: Machine, bandwidth: float) -> float:
        return prediction_cost(machine, data, bandwidth, longest_step=POLISH_STEP)

    def product(narrower: Fit) -> float:
        return cost(narrower.machine, SIMULATION) * cost(narrower.machine, fitted.bandwidth)

    def simulated(best: Fit, least: float) -> tuple[Fit, float]:
        # No parameters have a lower cost in prediction than the fit, and none in runs to which they were not fitted
        # than in those to which they were.
        goal = least / fitted.cost
        again = continue_fit(best, data, SIMULATION, goal=goal)
        if not again.cost < goal:
            return again, math.inf
        return again, _cross_validated_cost(again, data) * cost(again.machine, fitted.bandwidth)

    best = best_in_simulation(
        ((narrower, product(narrower)) for narrower in _narrowing(fitted, data)), simulated
    )
    return best if best is fitted else polish(best, data)


def _cross_validated_cost(fitted: Fit, data: Dataset) -> float:
    """Return the cost of all runs, each third with parameters that one step fits to the other two thirds."""
    model = ResidualModel(fitted.machine, fitted.free, data, fitted.bandwidth, fitted.longest_step)
    by_run = model.linearize(fitted.theta).by_run
    names, folds = [run.name for run in data.runs], min(_FOLDS, len(data.runs))
    parts = [NormalEquations.total(by_run[first::folds]) for first in range(folds)]
    if not all(part.finite for part in parts):  # the machine diverges
        return math.inf
    thetas = thetas_left_out(parts, fitted.free, fitted.theta)
    return sum(
        prediction_cost(
            model.machine_at(theta),
            data.with_runs(names[first::folds]),
            fitted.bandwidth,
            longest_step=POLISH_STEP,
        )
        for first, theta in enumerate(thetas)
    )


def leave_one_out_gain(without: Fit, with_effect: Fit, data: Dataset) -> float:
    """Return by how much an effect with values from other runs reduces the error of each run (leave one run out).

    All other parameters are fitted to all runs, without the effect and beside these values of it
    (`cross_validation_of_some`). The runs are divided as in `pieces_left_out`.

    Args:
        without: Fit without the effect.
        with_effect: Fit with the effect, at the same observer bandwidth (of the feedback of measurements).
        data: Runs that were fitted.

    Returns:
        Reduction of the cost, dimensionless, summed over all runs. It is usually smaller than the reduction on the
        fitted runs, and negative if the effect describes single runs rather than the machine.
    """
    tested, pieces = _of_effect(without, with_effect), _pieces_to_confirm(with_effect, data)
    return without.cost - sum(cross_validation_of_some(with_effect, tested, data, pieces))


def refitted_leave_one_out_gain(
    without: Fit, with_effect: Fit, data: Dataset, least: float = -math.inf
) -> float:
    """Return what `leave_one_out_gain` does, with parameters that are fitted again for each piece.

    The step of the linear model is too long where a single run determines a combination of parameters: without this
    run, they leave the range in which the model is linear. All pieces are left out once more, because a choice of those
    that speak against the effect would confirm what chance explains.

    A piece that is left out costs no less than one that is fitted, because the fit to all pieces would otherwise have
    its parameters. The pieces that speak most against the effect by the linear model are therefore left out first, and
    the others not at all once they could not confirm it even at the cost that they have in the fit.

    Args:
        without: Fit without the effect.
        with_effect: Fit with the effect, at the same observer bandwidth (of the feedback of measurements).
        data: Runs that were fitted.
        least: Reduction, dimensionless, that confirms the effect. Default: the reduction is asked for, whatever it is.

    Returns:
        Reduction of the cost, dimensionless, summed over all runs, or an upper limit of it that is less than `least`.
    """
    tested, pieces = _of_effect(without, with_effect), _pieces_to_confirm(with_effect, data)
    equations = equations_of_pieces(with_effect, data, pieces)
    linear = costs_of_some_left_out(equations, tested, with_effect.free, with_effect.theta)
    against = [left_out - piece.cost for left_out, piece in zip(linear, equations, strict=True)]
    parts = [data.leaving_out(piece, pieces) for piece in range(len(equations))]
    fitted = [
        prediction_cost(
            with_effect.machine, alone, with_effect.bandwidth, longest_step=with_effect.longest_step
        )
        for _, alone in parts
    ]
    gain = without.cost - sum(fitted)
    for piece in np.argsort(against)[::-1].tolist():
        if gain < least:
            break
        gain += fitted[piece] - _refitted_cost(with_effect, tested, data, *parts[piece])
    return gain


def _of_effect(without: Fit, with_effect: Fit) -> NDArray[np.bool_]:
    """Return which free parameters belong to an effect, or to the coordinates that it adds."""
    known = {free.name for free in without.free}
    return np.array([free.name not in known for free in with_effect.free])


def _refitted_cost(
    fitted: Fit, tested: NDArray[np.bool_], data: Dataset, others: Dataset, left_out: Dataset
) -> float:
    """Return the cost of a piece with values of the tested parameters that are fitted to all others."""
    step = fitted.longest_step

    def again(free: Sequence[FreeParameter], theta: Array, machine: Machine, runs: Dataset) -> Fit:
        accurate = _CONVERGED_COST / runs.count
        return fit(machine, free, runs, fitted.bandwidth, theta=theta, tolerance=accurate, longest_step=step)

    elsewhere = again(fitted.free, fitted.theta, fitted.machine, others)
    values = {f.name: elsewhere.values[f.name] for f, t in zip(fitted.free, tested, strict=True) if t}
    adapting = tuple(f for f, t in zip(fitted.free, tested, strict=True) if not t)
    beside = again(adapting, fitted.theta[~tested], fitted.machine.replace(values), data)
    return prediction_cost(beside.machine, left_out, fitted.bandwidth, longest_step=step)


def _pieces_to_confirm(with_effect: Fit, data: Dataset) -> int:
    """Return into how many pieces each run is divided to confirm an effect."""
    table = any(e.definition.family == TABLE_FAMILY for e in with_effect.machine.effects)
    return pieces_left_out(len(data.runs), table=table)


def pieces_left_out(runs: int, *, table: bool) -> int:
    """Return into how many pieces each run is divided, of which one is left out in turn to confirm an effect.

    Runs are left out whole. Of fewer than four runs, pieces (at least eight in all) are left out instead: too few other
    runs might not determine the parameters. Of a machine with a table, halves of runs are: some of its values may
    depend on a single run.

    Args:
        runs: Number of runs.
        table: Whether the machine has a table.
    """
    enough = 2 if table else 1
    return enough if runs >= _MIN_RUNS else -(-_PIECES // runs)


def left_out_costs(fitted: Fit, data: Dataset, pieces: int) -> list[float]:
    """Return the cost of each piece of the runs with parameters that are fitted to all others (cross-validation).

    Args:
        fitted: Fit of a machine.
        data: Runs that were fitted.
        pieces: Number of pieces into which each run is divided; 1 for complete runs.

    Returns:
        Costs, dimensionless: sums of squared residuals in units of the noise; infinite if the machine diverges.
    """
    return [cost for cost, _ in cross_validation(fitted, data, pieces)]


def contradicting_run(fitted: Fit, data: Dataset) -> str | None:
    """Find the run that contradicts the other runs: the machine that is fitted to them does not explain this run.

    The cause may be a mistake (a slipped belt, another amplifier setting) or an effect that only this run excites.

    Args:
        fitted: Fitted machine with its observer bandwidth.
        data: Runs that were fitted.

    Returns:
        Name of the run; None if there is none (`judge.run.contradicting_run`).
    """
    if len(data.runs) < MIN_RUNS_COMPARED:
        return None
    ratios = ratios_to_others(cross_validation(fitted, data, 1), [run.count for run in data.runs])
    return judge.contradicting_run(dict(zip((run.name for run in data.runs), ratios, strict=True)))


def ratios_to_others(costs: Sequence[tuple[float, float]], counts: Sequence[float]) -> list[float]:
    """Return the cost per value of each run over that of all others, so that runs may have different lengths.

    Args:
        costs: Cost of each run and of all others, dimensionless, with parameters that are fitted to the others.
        counts: Effective number of measured values of each run.
    """
    total = sum(counts)
    return [
        (cost / count) / (others / (total - count))
        for (cost, others), count in zip(costs, counts, strict=True)
    ]


def continue_fit(fitted: Fit, data: Dataset, bandwidth: float, *, goal: float = math.inf) -> Fit:
    """Fit a machine again from the parameters of an earlier fit, to other data or at another observer bandwidth.

    Args:
        fitted: Earlier fit; its parameters are the starting values.
        bandwidth: Bandwidth of the observer that corrects predictions by the measurements, rad/s; 0 for a simulation.
        goal: Cost, dimensionless, above which the fit is of no use (`fit`).

    Returns:
        Fit with the step of `search_step`.
    """
    start, step = (fitted.machine, fitted.free, data, bandwidth), search_step(bandwidth, data)
    return fit(*start, theta=fitted.theta, longest_step=step, goal=goal)
