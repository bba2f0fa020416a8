"""Online estimation of friction, masses and belt stiffness from momentum balances.

In every period the momentum balance of the rigid motion (to which belts are internal) and that of the tool leave a
residual beyond the model's drive, friction, belt and effect forces, along x and y in N,

    rigid motion   D = sum_c r_c (-f_c F_c dir_c - d_c m_c a_c)      r_c: travel of coordinate c per rigid motion
    tool           D = -f_c F_c dir_c - d_c m_c a_c + e B_c          c = x, y,

which is linear in the relative errors of the model: f_c of the Coulomb level F_c, d_c of the mass m_c, and e of the
belt force B_c. A Kalman filter with constant parameters (recursive least squares) estimates them from all periods of an
episode.

References:
    Ljung (1999), System Identification, section 11.2.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..dynamics import stiffness_matrix
from .motion_model import AXES, MotionModel, OperatingPointGrid

Array = NDArray[np.float64]
# Prior standard deviations of the relative errors, about those of the randomization "default".
FRICTION_STD, MASS_STD, BELT_STD = 0.5, 0.1, 0.2
# Standard deviation of the noise of a balance, N, tuned on recorded episodes; beside it a fraction of the friction of
# coordinates that reverse during the period, and for the tool a fraction of the belt force, because the belts' lengths
# are inaccurate too.
BALANCE_NOISE, REVERSAL_NOISE, BELT_FORCE_NOISE = 0.7, 1.0, 0.15
REVERSAL_SPEED = 0.01  # m/s, over which the direction of friction changes: tanh(v / REVERSAL_SPEED)


class MomentumFilter:
    """Recursive least-squares estimator of friction, masses and belt stiffness of B stages with n coordinates each.

    Args:
        model: Model of the machine with its declared parameters.
        period: Control period, s.

    Attributes:
        model: As given.
        period: As given, s.
        estimates: Relative errors of the model (0.1: actual value 10 % above the model's), shape (B, 2 n + 1): n
            Coulomb levels f_c, n masses d_c, belt stiffness e. Zero at the start of an episode.
    """

    def __init__(self, model: MotionModel, period: float) -> None:
        n = len(model.mass)
        self.model, self.period = model, period
        self._tool = [model.machine.coordinate_names.index(axis) for axis in AXES]
        self._grid = OperatingPointGrid(model.machine)
        units = model.machine.travel_per_unit
        on_grid = stiffness_matrix(model.machine, self._grid.points @ model.rigid.T / units)  # (points, n, n)
        self._stiffness = on_grid[:, self._tool] / (units[self._tool, None] * units)  # N/m, (points, 2, n)
        # Rows: the rigid motion along x and y, then the tool's; columns: the coordinates.
        self._rows = np.vstack([model.rigid.T, np.eye(n)[self._tool]])
        self._prior_std = np.concatenate([np.full(n, FRICTION_STD), np.full(n, MASS_STD), [BELT_STD]])
        self.estimates, self._covariance = np.zeros((0, 2 * n + 1)), np.zeros((0, 2 * n + 1, 2 * n + 1))

    @property
    def stiffness_ratio(self) -> Array:
        """Estimated ratio of belt stiffness to nominal stiffness, shape (B,)."""
        return 1.0 + self.estimates[:, -1]

    @property
    def mass_ratio(self) -> Array:
        """Estimated ratio of moving mass to nominal mass along x and y, shape (B, 2)."""
        n, moving_mass = len(self.model.mass), self.model.mass[:, None] * self.model.rigid**2
        return 1.0 + self.estimates[:, n:-1] @ (moving_mass / moving_mass.sum(axis=0))

    def update(self, before: Array, after: Array, volts: Array, effect_force: Array, starts: NDArray[np.bool_]) -> None:
        """Update the estimates with the momentum balances of the last control period.

        Args:
            before: States at the start of the period: belt travel (radius * angle of a rotary coordinate) and its
                velocity, m and m/s, shape (B, 2 n).
            after: States at the end of the period, m and m/s, shape (B, 2 n).
            volts: Mean voltages at the motors in the period, V, shape (B, 2).
            effect_force: Modeled forces of the machine's effects on each coordinate, N, shape (B, n).
            starts: True for stages whose episode starts with `after`, shape (B,); their estimates are set to zero.
        """
        size = len(self._prior_std)
        if len(self.estimates) != len(starts):
            self.estimates, self._covariance = np.zeros((len(starts), size)), np.zeros((len(starts), size, size))
        D, H, variance = self._balance(before, after, volts, effect_force)
        PH = self._covariance @ H.transpose(0, 2, 1)
        S = H @ PH + variance[:, :, None] * np.eye(4)
        K = np.linalg.solve(S, PH.transpose(0, 2, 1)).transpose(0, 2, 1)
        innovation = D - np.einsum("bap,bp->ba", H, self.estimates)
        self.estimates = self.estimates + np.einsum("bpa,ba->bp", K, innovation)
        self._covariance = self._covariance - K @ PH.transpose(0, 2, 1)
        self.estimates[starts], self._covariance[starts] = 0.0, np.diag(self._prior_std**2)

    def _balance(self, before: Array, after: Array, volts: Array, effect_force: Array) -> tuple[Array, Array, Array]:
        """Return the residuals D (B, 4), N, their regressors H (B, 4, 2 n + 1) and noise variances (B, 4)."""
        model, n = self.model, len(self.model.mass)
        velocities = before[:, n:], after[:, n:]
        belt_force = self._mean_belt_force(before, after)
        friction = _mean_direction(*velocities) * model.coulomb
        inertial = model.mass * (after[:, n:] - before[:, n:]) / self.period
        resistance = model.viscous * (after[:, :n] - before[:, :n]) / self.period + friction
        residual = inertial + resistance - volts @ model.drive.T - effect_force
        D = residual @ self._rows.T
        D[:, 2:] -= belt_force
        H = np.zeros((len(D), 4, len(self._prior_std)))
        H[:, :, :-1] = -np.concatenate([friction, inertial], axis=1)[:, None] * np.hstack([self._rows] * 2)
        H[:, 2:, -1] = belt_force
        reversal = np.tanh(velocities[1] / REVERSAL_SPEED) - np.tanh(velocities[0] / REVERSAL_SPEED)
        variance = BALANCE_NOISE**2 + REVERSAL_NOISE**2 * (reversal * model.coulomb) ** 2 @ self._rows.T**2
        variance[:, 2:] += (BELT_FORCE_NOISE * belt_force) ** 2
        return D, H, variance

    def _mean_belt_force(self, before: Array, after: Array) -> Array:
        """Return the mean force of the model's belts on the tool over a period, N, shape (B, 2)."""
        n = len(self.model.mass)
        # Mean of the cubic through both states, because belt modes oscillate within two or three periods.
        mean_travel = 0.5 * (before[:, :n] + after[:, :n]) + self.period / 12.0 * (before[:, n:] - after[:, n:])
        points = self._grid.nearest(self.model.tool_position(after))
        return -np.einsum("bij,bj->bi", self._stiffness[points], mean_travel)

    def friction_voltage_ahead(self, goals: Array) -> Array:
        """Compute the voltages that compensate the estimated minus the modeled Coulomb friction along a path.

        Args:
            goals: Tool goals at k sample times, the first now, the others one period apart, m, shape (B, k, 2), k > 2.

        Returns:
            Voltages for the k - 2 periods from now on, V, shape (B, k - 2, 2).
        """
        model, n = self.model, len(self.model.mass)
        mean_velocity = np.diff(goals, axis=1) / self.period
        inner = 0.5 * (mean_velocity[:, 1:] + mean_velocity[:, :-1])
        velocity = np.concatenate([2.0 * mean_velocity[:, :1] - inner[:, :1], inner], axis=1) @ model.rigid.T
        direction = _mean_direction(velocity[:, :-1], velocity[:, 1:])
        force = self.estimates[:, None, :n] * model.coulomb * direction
        return model.voltage(force @ model.rigid)


def _mean_direction(before: Array, after: Array) -> Array:
    """Return the mean of tanh(v / REVERSAL_SPEED) while velocities change linearly from `before` to `after`."""
    change = (after - before) / REVERSAL_SPEED
    # The integral of tanh is log cosh.
    integral = np.logaddexp(after / REVERSAL_SPEED, -after / REVERSAL_SPEED)
    integral = integral - np.logaddexp(before / REVERSAL_SPEED, -before / REVERSAL_SPEED)
    constant = np.abs(change) < 1e-4
    at_middle = np.tanh(0.5 * (before + after) / REVERSAL_SPEED)
    return np.asarray(np.where(constant, at_middle, integral / np.where(constant, 1.0, change)))
