"""Adaptive controller: the model-based one, scheduled on estimated belt stiffness, masses and friction.

Belts, masses   A bank of model-based controllers is designed for soft, nominal and stiff belts and for light
                and heavy masses. The forces that they demand along x and y are interpolated by the estimated
                belt stiffness and by the estimated mass of that axis (gain scheduling, Astrom and Wittenmark
                1995, chapter 9).
Friction        Along a previewed path, a feedforward voltage compensates the difference between estimated and
                modeled friction, minus its recent mean: the disturbance observers already compensate that
                mean, but they lag behind a force that reverses with the motion.

The estimates come from `MomentumFilter`, which starts from the same prior in every episode; there is no
training.

References:
    Astrom and Wittenmark (1995), Adaptive Control, 2nd edition.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import ClassVar

import numpy as np
from typing_extensions import override

from ..arrays import Actions, Array, Mask, PreviewedGoals, TravelStates
from ..errors import InputError
from ..machine import Machine
from .base import CONTROLLERS, FullStateController
from .estimation.momentum_filter import MomentumFilter
from .model_based_controller import ModelBasedController
from .models.input_compensation import DeadTime, InputInversion

# Design points of the bank, as factors on the declared EA and masses: about the range of the randomization
# "default".
STIFFNESS_RATIOS = np.array([0.7, 1.0, 1.3])
MASS_RATIOS = np.array([0.9, 1.2])
# Weight of the newest period in the recent friction voltage; matches the disturbance observer along a path.
RECENT_WEIGHT = 0.3
PERIODS_AHEAD = 3  # periods for which `expected_friction` gives the voltage, the present one included


@CONTROLLERS.register("adaptive-pid")
class AdaptiveController(FullStateController):
    """Model-based controller that adapts to belt stiffness, masses and friction, estimated in the episode.

    Its registered name is `adaptive-pid`, because the controllers that it adapts are `ModelBasedController`s
    (`pid`).

    Attributes:
        expected_friction: Voltages that compensate the difference between estimated and modeled friction
            along the path, divided by the rated voltages, shape (B, 4 * drives): one column per drive for the
            present period, then for each of the next two periods, then for the mean of recent periods. 0 if
            the goal does not move.
        feature_sizes: Numbers of columns of `expected_friction` and `estimates`, by name; a learned policy
            that corrects this controller may observe both.
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
        """Estimated relative errors of model parameters, shape (B, 2 n + 1) for B machines, n coordinates.

        The columns are the errors of the n Coulomb friction forces, the n masses, and the belt stiffness. An
        error of 0.1 means that the actual value is 10 % above the model's.
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
        mean_force = self.model.mean_effect_force(midpoint, midpoint_s, self.period)
        effect_force = mean_force + self.model.effect_friction(midpoint, midpoint_s)
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
            reach = (
                f"the preview ends {goals.shape[1] - 1} periods after the dead time, "
                f"{PERIODS_AHEAD + 1} are needed"
            )
            raise InputError(f"{reach}; increase the task's previews")
        ahead = self._filter.friction_voltage_ahead(goals) / self.model.rated
        self.expected_friction = np.concatenate([ahead, recent[:, None]], axis=1).reshape(len(goals), -1)

    def _controllers(self) -> Iterator[ModelBasedController]:
        """Iterate over all controllers of the bank."""
        return (controller for row in self._bank for controller in row)


def scaled_machine(machine: Machine, stiffness_ratio: float, mass_ratio: float) -> Machine:
    """Return a copy of a machine with other belts and masses.

    Args:
        stiffness_ratio: Factor on the EA of all belts, dimensionless.
        mass_ratio: Factor on all masses and moments of inertia, dimensionless.
    """
    factors = {"EA": stiffness_ratio, "mass": mass_ratio}
    values = machine.parameters.items()
    kinds = {name: name.rpartition(".")[2] for name in machine.parameters}
    return machine.replace(
        {name: factors[kinds[name]] * value for name, value in values if kinds[name] in factors}
    )


def _interpolation_weights(values: Array, grid: Array) -> Array:
    """Return the weights (len(grid), ...) of linear interpolation between grid points, for values (...)."""
    return np.stack([np.interp(values, grid, row) for row in np.eye(len(grid))])
