"""Extended Kalman filter of a machine's parameters, whose measurement model is the simulation of a control period.

Unlike `MomentumFilter`, which balances mean forces, it compares the measured state with the simulated one, so that belt
modes and friction that reverses within a period do not disturb it. It estimates every belt separately.

References:
    Ljung (1979), Asymptotic behavior of the extended Kalman filter as a parameter estimator for linear systems.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..dynamics import simulate_batch
from .motion_model import MotionModel

Array = NDArray[np.float64]
# Prior standard deviations of the logarithms of Coulomb friction, masses and belt stiffnesses, about those of the
# randomization "default".
FRICTION_STD, MASS_STD, BELT_STD = 0.4, 0.1, 0.22
# Standard deviations of the difference between measured and simulated belt travel, m, and its rate, m/s: what the
# linearization, other parameters and the step of the simulation leave.
TRAVEL_NOISE, RATE_NOISE = 2e-5, 8e-3
DIFFERENCE = 0.03  # step of the finite differences by the logarithms of the parameters
LARGEST = 1.2  # limit of the logarithms
INTEGRATION_STEP = 1e-3  # s


class ParameterFilter:
    """Estimator of Coulomb friction, masses and belt stiffnesses of B machines from their states and voltages.

    Args:
        model: Model of the machine with its declared parameters, n coordinates and b belts.
        period: Control period, s.

    Attributes:
        size: Number of estimates, 2 n + b.
        estimates: Logarithms of the ratios of actual to declared values (0.1: about 10 % above), limited to 1.2, shape
            (B, size): n Coulomb friction forces, n masses, b axial stiffnesses EA. Zero at the start of an episode.
    """

    def __init__(self, model: MotionModel, period: float) -> None:
        machine = model.machine
        self._model = model
        self._time_s = np.array([0.0, period])
        names = list(machine.parameters)
        coordinates = machine.coordinate_names
        groups = [
            ([f"{name}.coulomb" for name in coordinates], FRICTION_STD),
            ([f"{name}.mass" for name in coordinates], MASS_STD),
            ([f"{belt.name}.EA" for belt in machine.belts], BELT_STD),
        ]
        chosen = [(names.index(name), std) for group, std in groups for name in group if name in names]
        self._columns = np.array([column for column, _ in chosen])
        self._prior_std = np.array([std for _, std in chosen])
        self._nominal = np.array(list(machine.parameters.values()))
        self._units = np.tile(machine.travel_per_unit, 2)
        self._noise = np.repeat([TRAVEL_NOISE, RATE_NOISE], len(model.mass))
        self.size = len(chosen)
        self.estimates, self._covariance = np.zeros((0, self.size)), np.zeros((0, self.size, self.size))

    def update(self, before: Array, after: Array, actions: Array, starts: NDArray[np.bool_]) -> None:
        """Update the estimates by the control period that has ended.

        Args:
            before: States at its start: belt travel (radius * angle of a rotary coordinate) of the n coordinates of B
                machines and its velocity, m and m/s, shape (B, 2 n).
            after: States at its end, m and m/s, shape (B, 2 n).
            actions: Voltages applied in it, divided by the rated voltages, shape (B, drives).
            starts: True for machines whose episode starts with `after`, shape (B,); their estimates are set to zero.
        """
        if len(self.estimates) != len(starts):
            self.estimates = np.zeros((len(starts), self.size))
            self._covariance = np.zeros((len(starts), self.size, self.size))
        if not starts.all():
            self._correct(before, after, actions)
        self.estimates[starts], self._covariance[starts] = 0.0, np.diag(self._prior_std**2)

    def _correct(self, before: Array, after: Array, actions: Array) -> None:
        """Correct the estimates by the difference between measured and simulated states."""
        batch = len(before)
        changed = np.tile(self.estimates, (1 + self.size, 1, 1))
        changed[1:] += DIFFERENCE * np.eye(self.size)[:, None]
        parameters = np.tile(self._nominal, ((1 + self.size) * batch, 1))
        parameters[:, self._columns] *= np.exp(changed.reshape(-1, self.size))
        motion = simulate_batch(
            self._model.machine,
            self._time_s,
            np.repeat(np.tile(actions * self._model.rated, (1 + self.size, 1))[:, None], 2, axis=1),
            parameters=parameters,
            start=np.tile(before / self._units, (1 + self.size, 1)),
            longest_step=INTEGRATION_STEP,
            readings=False,
            parallel=False,
        )
        end = np.concatenate([motion.positions[:, -1], motion.velocities[:, -1]], axis=1) * self._units
        simulated = end.reshape(1 + self.size, batch, -1) / self._noise
        innovation = after / self._noise - simulated[0]
        H = ((simulated[1:] - simulated[0]) / DIFFERENCE).transpose(1, 2, 0)  # (B, 2 n, size), in units of the noise
        PH = self._covariance @ H.transpose(0, 2, 1)
        S = H @ PH + np.eye(H.shape[1])
        K = np.linalg.solve(S, PH.transpose(0, 2, 1)).transpose(0, 2, 1)
        self.estimates = np.clip(self.estimates + np.einsum("bpa,ba->bp", K, innovation), -LARGEST, LARGEST)
        self._covariance = self._covariance - K @ PH.transpose(0, 2, 1)
