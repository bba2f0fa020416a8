"""Sample parameters from their joint normal distribution within limits, such that known sums of them are kept."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

Array = NDArray[np.float64]
_ROUNDING = 1e-12  # Fraction of a variance below which a difference of variances is rounding.
# The largest standard normal number that a uniform number of `counter_rng` gives.
_LARGEST_NORMAL = -float(ndtri(0.5 * 2.0**-53))


def pivoted_cholesky(covariance: Array, scale: Array) -> Array:
    """Factorize a covariance matrix, which may be singular, into L L^T by the Cholesky method with pivoting.

    The first column of L is the joint change of all parameters with the one that has the largest variance (in units of
    `scale`), the second the change with the one of the largest remaining variance, and so on. Parameters of which only
    a sum is known therefore share one column.

    Args:
        covariance: Symmetric positive semidefinite matrix of k parameters, SI, shape (k, k).
        scale: Sizes of the parameters, by which their variances are compared, SI, positive, shape (k,).

    Returns:
        Factor L, SI, shape (k, k), with columns of 0 where no variance remains. Rows are in the order of the
        parameters, so that L is triangular only after a permutation.

    References:
        Higham (2002), "Accuracy and Stability of Numerical Algorithms", section 10.3.
    """
    scaled = covariance / np.outer(scale, scale)
    variance = np.diag(scaled)
    factor, remaining = np.zeros_like(scaled), np.full(len(scaled), True)
    for column in range(len(scaled)):
        unexplained = np.where(remaining, variance - np.sum(factor**2, axis=1), -np.inf)
        pivot = int(np.argmax(unexplained))
        if unexplained[pivot] > _ROUNDING * variance[pivot]:  # otherwise the parameter follows from the earlier pivots
            change = (scaled[:, pivot] - factor @ factor[pivot]) / np.sqrt(unexplained[pivot])
            factor[:, column] = np.where(remaining, change, 0.0)
        remaining[pivot] = False
    return factor * scale[:, None]


class CorrelatedSampler:
    """Sample deviations of k parameters from their nominal values.

    The distribution is normal with a given covariance, but each joint change of parameters (column of the Cholesky
    factor) is truncated where a parameter to which it contributes most of the variance would leave its limits. Clipping
    one of two parameters of which only a sum is known would change that sum.

    Args:
        covariance: Covariance of the parameters, SI, shape (k, k).
        nominal: Nominal values, SI, shape (k,).
        lower: Smallest values, SI, shape (k,).
        upper: Largest values, SI, shape (k,).

    Attributes:
        reach: Largest possible absolute deviation of each parameter, SI, shape (k,).
    """

    def __init__(self, covariance: Array, nominal: Array, lower: Array, upper: Array) -> None:
        std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        size = np.where(nominal != 0.0, np.abs(nominal), np.where(std > 0.0, std, 1.0))
        self._factor = pivoted_cholesky(covariance, size)
        self._lowest, self._highest = np.zeros(len(nominal)), np.ones(len(nominal))  # probabilities by column
        main = self._factor**2 > 0.5 * np.sum(self._factor**2, axis=1, keepdims=True)
        for row, column in np.argwhere(main):
            slope = self._factor[row, column]
            near, far = sorted([(lower[row] - nominal[row]) / slope, (upper[row] - nominal[row]) / slope])
            self._lowest[column] = max(self._lowest[column], float(ndtr(near)))
            self._highest[column] = min(self._highest[column], float(ndtr(far)))
        self.reach: Array = np.abs(self._factor).sum(axis=1) * _LARGEST_NORMAL

    def deviations(self, uniforms: Array) -> Array:
        """Convert uniform random numbers to correlated deviations of k parameters from their nominal values.

        Each uniform number gives a truncated normal one (inverse transform); these are multiplied by the Cholesky
        factor.

        Args:
            uniforms: Independent random numbers in (0, 1), shape (n, k) for n samples.

        Returns:
            Deviations from the nominal values, SI, shape (n, k). Only the normal numbers are truncated; a parameter
            that is correlated with others is their weighted sum, which may exceed the truncation a little.
        """
        probabilities = self._lowest + uniforms * (self._highest - self._lowest)
        normals = np.clip(ndtri(probabilities), -_LARGEST_NORMAL, _LARGEST_NORMAL)
        total = np.zeros_like(normals)
        # Term by term: a matrix product may add in another order for another batch size.
        for column, change in enumerate(self._factor.T):
            total += normals[:, column, None] * change
        return total
