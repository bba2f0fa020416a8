"""Estimation of friction, masses and belt stiffness from balances of momentum over control periods.

In every period the momentum balance of the rigid motion (to which belts are internal) and that of the tool
leave a residual beyond the model's drive, friction, belt and effect forces, along x and y in N,

    rigid motion   D = sum_c r_c (-f_c F_c dir_c - d_c m_c a_c)   r_c: travel of coordinate c per rigid motion
    tool           D = -f_c F_c dir_c - d_c m_c a_c + e B_c       c = x, y,

which is linear in the relative errors of the model: f_c of the Coulomb level F_c, d_c of the mass m_c, and e
of the belt force B_c. Recursive least squares estimate them from all periods of an episode, from the same
prior in each.

References:
    Ljung (1999), System Identification, section 11.2.
"""

from __future__ import annotations

import numpy as np

from ...arrays import Array, CoordinateForces, Mask, TravelStates, Volts
from ...dynamics import stiffness_matrix
from ..models.motion_model import MotionModel, OperatingPointGrid
from .recursive_least_squares import RecursiveLeastSquares

# Prior standard deviations of the relative errors, about those of the randomization "default".
FRICTION_STD, MASS_STD, BELT_STD = 0.5, 0.1, 0.2
# Standard deviation of the noise of a balance, N, tuned on recorded episodes; beside it a fraction of the
# friction of coordinates that reverse during the period, and for the tool a fraction of the belt force,
# because the belts' lengths are inaccurate too.
BALANCE_NOISE, REVERSAL_NOISE, BELT_FORCE_NOISE = 0.7, 1.0, 0.15
# m/s, over which the direction of friction changes, in means over a period: tanh(v / it).
MEAN_REVERSAL_SPEED = 0.01


class MomentumFilter:
    """Recursive least squares for friction, masses and belt stiffness of B machines with n coordinates.

    Args:
        period: Control period, s.
    """

    def __init__(self, model: MotionModel, period: float) -> None:
        n = len(model.mass)
        self.model, self.period = model, period
        self._tool = model.tool
        self._grid = OperatingPointGrid(model.machine)
        units = model.machine.travel_per_unit
        on_grid = stiffness_matrix(model.machine, self._grid.points @ model.rigid.T / units)  # (points, n, n)
        self._stiffness = on_grid[:, self._tool] / (units[self._tool, None] * units)  # N/m, (points, 2, n)
        # Rows: the rigid motion along x and y, then the tool's; columns: the coordinates.
        self._rows = np.vstack([model.rigid.T, np.eye(n)[self._tool]])
        prior_std = [*np.full(n, FRICTION_STD), *np.full(n, MASS_STD), BELT_STD]
        self._least_squares = RecursiveLeastSquares(np.array(prior_std))

    @property
    def estimates(self) -> Array:
        """Relative errors of the model (0.1: actual value 10 % above the model's), shape (B, 2 n + 1).

        The columns are those of n Coulomb friction forces (f_c), n masses (d_c) and the belt stiffness (e).
        All are zero at the start of an episode.
        """
        return self._least_squares.estimates

    @property
    def stiffness_ratio(self) -> Array:
        """Estimated belt stiffness divided by the model's, dimensionless, shape (B,) for B machines."""
        return 1.0 + self.estimates[:, -1]

    @property
    def mass_ratio(self) -> Array:
        """Estimated moving mass of each tool axis divided by the model's, shape (B, axes) for B machines."""
        n = len(self.model.mass)
        # Contribution of each coordinate to the mass moved along the tool axes with unstretched belts, kg,
        # (n, axes).
        moving_mass = self.model.mass[:, None] * self.model.rigid**2
        return 1.0 + self.estimates[:, n:-1] @ (moving_mass / moving_mass.sum(axis=0))

    def update(
        self,
        before: TravelStates,
        after: TravelStates,
        volts: Volts,
        effect_force: CoordinateForces,
        starts: Mask,
    ) -> None:
        """Update the estimates of friction, masses and belt stiffness by the last period's momentum balances.

        A balance compares the measured change of momentum with the modeled forces. There is one for the
        motion with unstretched belts and one for the tool, along each axis; the description of the module
        states the equations.

        Args:
            before: States at the start of the period.
            after: States at its end.
            volts: Mean voltages at the motors in the period.
            effect_force: Modeled forces of the machine's effects, including those by which effects change
                friction.
            starts: Machines whose episode starts with `after`; their estimates become zero.
        """
        if len(self.estimates) != len(starts):
            self._least_squares.resize(len(starts))
        D, H, variance = self._balance(before, after, volts, effect_force)
        innovation = D - np.einsum("bap,bp->ba", H, self.estimates)
        self._least_squares.correct(innovation, H, variance)
        self._least_squares.restart(starts)

    def _balance(
        self, before: Array, after: Array, volts: Array, effect_force: Array
    ) -> tuple[Array, Array, Array]:
        """Return the residuals D (B, 2 axes), N, their regressors H (B, 2 axes, 2 n + 1) and variances."""
        model, n, axes = self.model, len(self.model.mass), len(self._tool)
        velocities = before[:, n:], after[:, n:]
        belt_force = self._mean_belt_force(before, after)
        friction = _mean_direction(*velocities) * model.coulomb
        inertial = model.mass * (after[:, n:] - before[:, n:]) / self.period
        resistance = model.viscous * (after[:, :n] - before[:, :n]) / self.period + friction
        residual = inertial + resistance - volts @ model.drive.T - effect_force
        D = residual @ self._rows.T
        D[:, axes:] -= belt_force
        H = np.zeros((*D.shape, self.estimates.shape[1]))
        H[:, :, :-1] = -np.concatenate([friction, inertial], axis=1)[:, None] * np.hstack([self._rows] * 2)
        H[:, axes:, -1] = belt_force
        reversal = np.tanh(velocities[1] / MEAN_REVERSAL_SPEED) - np.tanh(velocities[0] / MEAN_REVERSAL_SPEED)
        variance = BALANCE_NOISE**2 + REVERSAL_NOISE**2 * (reversal * model.coulomb) ** 2 @ self._rows.T**2
        variance[:, axes:] += (BELT_FORCE_NOISE * belt_force) ** 2
        return D, H, variance

    def _mean_belt_force(self, before: Array, after: Array) -> Array:
        """Return the mean force of the model's belts on the tool over a period, N, shape (B, axes)."""
        n = len(self.model.mass)
        # Mean of the cubic through both states, because belt modes oscillate within two or three periods.
        mean_travel = 0.5 * (before[:, :n] + after[:, :n]) + self.period / 12.0 * (
            before[:, n:] - after[:, n:]
        )
        points = self._grid.nearest(self.model.tool_position(after))
        return -np.einsum("bij,bj->bi", self._stiffness[points], mean_travel)

    def friction_voltage_ahead(self, goals: Array) -> Array:
        """Compute voltages that compensate the error of the modeled Coulomb friction along a path.

        Friction opposes the velocity of the goals, which is computed from differences of the k goals.

        Args:
            goals: Tool goals now and at the ends of the next k - 1 periods, m, shape (B, k, axes), k > 2.

        Returns:
            Voltages for k - 2 periods, the first being the period that starts now, V,
            shape (B, k - 2, drives).
        """
        model, n = self.model, len(self.model.mass)
        mean_velocity = np.diff(goals, axis=1) / self.period
        # Velocities of x and y at the inner sample times, and by extrapolation at the first; then of all
        # coordinates.
        inner = 0.5 * (mean_velocity[:, 1:] + mean_velocity[:, :-1])
        velocity = np.concatenate([2.0 * mean_velocity[:, :1] - inner[:, :1], inner], axis=1) @ model.rigid.T
        direction = _mean_direction(velocity[:, :-1], velocity[:, 1:])
        force = self.estimates[:, None, :n] * model.coulomb * direction
        return model.voltage(force @ model.rigid)


def _mean_direction(before: Array, after: Array) -> Array:
    """Return the mean of tanh(v / MEAN_REVERSAL_SPEED) while v changes linearly from `before` to `after`."""
    change = (after - before) / MEAN_REVERSAL_SPEED
    # The integral of tanh is log cosh.
    integral = np.logaddexp(after / MEAN_REVERSAL_SPEED, -after / MEAN_REVERSAL_SPEED)
    integral = integral - np.logaddexp(before / MEAN_REVERSAL_SPEED, -before / MEAN_REVERSAL_SPEED)
    constant = np.abs(change) < 1e-4  # where the quotient below would lose its digits
    at_middle = np.tanh(0.5 * (before + after) / MEAN_REVERSAL_SPEED)
    return np.asarray(np.where(constant, at_middle, integral / np.where(constant, 1.0, change)))
