"""Standard deviations of quantities that are computed from identified parameters."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..arrays import Array
from .machine import Machine


def standard_deviations(
    machine: Machine, quantity: Callable[[Machine], Array], step: float = 1e-2
) -> Array | None:
    """Compute standard deviations of quantities from the identified parameters' covariance (delta method).

    Args:
        machine: Machine with the covariance.
        quantity: Function from a machine to quantities in any unit, an array of any one shape.
        step: Step of the central differences, in standard deviations of the parameter. Short steps exaggerate
            the change of a quantity that jumps.

    Returns:
        Standard deviations in the units of the quantities, in their shape; None if the machine has no
        covariance.
    """
    if machine.uncertainty is None:
        return None
    values = machine.parameters | machine.device_parameters
    rows, kept = [], []
    for i, name in enumerate(machine.uncertainty.names):
        std = machine.uncertainty.std(name)
        if name not in values or not std:
            continue
        ahead, behind = (
            quantity(machine.replace({name: values[name] + side * step * std})) for side in (1.0, -1.0)
        )
        rows.append((ahead - behind) / (2.0 * step * std))
        kept.append(i)
    if not kept:
        return None
    covariance = machine.uncertainty.covariance[np.ix_(kept, kept)]
    variances = np.einsum("i...,ij,j...->...", np.array(rows), covariance, np.array(rows))
    return np.sqrt(np.maximum(variances, 0.0))
