"""Identifiability: the smallest standard deviations that recordings allow for the parameters of a machine.

The Cramer-Rao bound is evaluated for the declared machine in simulation mode, with white residuals of the size of the
sensors' noise. A fit of real data has larger errors, because no model is exact.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..identification import Dataset, FreeParameter, PreparedRecording, default_free_parameters
from ..identification.linearization import NormalEquations, ResidualModel
from ..identification.prediction import map_runs
from ..machine import Machine
from .findings import Finding, Severity

Array = NDArray[np.float64]

_MAX_ROWS = 20_000  # rows of a run that are simulated
_LARGE_STD = 0.1  # relative standard deviation above which a parameter is reported as poorly identifiable
_INSEPARABLE = 0.98  # correlation above which two parameters are reported as inseparable
_NO_INFLUENCE = 1e-12  # sensitivity relative to the largest one below which a parameter has no influence
_SINGULAR = 1e-13  # eigenvalue of the normalized information matrix below which a combination is not determined


@dataclass(frozen=True)
class CramerRaoBound:
    """Bound on the standard deviation of one parameter in a joint fit.

    Attributes:
        name: Full name of the parameter.
        relative_std: Smallest standard deviation relative to the parameter's value; infinite without influence.
        partner: The parameter with the largest correlation, or "".
        correlation: Correlation with the partner.
    """

    name: str
    relative_std: float
    partner: str
    correlation: float


def cramer_rao_bounds(data: Dataset, machine: Machine, names: Sequence[str] = ()) -> list[CramerRaoBound]:
    """Return the Cramer-Rao bounds of parameters that are estimated jointly.

    Args:
        data: Prepared runs.
        machine: Declared machine.
        names: Full names of the parameters. Default: those that identification refits. Parameters that are zero are
            left out.

    Returns:
        One bound per parameter.

    References:
        Ljung, System Identification (1999), section 7.4.
    """
    names = [n for n in (names or [f.name for f in default_free_parameters(machine)]) if machine.parameters[n] != 0.0]
    runs = tuple(
        dataclasses.replace(
            run, time_s=run.time_s[:_MAX_ROWS], inputs=run.inputs[:_MAX_ROWS], outputs=run.outputs[:_MAX_ROWS]
        )
        for run in data.runs
    )
    data = dataclasses.replace(data, runs=runs)
    forward, backward = (_residual_model(data, machine, names, direction) for direction in (1.0, -1.0))
    at_declared = np.zeros(len(names))

    def normal_equations(run: PreparedRecording) -> NormalEquations:
        """Combine forward and backward differences to central ones: a forward difference separates what is not."""
        rows = forward.linearize_run(run, at_declared)
        opposite = backward.linearize_run(run, at_declared)
        return NormalEquations.from_rows((rows.jacobian - opposite.jacobian) / 2, rows.residual)

    return _joint_bounds(names, NormalEquations.total(map_runs(normal_equations, data)).information)


def check_parameters(data: Dataset, machine: Machine) -> list[Finding]:
    """Report the identifiability of each parameter that identification refits.

    Args:
        data: Prepared runs that move.
        machine: Declared machine.

    Returns:
        Advice for parameters that these runs do not determine, notes for the others.
    """
    findings = []
    for bound in cramer_rao_bounds(data, machine):
        if not np.isfinite(bound.relative_std):
            findings.append(Finding("advice", "", bound.name, "has no influence on these runs"))
            continue
        message = f"standard error at least {100 * bound.relative_std:.2g} %"
        if abs(bound.correlation) > _INSEPARABLE:
            message += f"; cannot be separated from {bound.partner} (correlation {bound.correlation:+.3f})"
        severity: Severity = "advice" if bound.relative_std > _LARGE_STD else "note"
        findings.append(Finding(severity, "", bound.name, message))
    return findings


def _residual_model(data: Dataset, machine: Machine, names: Sequence[str], direction: float) -> ResidualModel:
    """Return the residual as a function of relative changes, positive or negative, without priors."""
    free = tuple(
        FreeParameter(name, value, prior=np.inf, scale=direction * abs(value), lower=-np.inf)
        for name, value in ((name, machine.parameters[name]) for name in names)
    )
    return ResidualModel(machine, free, data, "simulation")


def _joint_bounds(names: Sequence[str], information: Array) -> list[CramerRaoBound]:
    """Invert an information matrix (k, k) of relative changes, without the parameters that have no influence."""
    sensitivity = np.sqrt(np.diag(information))
    influential = sensitivity > _NO_INFLUENCE * max(float(sensitivity.max(initial=0.0)), 1e-300)
    kept = [name for name, used in zip(names, influential, strict=True) if used]
    scale = sensitivity[influential]
    normalized = information[np.ix_(influential, influential)] / np.outer(scale, scale)
    # Parameters that cannot be separated make the matrix singular; rounding may even make an eigenvalue negative.
    eigenvalues, eigenvectors = np.linalg.eigh(normalized)
    covariance = (eigenvectors / np.maximum(eigenvalues, _SINGULAR)) @ eigenvectors.T
    std = np.sqrt(np.diag(covariance))
    bounds = {}
    for i, name in enumerate(kept):
        correlations = covariance[i] / np.maximum(std[i] * std, 1e-300)
        correlations[i] = 0.0
        closest = int(np.argmax(np.abs(correlations)))
        partner = kept[closest] if len(kept) > 1 else ""
        bounds[name] = CramerRaoBound(name, float(std[i] / scale[i]), partner, float(correlations[closest]))
    return [bounds.get(name, CramerRaoBound(name, float("inf"), "", 0.0)) for name in names]
