"""Adaptive controller: the model-based controller, scheduled on estimated belt stiffness, masses and friction.

Belts, masses   A bank of model-based controllers is designed for soft, nominal and stiff belts and for light and heavy
                masses. The forces that they demand along x and y are interpolated by the estimated belt stiffness and
                by the estimated mass of that axis (gain scheduling, Astrom and Wittenmark 1995, chapter 9).
Friction        Along a previewed path, a feedforward voltage compensates the difference between estimated and modeled
                friction, minus its recent mean: the disturbance observers already compensate that mean, but they lag
                behind a force that reverses with the motion.

The estimates come from `MomentumFilter`, which starts from the same prior in every episode; there is no training.

References:
    Astrom and Wittenmark (1995), Adaptive Control, 2nd edition.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..machine import Machine
from .base import CONTROLLERS, Controller, EpisodeStarts, Mask
from .input_compensation import DeadTime, InputInversion
from .model_based_controller import ModelBasedController
from .momentum_filter import MomentumFilter
from .motion_model import MotionModel

Array = NDArray[np.float64]
# Design points of the bank, as factors on the declared EA and masses: about the range of the randomization "default".
STIFFNESS_RATIOS = np.array([0.7, 1.0, 1.3])
MASS_RATIOS = np.array([0.9, 1.2])
# Weight of the newest period in the recent friction voltage; matches the disturbance observer along a path.
RECENT_WEIGHT = 0.3
PERIODS_AHEAD = 3  # periods for which `expected_friction` gives the voltage, the present one included


@CONTROLLERS.register("adaptive-pid")
class AdaptiveController(Controller):
    """Model-based controller that adapts to the belt stiffness, masses and friction it estimates during the episode.

    It commands a batch of B stages (simulated machines) with n coordinates each. The registered name `adaptive-pid`
    follows that of `ModelBasedController` (`pid`).

    Args:
        machine: Machine model from which the bank of controllers is designed.
        period: Control period, s.

    Attributes:
        model: Model of the machine.
        expected_friction: Voltages, divided by the rated voltages, that compensate the difference between estimated and
            modeled friction along the path: two columns for each of PERIODS_AHEAD periods, the present one first, then
            two columns with the recent mean; shape (B, 2 PERIODS_AHEAD + 2). Zero for a goal that does not move.
        feature_sizes: Numbers of columns of `expected_friction` and `estimates`, by name; a learned policy on top of
            this controller may observe both.

    Raises:
        InputError: If the machine does not have two drives that can move both x and y, x or y has no range, or the
            period is not positive.
    """

    def __init__(self, machine: Machine, period: float = 0.01) -> None:
        super().__init__(machine, period)
        self._bank = [
            [ModelBasedController(_scaled(machine, stiffness, mass), period) for mass in MASS_RATIOS.tolist()]
            for stiffness in STIFFNESS_RATIOS.tolist()
        ]
        self.model = MotionModel(machine)
        self._dead_time, self._inversion = DeadTime(machine, period), InputInversion(machine)
        self._filter = MomentumFilter(self.model, period)
        self.feature_sizes = {"expected_friction": 2 * (PERIODS_AHEAD + 1), "estimates": 2 * len(self.model.mass) + 1}
        self._starts = EpisodeStarts()
        self._elapsed_s = np.zeros(0)
        self._state = self.expected_friction = np.zeros((0, 0))

    def reset(self, mask: Mask | None = None) -> None:
        """Clear the estimates and the controllers of stages whose next observation starts a new episode.

        Args:
            mask: True for the stages to reset, shape (B,). Default: all; the batch size may then change.
        """
        for controller in self._controllers():
            controller.reset(mask)
        self._starts.reset(mask)

    @property
    def estimates(self) -> Array:
        """Estimated relative errors of Coulomb levels (n), masses (n) and belt stiffness (1), shape (B, 2 n + 1)."""
        return self._filter.estimates

    def act(self, observation: Mapping[str, NDArray[Any]]) -> Array:
        """Update the estimates and compute the actions for the control period that starts now.

        Args:
            observation: Arrays by key, for B stages. `observation`: positions of x, y and the motors, then their
                velocities, m, rad, m/s and rad/s, shape (B, 2 n). `desired_goal`: tool goal, m, shape (B, 2). For a
                moving goal also `preview`, m, shape (B, 2 P): goals at the ends of the next P periods.

        Returns:
            Voltages divided by the rated voltages, in [-1, 1], shape (B, 2).

        Raises:
            InputError: If the observation does not fit the machine, or the preview is too short.
        """
        model = self.model
        state = model.state(observation)
        if self._starts.resize(len(state)):
            self._state, self._elapsed_s = state, np.zeros(len(state))
            self.expected_friction = np.zeros((len(state), 2 * (PERIODS_AHEAD + 1)))
        self._update_estimates(state)
        self._update_expected_friction(observation)
        self._starts.clear()
        force = self._scheduled_force(observation)
        friction_change = (self.expected_friction[:, :2] - self.expected_friction[:, -2:]) * model.rated
        motor_voltage = np.clip(model.voltage(force) + friction_change, -model.rated, model.rated)
        actions = self._inversion.command(motor_voltage) / model.rated
        self._dead_time.send(actions * model.rated)
        for controller in self._controllers():
            controller.replace_last_action(actions)
        return actions

    def replace_last_action(self, actions: Array) -> None:
        """Record the actions that were applied instead of those that `act` returned last.

        Args:
            actions: Applied voltages divided by the rated voltages, in [-1, 1], shape (B, 2).
        """
        self._dead_time.replace_last(actions * self.model.rated)
        for controller in self._controllers():
            controller.replace_last_action(actions)

    def _scheduled_force(self, observation: Mapping[str, NDArray[Any]]) -> Array:
        """Return the forces along x and y (B, 2), N, interpolated between those of the bank."""
        model = self.model
        commands = np.array([[controller.act(observation) for controller in row] for row in self._bank]) * model.rated
        volts = self._inversion.motor_voltage(commands.reshape(-1, 2)).reshape(commands.shape)
        # k: stiffness, l: mass, b: stage, a: axis.
        by_stiffness = _interpolation_weights(self._filter.stiffness_ratio, STIFFNESS_RATIOS)
        by_mass = _interpolation_weights(self._filter.mass_ratio, MASS_RATIOS)
        return np.asarray(np.einsum("kb,lba,klba->ba", by_stiffness, by_mass, volts @ model.force_per_volt.T))

    def _update_estimates(self, state: Array) -> None:
        """Update the filter by the period that ends with `state` (B, 2 n)."""
        starts = self._starts.mask
        self._dead_time.reset(starts)
        self._elapsed_s = np.where(starts, 0.0, self._elapsed_s)
        midpoint, midpoint_s = 0.5 * (self._state + state), self._elapsed_s - 0.5 * self.period
        effect_force = self.model.effect_force(midpoint, midpoint_s) + self.model.effect_friction(midpoint, midpoint_s)
        volts = self._inversion.motor_voltage(self._dead_time.mean_arrived())
        self._filter.update(self._state, state, volts, effect_force, starts)
        self._state, self._elapsed_s = state, self._elapsed_s + self.period

    def _update_expected_friction(self, observation: Mapping[str, NDArray[Any]]) -> None:
        """Update `expected_friction` by the previewed goals."""
        starts = self._starts.mask
        previous = self.expected_friction.reshape(len(starts), PERIODS_AHEAD + 1, 2)
        recent = np.where(starts[:, None], 0.0, previous[:, -1] + RECENT_WEIGHT * (previous[:, 0] - previous[:, -1]))
        if "preview" in observation:
            path = np.concatenate([observation["desired_goal"], observation["preview"]], axis=1, dtype=np.float64)
            goals = self._dead_time.delayed_goals(path.reshape(len(path), -1, 2))[:, : PERIODS_AHEAD + 2]
            if goals.shape[1] < PERIODS_AHEAD + 2:
                raise InputError(
                    f"the preview ends {goals.shape[1] - 1} periods after the dead time, {PERIODS_AHEAD + 1} are "
                    "needed; increase the task's previews"
                )
            ahead = self._filter.friction_voltage_ahead(goals) / self.model.rated
            self.expected_friction = np.concatenate([ahead, recent[:, None]], axis=1).reshape(len(path), -1)

    def _controllers(self) -> Iterator[ModelBasedController]:
        """Iterate over all controllers of the bank."""
        return (controller for row in self._bank for controller in row)


def _scaled(machine: Machine, stiffness_ratio: float, mass_ratio: float) -> Machine:
    """Return the machine with all EA and all masses multiplied by a ratio."""
    factors = {".EA": stiffness_ratio, ".mass": mass_ratio}
    scaled = {
        name: factors[suffix] * value
        for name, value in machine.parameters.items()
        for suffix in factors
        if name.endswith(suffix)
    }
    return machine.replace(scaled)


def _interpolation_weights(values: Array, grid: Array) -> Array:
    """Return the weights (len(grid), ...) of linear interpolation between grid points, for values (...)."""
    return np.stack([np.interp(values, grid, row) for row in np.eye(len(grid))])
