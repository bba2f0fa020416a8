"""Friction, masses and belts of a stage as an episode shows them, by recursive least squares on momentum balances.

The balance of the rigid motion (belts are internal to it and drop out) and that of the tool leave, in every period and
beyond the model's own friction, belts and effects, along x and y in N,

    rigid   D = sum_c r_c (-(s_c - 1) F_c dir_c - d_c m_c a_c)      r_c: what the rigid motion moves coordinate c
    tool    D = -(s_c - 1) F_c dir_c - d_c m_c a_c + e B_c          c = x, y,

linear in s_c, how many times the model's Coulomb level F_c there is at coordinate c, d_c, by what share its mass is
more than m_c, and e, by what share the belts' pull is more than B_c.  A Kalman filter with constant parameters
estimates all from the motion so far (Ljung 1999, section 11.2).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..machine.linearization import stiffness_matrix
from .motion_model import MotionModel
from .operating_points import AXES, OperatingPointGrid

Array = NDArray[np.float64]
# Standard deviations before anything was seen, about those of `default`: of friction's factor, the masses', the belts'.
FRICTION, MASS, BELTS = 0.5, 0.1, 0.2
NOISE = 0.7  # N, of a balance over a period,
TURNED = 1.0  # besides it of the friction of a coordinate that turned over in the period,
PULL = 0.15  # and for the tool of the belts' pull: their lengths are not as declared either
TURN = 0.01  # m/s, over which friction turns over


class MomentumFilter:
    """Estimates for B stages of one machine with n coordinates.

    period: of control, s.  Attributes: estimates (B, 2 n + 1), s_c - 1, d_c, then e, zero before anything was seen.
    """

    def __init__(self, model: MotionModel, period: float) -> None:
        n = len(model.mass)
        self.model, self.period = model, period
        self._tool = [model.machine.coordinate_names.index(axis) for axis in AXES]
        self._places = OperatingPointGrid(model.machine)
        radii = model.machine.radii
        self._stiffness = np.stack(
            [stiffness_matrix(model.machine, model.rigid @ p / radii)[self._tool] for p in self._places.points]
        ) / (radii[self._tool, None] * radii)
        # Rows: the rigid motion along x and y, then the tool's own; columns: the coordinates.
        self._rows = np.vstack([model.rigid.T, np.eye(n)[self._tool]])
        self._prior = np.concatenate([np.full(n, FRICTION), np.full(n, MASS), [BELTS]])
        self.estimates, self._covariance = np.zeros((0, 2 * n + 1)), np.zeros((0, 2 * n + 1, 2 * n + 1))

    @property
    def belts(self) -> Array:
        """How many times as stiff as the model's the belts are (B,)."""
        return 1.0 + self.estimates[:, -1]

    @property
    def masses(self) -> Array:
        """How many times the model's the mass is that moves along x and y (B, 2)."""
        n, moves = len(self.model.mass), self.model.mass[:, None] * self.model.rigid**2
        return 1.0 + self.estimates[:, n:-1] @ (moves / moves.sum(axis=0))

    def learn(self, before: Array, after: Array, volts: Array, known: Array, fresh: NDArray[np.bool_]) -> None:
        """Take in how states (B, 2 n), m and m/s of travel, went over a period under volts (B, 2), V, at the motors.

        known: forces (B, n), N, of the machine's effects on each coordinate.  Of stages fresh (B,), whose episode
        begins with `after`, all is forgotten.
        """
        model, n = self.model, len(self.model.mass)
        if len(self.estimates) != len(fresh):
            size = len(self._prior)
            self.estimates, self._covariance = np.zeros((len(fresh), size)), np.zeros((len(fresh), size, size))
        speeds = before[:, n:], after[:, n:]
        pull = self._pull(before, after)
        friction = _direction(*speeds) * model.coulomb
        gained = model.mass * (after[:, n:] - before[:, n:]) / self.period
        resisted = model.viscous * (after[:, :n] - before[:, :n]) / self.period + friction
        own = gained + resisted - volts @ model.drive.T - known
        D = own @ self._rows.T
        D[:, 2:] -= pull
        H = np.zeros((len(D), 4, len(self._prior)))
        H[:, :, :-1] = -np.concatenate([friction, gained], axis=1)[:, None] * np.hstack([self._rows] * 2)
        H[:, 2:, -1] = pull
        turned = np.tanh(speeds[1] / TURN) - np.tanh(speeds[0] / TURN)
        doubt = NOISE**2 + TURNED**2 * (turned * model.coulomb) ** 2 @ self._rows.T**2
        doubt[:, 2:] += (PULL * pull) ** 2
        PH = self._covariance @ H.transpose(0, 2, 1)
        S = H @ PH + doubt[:, :, None] * np.eye(4)
        K = np.linalg.solve(S, PH.transpose(0, 2, 1)).transpose(0, 2, 1)
        self.estimates = self.estimates + np.einsum("bpa,ba->bp", K, D - np.einsum("bap,bp->ba", H, self.estimates))
        self._covariance = self._covariance - K @ PH.transpose(0, 2, 1)
        self.estimates[fresh], self._covariance[fresh] = 0.0, np.diag(self._prior**2)

    def _pull(self, before: Array, after: Array) -> Array:
        """Mean pull (B, 2), N, of the model's belts on the tool along x and y, over a period."""
        n = len(self.model.mass)
        # Of the cubic through both ends with their slopes: belts swing in two or three periods.
        mean = 0.5 * (before[:, :n] + after[:, :n]) + self.period / 12.0 * (before[:, n:] - after[:, n:])
        cells = self._places.nearest(self.model.tool(after))
        return -np.einsum("bij,bj->bi", self._stiffness[cells], mean)

    def friction_ahead(self, goals: Array) -> Array:
        """Voltages (B, k - 2, 2), V, that friction will take beyond the model's where goals (B, k, 2), m, now and a
        period apart, are followed."""
        model, n = self.model, len(self.model.mass)
        middle = np.diff(goals, axis=1) / self.period
        inside = 0.5 * (middle[:, 1:] + middle[:, :-1])
        speeds = np.concatenate([2.0 * middle[:, :1] - inside[:, :1], inside], axis=1) @ model.rigid.T
        takes = self.estimates[:, None, :n] * model.coulomb * _direction(speeds[:, :-1], speeds[:, 1:])
        return model.voltage(takes @ model.rigid)


def _direction(before: Array, after: Array) -> Array:
    """Mean of tanh(v / TURN) over a period in which speeds go evenly from `before` to `after`."""
    gained = (after - before) / TURN
    area = np.logaddexp(after / TURN, -after / TURN) - np.logaddexp(before / TURN, -before / TURN)  # of log cosh
    even = np.abs(gained) < 1e-4
    return np.asarray(np.where(even, np.tanh(0.5 * (before + after) / TURN), area / np.where(even, 1.0, gained)))
