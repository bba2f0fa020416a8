"""How accurately the parameters of a machine were identified."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arrays import Array


@dataclass(frozen=True)
class Uncertainty:
    """Covariance of the identified parameters of a machine.

    Attributes:
        names: Full names of the k parameters, for example x.mass.
        covariance: Covariance matrix, shape (k, k), in the products of the parameters' units.
    """

    names: tuple[str, ...]
    covariance: Array

    def std(self, name: str) -> float | None:
        """Return the standard deviation of a parameter in its unit, or None if it was not identified."""
        if name not in self.names:
            return None
        index = self.names.index(name)
        return float(np.sqrt(self.covariance[index, index]))

    @property
    def correlation(self) -> Array:
        """Correlation matrix of the parameters, shape (k, k); a parameter without variance has 0."""
        std = np.sqrt(np.maximum(np.diag(self.covariance), 1e-300))
        return self.covariance / np.outer(std, std)
