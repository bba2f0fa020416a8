"""Cross-validation: the cost of each run with parameters that were fitted to the other runs.

The runs, or pieces of them, are left out in turn. One step of the linear model around the fit to all runs
gives the parameters without a piece. The cost is the sum of squared residuals in units of the sensors' noise.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ...arrays import Array
from ...effects.smooth_table import TABLE_FAMILY
from ...machine import Machine
from ...preparation.dataset import Dataset, PreparedRecording
from ..judge import run as judge
from ..judge.run import MIN_RUNS_COMPARED
from ..predict.free_parameters import FreeParameter, bounded_step, prior_precision
from ..predict.linearization import ResidualModel
from ..predict.normal_equations import NormalEquations
from ..predict.prediction import POLISH_STEP, map_runs
from .estimation import CONVERGED_COST, Fit, fit, prediction_cost

_FOLDS = 3  # parts of the runs that are left out in turn where the error of a simulation is cross-validated
_MIN_RUNS, _PIECES = 4, 8  # fewer runs are divided into that many pieces to confirm an effect


def equations_of_pieces(fitted: Fit, data: Dataset, pieces: int) -> list[NormalEquations]:
    """Return the normal equations of each piece of the runs around a fit.

    The pieces of the first run come first, in the order of time.

    Args:
        fitted: Fit at whose parameters the residual is linearized.
        data: Runs to divide.
        pieces: Number of pieces into which each run is divided; 1 for complete runs.
    """
    model = ResidualModel(fitted.machine, fitted.free, data, fitted.bandwidth, fitted.longest_step)
    point = model.at(fitted.theta)

    def of_run(run: PreparedRecording) -> list[NormalEquations]:
        rows = point.linearize_run(run)
        return NormalEquations.of_pieces(rows.jacobian, rows.residual, run.count, pieces)

    return [piece for of_pieces in map_runs(of_run, data) for piece in of_pieces]


def thetas_left_out(
    equations: Sequence[NormalEquations], free: Sequence[FreeParameter], theta: Array
) -> list[Array]:
    """Return, for each piece, the parameters of a linear model fitted to all other pieces.

    Args:
        equations: Normal equations of each piece, of k parameters; they are finite.
        free: The parameters, with their limits and priors.
        theta: Parameters at which the model is linearized, dimensionless, shape (k,).

    Returns:
        Parameters theta, dimensionless, shape (k,) each.
    """
    total = NormalEquations.total(equations)
    precision = prior_precision(free) * max(1.0, total.chi2)
    thetas = []
    for left_out in equations:
        hessian = total.information - left_out.information + precision
        slope = total.gradient - left_out.gradient + precision @ theta
        thetas.append(theta + bounded_step(free, theta, hessian, slope))
    return thetas


def costs_left_out(
    equations: Sequence[NormalEquations], free: Sequence[FreeParameter], theta: Array
) -> list[tuple[float, float]]:
    """Compute, for each piece, the cost of a linear model whose parameters were fitted to all other pieces.

    Args:
        equations: Normal equations of each piece, of k parameters.
        free: The parameters, with their limits and priors.
        theta: Parameters at which the model is linearized, dimensionless, shape (k,).

    Returns:
        For each piece, the cost of the piece and that of all other pieces, dimensionless; all of them are
        infinite if the equations of a piece are not finite.
    """
    total = NormalEquations.total(equations)
    if not total.finite:  # the machine diverges
        return [(math.inf, math.inf)] * len(equations)
    costs = []
    for piece, fitted in zip(equations, thetas_left_out(equations, free, theta), strict=True):
        cost = piece.cost_after(fitted - theta)
        costs.append((cost, total.cost_after(fitted - theta) - cost))
    return costs


def costs_of_some_left_out(
    equations: Sequence[NormalEquations],
    tested: NDArray[np.bool_],
    free: Sequence[FreeParameter],
    theta: Array,
) -> list[float]:
    """Compute, for each piece, the cost with the tested parameters fitted to all other pieces.

    The other parameters are then fitted to all pieces. Otherwise a parameter that a single piece determines,
    such as a current that no other piece reaches, could cause any error.

    Args:
        equations: Normal equations of each piece, of k parameters.
        tested: True for the tested parameters, shape (k,).
        free: The parameters, with their limits and priors.
        theta: Fitted parameters, at which the model is linearized, dimensionless, shape (k,).

    Returns:
        Cost of each piece, dimensionless; all are infinite if the equations of a piece are not finite.
    """
    total = NormalEquations.total(equations)
    if not total.finite:  # the machine diverges
        return [math.inf] * len(equations)
    others, others_free = ~tested, [f for f, is_tested in zip(free, tested, strict=True) if not is_tested]
    hessian = total.information + prior_precision(free) * max(1.0, total.chi2)
    costs = []
    for left_out, fitted in zip(equations, thetas_left_out(equations, free, theta), strict=True):
        step = np.where(tested, fitted - theta, 0.0)
        slope = (hessian @ step)[others]  # theta is the best fit: only the tested parameters move the others
        step[others] = bounded_step(others_free, theta[others], hessian[np.ix_(others, others)], slope)
        costs.append(left_out.cost_after(step))
    return costs


def cross_validated_cost(fitted: Fit, data: Dataset) -> float:
    """Return the cost of all runs with parameters that were fitted to other runs.

    The runs are divided into three parts, each with every third run (of two runs, one each). Each part is
    predicted with parameters that a linear model fits to the other parts.

    Args:
        fitted: Fit at which the model is linearized, at any observer bandwidth.
        data: Runs to which it was fitted, at least two.

    Returns:
        Cost, dimensionless; infinite if the machine diverges.
    """
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
    """Return by how much an effect, fitted to all other runs, reduces the error of each run (leave one out).

    Only the effect's parameters are fitted without the run; all other parameters are fitted to all runs
    (`costs_of_some_left_out`). The runs are divided as in `pieces_left_out`.

    Args:
        without: Fit without the effect.
        with_effect: Fit with the effect, at the same observer bandwidth (of the feedback of measurements).

    Returns:
        Reduction of the cost, dimensionless, summed over all runs. It is usually smaller than the reduction
        on the fitted runs, and negative if the effect describes single runs rather than the machine.
    """
    tested, pieces = _of_effect(without, with_effect), _pieces_to_confirm(with_effect, data)
    equations = equations_of_pieces(with_effect, data, pieces)
    return without.cost - sum(costs_of_some_left_out(equations, tested, with_effect.free, with_effect.theta))


def refitted_leave_one_out_gain(
    without: Fit, with_effect: Fit, data: Dataset, least: float = -math.inf
) -> float:
    """Return the gain of `leave_one_out_gain` with a complete fit for each piece instead of a linear step.

    The linear step is too long where a single run determines a combination of parameters: without this run,
    they leave the range in which the model is linear. All pieces are left out, not only those that speak
    against the effect, because such a choice would favor it by chance.

    The cost of a piece that is left out is at least its cost in the fit to all pieces. To save time, the
    pieces that speak most against the effect by the linear model are therefore left out first, and the
    computation ends as soon as the others could not confirm the effect even at that cost.

    Args:
        without: Fit without the effect.
        with_effect: Fit with the effect, at the same observer bandwidth (of the feedback of measurements).
        least: Reduction, dimensionless, that confirms the effect. Default: the exact reduction is computed in
            any case.

    Returns:
        Reduction of the cost, dimensionless, summed over all runs. If it is less than `least`, only an upper
        limit that is less than `least`.
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
        accurate = CONVERGED_COST / runs.count
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
    """Return the number of pieces into which each run is divided to leave one piece out at a time.

    It is usually 1: complete runs are left out. With fewer than four runs, it gives at least eight pieces in
    all, since too few other runs might not determine the parameters. For a machine with a table it is at
    least 2, because some of the table's values may depend on a single run.

    Args:
        runs: Number of runs.
        table: Whether the machine has a table.
    """
    enough = 2 if table else 1
    return enough if runs >= _MIN_RUNS else -(-_PIECES // runs)


def contradicting_run(fitted: Fit, data: Dataset) -> str | None:
    """Find the run that contradicts the other runs: a machine fitted to them does not explain it.

    Each run in turn is left out of the fit, by a linear model. One contradicts if its chi-squared per sample
    is then more than 10 times that of the others. The cause may be a mistake (a slipped belt, another
    amplifier setting) or an effect that only this run excites.

    Args:
        fitted: Fitted machine with its observer bandwidth.
        data: Runs to which it was fitted.

    Returns:
        Name of the run with the largest ratio (`judge.run.contradicting_run`); None if none contradicts or
        there are fewer than three runs.
    """
    if len(data.runs) < MIN_RUNS_COMPARED:
        return None
    costs = costs_left_out(equations_of_pieces(fitted, data, 1), fitted.free, fitted.theta)
    ratios = ratios_to_others(costs, [run.count for run in data.runs])
    return judge.contradicting_run(dict(zip((run.name for run in data.runs), ratios, strict=True)))


def ratios_to_others(costs: Sequence[tuple[float, float]], counts: Sequence[float]) -> list[float]:
    """Return the cost per measured value of each run, divided by that of all other runs.

    Args:
        costs: For each run, its cost and that of all other runs, dimensionless, with parameters fitted to the
            others.
        counts: Effective number of measured values of each run.

    Returns:
        Ratio of each run, dimensionless.
    """
    total = sum(counts)
    return [
        (cost / count) / (others / (total - count))
        for (cost, others), count in zip(costs, counts, strict=True)
    ]
