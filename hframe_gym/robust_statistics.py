"""Standard deviations that single outliers hardly change."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from .arrays import Array

_STD_OF_MEDIAN = 1.4826  # Standard deviation of a normal distribution / median of its absolute values.


def std_by_median(deviations: Array, axis: int | None = None) -> Array:
    """Estimate standard deviations from the median of |deviations|, which outliers hardly change.

    Args:
        deviations: Deviations from the center, in any unit, shape (n,) or (n, channels).
        axis: 0 for the standard deviation of each channel. Default: one of all values.

    Returns:
        Standard deviations, in the deviations' unit, shape () or (channels,).
    """
    return _STD_OF_MEDIAN * np.median(np.abs(deviations), axis=axis)


def white_noise(pieces: Iterable[Array], order: int) -> float:
    """Estimate the standard deviation of white noise from differences, which smooth motion hardly changes.

    Args:
        pieces: Pieces of a signal, in any unit, each of shape (n,).
        order: Order of the differences, dimensionless: 1 for those of neighboring values, 2 for the
            differences of these, and so on.

    Returns:
        Standard deviation, in the unit of the values; 0 if no piece has more values than `order`.
    """
    differences = np.concatenate([np.diff(values, order) for values in pieces])
    if not len(differences):
        return 0.0
    # The coefficients of a difference are binomial, and comb(2 n, n) is the sum of their squares.
    return float(std_by_median(differences)) / math.sqrt(math.comb(2 * order, order))
