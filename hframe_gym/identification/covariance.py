"""Uncertainty of fitted parameters, and the reasons to doubt them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..machine import Machine, Uncertainty
from .dataset import Dataset, PreparedRecording
from .estimation import Fit
from .free_parameters import default_free_parameters, prior_precision
from .linearization import NormalEquations, ResidualModel
from .prediction import map_runs

Array = NDArray[np.float64]

_BLOCK_S = 0.2  # s; longer than the correlation of the residual
# Thresholds beyond which a parameter is reported as doubtful.
_POOR_RELATIVE_STD = 0.2
_POOR_PHASE_STD = 0.3  # rad
_HIGH_CORRELATION = 0.95
# A standard deviation beyond this fraction of the prior's: the data hardly added to the declared value.
_PRIOR_DOMINATES = 0.6
_BOUND_TOLERANCE = 1e-6  # relative


def with_uncertainty(fitted: Fit, data: Dataset) -> Machine:
    """Attach the covariance of the free parameters to a fitted machine.

    The sandwich covariance H^-1 M H^-1 holds for residuals that are not white: H is the information with the prior, M
    the covariance of the gradient, estimated from sums over blocks of 0.2 s, which preserve the correlation inside
    each block.  White residuals of the assumed size give M = H and so H^-1, which is also the reported minimum.

    Args:
        fitted: Fit whose parameters are uncertain.
        data: Runs that were fitted.

    Returns:
        The fitted machine with the covariance of the parameters' values, SI.

    References:
        White (1982), "Maximum likelihood estimation of misspecified models".
    """
    model = ResidualModel(fitted.machine, fitted.free, data, fitted.mode)
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
    """Return the reasons to doubt each identified parameter.

    Args:
        machine: Identified machine with its uncertainty.
        declared: Machine as it was declared, for the priors.

    Returns:
        By full parameter name, a list of phrases for the report, often empty.  No entries without uncertainty.
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
