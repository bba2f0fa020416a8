"""Variance of a residual correlated in time, in the direction in which an effect changes predictions."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ...arrays import Array
from ...machine import Machine
from ...preparation.dataset import Dataset
from ..judge.chance import LongRunVariance
from ..predict.free_parameters import prior_precision
from ..predict.linearization import ResidualModel, RunLinearization
from ..predict.prediction import block_size, map_runs
from .covariance import BLOCK_S
from .estimation import Fit

_NOISE_S = 0.05  # s; longer than the correlation of a sensor's noise


def long_run_variance(fitted: Fit, label: str, data: Dataset) -> LongRunVariance:
    """Return by which factor chance gains more than with white noise, because the residual is correlated.

    The gain is the reduction of the cost (sum of squared residuals in units of the noise). The factor is the
    ratio of the residual's long-run variance to the variance of white noise, in the direction in which the
    effect changes the predictions. The long-run variance follows from sums of the residual over blocks that
    count as independent. Blocks of 50 ms, of 0.5 s and complete runs are tried.

    Args:
        fitted: Fit with the effect, at any observer bandwidth.
        label: Label (name@site) of the effect, of which at least one parameter is free.

    Returns:
        The largest factor for the three kinds of blocks and all combinations of the effect's parameters, with
        the number of blocks of 0.5 s. It is infinite if the machine diverges at the fitted or slightly
        different parameters.

    References:
        Liang and Zeger (1986), "Longitudinal data analysis using generalized linear models".
    """
    model = ResidualModel(fitted.machine, fitted.free, data, fitted.bandwidth, fitted.longest_step)
    runs = list(map_runs(model.at(fitted.theta).linearize_run, data))
    of_effect = np.array([parameter.name.startswith(f"{label}.") for parameter in fitted.free])
    return variance_along(runs, of_effect, prior_precision(fitted.free), *_blocks(fitted.machine, data))


def variance_of_change(
    runs: Sequence[tuple[Array, Array]], machine: Machine, data: Dataset
) -> LongRunVariance:
    """Return the factor of `long_run_variance` in the direction of a given change of the predictions.

    No parameter is fitted beside the change.

    Args:
        runs: Of each run, the change and the residual with it, in units of the noise, shape (values,) each.
        machine: Machine with the sensors of these values.
        data: Data set of the runs, for the sampling period.

    Returns:
        Factor, dimensionless, for one parameter, with the number of blocks of 0.5 s.
    """
    rows = [RunLinearization(change[None], None, residual, None) for change, residual in runs]
    return variance_along(rows, np.array([True]), np.zeros((1, 1)), *_blocks(machine, data))


def _blocks(machine: Machine, data: Dataset) -> tuple[int, int]:
    """Return the numbers of values in a block of 50 ms and in one of 0.5 s."""
    return block_size(_NOISE_S, machine, data), block_size(BLOCK_S, machine, data)


def variance_along(
    runs: Sequence[RunLinearization], of_effect: NDArray[np.bool_], precision: Array, short: int, long: int
) -> LongRunVariance:
    """Return a residual's long-run variance in the direction of an effect's change / that of white noise.

    Args:
        runs: Linearized residual of each run, with respect to k parameters.
        of_effect: True for the parameters of the effect, shape (k,).
        precision: Precision of the prior of the parameters, dimensionless, shape (k, k).
        short: Number of values in a block that is longer than the correlation of a sensor's noise.
        long: Number of values in a block that counts as independent.

    Returns:
        Factor, dimensionless, with the numbers of parameters and of long blocks, as `long_run_variance`
        describes.
    """
    if not all(np.isfinite(run.jacobian).all() and np.isfinite(run.residual).all() for run in runs):
        return LongRunVariance(math.inf)
    others = ~of_effect
    hessian = sum((run.jacobian @ run.jacobian.T for run in runs), precision)
    # Change of the effect's parameters with adapted other parameters: one row per parameter of the effect.
    directions = np.eye(len(of_effect))[of_effect]
    directions[:, others] = -np.linalg.solve(
        hessian[np.ix_(others, others)], hessian[np.ix_(others, of_effect)]
    ).T
    responses = [directions @ run.jacobian for run in runs]
    inverse = np.linalg.pinv(sum(response @ response.T for response in responses), hermitian=True)
    largest = 1.0
    for size in (short, long, max(run.residual.size for run in runs)):
        sums = [_block_sums(j * run.residual, size) for j, run in zip(responses, runs, strict=True)]
        scores = np.concatenate(sums, axis=1)  # (parameters of the effect, blocks)
        largest = max(largest, float(np.linalg.eigvals(inverse @ scores @ scores.T).real.max()))
    blocks = sum(-(-run.residual.size // long) for run in runs)
    return LongRunVariance(largest, len(directions), blocks)


def _block_sums(rows: Array, size: int) -> Array:
    """Return sums over blocks of given length, shape (k, blocks), of k rows; the last may be shorter."""
    return np.asarray(np.add.reduceat(rows, np.arange(0, rows.shape[1], size), axis=1))
