"""Parameters of which the data determine only weighted sums."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components

from ....arrays import Array
from ....machine import Machine
from ...predict.free_parameters import default_free_parameters

# A combination of parameters is not determined if its variance is beyond this fraction of the prior's.
_UNDETERMINED_VARIANCE = 0.25
# Standard deviation, relative to the value, that counts as the prior of an effect's parameter that was not
# declared.
_UNDECLARED_PRIOR = 0.5
# A parameter belongs to a direction that is not determined if two values are at least this large: its
# component (in units of the prior's standard deviation) relative to the largest one, and the fraction of its
# variance that is along the direction.
_MIN_MEMBERSHIP = 0.1


class DeterminedSum(NamedTuple):
    """Weighted sum of parameters that the data determine.

    Attributes:
        weights: Weights by parameter name; that of the first parameter is 1.
        value: Its value, in the unit of the first parameter.
        std: Its standard deviation, in the same unit.
    """

    weights: dict[str, float]
    value: float
    std: float


@dataclass(frozen=True)
class InseparableParameters:
    """Parameters whose single values the data do not determine, but only some weighted sums of them.

    Attributes:
        names: Full names of the parameters.
        combinations: Weights by parameter name of each weighted sum that the data determine.
    """

    names: tuple[str, ...]
    combinations: tuple[dict[str, float], ...]

    def describe(self) -> str:
        """Describe in words which weighted sums of these parameters the data determine.

        Returns:
            Clause, for example "only phi1.viscous + 1.13 motor1.Ke is determined". If the data determine
            none: "no combination of phi1.viscous, motor1.Ke is determined".
        """
        if not self.combinations:
            return f"no combination of {', '.join(self.names)} is determined"
        sums = [sum_text(weights) for weights in self.combinations]
        return f"only {' and '.join(sums)} {'is' if len(sums) == 1 else 'are'} determined"

    def determined(self, machine: Machine) -> tuple[DeterminedSum, ...]:
        """Return the weighted sums that the data determine, with value and standard deviation.

        Both are in the unit of the first parameter of a sum.

        Args:
            machine: Identified machine with its uncertainty.
        """
        return tuple(
            DeterminedSum(weights, *_value_and_std(machine, weights)) for weights in self.combinations
        )


def sum_text(weights: Mapping[str, float]) -> str:
    """Format a weighted sum of parameters, for example "phi1.viscous + 1.13 motor1.Ke".

    Args:
        weights: Weight by full parameter name, in the unit of the first parameter per unit of the weighted
            parameter.

    Returns:
        Text with weights to three digits; weights of 1 are left out.
    """
    text = ""
    for name, weight in weights.items():
        sign = (" + " if weight > 0.0 else " - ") if text else ("" if weight > 0.0 else "-")
        text += sign + (name if abs(weight) == 1.0 else f"{abs(weight):.3g} {name}")
    return text


def _value_and_std(machine: Machine, weights: dict[str, float]) -> tuple[float, float]:
    """Return value and standard deviation of a weighted sum of identified parameters."""
    assert machine.uncertainty is not None
    values = machine.parameters
    row = np.array([weights.get(name, 0.0) for name in machine.uncertainty.names])
    variance = float(row @ machine.uncertainty.covariance @ row)
    return sum(weight * values[name] for name, weight in weights.items()), float(np.sqrt(max(variance, 0.0)))


def inseparable_parameters(machine: Machine, declared: Machine) -> tuple[InseparableParameters, ...]:
    """Find sets of parameters that the data do not separate: only weighted sums influence measurements.

    The covariance is scaled by the standard deviations of the priors. Its eigenvectors with an eigenvalue
    above 0.25 are directions along which the data reduced the variance of the prior by less than a factor of
    four. The data do not separate the parameters that contribute to the same direction.

    Args:
        machine: Identified machine with its uncertainty.
        declared: Machine as it was declared, whose parameters are the centers of the priors.

    Returns:
        Disjoint sets of at least two parameters each, with the weighted sums that the data determine.
        Ordinates of tables (curves) are left out. Empty if all parameters are separable or the machine has no
        uncertainty.
    """
    if machine.uncertainty is None:
        return ()
    std_by_name = _prior_std(machine, declared)  # standard deviation of each parameter's prior, SI, by name
    names = [name for name in machine.uncertainty.names if std_by_name.get(name, 0.0) > 0.0]
    if not names:
        return ()
    indices = [machine.uncertainty.names.index(name) for name in names]
    prior_std = np.array([std_by_name[name] for name in names])
    scaled = machine.uncertainty.covariance[np.ix_(indices, indices)] / np.outer(prior_std, prior_std)
    variances, axes = np.linalg.eigh(scaled)
    undetermined = variances > _UNDETERMINED_VARIANCE
    directions = (axes[:, undetermined] * np.sqrt(variances[undetermined])).T  # (directions, parameters)
    # In row echelon form, each direction is the change of one parameter (pivot) and of those that compensate
    # for it.
    directions, pivots = _row_echelon(directions)
    # A direction's component in a parameter that the data determine otherwise is rounding.
    member = np.abs(directions) > np.maximum(np.sqrt(_MIN_MEMBERSHIP * np.diag(scaled)), _MIN_MEMBERSHIP)
    groups = []
    # Directions that share a parameter belong together.
    sets = connected_components(member.astype(int) @ member.T, directed=False)[1]
    for rows in (np.flatnonzero(sets == k).tolist() for k in np.unique(sets)):
        members = np.flatnonzero(member[rows].any(axis=0))
        # Each parameter of the group that is no pivot gives one sum that the directions leave unchanged.
        if len(members) > 1:
            combinations = tuple(
                _determined_sum(
                    free, members, rows, pivots, np.where(member, directions, 0.0), prior_std, names
                )
                for free in members.tolist()
                if free not in pivots
            )
            groups.append(InseparableParameters(tuple(names[i] for i in members), combinations))
    return tuple(groups)


def _prior_std(machine: Machine, declared: Machine) -> dict[str, float]:
    """Return the prior's standard deviation of identified parameters, in their units; 0 for none."""
    declared_free = {f.name: f for f in default_free_parameters(declared)}
    parameters = {
        f"{e.label}.{p.name}": (p.role, bool(e.definition.against))
        for e in machine.effects
        for p in e.definition.parameters
    }
    stds: dict[str, float] = {}
    for name in machine.uncertainty.names if machine.uncertainty else ():
        value = machine.parameters[name]
        if name in declared_free:
            stds[name] = declared_free[name].prior_std(value)
        else:
            role, ordinate = parameters.get(name, ("shape", False))
            stds[name] = 0.0 if ordinate else 1.0 if role == "phase" else _UNDECLARED_PRIOR * abs(value)
    return stds


def _determined_sum(
    free: int,
    members: NDArray[np.intp],
    rows: list[int],
    pivots: list[int],
    directions: Array,
    unit: Array,
    names: list[str],
) -> dict[str, float]:
    """Return the weights, by name, of the sum of parameters that reduced directions leave; the first is 1.

    The sum has pivots and the one parameter `free` beside them. The directions are in multiples of `unit`.
    """
    weights = {free: 1.0 / unit[free]}
    weights |= {
        pivots[row]: -directions[row, free] / unit[pivots[row]] for row in rows if directions[row, free]
    }
    ordered = {i: weights[i] for i in members.tolist() if i in weights}
    first = next(iter(ordered.values()))
    return {names[i]: float(weight / first) for i, weight in ordered.items()}


def _row_echelon(rows: Array) -> tuple[Array, list[int]]:
    """Reduce independent rows (m, k) so that each has a pivot column with a 1 in which all others are 0.

    The pivot is the largest element of a row, so that rows about different columns do not mix. Return the
    pivots, too.
    """
    reduced, pivots = rows.copy(), []
    for i in range(len(reduced)):
        pivot = int(np.argmax(np.abs(reduced[i])))
        reduced[i] /= reduced[i, pivot]
        others = np.arange(len(reduced)) != i
        reduced[others] -= np.outer(reduced[others, pivot], reduced[i])
        pivots.append(pivot)
    return reduced, pivots
