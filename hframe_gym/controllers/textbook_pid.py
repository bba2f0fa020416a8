"""One PID controller per axis (x and y), tuned by pole placement: the baseline for comparisons."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..dynamics import mode_frequencies
from ..machine import Machine
from .base import CONTROLLERS, Controller, Mask
from .motion_model import AXES, MotionModel

Array = NDArray[np.float64]
# Slowest belt mode, or half the sampling frequency where that is lower, over the bandwidth of the closed loop: the
# usual rule of thumb.
FREQUENCY_MARGIN = 5.0


@CONTROLLERS.register("textbook-pid")
class TextbookPID(Controller):
    """PID control of the tool position along x and y; integration stops while a drive saturates (anti-windup).

    Each axis is modeled as a rigid mass m with viscous friction b, m v' = f - b v for velocity v and force f, and the
    gains put all three closed-loop poles at -w, where w is the frequency of the slowest belt mode (or half the sampling
    frequency, if that is lower) divided by FREQUENCY_MARGIN. The derivative acts on the measured velocity; for a moving
    goal, on the difference to the goal's velocity.

    Args:
        machine: Machine model from which the gains are computed.
        period: Control period, s.

    Attributes:
        model: Model of the machine.
        proportional: Proportional gains of x and y, N/m, shape (2,).
        derivative: Derivative gains of x and y, Ns/m, shape (2,).
        integral: Integral gains of x and y, N/(m s), shape (2,).

    Raises:
        InputError: If the machine does not have two drives that can move both x and y, or the period is not positive.

    References:
        Astrom and Hagglund (2006), Advanced PID Control, chapter 6.
    """

    def __init__(self, machine: Machine, period: float = 0.01) -> None:
        super().__init__(machine, period)
        self.model = MotionModel(machine)
        modes = [frequency for frequency in mode_frequencies(machine) if frequency > 0.0]
        bandwidth = 2.0 * np.pi * min([0.5 / period, *modes]) / FREQUENCY_MARGIN  # rad/s
        rigid = self.model.rigid**2
        mass, viscous = rigid.T @ self.model.mass, rigid.T @ self.model.viscous
        self.proportional = 3.0 * mass * bandwidth**2
        # No derivative action where friction damps more than the poles need.
        self.derivative = np.maximum(3.0 * mass * bandwidth - viscous, 0.0)
        self.integral = mass * bandwidth**3
        self._integral_force = np.zeros((0, 2))  # N
        self._axes = np.array([machine.coordinate_names.index(axis) for axis in AXES])

    def reset(self, mask: Mask | None = None) -> None:
        """Set the integrators of stages whose next observation starts a new episode to zero.

        Args:
            mask: True for the stages to reset, shape (B,). Default: all; the batch size may then change.
        """
        if mask is None or not len(self._integral_force):
            self._integral_force = np.zeros((0, 2))
        else:
            self._integral_force = np.where(mask[:, None], 0.0, self._integral_force)

    def act(self, observation: Mapping[str, NDArray[Any]]) -> Array:
        """Compute the actions for the control period that starts now, for B stages.

        Args:
            observation: Arrays by key. `observation`: positions of x, y and the motors, then their velocities, m, rad,
                m/s and rad/s, shape (B, 2 n) for n coordinates. `desired_goal`: tool goal, m, shape (B, 2). For a
                moving goal also `preview`, m, shape (B, 2 P): goals at the ends of the next P periods.

        Returns:
            Voltages divided by the rated voltages, in [-1, 1], shape (B, 2).

        Raises:
            InputError: If the observation does not fit the machine.
        """
        state = self.model.state(observation)
        if len(self._integral_force) != len(state):
            self._integral_force = np.zeros((len(state), 2))
        velocity = state[:, len(self.model.mass) + self._axes]
        goal = np.asarray(observation["desired_goal"], np.float64)
        if "preview" in observation:
            velocity = velocity - (np.asarray(observation["preview"], np.float64)[:, :2] - goal) / self.period
        error = goal - state[:, self._axes]
        integral_force = self._integral_force + self.integral * self.period * error
        volts = self.model.voltage(self.proportional * error - self.derivative * velocity + integral_force)
        saturated = np.any(np.abs(volts) > self.model.rated, axis=1, keepdims=True)
        self._integral_force = np.where(saturated, self._integral_force, integral_force)
        return np.clip(volts / self.model.rated, -1.0, 1.0)
