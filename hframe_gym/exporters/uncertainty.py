"""Standard deviations of quantities that follow from identified parameters, to first order (delta method)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..arrays import Array
from ..machine import Machine

# Step of the differences, in standard deviations: there a quantity is linear, and rounding is small.
_STEP_IN_STD = 1e-2


def standard_deviations(machine: Machine, quantity: Callable[[Machine], Array]) -> Array | None:
    """Propagate the covariance of the identified parameters to quantities.

    Args:
        quantity: Function from a machine to quantities in any unit, an array of any one shape.

    Returns:
        Standard deviations in the units of the quantities, in their shape; None if the machine has no covariance.
    """
    if machine.uncertainty is None:
        return None
    values = machine.parameters | machine.device_parameters
    rows, kept = [], []
    for i, name in enumerate(machine.uncertainty.names):
        std = machine.uncertainty.std(name)
        if name not in values or not std:
            continue
        step = _STEP_IN_STD * std
        ahead, behind = (
            quantity(machine.replace({name: values[name] + side * step})) for side in (1.0, -1.0)
        )
        rows.append((ahead - behind) / (2.0 * step))
        kept.append(i)
    if not kept:
        return None
    covariance = machine.uncertainty.covariance[np.ix_(kept, kept)]
    variances = np.einsum("i...,ij,j...->...", np.array(rows), covariance, np.array(rows))
    return np.sqrt(np.maximum(variances, 0.0))
