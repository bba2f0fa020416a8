"""Thin out long curves so that plots still show their peaks."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..arrays import Array


def extreme_rows(curves: Sequence[Array], intervals: int) -> NDArray[np.intp]:
    """Choose rows with which a plot of long curves still shows every peak.

    The rows are divided into equal intervals. Of each interval, the rows with the smallest and the largest
    value of each curve are kept. Where a curve has no finite value in an interval, its first row is kept,
    which shows the gap.

    Args:
        curves: Curves with the same rows, in any units, shape (n,) each; NaN where nothing was measured.
        intervals: Number of intervals, dimensionless.

    Returns:
        Rows, increasing, shape (m,): at most two for each curve and interval.
    """
    parts = [part for part in np.array_split(np.arange(len(curves[0])), intervals) if len(part)]
    kept: list[np.intp] = []
    for values in curves:
        measured = np.isfinite(values)
        low, high = np.where(measured, values, np.inf), np.where(measured, values, -np.inf)
        for part in parts:
            kept += [part[np.argmin(low[part])], part[np.argmax(high[part])]]
    return np.unique(np.array(kept, np.intp))
