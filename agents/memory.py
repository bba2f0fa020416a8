"""What a stage has shown of its friction and masses in an episode, by recursive least squares.

The momentum balance of the rigid motion (belts are internal to it and drop out) leaves, in every period,

    D = sum_c r_c (-(s_c - 1) F_c dir_c - d_c m_c a_c)        beyond the model's own friction, N along x and y,

linear in s_c, how many times the model's Coulomb level F_c there is at coordinate c, and d_c, by what share its mass is
more than m_c.  A Kalman filter with constant parameters estimates both from the motion so far; with them the same sum
says what the motion to come will take (Ljung 1999, section 11.2).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hframe_gym.control.model import MotionModel

Array = NDArray[np.float64]
# Standard deviations before anything was seen: of friction's factor and of the masses', about those of `default`.
FRICTION, MASS = 0.5, 0.1
NOISE = 0.7  # N, of the balance over a period: friction that turns over within it, mostly
TURNED = 1.0  # of the friction of a coordinate that turned over in a period, when it was not seen in which way
TURN = 0.01  # m/s, over which a speed changes its sign


class Memory:
    """Estimates for B stages of one machine.

    period: of control, s.
    """

    def __init__(self, model: MotionModel, period: float) -> None:
        n = len(model.mass)
        self.model, self.period = model, period
        self._prior = np.concatenate([np.full(n, FRICTION), np.full(n, MASS)])
        self._mean, self._covariance = np.zeros((0, 2 * n)), np.zeros((0, 2 * n, 2 * n))

    def learn(self, before: Array, after: Array, volts: Array, fresh: NDArray[np.bool_]) -> None:
        """Take in how states (B, 2 n), m and m/s of travel, went over a period under volts (B, 2), V.

        Of stages fresh (B,), whose episode begins with `after`, all is forgotten.
        """
        model, n = self.model, len(self.model.mass)
        if len(self._mean) != len(fresh):
            self._mean, self._covariance = np.zeros((len(fresh), 2 * n)), np.zeros((len(fresh), 2 * n, 2 * n))
        speeds = before[:, n:], after[:, n:]
        H = self._regressors(*speeds)
        own = -(_direction(*speeds) * model.coulomb) @ model.rigid
        missed = model.disturbance(before, after, volts, self.period) - own - np.einsum("bap,bp->ba", H, self._mean)
        PH = self._covariance @ H.transpose(0, 2, 1)
        turned = np.tanh(speeds[1] / TURN) - np.tanh(speeds[0] / TURN)
        doubt = NOISE**2 + TURNED**2 * (turned * model.coulomb) ** 2 @ model.rigid**2
        S = H @ PH + doubt[:, :, None] * np.eye(2)
        K = np.linalg.solve(S, PH.transpose(0, 2, 1)).transpose(0, 2, 1)
        self._mean = self._mean + np.einsum("bpa,ba->bp", K, missed)
        self._covariance = self._covariance - K @ PH.transpose(0, 2, 1)
        self._mean[fresh], self._covariance[fresh] = 0.0, np.diag(self._prior**2)

    def expects(self, goals: Array) -> Array:
        """Voltages (B, k - 2, 2), V, beyond what the model itself says, that it takes to follow goals (B, k, 2), m,
        now and a period apart."""
        middle = np.diff(goals, axis=1) / self.period
        inside = 0.5 * (middle[:, 1:] + middle[:, :-1])
        speeds = np.concatenate([2.0 * middle[:, :1] - inside[:, :1], inside], axis=1)
        travel = speeds @ self.model.rigid.T
        B, k, n = travel.shape
        H = self._regressors(travel[:, :-1].reshape(-1, n), travel[:, 1:].reshape(-1, n)).reshape(B, k - 1, 2, -1)
        return -self.model.voltage(np.einsum("bkap,bp->bka", H, self._mean))

    def _regressors(self, before: Array, after: Array) -> Array:
        """(B, 2, 2 n): of D, by the parameters, where speeds of travel (B, n) go from `before` to `after`."""
        model = self.model
        turning = _direction(before, after) * model.coulomb
        gained = (after - before) / self.period * model.mass
        return -np.einsum("bp,pa->bap", np.concatenate([turning, gained], axis=1), np.vstack([model.rigid] * 2))


def _direction(before: Array, after: Array) -> Array:
    """Mean of tanh(v / TURN) over a period in which speeds go evenly from `before` to `after`."""
    gained = (after - before) / TURN
    area = np.logaddexp(after / TURN, -after / TURN) - np.logaddexp(before / TURN, -before / TURN)  # of log cosh
    even = np.abs(gained) < 1e-4
    return np.where(even, np.tanh(0.5 * (before + after) / TURN), area / np.where(even, 1.0, gained))
