"""Choose the observer bandwidth for a machine from the losses and costs of fits at several bandwidths."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TypeVar

import numpy as np

from ...arrays import Array

Fitted = TypeVar("Fitted")


def likeliest(narrowing: Iterable[tuple[Fitted, float]], simulated: tuple[Fitted, float]) -> Fitted:
    """Choose the observer under which the data are most likely: the fit with the smallest loss.

    Fits are compared from the widest observer to narrower ones until one has no smaller loss than the one
    before; later ones are not computed. The simulation is compared in any case, because the likelihood may
    have a second maximum there: an observer disturbs phases in which friction holds the machine at rest.

    Args:
        narrowing: Fits with their losses (-2 log likelihood per value, dimensionless), at least one, by
            decreasing bandwidth.
        simulated: The fit in simulation and its loss, dimensionless.

    Returns:
        The chosen fit; of two with equal loss, the earlier.
    """
    fits = iter(narrowing)
    best, least = next(fits)
    for fitted, loss in fits:
        if not loss < least:
            break
        best, least = fitted, loss
    return simulated[0] if simulated[1] < least else best


def best_in_simulation(
    narrowing: Iterable[tuple[Fitted, float]], simulated: Callable[[Fitted, float], tuple[Fitted, float]]
) -> Fitted:
    """Choose the fit with the smallest product of two costs: in simulation and in prediction.

    Simulation alone may choose wrong parameters where its errors grow without limit.

    Args:
        narrowing: Fits, at least one, with their products, dimensionless, from the present observer to
            narrower ones; all are computed.
        simulated: Function of the best of these fits and its product. It continues this fit in simulation,
            without an observer, and returns the result with its product. There the cost in simulation is
            cross-validated, because such a fit adapts to errors of the model.

    Returns:
        The fit with the smallest product; of equal ones, the earlier.
    """
    best, least = min(narrowing, key=lambda fit_and_product: fit_and_product[1])
    alternative, product = simulated(best, least)
    return alternative if product < least else best


def index_of_best_simulation(costs: Array) -> int:
    """Return the index of the machine that simulates the runs best: the smallest geometric mean of costs.

    All runs have equal weight in this mean. A machine that diverges in a run is never chosen before one that
    does not.

    Args:
        costs: Cost of each run in simulation with each of the machines, dimensionless, shape (machines,
            runs); not finite where a simulation diverges.

    Returns:
        Index; of equal machines, the first; 0 if all machines diverge in some run.
    """
    means = np.where(np.isfinite(costs).all(axis=1), np.mean(np.log(costs), axis=1), np.inf)
    return int(np.argmin(means))
