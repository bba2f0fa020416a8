"""A plain PID for each axis, tuned by the book: the baseline that a careful user has in ten minutes.

The stage is taken as a rigid mass with viscous friction on each axis, m v' = f - b v.  The three gains place its poles
at a triple -w (pole placement, Astrom and Hagglund 2006, Advanced PID Control, chapter 6), and w is a fifth of the
slowest belt mode's frequency, or of half the sampling's where that is lower: the rule of thumb that keeps clear of
both.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..machine import Machine, mode_frequencies
from .motion_model import MotionModel

Array = NDArray[np.float64]
CLEAR = 5.0  # of the closed loop's frequency, from the slowest belt mode and from half the sampling


class TextbookPID:
    """PID on x and y with an integral that stops while a drive saturates.

    The derivative is on the measured speed, and for a goal that moves on how much it is off the goal's.

    machine: the model that the gains are made of.  period: of control, s.

    Raises ValueError for a machine that it cannot control (see `MotionModel`) or a period that is not positive.
    """

    def __init__(self, machine: Machine, period: float = 0.01) -> None:
        if not (np.isfinite(period) and period > 0.0):
            raise ValueError(f"period is {period!r}, it must be a positive number of seconds")
        self.model = MotionModel(machine)
        self.period = period
        modes = [f for f in mode_frequencies(machine) if f > 0.0]
        w = 2.0 * np.pi * min([0.5 / period, *modes]) / CLEAR
        rigid = self.model.rigid**2
        mass, viscous = rigid.T @ self.model.mass, rigid.T @ self.model.viscous
        self.proportional = 3.0 * mass * w**2  # N/m
        # Where friction damps more than the poles ask, the speed is left alone.
        self.derivative = np.maximum(3.0 * mass * w - viscous, 0.0)  # Ns/m
        self.integral = mass * w**3  # N/(m s)
        self._sum = np.zeros((0, 2))  # N
        self._axes = np.array([machine.coordinate_names.index(axis) for axis in ("x", "y")])

    def reset(self, mask: NDArray[np.bool_] | None = None) -> None:
        """Forget the integral of the stages of mask (B,), or of all."""
        self._sum = np.zeros((0, 2)) if mask is None or not len(self._sum) else np.where(mask[:, None], 0.0, self._sum)

    def applied(self, actions: Array) -> None:
        """Changes nothing: it remembers errors, and no voltage."""

    def act(self, observation: Mapping[str, NDArray[Any]]) -> Array:
        """Actions (B, 2) in [-1, 1], shares of the rated voltage.

        observation: `observation` (B, 2 n), `desired_goal` (B, 2), m, and for a goal that moves `preview`, as for
        `ModelBasedController.act`.

        Raises ValueError for an observation that is not of this machine.
        """
        state = self.model.state(observation)
        if len(self._sum) != len(state):
            self._sum = np.zeros((len(state), 2))
        speed = state[:, len(self.model.mass) + self._axes]
        goal = np.asarray(observation["desired_goal"], np.float64)
        if "preview" in observation:
            speed = speed - (np.asarray(observation["preview"], np.float64)[:, :2] - goal) / self.period
        error = goal - state[:, self._axes]
        total = self._sum + self.integral * self.period * error
        volts = self.model.voltage(self.proportional * error - self.derivative * speed + total)
        saturated = np.any(np.abs(volts) > self.model.rated, axis=1, keepdims=True)
        self._sum = np.where(saturated, self._sum, total)
        return np.clip(volts / self.model.rated, -1.0, 1.0)
