"""A stage that advances by Euler steps under held voltages."""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from tests.euler_simulator.dynamics import (
    COORDINATES,
    ECCENTRICITY_M,
    ECCENTRICITY_PHASE,
    FIELDS,
    FRAME,
    RADIUS_M,
    STATE,
    YAW,
    Array,
    advance,
)

DEFAULT_STEP_S = 4e-6
_SAME_TIME_S = 1e-12


def parameter_table(**values: float | tuple[float, ...] | Array) -> Array:
    """Return the table of parameters for `EulerStage`.

    Args:
        **values: Value of every field: per coordinate (four, without the yaw, or five), belt or drive, or a
            number.

    Returns:
        The table, shape (len(FIELDS), 5).

    Raises:
        ValueError: If a field is missing or unknown.
    """
    if set(values) != set(FIELDS):
        raise ValueError(f"missing or unknown fields: {sorted(set(values) ^ set(FIELDS))}")
    table = np.zeros((len(FIELDS), COORDINATES))
    for row, name in enumerate(FIELDS):
        value = np.atleast_1d(np.asarray(values[name], float))
        table[row, : len(value)] = value
    return table


class EulerStage:
    """Stage, at first at rest with unstretched belts.

    Attributes:
        time_s: Present time, s.

    Args:
        parameters: Parameters of the stage, see `parameter_table`.
        delay_s: Delay of the voltage of each drive, s.
        start_xy: Position of the carriage, m.
        start_s: Time at the beginning, s.
        step_s: Longest step, s.
    """

    def __init__(
        self,
        parameters: Array,
        delay_s: tuple[float, float] = (0.0, 0.0),
        start_xy: tuple[float, float] = (0.0, 0.0),
        start_s: float = 0.0,
        step_s: float = DEFAULT_STEP_S,
    ) -> None:
        self.time_s, self._step_s = float(start_s), step_s
        self._parameters, self._delay_s = parameters, delay_s
        x, y = start_xy
        self._state = np.zeros(STATE)
        self._state[:4] = x, y, self._unstretched(0, -x - y), self._unstretched(1, x - y)
        self._volts = np.zeros(2)
        self._pending: tuple[deque[tuple[float, float]], ...] = (deque(), deque())

    def _unstretched(self, j: int, travel: float) -> float:
        """Return the angle, rad, at which a pulley has drawn in a length of belt, m, by iteration."""
        p = self._parameters
        r, e, phase = p[RADIUS_M, 0], p[ECCENTRICITY_M, j], p[ECCENTRICITY_PHASE, j]
        angle = travel / r
        for _ in range(60):
            angle = (travel - e * math.sin(angle + phase)) / r
        return float(angle)

    @property
    def position(self) -> Array:
        """x, y of the tool, m, as the lasers see it, and phi1, phi2, rad, shape (4,)."""
        s = self._state
        return np.array([s[0] + s[1] * s[YAW] + s[FRAME], s[1], s[2], s[3]])

    @property
    def velocity(self) -> Array:
        """Rates of the position, m/s and rad/s, shape (4,)."""
        s = self._state
        v = s[COORDINATES:]
        return np.array([v[0] + v[1] * s[YAW] + s[1] * v[YAW] + s[FRAME + 1], v[1], v[2], v[3]])

    def step(self, volts: tuple[float, float] | Array, until_s: float) -> None:
        """Hold the commanded voltages until a time.

        Args:
            volts: Voltages of motor 1 and 2, V.
            until_s: Time to advance to, s.
        """
        for queue, value, delay in zip(self._pending, volts, self._delay_s, strict=True):
            queue.append((self.time_s + delay, float(value)))
        while until_s - self.time_s > _SAME_TIME_S:
            end = until_s
            for j, queue in enumerate(self._pending):
                while queue and queue[0][0] <= self.time_s + _SAME_TIME_S:
                    self._volts[j] = queue.popleft()[1]
                if queue:
                    end = min(end, queue[0][0])
            length = end - self.time_s
            steps = max(1, math.ceil(length / self._step_s - 1e-6))
            advance(self.time_s, length / steps, steps, self._state, self._volts, self._parameters)
            self.time_s = end
