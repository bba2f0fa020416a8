"""Linear models of batches of different machines, and transfers to rest that are planned with them.

`LinearMotion`         Linear models of B machines with different parameters, for example as estimated.
`reachability`         What voltages contribute to the state after N periods, for transfers of any design.
`SimulatedTransfers`   Transfers of machines as estimated, planned anew in every period and corrected by simulations.

`MinimumEnergyTransfers` are designed once, for the declared machine, and leave Coulomb friction out. Here each of B
machines has parameters of its own, which an estimator changes from period to period, and friction is part of the plan:

Linear plan   The voltages with the least sum of squares that bring the linear model to rest at the goal in N periods,
              against a constant friction force that opposes the motion.
Simulation    Friction reverses within a motion, and static friction decides where a tool stops that is a tenth of a
              millimeter from its goal. Plans that end soon are simulated with the estimated parameters; the state at
              their end shows by how much they miss, and the linear model corrects them (shooting, a few iterations).

The derivative of the voltages with respect to the state is that of the linear plan.

References:
    Stoer and Bulirsch (2002), Introduction to Numerical Analysis, section 7.3 (shooting methods).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..dynamics import Equations, MotionPoint, rollout
from ..errors import InputError
from .motion_model import MotionModel

Array = NDArray[np.float64]
TAYLOR_DEGREE, HALVINGS = 8, 7  # of the matrix exponential; the period over 2^7 is far below that of any belt mode
VELOCITY_SCALE_S = 0.01  # s, typical position error over velocity error, for the condition of W_N
FRICTION_SPEED, FRICTION_TRAVEL = 0.02, 1e-3  # m/s and m, over which the expected direction of friction changes
SIMULATED_PERIODS, CORRECTIONS = 6, 5  # longest plan that is simulated, and how often it is corrected
SHORTER = 0.5  # factor of a correction after one that did not help
INTEGRATION_STEP = 1e-3  # s; the corrections need no higher accuracy
SWITCHING_S = 1e-9  # s, length of the interval in which the last voltage is applied, for a dead time
# m/V: final error (velocities in units of 0.1 m/s per mm) that is as costly as 1 V. It matters for plans of so few
# periods that they cannot bring every state to rest.
FINAL_ERROR = 1e-6


class LinearMotion:
    """Discrete-time linear models of B machines with different parameters, for voltages that are held over a period.

    The state is belt travel (radius * angle of a rotary coordinate) of n coordinates and its velocity.

    Args:
        model: Model of the machine with its declared parameters.
        period: Control period, s.
    """

    def __init__(self, model: MotionModel, period: float) -> None:
        self._model, self._period = model, period
        self._machine = dataclasses.replace(model.machine, effects=())
        self._extension = model.machine.belt_matrix / model.machine.travel_per_unit  # per belt travel, (belts, n)

    def matrices(self, parameters: Array, position: Array) -> tuple[Array, Array, Array]:
        """Linearize the machines without Coulomb friction and effects, and discretize them with zero-order hold.

        Args:
            parameters: Parameters of B machines in the order of `Machine.parameters`, SI, shape (B, P).
            position: Tool positions of the linearization, m, shape (B, axes).

        Returns:
            A: System matrices, shape (B, 2 n, 2 n).
            B: Input matrices of the voltages, m/V and m/(Vs), shape (B, 2 n, drives).
            E: Input matrices of a force on each coordinate, m/N and m/(Ns), shape (B, 2 n, n).
        """
        model, n, drives = self._model, len(self._model.mass), len(self._model.rated)
        equations = Equations(self._machine, dict(zip(model.machine.parameters, parameters.T, strict=True)))
        travel = position @ model.rigid.T
        belts = equations.belt_states(MotionPoint(list(travel.T), list(np.zeros_like(travel).T)))
        values = [belt.stiffness for belt in belts] + [equations.mass(i) for i in range(n)]
        stiffness, mass = np.split(np.array([value + np.zeros(len(parameters)) for value in values]).T, [len(belts)], 1)
        rates = np.zeros((len(parameters), 3 * n + drives, 3 * n + drives))
        rates[:, :n, n : 2 * n] = np.eye(n)
        rates[:, n : 2 * n, :n] = -np.einsum("bk,ki,kj->bij", stiffness, self._extension, self._extension)
        rates[:, n : 2 * n, n : 2 * n] = -np.diag(model.viscous)
        rates[:, n : 2 * n, 2 * n : 2 * n + drives] = model.drive
        rates[:, n : 2 * n, 2 * n + drives :] = np.eye(n)
        rates[:, n : 2 * n] /= mass[:, :, None]
        discrete = _exponential(rates * self._period)[:, : 2 * n]
        return discrete[:, :, : 2 * n], discrete[:, :, 2 * n : 2 * n + drives], discrete[:, :, 2 * n + drives :]


def _exponential(matrices: Array) -> Array:
    """Return the exponentials of many small matrices (B, m, m), by a Taylor series and repeated squaring."""
    power = step = matrices / 2**HALVINGS
    result = np.eye(step.shape[1]) + step
    for degree in range(2, TAYLOR_DEGREE + 1):
        power = power @ step / degree
        result = result + power
    for _ in range(HALVINGS):
        result = result @ result
    return result


def state_scale(states: int) -> Array:
    """Return units (2 n,) in which positions and velocities have similar size, so that W_N is well conditioned.

    Args:
        states: Number of states, 2 n.

    Returns:
        1 for belt travel, m, and 1 / VELOCITY_SCALE_S for its velocity, m/s, shape (2 n,).
    """
    return np.repeat([1.0, 1.0 / VELOCITY_SCALE_S], states // 2)


def reachability(A: Array, B: Array, longest: int) -> Iterator[tuple[Array, Array, Array]]:
    """Yield, for N = 1 to `longest` periods, what voltages and the present state contribute to the state after N.

    Args:
        A: System matrices of any number of machines or operating points, shape (points, 2 n, 2 n).
        B: Input matrices of the voltages, shape (points, 2 n, drives).
        longest: Largest number of periods.

    Yields:
        A^(N-1) B, the Gramian W_N (sum of A^j B B' A'^j for j < N) and A^N, all with states in units of `state_scale`,
        of the shapes (points, 2 n, drives), (points, 2 n, 2 n) and (points, 2 n, 2 n).
    """
    scale = state_scale(A.shape[1])
    A, B = A / scale[:, None] * scale, B / scale[:, None]
    gramian, power = np.zeros_like(A), np.broadcast_to(np.eye(A.shape[1]), A.shape)
    for _ in range(longest):
        pulse = power @ B
        gramian, power = gramian + pulse @ pulse.transpose(0, 2, 1), power @ A
        yield pulse, gramian, power


def opposing_friction(model: MotionModel, state: Array, error: Array, parameters: Array) -> Array:
    """Compute the Coulomb friction that acts until the goal is reached, against the motion or the way ahead.

    Args:
        model: Model of the machine with its declared parameters, n coordinates.
        state: Belt travel of the n coordinates of B machines and its velocity, m and m/s, shape (B, 2 n).
        error: State minus that at the goal, m and m/s, shape (B, 2 n).
        parameters: Parameters of the machines in the order of `Machine.parameters`, SI, shape (B, P).

    Returns:
        Force on each coordinate, N, shape (B, n).
    """
    n, declared = len(model.mass), model.machine.parameters
    columns = [list(declared).index(f"{name}.coulomb") for name in model.machine.coordinate_names]
    values = np.array(list(declared.values()))[columns]
    ratio = parameters[:, columns] / np.where(values, values, 1.0) + (values == 0.0)
    moving = np.tanh(state[:, n:] / FRICTION_SPEED)
    ahead = -np.tanh(error[:, :n] / FRICTION_TRAVEL)
    return np.asarray(-model.coulomb * ratio * (moving + (1.0 - np.abs(moving)) * ahead))


class PlannedTransfers(NamedTuple):
    """First voltages of K transfers of each of B machines with n coordinates.

    Attributes:
        volts: Voltages of the first period, V, not limited, shape (B, K, drives).
        gains: Their derivatives with respect to the state (belt travel of n coordinates and its velocity), V/m and
            Vs/m, shape (B, K, drives, 2 n).
    """

    volts: Array
    gains: Array


class SimulatedTransfers:
    """Planner of motions to rest at the goal in given numbers of periods, for B machines with different parameters.

    Args:
        model: Model of the machine with its declared parameters, n coordinates; the simulations contain its effects.
        period: Control period, s.
        durations: Numbers of periods of the K transfers, positive, ascending.

    Raises:
        InputError: If the durations are not positive and ascending.
    """

    def __init__(self, model: MotionModel, period: float, durations: Sequence[int]) -> None:
        if not durations or durations[0] < 1 or list(durations) != sorted(set(durations)):
            raise InputError(f"durations of transfers are {list(durations)}; they must be positive and ascending")
        self._model, self._linear = model, LinearMotion(model, period)
        self._durations = np.array(durations)
        self._scale = state_scale(2 * len(model.mass))
        self._units = np.tile(model.machine.travel_per_unit, 2)
        self._simulated = self._durations[self._durations <= SIMULATED_PERIODS]
        longest = self._simulated.max(initial=1)
        self._time_s = period * np.arange(longest + 1)
        self._delayed = any(float(delay) > 0.0 for delay in Equations(model.machine).voltage_delays())
        if self._delayed:  # the simulation delays what is applied from the first sample on
            self._time_s = np.insert(self._time_s, 1, SWITCHING_S)

    def plan(self, state: Array, goal: Array, parameters: Array, last_volts: Array) -> PlannedTransfers:
        """Plan all transfers from the present states.

        Args:
            state: Belt travel (radius * angle of a rotary coordinate) of the n coordinates of B machines and its
                velocity, m and m/s, shape (B, 2 n).
            goal: Tool positions of the goals, m, shape (B, axes).
            parameters: Parameters of the machines in the order of `Machine.parameters`, SI, shape (B, P).
            last_volts: Voltages of the period before, V, shape (B, drives); they act during a dead time only.

        Returns:
            `PlannedTransfers`: voltages, V, shape (B, K, drives), and their derivatives, shape (B, K, drives, 2 n).
        """
        scale = self._scale
        error = state - self._model.goal_state(goal)
        force = opposing_friction(self._model, state, error, parameters)
        pulse, gramian, costates = self._costates(self._linear.matrices(parameters, goal), force)
        first = pulse[:, self._durations - 1].transpose(0, 1, 3, 2)
        gains = first @ costates[..., :-1] / scale
        planned = np.einsum("bkij,bj->bki", costates[..., :-1], error / scale) + costates[..., -1]
        count = len(self._simulated)
        best, least = planned[:, :count], np.full((len(state), count), np.inf)
        change, length = np.zeros_like(best), np.ones_like(least)
        for _ in range(CORRECTIONS if count else 0):
            missed = self._final_states(pulse, planned[:, :count], state, parameters, last_volts)
            missed = (missed - self._model.goal_state(goal)[:, None]) / scale
            missed = np.nan_to_num(missed, nan=1.0, posinf=1.0, neginf=-1.0)
            distance = np.linalg.norm(missed, axis=2)
            # A plan that ends farther away than the one before is not used; the next correction is then shorter.
            closer = distance < least
            better = closer[..., None]
            best, least = np.where(better, planned[:, :count], best), np.minimum(distance, least)
            change = np.where(better, np.linalg.solve(gramian[:, :count], missed[..., None])[..., 0], change)
            length = np.where(closer, 1.0, SHORTER * length)
            planned[:, :count] = best - length[..., None] * change
        return PlannedTransfers(np.einsum("bkij,bkj->bki", first, planned), gains)

    def _costates(self, matrices: tuple[Array, Array, Array], force: Array) -> tuple[Array, Array, Array]:
        """Return what determines the voltages of all transfers, against a constant force on each coordinate (B, n), N.

        A plan with the costate c applies (A^(j-1) B)' c in the j-th period before its end.

        Returns:
            A^(j-1) B for j = 1 to the longest duration, (B, periods, 2 n, drives); the Gramians (B, K, 2 n, 2 n); and
            the costates as a linear function of the state error, with what the force adds in the last column, (B, K,
            2 n, 2 n + 1).
        """
        A, B, E = matrices
        push = np.einsum("bij,bj->bi", E, force) / self._scale
        free, pushed = [np.broadcast_to(np.eye(A.shape[1]), A.shape)], [np.zeros_like(push)]  # by period
        pulses, gramians = [], []
        for pulse, gramian, power in reachability(A, B, int(self._durations[-1])):
            pulses.append(pulse)
            gramians.append(gramian + FINAL_ERROR**2 * np.eye(A.shape[1]))
            pushed.append(pushed[-1] + np.einsum("bij,bj->bi", free[-1], push))
            free.append(power)
        chosen = np.stack(gramians, axis=1)[:, self._durations - 1]
        final = np.concatenate([np.stack(free, axis=1), np.stack(pushed, axis=1)[..., None]], axis=3)
        return np.stack(pulses, axis=1), chosen, -np.linalg.solve(chosen, final[:, self._durations])

    def _final_states(self, pulse: Array, costates: Array, state: Array, parameters: Array, last_volts: Array) -> Array:
        """Simulate the plans that end soon, within the voltage limits; return the states at their ends (B, k, 2 n)."""
        periods, rated = int(self._simulated[-1]), self._model.rated
        remaining = self._simulated[:, None] - 1 - np.arange(periods)
        by_period = np.where((remaining >= 0)[..., None, None], pulse[:, np.maximum(remaining, 0)], 0.0)
        volts = np.einsum("bkjis,bki->bkjs", by_period, costates).clip(-rated, rated).reshape(-1, periods, len(rated))
        volts = np.concatenate([volts, volts[:, -1:]], axis=1)
        count = len(self._simulated)
        if self._delayed:
            volts = np.concatenate([np.repeat(last_volts, count, axis=0)[:, None], volts], axis=1)
        states = rollout(
            self._model.machine,
            self._time_s,
            volts,
            velocities=True,
            parameters=np.repeat(parameters, count, axis=0),
            start=np.repeat(state / self._units, count, axis=0),
            longest_step=INTEGRATION_STEP,
            parallel=False,
        )
        ends = states[:, -periods:].reshape(len(state), count, periods, -1)[:, np.arange(count), self._simulated - 1]
        return np.asarray(ends * self._units)
