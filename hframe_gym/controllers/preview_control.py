"""Following a goal that moves: the least-squares plan over the goals in sight, made anew every period.

With held voltages the state goes z+ = A z + B u + E f, f the force on each coordinate.  Of all voltages over the H
periods whose goals g are seen, the plan takes those that are least in

    sum_j |C z_j - g_j|^2 + change^2 sum_j |u_j - u_(j-1)|^2,        C z the tool

and plays the first (preview control, Tomizuka 1975, over a finite horizon).  Solved once for each place of the
workspace it is a gain on the state (P and D, of carriage and motors), on the goals (the feed-forward: what speed,
acceleration and back-EMF take, and how far the belts stretch by it, is in A and B), on the last voltage, and on the
forces: the known friction along the path, and, in place of an integral, what the periods so far left unexplained.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .motion_model import MotionModel
from .operating_points import AXES, OperatingPointGrid

Array = NDArray[np.float64]
# m/V: how far off a change of 1 V may leave the tool.  Smaller moves the voltages more and the tool no closer.
CHANGE = 3e-5
LEARN = 0.028  # s, in which what is unexplained is believed; less rings where belts are 40 % softer than the model's
ENOUGH = 0.1  # s of goals in sight; what comes later changes nothing now


class PreviewGains:
    """First voltages of the plans, by place of the workspace.

    period: of control, s; goals: in sight, H; change: m/V.  Attributes (places, 2, .): state (2 n), V per m and m/s;
    last (2), V/V; goal (2 H), V/m; force (n H), V/N, on each coordinate in each period.
    """

    def __init__(
        self, model: MotionModel, places: OperatingPointGrid, period: float, goals: int, change: float
    ) -> None:
        gains = [self._solve(model, *model.discretize(place, period), goals, change) for place in places.points]
        self.state, self.last, self.goal, self.force = (np.stack(g) for g in zip(*gains, strict=True))

    @staticmethod
    def _solve(
        model: MotionModel, A: Array, B: Array, E: Array, goals: int, change: float
    ) -> tuple[Array, Array, Array, Array]:
        C = np.zeros((len(AXES), len(A)))
        for row, axis in enumerate(AXES):
            C[row, model.machine.coordinate_names.index(axis)] = 1.0
        powers = [C]  # C A^j
        for _ in range(goals):
            powers.append(powers[-1] @ A)

        def response(G: Array) -> Array:
            """What inputs by G (2 n, m) in each period do to the tool at the end of each, (2 H, m H)."""
            pulses = [power @ G for power in powers[:goals]]
            zero = np.zeros_like(pulses[0])
            return np.block([[pulses[j - i] if i <= j else zero for i in range(goals)] for j in range(goals)])

        by_volts = response(B)
        inputs = B.shape[1]
        steps = np.eye(inputs * goals) - np.eye(inputs * goals, k=-inputs)
        first = np.asarray(np.linalg.inv(by_volts.T @ by_volts + change**2 * steps.T @ steps)[:inputs], np.float64)
        goal = first @ by_volts.T
        return -goal @ np.vstack(powers[1:]), change**2 * first[:, :inputs], goal, -goal @ response(E)


class PreviewTracker:
    """Plans for B stages, and what each has learnt of the forces on it.

    goals: in sight, H.  A stage's memory begins anew where `fresh` says so.
    """

    def __init__(self, model: MotionModel, places: OperatingPointGrid, period: float, goals: int) -> None:
        self.model, self.places, self.period = model, places, period
        self.goals = min(goals, max(1, round(ENOUGH / period)))
        self.plans = PreviewGains(model, places, period, self.goals, CHANGE)
        steps = [model.discretize(place, period) for place in places.points]
        self._A, self._B, self._E = (np.stack(matrices) for matrices in zip(*steps, strict=True))
        self._share = 1.0 - np.exp(-period / LEARN)
        self._explain = np.linalg.pinv(self._E)
        self._expected = self._unexplained = np.zeros((0, len(model.mass)))  # N

    def learn(self, before: Array, after: Array, volts: Array, fresh: NDArray[np.bool_]) -> None:
        """Take in how states (B, 2 n) went over the last period under volts (B, 2); not for stages fresh (B,)."""
        if len(self._unexplained) != len(after):
            self._expected = self._unexplained = np.zeros((len(after), len(self.model.mass)))
        cells = self.places.nearest(self.model.tool(before))
        expected = _times(self._A[cells], before) + _times(self._B[cells], volts)
        missed = _times(self._explain[cells], after - expected) - self._expected
        self._unexplained = np.where(fresh[:, None], 0.0, self._unexplained + self._share * missed)

    def volts(self, state: Array, goals: Array, last: Array, elapsed_s: Array) -> Array:
        """First voltages (B, 2) of the plans, V, within the rated ones.

        state (B, 2 n), m and m/s; goals (B, 1 + H or more, 2), m, now and at the end of each period; last (B, 2), V,
        given in the period before; elapsed_s (B,) since the episode began.
        """
        model, H = self.model, self.goals
        goals = goals[:, : H + 1]
        speed = np.diff(goals, axis=1) / self.period
        middle = 0.5 * (goals[:, 1:] + goals[:, :-1])
        path = np.concatenate([middle @ model.rigid.T, speed @ model.rigid.T], axis=2).reshape(len(state) * H, -1)
        times = (elapsed_s[:, None] + self.period * (0.5 + np.arange(H))).ravel()
        known = (model.friction(path, times) + model.pushes(path, times)).reshape(len(state), H, -1)
        force = known + self._unexplained[:, None]
        self._expected = force[:, 0]
        cells, plans = self.places.nearest(goals[:, 0]), self.plans
        volts = _times(plans.state[cells], state) + _times(plans.last[cells], last)
        volts += _times(plans.goal[cells], goals[:, 1:].reshape(len(state), -1))
        volts += _times(plans.force[cells], force.reshape(len(state), -1))
        return np.clip(volts, -model.rated, model.rated)


def _times(matrices: Array, vectors: Array) -> Array:
    """Matrices (B, i, j) times vectors (B, j)."""
    return np.asarray(np.einsum("bij,bj->bi", matrices, vectors))
