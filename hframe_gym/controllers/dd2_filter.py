"""How a normal distribution goes through a map that has kinks: second-order divided differences.

Norgaard, Poulsen and Ravn (2000), Automatica 36(11), DD2: in place of derivatives, which friction does not have, the
map is asked at points as far apart as the distribution is wide.  The covariance is a sum of squares: never indefinite.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
SPREAD2 = 3.0  # squared distance of the points, in standard deviations: the kurtosis of a normal distribution
ROUNDING = 1e-9  # share by which variances grow: keeps a covariance of doubles positive definite


def points(mean: Array, covariance: Array, least: Array) -> Array:
    """The points (B, 2 N + 1, N) at which a map is to be asked: the mean (B, N), and two along each column of a square
    root of the covariance (B, N, N).  least (N,): smallest standard deviations, also where nothing is unknown."""
    every = np.arange(mean.shape[1])
    widened = covariance.copy()
    widened[:, every, every] = (1.0 + ROUNDING) * widened[:, every, every] + least**2
    steps = np.sqrt(SPREAD2) * np.linalg.cholesky(widened).transpose(0, 2, 1)
    centre = mean[:, None]
    return np.concatenate([centre, centre + steps, centre - steps], axis=1)


def moments(mapped: Array) -> tuple[Array, Array]:
    """Mean (B, M) and covariance (B, M, M) of what the map makes of `points`, mapped (B, 2 N + 1, M)."""
    count = mapped.shape[1] // 2
    centre, above, below = mapped[:, :1], mapped[:, 1 : count + 1], mapped[:, count + 1 :]
    bend = above + below - 2.0 * centre
    mean = centre[:, 0] + bend.sum(axis=1) / (2.0 * SPREAD2)
    first = (above - below) / (2.0 * np.sqrt(SPREAD2))
    second = bend * np.sqrt(SPREAD2 - 1.0) / (2.0 * SPREAD2)
    roots = np.concatenate([first, second], axis=1)
    return mean, roots.transpose(0, 2, 1) @ roots
