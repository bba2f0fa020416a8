"""Point-to-point references: the least-effort transfers to rest in N control periods, belts included.

With held voltages the state after N periods is A^N e + sum A^(N-1-j) B u_j.  Of all voltages that bring an error e to
zero in N periods, those least in square are

    u_j = -B' A'^(N-1-j) W_N^-1 A^N e,      W_N = sum A^j B B' A'^j            (Kleinman 1970)

and the first of them, for each time to go, is a feedback gain on the whole state.  The least N whose voltages keep within
the limit is close to the least possible time because the motors' back-EMF makes the stage viscous: least effort is then a
constant voltage in cruise and an exponential brake that ends at the same voltage with the other sign.  The belts' modes
are in A, so a transfer ends with them at rest.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..machine import mode_frequencies
from .model import AXES, MotionModel

Array = NDArray[np.float64]
GRID = (9, 7)  # places of the workspace for which the belts' stiffness is worked out: within 5 % of any between them
SHORTEST = 0.6  # of the slowest belt mode's period: less time relies on more of the mode's frequency than a model knows
MARGIN = 1.3  # of the longest transfer over the longest way at top speed
SLOWEST = 10.0  # s, longest transfer of a stage whose friction leaves it no top speed
LAST = 7  # periods at the end of a transfer that are checked against the limit; its cruise peaks at the first
SPEED_SCALE = 0.01  # s, of speeds against positions, for the condition of W_N


class Choice(NamedTuple):
    """The transfer chosen for each stage: periods to go (B,) and the voltages (B, 2) of its first period, V."""

    periods: NDArray[np.intp]
    volts: Array


class Transfers:
    """Transfers to rest for every place of the goal and every time to go.

    period: of control, s.  Attributes: shortest, longest, periods of a transfer; gains (9, 7, longest - shortest + 1,
    8, 2, 2 n), V per m and m/s: the first period and the last seven, by place and time to go.

    Raises ValueError for a period that is not positive, or a machine whose workspace has no range.
    """

    def __init__(self, model: MotionModel, period: float) -> None:
        if not (np.isfinite(period) and period > 0.0):
            raise ValueError(f"period is {period!r}, it must be a positive number of seconds")
        ranges = [model.machine.coordinate(axis).range for axis in AXES]
        if None in ranges:
            raise ValueError(f"machine {model.machine.name!r}: x and y need a range to be controlled in")
        self.model = model
        self.period = period
        self._places = [np.linspace(*edges, count) for edges, count in zip(ranges, GRID, strict=True)]  # type: ignore[misc]
        states, inputs = 2 * len(model.mass), model.drive.shape[1]
        modes = [f for f in mode_frequencies(model.machine) if f > 0.0]
        mode_period = 1.0 / min(modes) if modes else 0.0
        # Fewer periods than this cannot zero every state.
        self.shortest = max(-(-states // inputs), round(SHORTEST * mode_period / period))
        speed = model.top_speed()
        spans = np.array([p[-1] - p[0] for p in self._places])
        longest = MARGIN * np.sum(spans / speed) if speed.min() > 0.0 else SLOWEST
        self.longest = max(self.shortest + 1, int(np.ceil(min(longest, SLOWEST) / period)))
        cells = [
            model.discretise(np.array([x, y]), period) for x in self._places[0] for y in self._places[1]
        ]
        A, B = (np.stack(matrices) for matrices in zip(*cells, strict=True))
        self.gains = self._gains(A, B).reshape(*GRID, -1, LAST + 1, inputs, states)

    def _gains(self, A: Array, B: Array) -> Array:
        """Gains (cells, times, 1 + LAST, inputs, 2 n) from A (cells, 2 n, 2 n) and B (cells, 2 n, inputs)."""
        states = A.shape[1]
        scale = np.repeat([1.0, 1.0 / SPEED_SCALE], states // 2)
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
            if N < self.shortest:
                continue
            whole = np.linalg.pinv(W, rcond=1e-15, hermitian=True) @ power / scale
            # Transfers shorter than LAST repeat their first period.
            rows = [back[-1]] + [back[min(j, N - 1)] for j in reversed(range(LAST))]
            times.append(np.stack([-row @ whole for row in rows], axis=1))
        return np.stack(times, axis=1)

    def choose(self, error: Array, goal: Array, limit: Array, at_least: NDArray[np.intp]) -> Choice:
        """The fastest transfers whose voltages keep within a limit.

        error (B, 2 n): state less goal state, m and m/s; goal (B, 2), m; limit (B, 2), V; at_least (B,) periods.  Where no
        transfer keeps within the limit it is the longest.
        """
        cells = tuple(np.abs(goal[:, i : i + 1] - p).argmin(axis=1) for i, p in enumerate(self._places))
        gains = self.gains[cells]
        volts = (gains @ error[:, None, None, :, None])[..., 0]
        fits = np.all(np.abs(volts) <= limit[:, None, None, :], axis=(2, 3))
        fits &= np.arange(self.shortest, self.longest + 1) >= at_least[:, None]
        fits[:, -1] = True
        first = fits.argmax(axis=1)
        return Choice(first + self.shortest, volts[np.arange(len(error)), first, 0])

    def reference(self, start: Array, goal: Array, limit: Array) -> tuple[Array, Array]:
        """The whole transfer of the frictionless model from rest at start (2,) to goal (2,), m, within limit (2,), V.

        Returns tool positions (N + 1, 2), m, one a period, and voltages (N, 2), V.
        """
        goal = np.asarray(goal, np.float64)
        origin = self.model.goal_state(np.asarray(start)[None]) - self.model.goal_state(goal[None])
        A, B = self.model.discretise(self._nearest(goal), self.period)
        error, volts, path = origin, [], [origin]
        go = self.choose(error, goal[None], limit[None], np.array([self.shortest])).periods
        for left in range(int(go[0]), 0, -1):
            row = self.gains[self._cell(goal)][max(left, self.shortest) - self.shortest]
            # The last periods of a transfer are kept as rows, for it is no longer a transfer of its own.
            if left >= self.shortest:
                u, final = error @ row[0].T, error
            else:
                u = final @ row[1 + LAST - left].T
            volts.append(u[0])
            error = error @ A.T + u @ B.T
            path.append(error)
        axes = [self.model.machine.coordinate_names.index(axis) for axis in AXES]
        return np.concatenate(path)[:, axes] + goal, np.array(volts)

    def _cell(self, goal: Array) -> tuple[int, ...]:
        return tuple(int(np.abs(g - p).argmin()) for g, p in zip(goal, self._places, strict=True))

    def _nearest(self, goal: Array) -> Array:
        return np.array([p[i] for p, i in zip(self._places, self._cell(goal), strict=True)])
