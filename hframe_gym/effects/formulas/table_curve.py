"""The curve of a table in a machine, and the terms that a formula for the table may contain."""

from __future__ import annotations

import numpy as np

from ...arrays import Array
from ...machine import AppliedEffect, Machine
from ..smooth_table import KNOTS
from .regression import Curve
from .terms import Term, terms_of


def terms_of_table(table: AppliedEffect) -> tuple[Term, ...]:
    """Return the terms that a formula for a table may contain, see `terms_of`."""
    variable = table.definition.against.partition(" of ")[0]
    return tuple(terms_of(variable, force=table.name.startswith("smooth_force")))


def curve_of_table(table: AppliedEffect, machine: Machine) -> Curve:
    """Return the values of a table with their covariance, which is zero if the machine states none.

    Returns:
        Ordinates at the k knots, N or Nm, shape (k,), and their covariance, shape (k, k).
    """
    knots = np.array([table.parameters[f"k{i:02d}"] for i in range(KNOTS)])
    values = np.array([table.parameters[f"f{i:02d}"] for i in range(KNOTS)])
    covariance = np.zeros((KNOTS, KNOTS))
    uncertainty = machine.uncertainty
    names = [f"{table.label}.f{i:02d}" for i in range(KNOTS)]
    if uncertainty is not None and set(names) <= set(uncertainty.names):
        index = [uncertainty.names.index(name) for name in names]
        covariance = uncertainty.covariance[np.ix_(index, index)]
    return Curve(knots, values, covariance, _friction_basis(table, knots))


def _friction_basis(table: AppliedEffect, knots: Array) -> Array:
    """Return the curves by which the coordinate's Coulomb and viscous friction can change a table's values.

    The recordings determine the sum of friction and table only, so that formulas need not explain these
    curves.
    """
    of_speed = table.definition.against == f"velocity of {table.site}"
    if table.name.startswith("smooth_friction"):
        return np.stack([np.ones_like(knots), *([np.abs(knots)] if of_speed else [])], axis=1)
    return np.stack([knots], axis=1) if of_speed else np.zeros((len(knots), 0))
