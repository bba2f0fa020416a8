"""One PID controller per axis of the tool, tuned by pole placement: the baseline for comparisons."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from typing_extensions import override

from ..arrays import Actions, PreviewedGoals, TravelStates
from ..dynamics import belt_modes
from ..machine import Machine
from .base import CONTROLLERS, FullStateController
from .models.motion_model import OperatingPointGrid

# Slowest belt mode, or half the sampling frequency where that is lower, over the bandwidth of the closed
# loop: the usual rule of thumb.
FREQUENCY_MARGIN = 5.0


@CONTROLLERS.register("textbook-pid")
class TextbookPID(FullStateController):
    """PID control of each axis of the tool; integration stops while a drive saturates (anti-windup).

    Each axis is modeled as a rigid mass m with viscous friction b, m v' = f - b v for velocity v and force f,
    and the gains put all three closed-loop poles at -w, where w is the frequency of the slowest vibration
    mode of the belts (or half the sampling frequency, if that is lower) divided by FREQUENCY_MARGIN. The
    derivative acts on the measured velocity; for a moving goal, on the difference to the goal's velocity.

    Attributes:
        proportional: Proportional gains of the axes, N/m, shape (axes,).
        derivative: Derivative gains of the axes, Ns/m, shape (axes,).
        integral: Integral gains of the axes, N/(m s), shape (axes,).

    References:
        Astrom and Hagglund (2006), Advanced PID Control, chapter 6.
    """

    knowledge: ClassVar[str] = "mass and slowest mode"

    def __init__(self, machine: Machine, period: float = 0.01) -> None:
        super().__init__(machine, period)
        modes = belt_modes(machine)
        bandwidth = 2.0 * np.pi * min([0.5 / period, *modes]) / FREQUENCY_MARGIN  # rad/s
        # Mass and friction of all coordinates, seen along the axes with unstretched belts, kg and Ns/m, each
        # (axes,).
        travel_squared = self.model.rigid**2
        mass, viscous = travel_squared.T @ self.model.mass, travel_squared.T @ self.model.viscous
        # Coefficients of (s + w)^3 = s^3 + 3 w s^2 + 3 w^2 s + w^3 with w = bandwidth.
        self.proportional = 3.0 * mass * bandwidth**2
        # No derivative action where friction damps more than the poles need.
        self.derivative = np.maximum(3.0 * mass * bandwidth - viscous, 0.0)
        self.integral = mass * bandwidth**3
        self._integral_force = np.zeros((0, len(mass)))  # N
        self._axes = np.array(self.model.tool)

    @override
    def concern(self) -> str | None:
        """Return a warning if the sampled linear closed loop is unstable in the workspace, else None.

        It is also returned if the loop is unstable at some positions only. Saturation, dead time, Coulomb
        friction and effects, which may damp the belts, are ignored.
        """
        n, axes = len(self.model.mass), len(self._axes)
        # Select the tool from the state.
        position, velocity = (np.eye(2 * n)[self._axes + shift] for shift in (0, n))
        volts_per_force = self.model.voltage(np.eye(axes)).T
        integral = self.integral * self.period
        state_gain = (self.proportional + integral)[:, None] * position + self.derivative[:, None] * velocity
        largest = 0.0
        for point in OperatingPointGrid(self.machine).points:
            A, B, _ = self.model.discretize(point, self.period)
            B = B @ volts_per_force
            # State: that of the machine and the integrators' force.
            loop = np.block([[A - B @ state_gain, B], [-integral[:, None] * position, np.eye(axes)]])
            largest = max(largest, float(np.abs(np.linalg.eigvals(loop)).max()))
        if largest <= 1.0 + 1e-9:
            return None
        return (
            f"textbook-pid is unstable on machine {self.machine.name!r} at a control period "
            f"of {self.period:g} s, unless dry friction or effects damp it (largest eigenvalue of the closed "
            f"loop without them {largest:.2f}): its one-mass model ignores that the belts stretch"
        )

    @override
    def act_on_state(self, state: TravelStates, goals: PreviewedGoals) -> Actions:
        """Compute the actions; the first previewed goal gives the velocity of the goal."""
        if self._starts.resize(len(state)):
            self._integral_force = np.zeros((len(state), len(self._axes)))
        self._integral_force = np.where(self._starts.mask[:, None], 0.0, self._integral_force)
        self._starts.clear()
        error = goals[:, 0] - state[:, self._axes]
        velocity = state[:, len(self.model.mass) + self._axes]
        if goals.shape[1] > 1:
            velocity = velocity - (goals[:, 1] - goals[:, 0]) / self.period
        integral_force = self._integral_force + self.integral * self.period * error
        force = self.proportional * error - self.derivative * velocity + integral_force  # N, (B, axes)
        volts = self.model.voltage(force)
        # Anti-windup: the integrators keep their values while a drive saturates.
        saturated = np.any(np.abs(volts) > self.model.rated, axis=1, keepdims=True)
        self._integral_force = np.where(saturated, self._integral_force, integral_force)
        return np.clip(volts / self.model.rated, -1.0, 1.0)
