"""Adaptive controller: the model-based controller, scheduled on estimated belt stiffness, masses and friction.

Belts, masses   A bank of model-based controllers is designed for soft, nominal and stiff belts and for light and heavy
                masses. The forces that they demand along x and y are interpolated by the estimated belt stiffness and
                by the estimated mass of that axis (gain scheduling, Astrom and Wittenmark 1995, chapter 9).
Friction        Along a previewed path, a feedforward voltage compensates the difference between estimated and modeled
                friction, minus its recent mean: the disturbance observers already compensate that mean, but they lag
                behind a force that reverses with the motion.

The estimates come from `MomentumFilter`, which starts from the same prior in every episode; there is no training. In
every period the momentum balance of the rigid motion (to which belts are internal) and that of the tool leave a
residual beyond the model's drive, friction, belt and effect forces, along x and y in N,

    rigid motion   D = sum_c r_c (-f_c F_c dir_c - d_c m_c a_c)      r_c: travel of coordinate c per rigid motion
    tool           D = -f_c F_c dir_c - d_c m_c a_c + e B_c          c = x, y,

which is linear in the relative errors of the model: f_c of the Coulomb level F_c, d_c of the mass m_c, and e of the
belt force B_c. A Kalman filter with constant parameters (recursive least squares) estimates them from all periods of an
episode.

References:
    Astrom and Wittenmark (1995), Adaptive Control, 2nd edition.
    Ljung (1999), System Identification, section 11.2.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import ClassVar

import numpy as np
from typing_extensions import override

from ..arrays import Actions, Array, CoordinateForces, Mask, PreviewedGoals, TravelStates, Volts
from ..dynamics import stiffness_matrix
from ..errors import InputError
from ..machine import Machine
from .base import CONTROLLERS, FullStateController
from .model_based_controller import ModelBasedController
from .models.input_compensation import DeadTime, InputInversion
from .models.motion_model import MotionModel, OperatingPointGrid

# Design points of the bank, as factors on the declared EA and masses: about the range of the randomization "default".
STIFFNESS_RATIOS = np.array([0.7, 1.0, 1.3])
MASS_RATIOS = np.array([0.9, 1.2])
# Weight of the newest period in the recent friction voltage; matches the disturbance observer along a path.
RECENT_WEIGHT = 0.3
PERIODS_AHEAD = 3  # periods for which `expected_friction` gives the voltage, the present one included
# Prior standard deviations of the relative errors, about those of the randomization "default".
FRICTION_STD, MASS_STD, BELT_STD = 0.5, 0.1, 0.2
# Standard deviation of the noise of a balance, N, tuned on recorded episodes; beside it a fraction of the friction of
# coordinates that reverse during the period, and for the tool a fraction of the belt force, because the belts' lengths
# are inaccurate too.
BALANCE_NOISE, REVERSAL_NOISE, BELT_FORCE_NOISE = 0.7, 1.0, 0.15
# m/s, over which the direction of friction changes, in means over a period: tanh(v / it).
MEAN_REVERSAL_SPEED = 0.01


@CONTROLLERS.register("adaptive-pid")
class AdaptiveController(FullStateController):
    """Model-based controller that adapts to the belt stiffness, masses and friction it estimates during the episode.

    Its registered name is `adaptive-pid`, because the controllers that it adapts are `ModelBasedController`s (`pid`).

    Attributes:
        expected_friction: Voltages that compensate the difference between estimated and modeled friction along the
            path, divided by the rated voltages, shape (B, 4 * drives): one column per drive for the present period,
            then for each of the next two periods, then for the mean of recent periods. 0 if the goal does not move.
        feature_sizes: Numbers of columns of `expected_friction` and `estimates`, by name; a learned policy that
            corrects this controller may observe both.

    Raises:
        InputError: If the machine does not have one drive per axis of its tool, an axis has no range, or the period is
            invalid.
    """

    knowledge: ClassVar[str] = "feedback laws, estimates parameters"

    def __init__(self, machine: Machine, period: float = 0.01) -> None:
        super().__init__(machine, period)
        self._bank = [
            [
                ModelBasedController(scaled_machine(machine, stiffness, mass), period)
                for mass in MASS_RATIOS.tolist()
            ]
            for stiffness in STIFFNESS_RATIOS.tolist()
        ]
        self._dead_time, self._inversion = DeadTime(self.model.machine, period), InputInversion(machine)
        self._filter = MomentumFilter(self.model, period)
        drives = len(self.model.rated)
        self.feature_sizes = {
            "expected_friction": drives * (PERIODS_AHEAD + 1),
            "estimates": 2 * len(self.model.mass) + 1,
        }
        self._elapsed_s = np.zeros(0)
        self._state = self.expected_friction = np.zeros((0, 0))

    @override
    def reset(self, mask: Mask | None = None) -> None:
        super().reset(mask)
        for controller in self._controllers():
            controller.reset(mask)

    @property
    def estimates(self) -> Array:
        """Estimated relative errors of model parameters, shape (B, 2 n + 1) for B machines with n coordinates.

        The columns are the errors of the n Coulomb friction forces, the n masses, and the belt stiffness. An error of
        0.1 means that the actual value is 10 % above the model's.
        """
        return self._filter.estimates

    @override
    def act_on_state(self, state: TravelStates, goals: PreviewedGoals) -> Actions:
        """Update the estimates and compute the actions.

        The preview of a moving goal must cover the dead time of the drives and PERIODS_AHEAD + 1 periods.
        """
        model = self.model
        if self._starts.resize(len(state)):
            self._state, self._elapsed_s = state, np.zeros(len(state))
            self.expected_friction = np.zeros((len(state), self.feature_sizes["expected_friction"]))
        self._update_estimates(state)
        self._update_expected_friction(goals)
        self._starts.clear()
        force = self._scheduled_force(state, goals)
        drives = len(model.rated)
        present, recent_mean = self.expected_friction[:, :drives], self.expected_friction[:, -drives:]
        friction_change = (present - recent_mean) * model.rated
        motor_voltage = np.clip(model.voltage(force) + friction_change, -model.rated, model.rated)
        actions = self._inversion.command(motor_voltage) / model.rated
        self._dead_time.send(actions * model.rated)
        for controller in self._controllers():
            controller.replace_last_action(actions)
        return actions

    @override
    def replace_last_action(self, actions: Actions) -> None:
        self._dead_time.replace_last(actions * self.model.rated)
        for controller in self._controllers():
            controller.replace_last_action(actions)

    def _scheduled_force(self, state: Array, goals: Array) -> Array:
        """Return the forces along the tool axes (B, axes), N, interpolated between those of the bank."""
        model = self.model
        actions = [[controller.act_on_state(state, goals) for controller in row] for row in self._bank]
        commands = np.array(actions) * model.rated  # V, (stiffness ratios, mass ratios, B, drives)
        volts = self._inversion.motor_voltage(commands.reshape(-1, len(model.rated))).reshape(commands.shape)
        # k: stiffness ratio, l: mass ratio, b: machine of the batch, a: axis.
        by_stiffness = _interpolation_weights(self._filter.stiffness_ratio, STIFFNESS_RATIOS)
        by_mass = _interpolation_weights(self._filter.mass_ratio, MASS_RATIOS)
        return np.asarray(np.einsum("kb,lba,klba->ba", by_stiffness, by_mass, volts @ model.force_per_volt.T))

    def _update_estimates(self, state: Array) -> None:
        """Update the filter by the period that ends with `state` (B, 2 n)."""
        starts = self._starts.mask
        self._dead_time.reset(starts)
        self._elapsed_s = np.where(starts, 0.0, self._elapsed_s)
        midpoint, midpoint_s = 0.5 * (self._state + state), self._elapsed_s - 0.5 * self.period
        effect_force = self.model.effect_force(midpoint, midpoint_s) + self.model.effect_friction(
            midpoint, midpoint_s
        )
        volts = self._inversion.motor_voltage(self._dead_time.mean_arrived())
        self._filter.update(self._state, state, volts, effect_force, starts)
        self._state, self._elapsed_s = state, self._elapsed_s + self.period

    def _update_expected_friction(self, goals: Array) -> None:
        """Update `expected_friction` by the previewed goals."""
        if goals.shape[1] == 1:  # a fixed goal, perhaps after a path
            self.expected_friction = np.zeros_like(self.expected_friction)
            return
        starts = self._starts.mask
        previous = self.expected_friction.reshape(len(starts), PERIODS_AHEAD + 1, -1)
        recent = np.where(
            starts[:, None], 0.0, previous[:, -1] + RECENT_WEIGHT * (previous[:, 0] - previous[:, -1])
        )
        goals = self._dead_time.delayed_goals(goals)[:, : PERIODS_AHEAD + 2]
        if goals.shape[1] < PERIODS_AHEAD + 2:
            reach = f"the preview ends {goals.shape[1] - 1} periods after the dead time, {PERIODS_AHEAD + 1} are needed"
            raise InputError(f"{reach}; increase the task's previews")
        ahead = self._filter.friction_voltage_ahead(goals) / self.model.rated
        self.expected_friction = np.concatenate([ahead, recent[:, None]], axis=1).reshape(len(goals), -1)

    def _controllers(self) -> Iterator[ModelBasedController]:
        """Iterate over all controllers of the bank."""
        return (controller for row in self._bank for controller in row)


class MomentumFilter:
    """Recursive least-squares estimator of friction, masses and belt stiffness of B machines with n coordinates.

    Attributes:
        estimates: Relative errors of the model (0.1: actual value 10 % above the model's), shape (B, 2 n + 1): n
            Coulomb friction forces (f_c), n masses (d_c), belt stiffness (e). Zero at the start of an episode.
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
        self._prior_std = np.concatenate([np.full(n, FRICTION_STD), np.full(n, MASS_STD), [BELT_STD]])
        self.estimates, self._covariance = np.zeros((0, 2 * n + 1)), np.zeros((0, 2 * n + 1, 2 * n + 1))

    @property
    def stiffness_ratio(self) -> Array:
        """Estimated belt stiffness divided by the model's, dimensionless, shape (B,) for B machines."""
        return 1.0 + self.estimates[:, -1]

    @property
    def mass_ratio(self) -> Array:
        """Estimated mass that moves along each tool axis divided by the model's, shape (B, axes) for B machines."""
        n = len(self.model.mass)
        # Contribution of each coordinate to the mass moved along the tool axes with unstretched belts, kg, (n, axes).
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
        """Update the estimates of friction, masses and belt stiffness with the momentum balances of the last period.

        A balance compares the measured change of momentum with the modeled forces. There is one for the motion with
        unstretched belts and one for the tool, along each axis; the description of the module states the equations.

        Args:
            volts: Mean voltages at the motors in the period.
            effect_force: Modeled forces of the machine's effects, including those by which effects change friction.
            starts: Machines whose episode starts with `after`; their estimates become zero.
        """
        size = len(self._prior_std)
        if len(self.estimates) != len(starts):
            self.estimates, self._covariance = (
                np.zeros((len(starts), size)),
                np.zeros((len(starts), size, size)),
            )
        # Kalman filter for constant parameters: D are measurements with the matrix H, S is the covariance of the
        # innovation, K the gain.
        D, H, variance = self._balance(before, after, volts, effect_force)
        PH = self._covariance @ H.transpose(0, 2, 1)
        S = H @ PH + variance[:, :, None] * np.eye(D.shape[1])
        K = np.linalg.solve(S, PH.transpose(0, 2, 1)).transpose(0, 2, 1)
        innovation = D - np.einsum("bap,bp->ba", H, self.estimates)
        self.estimates = self.estimates + np.einsum("bpa,ba->bp", K, innovation)
        self._covariance = self._covariance - K @ PH.transpose(0, 2, 1)
        self.estimates[starts], self._covariance[starts] = 0.0, np.diag(self._prior_std**2)

    def _balance(
        self, before: Array, after: Array, volts: Array, effect_force: Array
    ) -> tuple[Array, Array, Array]:
        """Return the residuals D (B, 2 axes), N, their regressors H (B, 2 axes, 2 n + 1) and noise variances of D."""
        model, n, axes = self.model, len(self.model.mass), len(self._tool)
        velocities = before[:, n:], after[:, n:]
        belt_force = self._mean_belt_force(before, after)
        friction = _mean_direction(*velocities) * model.coulomb
        inertial = model.mass * (after[:, n:] - before[:, n:]) / self.period
        resistance = model.viscous * (after[:, :n] - before[:, :n]) / self.period + friction
        residual = inertial + resistance - volts @ model.drive.T - effect_force
        D = residual @ self._rows.T
        D[:, axes:] -= belt_force
        H = np.zeros((*D.shape, len(self._prior_std)))
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

        Friction opposes the velocity of the goals, which follows from the differences of k goals for k - 2 periods.

        Args:
            goals: Tool goals now and at the ends of the next k - 1 periods, m, shape (B, k, axes), k > 2.

        Returns:
            Voltages for k - 2 periods, the first being the period that starts now, V, shape (B, k - 2, drives).
        """
        model, n = self.model, len(self.model.mass)
        mean_velocity = np.diff(goals, axis=1) / self.period
        # Velocities of x and y at the inner sample times, and by extrapolation at the first; then of all coordinates.
        inner = 0.5 * (mean_velocity[:, 1:] + mean_velocity[:, :-1])
        velocity = np.concatenate([2.0 * mean_velocity[:, :1] - inner[:, :1], inner], axis=1) @ model.rigid.T
        direction = _mean_direction(velocity[:, :-1], velocity[:, 1:])
        force = self.estimates[:, None, :n] * model.coulomb * direction
        return model.voltage(force @ model.rigid)


def scaled_machine(machine: Machine, stiffness_ratio: float, mass_ratio: float) -> Machine:
    """Return a machine with all EA times `stiffness_ratio` and all masses times `mass_ratio`, dimensionless."""
    factors = {"EA": stiffness_ratio, "mass": mass_ratio}
    values = machine.parameters.items()
    kinds = {name: name.rpartition(".")[2] for name in machine.parameters}
    return machine.replace(
        {name: factors[kinds[name]] * value for name, value in values if kinds[name] in factors}
    )


def _interpolation_weights(values: Array, grid: Array) -> Array:
    """Return the weights (len(grid), ...) of linear interpolation between grid points, for values (...)."""
    return np.stack([np.interp(values, grid, row) for row in np.eye(len(grid))])


def _mean_direction(before: Array, after: Array) -> Array:
    """Return the mean of tanh(v / MEAN_REVERSAL_SPEED) while velocities change linearly from `before` to `after`."""
    change = (after - before) / MEAN_REVERSAL_SPEED
    # The integral of tanh is log cosh.
    integral = np.logaddexp(after / MEAN_REVERSAL_SPEED, -after / MEAN_REVERSAL_SPEED)
    integral = integral - np.logaddexp(before / MEAN_REVERSAL_SPEED, -before / MEAN_REVERSAL_SPEED)
    constant = np.abs(change) < 1e-4  # where the quotient below would lose its digits
    at_middle = np.tanh(0.5 * (before + after) / MEAN_REVERSAL_SPEED)
    return np.asarray(np.where(constant, at_middle, integral / np.where(constant, 1.0, change)))
