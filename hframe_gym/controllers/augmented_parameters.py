"""The numbers of a declared machine that an observer learns, and by how much each may be off.

A number is learnt as the logarithm of its factor on the declared one, so that none changes its sign.  A belt's EA
stands for its whole stiffness, its length included.  What a resistance does, a Kt does too, and is not learnt twice.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..machine import Machine

Array = NDArray[np.float64]
# Standard deviations of the logarithms: of friction little is known before it is measured, masses are weighed, and
# motors have data sheets.
OFF = {"mass": 0.1, "coulomb": 0.4, "viscous": 0.2, "EA": 0.1, "Kt": 0.05, "Ke": 0.05}
BELTS = 0.17  # of what all belts have in common, being cut from one piece
MOST = 4.0  # a factor, up or down: there is no such stage beyond


class AugmentedParameters:
    """The masses, frictions, belt stiffnesses and motor constants of a machine that are not zero.

    Attributes: names (k), of `Machine.parameters`; covariance (k, k) of the logarithms of their factors.
    """

    def __init__(self, machine: Machine) -> None:
        values = machine.parameters
        owners = [*machine.coordinate_names, *(b.name for b in machine.belts), *(d.name for d in machine.drives)]
        candidates = [f"{owner}.{key}" for owner in owners for key in OFF]
        self.names = tuple(name for name in candidates if values.get(name, 0.0) != 0.0)
        self._columns = [list(values).index(name) for name in self.names]
        self._declared = np.array(list(values.values()))
        keys = [name.rpartition(".")[2] for name in self.names]
        belts = np.array([key == "EA" for key in keys], np.float64)
        own = np.array([OFF[key] for key in keys], np.float64)
        self.covariance: Array = np.diag(own**2) + BELTS**2 * np.outer(belts, belts)

    def factors(self, logarithms: Array) -> Array:
        """Factors (B, k) on the declared numbers, within `MOST` either way."""
        return np.exp(self.within(logarithms))

    def within(self, logarithms: Array) -> Array:
        """Logarithms (B, k) no farther from zero than that of `MOST`."""
        return np.clip(logarithms, -np.log(MOST), np.log(MOST))

    def parameters(self, logarithms: Array) -> Array:
        """Parameters (B, P), in the order of `Machine.parameters`, of machines that are off by logarithms (B, k)."""
        rows = np.tile(self._declared, (len(logarithms), 1))
        rows[:, self._columns] *= self.factors(logarithms)
        return rows
