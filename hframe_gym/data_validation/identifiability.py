"""Check identifiability: Cramer-Rao bounds of the parameters.

The bounds are evaluated for simulations of the declared machine, with white residuals of the size of the
sensors' noise. A fit of real data has larger errors, because no model is exact.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..arrays import Array
from ..identification import Dataset, FreeParameter, PreparedRecording, default_free_parameters
from ..identification.predict.linearization import ResidualModel
from ..identification.predict.normal_equations import NormalEquations
from ..identification.predict.prediction import SIMULATION, map_runs
from ..machine import Machine
from .findings import Finding, Severity

_MAX_ROWS = 20_000  # rows of a run that are simulated, to limit the time; more would lower the bounds
_LARGE_STD = 0.1  # relative standard deviation above which a parameter is reported as poorly identifiable
# Relative standard deviation above which not even the sign of a parameter follows from the recordings.
_UNDETERMINED_STD = 1.0
_INSEPARABLE = 0.98  # correlation above which two parameters are reported as inseparable
_NO_INFLUENCE = 1e-12  # sensitivity relative to the largest one below which a parameter has no influence
# Eigenvalue of the normalized information matrix below which a combination is not determined.
_SINGULAR = 1e-13
_TINY = 1e-300  # avoids a division by zero, and changes no other value


@dataclass(frozen=True)
class CramerRaoBound:
    """Lower bound on the standard deviation of one parameter that is estimated jointly with others.

    Attributes:
        name: Full name of the parameter, e.g. `x.coulomb`.
        relative_std: Smallest possible standard deviation divided by the absolute value of the parameter;
            infinite if the parameter has no influence on the measurements.
        partner: Name of the parameter with the largest absolute correlation, "" if there is no other.
        correlation: Correlation of both estimates, dimensionless, -1 to 1; 0 without a partner.
    """

    name: str
    relative_std: float
    partner: str
    correlation: float


def cramer_rao_bounds(data: Dataset, machine: Machine, names: Sequence[str] = ()) -> list[CramerRaoBound]:
    """Compute how well recordings determine parameters: Cramer-Rao bounds on their standard deviations.

    The bounds assume that all these parameters are estimated jointly, without priors, from simulations of the
    declared machine (without feedback of measurements) with white sensor noise. The first 20,000 rows of each
    run are used.

    References:
        Ljung, System Identification (1999), section 7.4.

    Args:
        machine: Declared machine, at whose parameter values the simulation is linearized.
        names: Full names of the parameters. Default: the parameters that identification refits.

    Returns:
        One bound per parameter, in the order of `names`; parameters whose value is zero are left out. It
        contains the smallest possible standard deviation divided by |value|, dimensionless (infinite for a
        parameter without influence on the measurements), the parameter with the largest correlation, and this
        correlation, -1 to 1.

    Raises:
        KeyError: If the machine has no parameter of a given name.
    """
    names = names or [f.name for f in default_free_parameters(machine)]
    return _joint_bounds(*_relative_information(data, machine, names))


def _relative_information(data: Dataset, machine: Machine, names: Sequence[str]) -> tuple[list[str], Array]:
    """Return the nonzero parameters, and the information matrix (k, k) of their relative changes."""
    # Derivatives are with respect to relative changes of the parameters, which do not exist for a value of
    # zero.
    names = [name for name in names if machine.parameters[name] != 0.0]
    data = dataclasses.replace(data, runs=tuple(run.first_rows(_MAX_ROWS) for run in data.runs))
    at_declared = np.zeros(len(names))
    forward, backward = (_residual_model(data, machine, names, sign).at(at_declared) for sign in (1.0, -1.0))

    def normal_equations(run: PreparedRecording) -> NormalEquations:
        """Use central differences; rounding in forward ones would seem to separate inseparable parameters."""
        rows = forward.linearize_run(run)
        opposite = backward.linearize_run(run)  # derivatives with respect to decreases
        return NormalEquations.from_rows((rows.jacobian - opposite.jacobian) / 2, rows.residual)

    return names, NormalEquations.total(map_runs(normal_equations, data)).information


def check_parameters(data: Dataset, machine: Machine) -> list[Finding]:
    """Report how precisely the recordings can determine each parameter that identification refits.

    The precision is the Cramer-Rao bound: the smallest standard deviation of any unbiased estimate. Viscous
    friction and back-EMF of a motor brake its motion alike; if the runs cannot separate them, the precision
    of their sum is given.

    Returns:
        One finding (severity, channel, message) per parameter or sum: advice if its relative standard
        deviation exceeds 10 %, otherwise a note; and one of advice each for all parameters without influence
        on the measurements and for all that the recordings do not determine.
    """
    names, information = _relative_information(
        data, machine, [f.name for f in default_free_parameters(machine)]
    )
    bounds = _joint_bounds(names, information)
    sums = _inseparable_damping(bounds, machine)
    rows = [i for i, name in enumerate(names) if name not in sums]
    with_known_ke = _joint_bounds([names[i] for i in rows], information[np.ix_(rows, rows)])
    reported_alone = {bound.name: bound.relative_std for bound in with_known_ke}
    findings = []
    for ke, (viscous, fraction) in sums.items():
        relative_std = reported_alone.pop(viscous) * fraction
        message = (
            "only their sum can be determined, with a standard error of at least "
            f"{100 * relative_std:.2g} %: viscous friction and back-EMF brake the motor alike, "
            "and simulation and control need only the sum"
        )
        severity: Severity = "advice" if relative_std > _LARGE_STD else "note"
        findings.append(Finding(severity, "", f"{viscous} and {ke}", message))
    return findings + findings_of_bounds([bound for bound in bounds if bound.name in reported_alone])


def findings_of_bounds(bounds: Sequence[CramerRaoBound]) -> list[Finding]:
    """Report the bounds of parameters.

    Args:
        bounds: Bounds of parameters that are estimated jointly.

    Returns:
        One finding of severity "advice" for all parameters without influence on the measurements, one for all
        that the runs do not determine, and one for each other parameter: "advice" if its relative standard
        deviation exceeds 10 %, otherwise "note".
    """
    findings = []
    without_influence = [b.name for b in bounds if not np.isfinite(b.relative_std)]
    if without_influence:
        verb = "has" if len(without_influence) == 1 else "have"
        message = f"{verb} no influence on these runs"
        findings.append(Finding("advice", "", ", ".join(without_influence), message))
    undetermined = [b.name for b in bounds if _UNDETERMINED_STD < b.relative_std < np.inf]
    if undetermined:
        message = (
            f"not determined by these runs (standard error above {100 * _UNDETERMINED_STD:.0f} %), "
            "at most the ratios of some: fitted values stay near the machine file; "
            "motion that is faster or reaches limits tells more"
        )
        findings.append(Finding("advice", "", ", ".join(undetermined), message))
    for bound in bounds:
        if bound.relative_std > _UNDETERMINED_STD:
            continue
        severity: Severity = "note"
        message = f"standard error at least {100 * bound.relative_std:.2g} %"
        if bound.relative_std > _LARGE_STD:
            severity = "advice"
            if abs(bound.correlation) > _INSEPARABLE:
                message += (
                    f"; cannot be separated from {bound.partner} (correlation {bound.correlation:+.3f})"
                )
        findings.append(Finding(severity, "", bound.name, message))
    return findings


def _inseparable_damping(bounds: Sequence[CramerRaoBound], machine: Machine) -> dict[str, tuple[str, float]]:
    """Return back-EMF constants that nothing separates from a viscous friction, its name, and its part."""
    correlated = {(b.name, b.partner) for b in bounds if b.correlation < -_INSEPARABLE}
    sums = {}
    sensed = {name for sensor in machine.sensors if sensor.quantity == "current" for name in sensor.row}
    for drive in machine.drives:
        if drive.name in sensed:
            continue  # its current separates the two
        viscous, ke = f"{drive.coordinate}.viscous", f"{drive.name}.Ke"
        if correlated & {(viscous, ke), (ke, viscous)}:
            back_emf = drive.gain * drive.Ke * drive.gear_ratio  # N s/m or Nm s/rad
            friction = machine.parameters[viscous]
            sums[ke] = (viscous, friction / (friction + back_emf))
    return sums


def _residual_model(data: Dataset, machine: Machine, names: Sequence[str], direction: float) -> ResidualModel:
    """Return the residual as a function of relative changes, positive or negative, without priors."""
    free = tuple(
        FreeParameter(name, value, prior=np.inf, scale=direction * abs(value), lower=-np.inf)
        for name, value in ((name, machine.parameters[name]) for name in names)
    )
    return ResidualModel(machine, free, data, SIMULATION)


def _joint_bounds(names: Sequence[str], information: Array) -> list[CramerRaoBound]:
    """Invert an information matrix (k, k) of relative changes, without parameters that have no influence."""
    sensitivity = np.sqrt(np.diag(information))
    influential = sensitivity > _NO_INFLUENCE * max(float(sensitivity.max(initial=0.0)), _TINY)
    kept = [name for name, used in zip(names, influential, strict=True) if used]
    scale = sensitivity[influential]
    normalized = information[np.ix_(influential, influential)] / np.outer(scale, scale)
    # Parameters that cannot be separated make the matrix singular; rounding may even make an eigenvalue
    # negative.
    eigenvalues, eigenvectors = np.linalg.eigh(normalized)
    covariance = (eigenvectors / np.maximum(eigenvalues, _SINGULAR)) @ eigenvectors.T
    std = np.sqrt(np.diag(covariance))
    bounds = {}
    for i, name in enumerate(kept):
        correlations = covariance[i] / np.maximum(std[i] * std, _TINY)
        correlations[i] = 0.0
        closest = int(np.argmax(np.abs(correlations)))
        partner = kept[closest] if len(kept) > 1 else ""
        bounds[name] = CramerRaoBound(name, float(std[i] / scale[i]), partner, float(correlations[closest]))
    return [bounds.get(name, CramerRaoBound(name, float("inf"), "", 0.0)) for name in names]
