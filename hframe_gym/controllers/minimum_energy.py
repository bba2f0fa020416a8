"""Point-to-point references: the least-effort transfers to rest in N control periods, belts included.

With held voltages the state after N periods is A^N e + sum A^(N-1-j) B u_j.  Of all voltages that bring an error e to
zero in N periods, those least in square are

    u_j = -B' A'^(N-1-j) W_N^-1 A^N e,      W_N = sum A^j B B' A'^j            (Kleinman 1970)

and the first of them, for each time to go, is a feedback gain on the whole state.  The least N whose voltages keep
within the limit is close to the least possible time because the motors' back-EMF makes the stage viscous: least effort
is then a constant voltage in cruise and an exponential brake that ends at the same voltage with the other sign.  The
modes of the belts are in A, so a transfer ends with them at rest.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..machine import mode_frequencies
from .motion_model import MotionModel
from .operating_points import AXES, OperatingPointGrid

Array = NDArray[np.float64]
SHORTEST = 0.6  # of the slowest belt mode's period: less time relies on more of the mode's frequency than a model knows
MARGIN = 1.3  # of the longest transfer over the longest way at top speed
SLOWEST = 10.0  # s, longest transfer of a stage whose friction leaves it no top speed
LAST = 7  # periods at the end of a transfer that are checked against the limit; its cruise peaks at the first
SPEED_SCALE = 0.01  # s, of speeds against positions, for the condition of W_N


class Choice(NamedTuple):
    """The transfer chosen for each stage: periods to go (B,) and the voltages (B, 2) of its first period, V."""

    periods: NDArray[np.intp]
    volts: Array


class MinimumEnergyTransfers:
    """Transfers to rest for every place of the goal and every time to go.

    period: of control, s.  Attributes: shortest, longest, periods of a transfer; gains (63, longest - shortest + 1, 8,
    2, 2 n), V per m and m/s: of the first period and the last seven, by place and time to go.

    Raises ValueError for a period that is not positive, or a machine whose workspace has no range.
    """

    def __init__(self, model: MotionModel, period: float) -> None:
        if not (np.isfinite(period) and period > 0.0):
            raise ValueError(f"period is {period!r}, it must be a positive number of seconds")
        self.model = model
        self.period = period
        self.places = OperatingPointGrid(model.machine)
        states, inputs = 2 * len(model.mass), model.drive.shape[1]
        modes = [f for f in mode_frequencies(model.machine) if f > 0.0]
        mode_period = 1.0 / min(modes) if modes else 0.0
        # Fewer periods than this cannot zero every state.
        self.shortest = max(-(-states // inputs), round(SHORTEST * mode_period / period))
        speed = model.top_speed()
        longest = MARGIN * np.sum(self.places.span / speed) if speed.min() > 0.0 else SLOWEST
        self.longest = max(self.shortest + 1, int(np.ceil(min(longest, SLOWEST) / period)))
        self._matrices = [model.discretize(place, period)[:2] for place in self.places.points]
        self.gains = self._gains(*(np.stack(matrices) for matrices in zip(*self._matrices, strict=True)))

    def _gains(self, A: Array, B: Array) -> Array:
        """Gains (cells, times, 1 + LAST, inputs, 2 n) from A (cells, 2 n, 2 n) and B (cells, 2 n, inputs)."""
        states = A.shape[1]
        scale = _scale(states)
        A = A / scale[:, None] * scale
        scaled = B / scale[:, None]
        W = np.zeros_like(A)
        power = np.broadcast_to(np.eye(states), A.shape)
        back: list[Array] = []  # B' A'^j
        times = []
        for N in range(1, self.longest + 1):
            back.append((power @ scaled).transpose(0, 2, 1))
            W = W + (power @ scaled) @ back[-1]
            power = power @ A
            if self.shortest > N:
                continue
            whole = np.linalg.pinv(W, rcond=1e-15, hermitian=True) @ power / scale
            # Transfers shorter than LAST repeat their first period.
            rows = [back[-1]] + [back[min(j, N - 1)] for j in reversed(range(LAST))]
            times.append(np.stack([-row @ whole for row in rows], axis=1))
        return np.stack(times, axis=1)

    def choose(self, error: Array, goal: Array, limits: tuple[Array, Array], at_least: NDArray[np.intp]) -> Choice:
        """The fastest transfers whose voltages keep within limits.

        error (B, 2 n): state less goal state, m and m/s; goal (B, 2), m; limits (B, 2) each, lowest and highest V;
        at_least (B,) periods.  Where no transfer keeps within the limits it is the longest.
        """
        cells = self.places.nearest(goal)
        lowest, highest = limits
        low, high = at_least - self.shortest, np.full(len(error), self.gains.shape[1] - 1)
        # By bisection, for a longer transfer takes less voltage; where the belts still ring that may fail by a period,
        # and the transfer found is a little longer than the fastest.
        while np.any(low < high):
            middle = (low + high) // 2
            volts = np.einsum("bkij,bj->bki", self.gains[cells, middle], error)
            fits = np.all((volts >= lowest[:, None, :]) & (volts <= highest[:, None, :]), axis=(1, 2))
            low, high = np.where(fits | (low == high), low, middle + 1), np.where(fits, middle, high)
        volts = np.einsum("bij,bj->bi", self.gains[cells, high, 0], error)
        return Choice(high + self.shortest, volts)

    def reference(self, start: Array, goal: Array, limit: Array) -> tuple[Array, Array]:
        """The whole transfer of the frictionless model from rest at start (2,) to goal (2,), m, within limit (2,), V.

        Returns tool positions (N + 1, 2), m, one a period, and voltages (N, 2), V.
        """
        start, goal = (np.asarray(point, np.float64)[None] for point in (start, goal))
        error = self.model.goal_state(start) - self.model.goal_state(goal)
        N = int(self.choose(error, goal, (-limit[None], limit[None]), np.array([self.shortest])).periods[0])
        A, B = self._matrices[int(self.places.nearest(goal)[0])]
        scale = _scale(len(A))
        A, B = A / scale[:, None] * scale, B / scale[:, None]
        powers = [np.eye(len(A))]
        for _ in range(N):
            powers.append(A @ powers[-1])
        reach = np.hstack([powers[j] @ B for j in reversed(range(N))])
        volts = -np.linalg.lstsq(reach, powers[N] @ (error[0] / scale), rcond=None)[0].reshape(N, -1)
        states = [error[0] / scale]
        for u in volts:
            states.append(A @ states[-1] + B @ u)
        axes = [self.model.machine.coordinate_names.index(axis) for axis in AXES]
        return np.array(states)[:, axes] + goal, volts


def _scale(states: int) -> Array:
    """Units (2 n,) in which positions and speeds have like size: W_N is then far better conditioned."""
    return np.repeat([1.0, 1.0 / SPEED_SCALE], states // 2)
