"""Preview control: track a moving goal by a least-squares plan over the previewed goals, renewed every period.

With voltages held over each period the state follows z+ = A z + B u + E f, where f is the force on each coordinate. Of
all voltages over the H previewed periods the plan takes those that minimize

    sum_j |C z_j - g_j|^2 + w^2 sum_j |u_j - u_(j-1)|^2,        C z: tool position, g: goal,

and applies the first. Solved once for each operating point, this is a constant gain on the state, on the goals
(feedforward of velocity, acceleration, back-EMF and belt stretch, which are all part of A and B), on the last voltage
and on the forces: the modeled friction along the path and, in place of an integrator, the estimated disturbance.

References:
    Tomizuka (1975), Optimal continuous finite preview problem, IEEE Transactions on Automatic Control 20(3).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .motion_model import AXES, MotionModel, OperatingPointGrid

Array = NDArray[np.float64]
# m/V, the weight w: tool error that is as costly as a voltage change of 1 V. Tuned: a smaller weight makes the voltages
# more active and the tool no more accurate.
VOLTAGE_CHANGE_WEIGHT = 3e-5
# s, time constant of the disturbance estimate. Tuned: smaller values ring where belts are 40 % softer than the model's.
DISTURBANCE_TIME_CONSTANT_S = 0.028
HORIZON_S = 0.1  # s; goals farther ahead do not change the first voltage


class PreviewGains:
    """Gains of preview control, which give the first voltage of the least-squares plan, by operating point.

    The state holds the belt travel (radius * angle of a rotary coordinate) of n coordinates and its velocity.

    Args:
        model: Model of the machine.
        grid: Operating points (tool positions) for which gains are computed.
        period: Control period, s.
        horizon: Number of previewed goals, H.
        change_weight: Weight w of voltage changes, m/V.

    Attributes:
        state: Gains on the present state, V/m and Vs/m, shape (points, 2, 2 n).
        last: Gains on the voltages of the previous period, V/V, shape (points, 2, 2).
        goal: Gains on the previewed goals (x, y), V/m, shape (points, 2, 2 H).
        force: Gains on the force on each coordinate in each period, V/N, shape (points, 2, n H).
        A: Discrete-time system matrices, shape (points, 2 n, 2 n).
        B: Discrete-time input matrices of the voltages, m/V and m/(Vs), shape (points, 2 n, 2).
        E: Discrete-time input matrices of the forces on the coordinates, m/N and m/(Ns), shape (points, 2 n, n).
    """

    def __init__(
        self, model: MotionModel, grid: OperatingPointGrid, period: float, horizon: int, change_weight: float
    ) -> None:
        matrices = [model.discretize(point, period) for point in grid.points]
        self.A, self.B, self.E = (np.stack(by_point) for by_point in zip(*matrices, strict=True))
        gains = [self._solve(model, *ABE, horizon, change_weight) for ABE in matrices]
        self.state, self.last, self.goal, self.force = (np.stack(g) for g in zip(*gains, strict=True))

    @staticmethod
    def _solve(
        model: MotionModel, A: Array, B: Array, E: Array, horizon: int, change_weight: float
    ) -> tuple[Array, Array, Array, Array]:
        """Return the gains on state, last voltage, goals and forces at one operating point."""
        C = np.zeros((len(AXES), len(A)))
        for row, axis in enumerate(AXES):
            C[row, model.machine.coordinate_names.index(axis)] = 1.0
        powers = [C]  # C A^j
        for _ in range(horizon):
            powers.append(powers[-1] @ A)

        def impulse_response(G: Array) -> Array:
            """Response of the tool at each period's end to inputs by G (2 n, m) in each period, (2 H, m H)."""
            pulses = [power @ G for power in powers[:horizon]]
            zero = np.zeros_like(pulses[0])
            return np.block([[pulses[j - i] if i <= j else zero for i in range(horizon)] for j in range(horizon)])

        volts_response = impulse_response(B)
        inputs = B.shape[1]
        difference = np.eye(inputs * horizon) - np.eye(inputs * horizon, k=-inputs)
        normal = volts_response.T @ volts_response + change_weight**2 * difference.T @ difference
        first = np.asarray(np.linalg.inv(normal)[:inputs], np.float64)
        goal = first @ volts_response.T
        return -goal @ np.vstack(powers[1:]), change_weight**2 * first[:, :inputs], goal, -goal @ impulse_response(E)


class PreviewTracker:
    """Preview control of the tool position of B stages (simulated machines), with a disturbance observer.

    Args:
        model: Model of the machine.
        grid: Operating points of the gains.
        period: Control period, s.
        goals: Number of previewed goals that `command` receives; those beyond `HORIZON_S` are not used.

    Attributes:
        horizon: Number of previewed goals that are used, H.
        gains: Preview gains by operating point.
    """

    def __init__(self, model: MotionModel, grid: OperatingPointGrid, period: float, goals: int) -> None:
        self.model, self.grid, self.period = model, grid, period
        self.horizon = min(goals, max(1, round(HORIZON_S / period)))
        self.gains = PreviewGains(model, grid, period, self.horizon, VOLTAGE_CHANGE_WEIGHT)
        self._filter_gain = 1.0 - np.exp(-period / DISTURBANCE_TIME_CONSTANT_S)
        self._force_from_residual = np.linalg.pinv(self.gains.E)
        self._planned_force = self._disturbance = np.zeros((0, len(model.mass)))  # N

    def update_disturbance(self, before: Array, after: Array, volts: Array, starts: NDArray[np.bool_]) -> None:
        """Update the low-pass filtered disturbance forces with the one-step prediction error of the last period.

        Args:
            before: States at the start of the period: belt travel (radius * angle of a rotary coordinate) of the n
                coordinates and its velocity, m and m/s, shape (B, 2 n).
            after: States at the end of the period, m and m/s, shape (B, 2 n).
            volts: Voltages at the motors in the period, V, shape (B, 2).
            starts: True for stages whose episode starts with `after`, shape (B,); their estimate is set to zero.
        """
        if len(self._disturbance) != len(after):
            self._planned_force = self._disturbance = np.zeros((len(after), len(self.model.mass)))
        points = self.grid.nearest(self.model.tool_position(before))
        predicted = _matvec(self.gains.A[points], before) + _matvec(self.gains.B[points], volts)
        residual = _matvec(self._force_from_residual[points], after - predicted) - self._planned_force
        self._disturbance = np.where(starts[:, None], 0.0, self._disturbance + self._filter_gain * residual)

    def command(self, state: Array, goals: Array, last: Array, elapsed_s: Array) -> Array:
        """Compute the motor voltages that track the previewed goals, for the period that starts now.

        Args:
            state: Present states: belt travel of the n coordinates and its velocity, m and m/s, shape (B, 2 n).
            goals: Tool goals now and at the end of each following period, m, shape (B, 1 + H or more, 2).
            last: Motor voltages of the previous period, V, shape (B, 2).
            elapsed_s: Time since the start of the episode, s, shape (B,).

        Returns:
            Motor voltages, limited to the rated voltages, V, shape (B, 2).
        """
        model, H = self.model, self.horizon
        goals = goals[:, : H + 1]
        velocity = np.diff(goals, axis=1) / self.period
        midpoint = 0.5 * (goals[:, 1:] + goals[:, :-1])
        path = np.concatenate([midpoint @ model.rigid.T, velocity @ model.rigid.T], axis=2)  # (B, H, 2 n)
        path = path.reshape(len(state) * H, -1)
        times = (elapsed_s[:, None] + self.period * (0.5 + np.arange(H))).ravel()
        modeled = (model.friction_force(path, times) + model.effect_force(path, times)).reshape(len(state), H, -1)
        force = modeled + self._disturbance[:, None]
        self._planned_force = force[:, 0]
        points, gains = self.grid.nearest(goals[:, 0]), self.gains
        volts = _matvec(gains.state[points], state) + _matvec(gains.last[points], last)
        volts += _matvec(gains.goal[points], goals[:, 1:].reshape(len(state), -1))
        volts += _matvec(gains.force[points], force.reshape(len(state), -1))
        return np.clip(volts, -model.rated, model.rated)


def _matvec(matrices: Array, vectors: Array) -> Array:
    """Multiply matrices (B, i, j) by vectors (B, j)."""
    return np.asarray(np.einsum("bij,bj->bi", matrices, vectors))
