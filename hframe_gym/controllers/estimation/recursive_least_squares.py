"""Recursive least squares: a Kalman filter of parameters that are constant within an episode."""

from __future__ import annotations

import numpy as np

from ...arrays import Array, Mask


class RecursiveLeastSquares:
    """Estimates of constant parameters of B machines from measurements that depend on them linearly.

    Args:
        prior_std: Standard deviations of the parameters at the start of an episode, in their units,
            shape (size,).

    Attributes:
        estimates: Estimated parameters, in their units, shape (B, size). Zero at the start of an episode.
    """

    def __init__(self, prior_std: Array) -> None:
        self._prior_covariance = np.diag(prior_std**2)
        self.resize(0)

    def resize(self, batch: int) -> None:
        """Allocate the estimates of `batch` machines; call `restart` for all of them next."""
        size = len(self._prior_covariance)
        self.estimates, self._covariance = np.zeros((batch, size)), np.zeros((batch, size, size))

    def restart(self, starts: Mask) -> None:
        """Reset the estimates to zero, and their covariance to the prior, where an episode starts."""
        self.estimates[starts], self._covariance[starts] = 0.0, self._prior_covariance

    def correct(self, innovation: Array, matrix: Array, variance: Array) -> None:
        """Correct the estimates by measurements.

        Args:
            innovation: Measured minus predicted values, in the units of the measurements, shape (B, m).
            matrix: Derivatives of the predictions with respect to the parameters, shape (B, m, size).
            variance: Variances of the measurements, in their units squared, shape (B, m) or (m,).
        """
        PH = self._covariance @ matrix.transpose(0, 2, 1)
        K = kalman_gain(PH, matrix @ PH + variance[..., None] * np.eye(matrix.shape[1]))
        self.estimates = self.estimates + np.einsum("bpa,ba->bp", K, innovation)
        self._covariance = self._covariance - K @ PH.transpose(0, 2, 1)


def kalman_gain(PH: Array, S: Array) -> Array:
    """Compute the gains K = P H' S^-1 of B Kalman filters with N estimates and m measurements.

    Args:
        PH: Covariances P H' of the estimates with the measurements, in products of their units,
            shape (B, N, m).
        S: Covariances of the innovations, in products of the measurements' units, shape (B, m, m).

    Returns:
        Gains, in units of estimates per unit of measurements, shape (B, N, m).
    """
    return np.asarray(np.linalg.solve(S, PH.transpose(0, 2, 1)).transpose(0, 2, 1))
