"""Reasons to doubt identified parameters, and friction that the machine file lacks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ....machine import Machine, Uncertainty
from ...predict.free_parameters import FreeParameter, default_free_parameters, rated_force
from .inseparable_parameters import inseparable_parameters

# A standard deviation beyond this fraction of the prior's: the data hardly added to the declared value.
PRIOR_DOMINATES = 0.6
# Thresholds beyond which a parameter is reported as doubtful.
POOR_RELATIVE_STD = 0.2
_POOR_PHASE_STD = 0.3  # rad
_HIGH_CORRELATION = 0.95
_BOUND_TOLERANCE = 1e-6  # relative
# Friction that is declared as zero is reported beyond this many standard deviations of its prior, and of its
# estimate.
_UNDECLARED_STDS = 4.0
_CLEAR_DAMPING = 2.0  # factor between fitted and declared damping, from which on the file is called wrong
_COMPATIBLE_STDS = 2.0  # standard deviations within which a value may equal the declared one
# Parameters that users know to within a factor of two; friction and back-EMF may be a fraction of the
# declared value.
_KNOWN_PARAMETERS = ("mass", "EA", "Kt")


@dataclass(frozen=True)
class UndeclaredFriction:
    """Friction that the motion shows and the machine file does not declare.

    Attributes:
        name: Full name of the parameter, such as "x.coulomb".
        value: Its value, in `unit`.
        std: Its standard deviation; None if it is not known.
        unit: Unit of the value.
        share: Dry friction / force of all drives at standstill and rated voltage; None for viscous friction.
    """

    name: str
    value: float
    std: float | None
    unit: str
    share: float | None


def with_structure_of(machine: Machine, declared: Machine) -> Machine:
    """Return a declared machine with the effects of an identified one that change its components.

    Such an effect may divide a belt at its idlers, or take from a motor the inertia of what it adds. Values
    of an identified machine can be compared with those of a machine with the same components only.

    Args:
        machine: Identified machine.
        declared: Machine as it was declared.
    """
    known = {effect.label for effect in declared.effects}
    structural = (e for e in machine.effects if e.definition.structure and e.label not in known)
    return declared.with_effects(*structural)


def undeclared_friction(machine: Machine, declared: Machine) -> tuple[UndeclaredFriction, ...]:
    """Find friction that is declared as zero and clearly is not.

    It must exceed four standard deviations of its prior, which is centered on zero, and four of its fitted
    value.

    Args:
        machine: Fitted machine, with its uncertainty if that is known.
        declared: Machine as it was declared.

    Returns:
        One entry for each such viscous or dry friction of a coordinate.
    """
    found = []
    for parameter in default_free_parameters(declared):
        name, value = parameter.name, machine.parameters.get(parameter.name, 0.0)
        owner, _, key = name.rpartition(".")
        if parameter.of_effect or key not in ("viscous", "coulomb") or parameter.center != 0.0:
            continue
        std = machine.uncertainty.std(name) if machine.uncertainty else None
        if parameter.theta(value) <= _UNDECLARED_STDS * parameter.prior or value <= _UNDECLARED_STDS * (
            std or 0.0
        ):
            continue
        of_drives = rated_force(declared) * declared.coordinate(owner).travel_per_unit
        share = value / of_drives if key == "coulomb" and of_drives else None
        found.append(UndeclaredFriction(name, value, std, declared.unit(name), share))
    return tuple(found)


def parameters_at_limit(machine: Machine, declared: Machine) -> dict[str, str]:
    """Describe the parameters of the machine that the fit moved to the limit of their range.

    The limit is 4 prior standard deviations of the value's logarithm from the declared value. A value so far
    away means that the machine file, or a unit or gear ratio of the recordings, is wrong by a factor, or that
    the machine lacks an effect. The other parameters are then unreliable as well. If the declared value is
    within two standard deviations of the fitted one, the recordings do not determine the parameter, and its
    fitted value means nothing.

    Args:
        machine: Refitted machine, with its uncertainty if that is known.
        declared: Machine as it was declared, whose parameters are the centers of the priors.

    Returns:
        By full parameter name, one sentence; empty if no parameter is at its limit. Masses, belt stiffnesses
        and torque constants come first: users know them better than friction and back-EMF.
    """
    described = {}
    declared = with_structure_of(machine, declared)
    for parameter in default_free_parameters(declared):
        value = machine.parameters.get(parameter.name)
        if value is None:
            continue
        if not parameter.at_limit(parameter.theta(value)):
            continue
        std = (machine.uncertainty.std(parameter.name) if machine.uncertainty else None) or 0.0
        ratio = f"{value / parameter.center:.2g}"
        if abs(value - parameter.center) < _COMPATIBLE_STDS * std:
            described[parameter.name] = (
                f"the recordings do not determine {parameter.name}: the fit ends at {ratio} +- "
                f"{std / abs(parameter.center):.2g} times its declared value, which may be the better one"
            )
        elif parameter.beyond_limit(parameter.theta(value)):
            what = parameter.name
            if damping := _damping_ratio(parameter, machine, declared):
                what, ratio = damping[0], f"{damping[1]:.2g}"
                named = any(text.startswith(what) for text in described.values())
                if named or 1.0 / _CLEAR_DAMPING < damping[1] < _CLEAR_DAMPING:
                    continue
            described[parameter.name] = (
                f"{what} is {ratio} times its declared value, as the motion determines it: correct the "
                "machine file (mass, Kt, resistance, gear ratio) or the units of the recordings"
            )
        elif _is_known(parameter.name):
            described[parameter.name] = (
                f"{parameter.name} ends at the limit of the fit, {ratio} times its declared value: check the "
                "machine file (mass, Kt, resistance, gear ratio) and the units of the recordings"
            )
        else:
            described[parameter.name] = (
                f"{parameter.name} ends at the limit of the fit, {ratio} times its declared value: "
                "correct the machine file if that is possible, "
                "because the other parameters compensate for what is beyond the limit"
            )
    return dict(sorted(described.items(), key=lambda item: not _is_known(item[0])))


def is_limited(parameter: FreeParameter, value: float) -> bool:
    """Return whether a limit of the fit determines a value: it is at the limit, not beyond it.

    A value beyond the limit comes from a plain fit, which has none.

    Args:
        parameter: Parameter whose limits count.
        value: Its fitted value, SI.
    """
    theta = parameter.theta(value)
    return parameter.at_limit(theta) and not parameter.beyond_limit(theta)


def _damping_ratio(parameter: FreeParameter, machine: Machine, declared: Machine) -> tuple[str, float] | None:
    """Return the words for the damping to which a parameter belongs, and its ratio to the declared one.

    Viscous friction and back-EMF act alike, so that only their sum can contradict the machine file.
    """
    owner, _, key = parameter.name.rpartition(".")
    if parameter.of_effect or key not in ("viscous", "Ke"):
        return None
    coordinate = next((d.coordinate for d in declared.drives if d.name == owner and key == "Ke"), owner)

    def damping(m: Machine) -> float:
        back_emf = sum(d.back_emf for d in m.drives if d.coordinate == coordinate)
        return m.coordinate(coordinate).viscous + back_emf

    words = f"the damping of {coordinate} (viscous friction and back-EMF together)"
    return (words, damping(machine) / damping(declared)) if damping(declared) else None


def _is_known(name: str) -> bool:
    """Return whether users know a parameter to within a factor of two."""
    return name.rpartition(".")[2] in _KNOWN_PARAMETERS


def parameter_doubts(machine: Machine, declared: Machine) -> dict[str, list[str]]:
    """List, for each identified parameter, the reasons why its value may be unreliable.

    The reasons are:

    - The value is at a bound or at the limit of the fit. (A value beyond the limit comes from a fit without
      limits and is not doubted.)
    - The data determine only weighted sums with other parameters. The following reasons are then not given.
    - The standard deviation is above 20 % of the value (of a phase: 0.3 rad), or above 60 % of that of the
      prior, so that the declared value determines the parameter more than the data do.
    - The magnitude of the correlation with another parameter is above 0.95.

    Args:
        machine: Identified machine with its uncertainty.
        declared: Machine as it was declared, whose parameters are the centers of the priors.

    Returns:
        Phrases for the report by full parameter name; an empty list for a reliable parameter. An empty
        dictionary if the machine has no uncertainty.
    """
    if machine.uncertainty is None:
        return {}
    doubts: dict[str, list[str]] = {name: [] for name in machine.uncertainty.names}
    _add_bound_doubts(machine, doubts)
    for parameter in default_free_parameters(with_structure_of(machine, declared)):
        if parameter.name in doubts and is_limited(parameter, machine.parameters[parameter.name]):
            doubts[parameter.name].append("at the limit of the fit")
    separable = dict(doubts)
    for group in inseparable_parameters(machine, declared):
        for name in group.names:
            doubts[name].append(group.describe())
            separable.pop(name)
    _add_precision_doubts(machine, machine.uncertainty, declared, separable)
    _add_correlation_doubts(machine.uncertainty, separable)
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
    """Add parameters of large standard deviation, and those that the prior determines not the data."""
    priors = {f.name: f for f in default_free_parameters(declared)}
    roles = {f"{e.label}.{p.name}": p.role for e in machine.effects for p in e.definition.parameters}
    for name, reasons in doubts.items():
        value, std = machine.parameters[name], uncertainty.std(name) or 0.0
        prior = priors.get(name)
        limit = _POOR_PHASE_STD if roles.get(name) == "phase" else POOR_RELATIVE_STD * abs(value)
        if prior is not None and std > PRIOR_DOMINATES * prior.prior_std(value):
            reasons.append("determined by the declared value more than by the data")
        elif std > limit:
            reasons.append("poorly determined")


def _add_correlation_doubts(uncertainty: Uncertainty, doubts: dict[str, list[str]]) -> None:
    """Add the number of parameters with which a parameter is almost perfectly correlated."""
    partners = (np.abs(uncertainty.correlation) > _HIGH_CORRELATION).sum(axis=1) - 1
    for name, count in zip(uncertainty.names, partners, strict=True):
        if count > 0 and name in doubts:
            others = "another parameter" if count == 1 else f"{count} others"
            doubts[name].append(f"correlation beyond {_HIGH_CORRELATION:g} with {others}")
