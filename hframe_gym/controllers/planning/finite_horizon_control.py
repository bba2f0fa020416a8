"""Finite-horizon optimal control: minimum-energy transfers to a fixed goal, preview control of a moving one.

Minimum-energy transfers (feedback gains of motions from point to point)
    A transfer of N periods is a motion that brings the state to rest at the goal within N control periods.
    With voltages constant over each period, the state error after N periods is A^N e + sum_j A^(N-1-j) B u_j.
    Of all voltages that bring the error to zero in N periods, those with the least sum of squares are

        u_j = -B' A'^(N-1-j) W_N^-1 A^N e,      W_N = sum_j A^j B B' A'^j,

    and for each number of periods to go the first of them is a feedback gain on the full state. The shortest
    transfer whose voltages stay within the limits comes close to the time optimum because back-EMF makes the
    stage viscous: minimum energy then means constant voltage during the cruise and an exponential brake that
    ends at the same voltage with opposite sign. The belt modes are part of A, so that they are at rest at the
    end of a transfer, unless all of them are above half the control rate. Near that rate a vibration hardly
    differs, at the sampling instants, from the motion of rigid belts. Gains that tell both apart would be
    large, and unstable where the stiffness of the belts is another one by a few percent; A is then that of
    rigid belts, which transmit what the drives do within a period.

Preview control (a least-squares plan over the previewed goals, renewed every period)
    With a force f on each coordinate the state follows z+ = A z + B u + E f. Of all voltages over the H
    previewed periods the plan takes those that minimize

        sum_j |C z_j - g_j|^2 + w^2 sum_j |u_j - u_(j-1)|^2,        C z: tool position, g: goal,

    and applies the first. Solved once for each operating point, this is a constant gain on the state, on the
    goals (feedforward of velocity, acceleration, back-EMF and belt stretch, which are all part of A and B),
    on the last voltage and on the forces: the modeled friction along the path and, in place of an integrator,
    the estimated disturbance.

References:
    Kleinman (1970), An easy way to stabilize a linear constant system, IEEE Transactions on Automatic Control
    15(6). Tomizuka (1975), Optimal continuous finite preview problem, IEEE Transactions on Automatic Control
    20(3).
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...arrays import Array, ElapsedTimes, Mask, ToolPositions, TravelStates, Volts
from ...dynamics import belt_modes
from ..control_period import check_period, shorter_period
from ..models.linear_motion import reachability, state_scale
from ..models.motion_model import MotionModel, OperatingPointGrid

# Shortest transfer in periods of the slowest belt mode; a shorter one needs the mode's frequency more
# accurately than a model has it.
SHORTEST_MODE_PERIODS = 0.6
LONGEST_MARGIN = 1.3  # longest transfer over the time that the longest way takes at top speed
MAX_TRANSFER_S = 10.0  # s, longest transfer of a stage that friction leaves without a top speed
# Periods at the end of a transfer whose voltages are checked against the limits, beside the first; the
# voltage of the cruise is largest in the first period.
CHECKED_FINAL_PERIODS = 7
# m/V, the weight w: tool error that is as costly as a voltage change of 1 V. Tuned: a smaller weight makes
# the voltages more active and the tool no more accurate.
VOLTAGE_CHANGE_WEIGHT = 3e-5
# s, time constant of the disturbance estimate. Tuned: smaller values ring where belts are 40 % softer than
# the model's.
DISTURBANCE_TIME_CONSTANT_S = 0.028
HORIZON_S = 0.1  # s; goals farther ahead do not change the first voltage


def longest_transfer_s(model: MotionModel, grid: OperatingPointGrid) -> float:
    """Estimate the time of the longest point-to-point motion in the workspace, s, to limit planned durations.

    It is 1.3 (`LONGEST_MARGIN`) times the longer of two times. One is the time along both sides of the
    workspace at top speed. The other one limits axes whose drive has no back-EMF: the force of the
    minimum-energy motion of a mass m over the distance d falls linearly from its largest value F to -F, which
    takes sqrt(6 d m / F). If the drives cannot overcome Coulomb friction along an axis, the result is 10 s
    (`MAX_TRANSFER_S`).
    """
    top_speed = model.top_speed()
    if top_speed.min() <= 0.0:
        return MAX_TRANSFER_S
    cruise_s = np.sum(grid.span / top_speed)
    acceleration_s = np.sum(np.sqrt(6.0 * grid.span / model.top_acceleration()))
    return float(LONGEST_MARGIN * max(cruise_s, acceleration_s))


class TransferSelection(NamedTuple):
    """Transfers (motions that end at rest at the goal) that were selected for B simulated machines.

    Attributes:
        periods: Number of control periods until the machine is at rest at its goal, shape (B,).
        volts: Voltages of the first period of the transfer, V, shape (B, drives).
    """

    periods: NDArray[np.intp]
    volts: Array


class TransferDesign:
    """Design of minimum-energy transfers that take `shortest` to `longest` periods.

    A transfer is a motion that brings the machine to rest at its goal. An operating point is a tool position
    at which the machine is linearized.

    Args:
        model: Model of the machine, with n coordinates.
        period: Control period, s.

    Attributes:
        grid: Operating points.
        shortest: Number of periods of the shortest transfer.
        longest: Number of periods of the longest one.

    Raises:
        InputError: If the period is not positive, or the machine's workspace has no range.
    """

    def __init__(self, model: MotionModel, period: float) -> None:
        self.model = model
        self.period = check_period(period)
        self.grid = OperatingPointGrid(model.machine)
        states, inputs = 2 * len(model.mass), model.drive.shape[1]
        self._rigid = shorter_period(model.machine, period) is not None
        self._from_state = model.rigid_part if self._rigid else np.eye(states)  # to the state of A
        modes = belt_modes(model.machine)
        mode_period = 1.0 / min(modes) if modes else 0.0
        # Fewer than states / inputs periods cannot bring every state to zero.
        self.shortest = max(-(-states // inputs), round(SHORTEST_MODE_PERIODS * mode_period / period))
        longest_s = min(longest_transfer_s(model, self.grid), MAX_TRANSFER_S)
        self.longest = max(self.shortest + 1, int(np.ceil(longest_s / period)))

    def first_gains(self, beyond: Sequence[int], points: Sequence[int] | None = None) -> Array:
        """Compute the feedback gains for the first period of transfers of some durations.

        Args:
            beyond: Durations, in periods beyond the shortest transfer.
            points: Indices of K operating points. Default: all.

        Returns:
            Gains from the state error to the voltages, V/m and Vs/m, shape (K, len(beyond), drives, 2 n).
        """
        chosen = range(len(self.grid.points)) if points is None else points
        durations = [self.shortest + extra for extra in beyond]
        costates = self._costates([self._discretized(point) for point in chosen], durations)
        by_duration = {
            N: -pulse.transpose(0, 2, 1) @ costate for N, pulse, costate in costates if N in durations
        }
        return np.stack([by_duration[N] for N in durations], axis=1)

    def _costates(
        self, matrices: Sequence[tuple[Array, Array]], durations: Collection[int]
    ) -> Iterator[tuple[int, Array, Array]]:
        """Yield N = 1, 2, ..., the pulse response over N periods, and the error's costate if N is a duration.

        The voltages of a transfer of N periods are minus the transposed pulse responses times its costate.
        For other N, the costate is empty.
        """
        A, B = (np.stack(by_point) for by_point in zip(*matrices, strict=True))
        scale = state_scale(A.shape[1])
        for N, (pulse, W, power) in enumerate(reachability(A, B, max(durations)), 1):
            costate = np.zeros(0)
            if N in durations:
                costate = np.linalg.pinv(W, rcond=1e-15, hermitian=True) @ power / scale @ self._from_state
            yield N, pulse, costate

    def _discretized(self, point: int) -> tuple[Array, Array]:
        """Return the system matrix and the input matrix of the voltages at an operating point."""
        return self.model.discretize(self.grid.points[point], self.period, rigid=self._rigid)[:2]


class MinimumEnergyTransfers(TransferDesign):
    """Feedback gains of minimum-energy transfers for every operating point and every duration in periods.

    Attributes:
        gains: Gains from the state error at the start of a transfer to its voltages, V/m and Vs/m, shape
            (points, longest - shortest + 1, 1 + CHECKED_FINAL_PERIODS, drives, 2 n). Third axis: first period
            of the transfer, then its last CHECKED_FINAL_PERIODS periods.
    """

    def __init__(self, model: MotionModel, period: float) -> None:
        super().__init__(model, period)
        matrices = [self._discretized(point) for point in range(len(self.grid.points))]
        back: list[Array] = []  # B' A'^j
        gains = []
        for N, pulse, costate in self._costates(matrices, range(self.shortest, self.longest + 1)):
            back.append(pulse.transpose(0, 2, 1))
            if self.shortest > N:
                continue
            # Transfers shorter than CHECKED_FINAL_PERIODS repeat their first period.
            rows = [back[-1]] + [back[min(j, N - 1)] for j in reversed(range(CHECKED_FINAL_PERIODS))]
            gains.append(np.stack([-row @ costate for row in rows], axis=1))
        self.gains = np.stack(gains, axis=1)

    def select(
        self,
        error: TravelStates,
        goal: ToolPositions,
        limits: tuple[Array, Array],
        at_least: NDArray[np.intp],
    ) -> TransferSelection:
        """Select each machine's shortest motion to rest at its goal whose voltages stay within the limits.

        It is found by bisection, because longer motions need lower voltages; where belts ring, a slightly
        longer one may be found. The limits are checked in the first period and in the last 7 periods of a
        motion. Where no motion stays within them, the longest one is selected, which exceeds them.

        Args:
            error: State minus goal state.
            goal: Tool position at the goal.
            limits: Lowest voltages and highest voltages, V, shape (B, drives) each.
            at_least: Minimum number of control periods until rest, from `shortest` to `longest`, shape (B,).

        Returns:
            Number of periods of each motion, shape (B,), and its voltages in the first period, V, shape (B,
            drives).
        """
        points = self.grid.nearest(goal)
        lowest, highest = limits
        # Indices of numbers of periods, between which the shortest admissible transfer is.
        low, high = at_least - self.shortest, np.full(len(error), self.gains.shape[1] - 1)
        while np.any(low < high):
            middle = (low + high) // 2
            # Voltages of the k checked periods, (B, k, drives).
            volts = np.einsum("bkij,bj->bki", self.gains[points, middle], error)
            admissible = np.all((volts >= lowest[:, None, :]) & (volts <= highest[:, None, :]), axis=(1, 2))
            low = np.where(admissible | (low == high), low, middle + 1)
            high = np.where(admissible, middle, high)
        volts = np.einsum("bij,bj->bi", self.gains[points, high, 0], error)
        return TransferSelection(high + self.shortest, volts)


class PreviewGains:
    """Gains of preview control, which give the first voltage of the least-squares plan.

    There are gains for each operating point, a tool position at which the machine is linearized. The state is
    that of `TravelStates`.

    Args:
        period: Control period, s.
        horizon: Number of previewed goals, H.
        change_weight: Weight w of voltage changes, m/V.

    Attributes:
        state: Gains on the present state, V/m and Vs/m, shape (points, drives, 2 n).
        last: Gains on the voltages of the previous period, V/V, shape (points, drives, drives).
        goal: Gains on the previewed goals, V/m, shape (points, drives, axes * H).
        force: Gains on the force on each coordinate in each period, V/N, shape (points, drives, n H).
        A: Discrete-time system matrices, shape (points, 2 n, 2 n).
        B: Discrete-time input matrices of the voltages, m/V and m/(Vs), shape (points, 2 n, drives).
        E: Discrete-time input matrices of the forces on the coordinates, m/N and m/(Ns),
            shape (points, 2 n, n).
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
        powers = [np.eye(len(A))[model.tool]]  # C A^j
        for _ in range(horizon):
            powers.append(powers[-1] @ A)

        def impulse_response(G: Array) -> Array:
            """Return the tool's response at the periods' ends to inputs by G (2 n, m), (axes * H, m * H)."""
            axes, m = powers[0].shape[0], G.shape[1]
            response = np.zeros((horizon, axes, horizon, m))
            for delay, power in enumerate(powers[:horizon]):
                periods = np.arange(horizon - delay)  # of the inputs
                response[periods + delay, :, periods] = power @ G
            return response.reshape(axes * horizon, m * horizon)

        volts_response = impulse_response(B)
        inputs = B.shape[1]
        difference = np.eye(inputs * horizon) - np.eye(inputs * horizon, k=-inputs)
        normal = volts_response.T @ volts_response + change_weight**2 * difference.T @ difference
        first = np.asarray(np.linalg.inv(normal)[:inputs], np.float64)
        goal = first @ volts_response.T
        return (
            -goal @ np.vstack(powers[1:]),
            change_weight**2 * first[:, :inputs],
            goal,
            -goal @ impulse_response(E),
        )


class PreviewTracker:
    """Preview control of the tool position, with a disturbance observer.

    Args:
        period: Control period, s.
        goals: Number of previewed goals (one per control period) that `command` receives; those more than
            0.1 s ahead are not used.

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

    def update_disturbance(
        self, before: TravelStates, after: TravelStates, volts: Volts, starts: Mask
    ) -> None:
        """Update the estimated disturbance with the states before and after the last period.

        The disturbance is the force on each coordinate, in addition to the modeled forces, that explains the
        measured state `after`. It is low-pass filtered (time constant 28 ms), and zero where an episode
        starts with `after`. `command` compensates it, which replaces an integrator.
        """
        if len(self._disturbance) != len(after):
            self._planned_force = self._disturbance = np.zeros((len(after), len(self.model.mass)))
        points = self.grid.nearest(self.model.tool_position(before))
        predicted = _matvec(self.gains.A[points], before) + _matvec(self.gains.B[points], volts)
        # Force that explains the prediction error, beyond the force that the plan assumed for this period, N,
        # (B, n).
        residual = _matvec(self._force_from_residual[points], after - predicted) - self._planned_force
        self._disturbance = np.where(starts[:, None], 0.0, self._disturbance + self._filter_gain * residual)

    def command(
        self, state: TravelStates, goals: Array, last: Volts, elapsed_s: ElapsedTimes, loads: Array
    ) -> Volts:
        """Compute the motor voltages, within the rated ones, that follow the previewed goals from now on.

        Args:
            goals: Tool goals now and at the end of each following period, m, shape (B, 1 + H or more, axes)
                for H = `horizon`; further goals are ignored.
            last: Motor voltages of the previous period. The plan penalizes changes from them.
            loads: Forces of swinging loads in these periods, N, shape (B, H or more, n).
        """
        model, H = self.model, self.horizon
        goals = goals[:, : H + 1]
        velocity = np.diff(goals, axis=1) / self.period
        midpoint = 0.5 * (goals[:, 1:] + goals[:, :-1])
        path = np.concatenate([midpoint @ model.rigid.T, velocity @ model.rigid.T], axis=2)  # (B, H, 2 n)
        path = path.reshape(len(state) * H, -1)
        # On the goal's path with unstretched belts: friction in the middle of a period, effects in the mean.
        times = (elapsed_s[:, None] + self.period * (0.5 + np.arange(H))).ravel()
        effects = model.mean_effect_force(path, times, self.period)
        modeled = (model.friction_force(path, times) + effects).reshape(len(state), H, -1)
        force = modeled + loads[:, :H] + self._disturbance[:, None]
        self._planned_force = force[:, 0]
        # The plan's first voltages: feedback of the state and the last voltages, feedforward of goals and
        # forces.
        points, gains = self.grid.nearest(goals[:, 0]), self.gains
        volts = _matvec(gains.state[points], state) + _matvec(gains.last[points], last)
        volts += _matvec(gains.goal[points], goals[:, 1:].reshape(len(state), -1))
        volts += _matvec(gains.force[points], force.reshape(len(state), -1))
        return np.clip(volts, -model.rated, model.rated)


def _matvec(matrices: Array, vectors: Array) -> Array:
    """Multiply matrices (B, i, j) by vectors (B, j)."""
    return np.asarray(np.einsum("bij,bj->bi", matrices, vectors))
