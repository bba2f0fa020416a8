"""Minimum-energy transfers to rest: point-to-point references and their feedback gains.

A transfer of N periods is a motion that brings the state to rest at the goal within N control periods. With voltages
held over each period, the state error after N periods is A^N e + sum_j A^(N-1-j) B u_j. Of all voltages
that bring the error to zero in N periods, those with the least sum of squares are

    u_j = -B' A'^(N-1-j) W_N^-1 A^N e,      W_N = sum_j A^j B B' A'^j,

and for each number of periods to go the first of them is a feedback gain on the full state. The shortest transfer whose
voltages stay within the limits comes close to the time optimum because back-EMF makes the stage viscous: minimum energy
then means constant voltage during the cruise and an exponential brake that ends at the same voltage with opposite sign.
The belt modes are part of A, so that they are at rest at the end of a transfer.

References:
    Kleinman (1970), An easy way to stabilize a linear constant system, IEEE Transactions on Automatic Control 15(6).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..dynamics import mode_frequencies
from .base import check_period
from .motion_model import AXES, MotionModel, OperatingPointGrid

Array = NDArray[np.float64]
# Shortest transfer in periods of the slowest belt mode; a shorter one needs the mode's frequency more accurately than a
# model has it.
SHORTEST_MODE_PERIODS = 0.6
LONGEST_MARGIN = 1.3  # longest transfer over the time that the longest way takes at top speed
MAX_TRANSFER_S = 10.0  # s, longest transfer of a stage that friction leaves without a top speed
# Periods at the end of a transfer whose voltages are checked against the limits, beside the first; the voltage of the
# cruise is largest in the first period.
CHECKED_FINAL_PERIODS = 7
VELOCITY_SCALE_S = 0.01  # s, typical position error over velocity error, for the condition of W_N


class TransferSelection(NamedTuple):
    """Transfers to rest selected for a batch of B stages.

    Attributes:
        periods: Number of control periods until the stage is at rest at its goal, shape (B,).
        volts: Voltages of the first period of the transfer, V, shape (B, 2).
    """

    periods: NDArray[np.intp]
    volts: Array


class MinimumEnergyTransfers:
    """Feedback gains of minimum-energy transfers to rest, for every operating point and every number of periods.

    Args:
        model: Model of the machine.
        period: Control period, s.

    Attributes:
        model: As given.
        period: As given, s.
        grid: Operating points of the gains.
        shortest: Number of periods of the shortest transfer.
        longest: Number of periods of the longest transfer.
        gains: Gains on the state error at the start of the transfer (belt travel and velocity of n coordinates) for the
            voltages of its first and its last CHECKED_FINAL_PERIODS periods, V/m and Vs/m, shape (points,
            longest - shortest + 1, 1 + CHECKED_FINAL_PERIODS, 2, 2 n).

    Raises:
        InputError: If the period is not positive, or the machine's workspace has no range.
    """

    def __init__(self, model: MotionModel, period: float) -> None:
        self.model = model
        self.period = check_period(period)
        self.grid = OperatingPointGrid(model.machine)
        states, inputs = 2 * len(model.mass), model.drive.shape[1]
        modes = [frequency for frequency in mode_frequencies(model.machine) if frequency > 0.0]
        mode_period = 1.0 / min(modes) if modes else 0.0
        # Fewer than states / inputs periods cannot bring every state to zero.
        self.shortest = max(-(-states // inputs), round(SHORTEST_MODE_PERIODS * mode_period / period))
        top_speed = model.top_speed()
        longest_s = LONGEST_MARGIN * np.sum(self.grid.span / top_speed) if top_speed.min() > 0.0 else MAX_TRANSFER_S
        self.longest = max(self.shortest + 1, int(np.ceil(min(longest_s, MAX_TRANSFER_S) / period)))
        self._matrices = [model.discretize(point, period)[:2] for point in self.grid.points]
        self.gains = self._design(*(np.stack(matrices) for matrices in zip(*self._matrices, strict=True)))

    def _design(self, A: Array, B: Array) -> Array:
        """Compute `gains` from A (points, 2 n, 2 n) and B (points, 2 n, inputs)."""
        states = A.shape[1]
        scale = _state_scale(states)
        A = A / scale[:, None] * scale
        scaled_B = B / scale[:, None]
        W = np.zeros_like(A)
        power = np.broadcast_to(np.eye(states), A.shape)  # A^(N-1)
        back: list[Array] = []  # B' A'^j
        gains = []
        for N in range(1, self.longest + 1):
            back.append((power @ scaled_B).transpose(0, 2, 1))
            W = W + (power @ scaled_B) @ back[-1]
            power = power @ A
            if self.shortest > N:
                continue
            error_to_costate = np.linalg.pinv(W, rcond=1e-15, hermitian=True) @ power / scale
            # Transfers shorter than CHECKED_FINAL_PERIODS repeat their first period.
            rows = [back[-1]] + [back[min(j, N - 1)] for j in reversed(range(CHECKED_FINAL_PERIODS))]
            gains.append(np.stack([-row @ error_to_costate for row in rows], axis=1))
        return np.stack(gains, axis=1)

    def select(
        self, error: Array, goal: Array, limits: tuple[Array, Array], at_least: NDArray[np.intp]
    ) -> TransferSelection:
        """Select for each of B stages the shortest transfer to rest whose voltages stay within the limits.

        Args:
            error: State minus goal state: belt travel (radius * angle of a rotary coordinate) of the n coordinates and
                its velocity, m and m/s, shape (B, 2 n).
            goal: Tool position (x, y) of the goal, m, shape (B, 2).
            limits: Lowest and highest voltages, V, each of shape (B, 2).
            at_least: Minimum number of periods of the transfer, from `shortest` to `longest`, shape (B,).

        Returns:
            Numbers of periods and first voltages; those of the longest transfer where none stays within the limits.
        """
        points = self.grid.nearest(goal)
        lowest, highest = limits
        low, high = at_least - self.shortest, np.full(len(error), self.gains.shape[1] - 1)
        # Bisection, because a longer transfer needs less voltage. With ringing belts that can fail by a period; the
        # selected transfer is then slightly longer than the shortest admissible one.
        while np.any(low < high):
            middle = (low + high) // 2
            volts = np.einsum("bkij,bj->bki", self.gains[points, middle], error)
            admissible = np.all((volts >= lowest[:, None, :]) & (volts <= highest[:, None, :]), axis=(1, 2))
            low, high = np.where(admissible | (low == high), low, middle + 1), np.where(admissible, middle, high)
        volts = np.einsum("bij,bj->bi", self.gains[points, high, 0], error)
        return TransferSelection(high + self.shortest, volts)

    def reference(self, start: Array, goal: Array, limit: Array) -> tuple[Array, Array]:
        """Compute the shortest admissible minimum-energy transfer from rest to rest, without Coulomb friction.

        Args:
            start: Tool position (x, y) at the start, m, shape (2,).
            goal: Tool position (x, y) at the end, m, shape (2,).
            limit: Largest voltage magnitude of each drive, V, shape (2,).

        Returns:
            positions: Tool positions at the start and at the end of each of N periods, m, shape (N + 1, 2).
            volts: Voltages held over each period, V, shape (N, 2).
        """
        start, goal = (np.asarray(point, np.float64)[None] for point in (start, goal))
        error = self.model.goal_state(start) - self.model.goal_state(goal)
        N = int(self.select(error, goal, (-limit[None], limit[None]), np.array([self.shortest])).periods[0])
        A, B = self._matrices[int(self.grid.nearest(goal)[0])]
        scale = _state_scale(len(A))
        A, B = A / scale[:, None] * scale, B / scale[:, None]
        powers = [np.eye(len(A))]
        for _ in range(N):
            powers.append(A @ powers[-1])
        reachability = np.hstack([powers[j] @ B for j in reversed(range(N))])  # (2 n, 2 N)
        volts = -np.linalg.lstsq(reachability, powers[N] @ (error[0] / scale), rcond=None)[0].reshape(N, -1)
        states = [error[0] / scale]
        for u in volts:
            states.append(A @ states[-1] + B @ u)
        axes = [self.model.machine.coordinate_names.index(axis) for axis in AXES]
        return np.array(states)[:, axes] + goal, volts


def _state_scale(states: int) -> Array:
    """Return units (2 n,) in which positions and velocities have similar size, so that W_N is well conditioned."""
    return np.repeat([1.0, 1.0 / VELOCITY_SCALE_S], states // 2)
