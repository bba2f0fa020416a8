"""Linear models of batches of different machines, and transfers to rest that are planned with them.

`LinearMotion`         Linear models of B machines with different parameters, for example as estimated.
`reachability`         Response to voltages, and Gramian, from which voltages to rest in N periods follow.
`SimulatedTransfers`   Transfers of machines as estimated, planned anew in every period and corrected by simulations.

`MinimumEnergyTransfers` are designed once, for the declared machine, and leave Coulomb friction out. Here each of B
machines has parameters of its own, which an estimator changes from period to period, and friction is part of the plan:

Linear plan   The voltages with the least sum of squares that bring the linear model to rest at the goal in N periods,
              against a constant friction force that opposes the motion.
Simulation    Friction reverses within a motion, and static friction decides where a tool stops that is a tenth of a
              millimeter from its goal. Plans that end soon are simulated with the estimated parameters; the linear
              model corrects them by the error of the state at their end (shooting, a few iterations).

The derivative of the voltages with respect to the state is that of the linear plan.

References:
    Stoer and Bulirsch (2002), Introduction to Numerical Analysis, section 7.3 (shooting methods).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from ...arrays import Array, CoordinateForces, ParameterRows, ToolPositions, TravelStates, Volts
from ...dynamics import Equations, MotionPoint, rollout
from ...errors import InputError
from .motion_model import FRICTION_COMPENSATION_SPEED, MotionModel

# Of the matrix exponential; the period over 2^7 is far below that of any belt mode.
TAYLOR_DEGREE, HALVINGS = 8, 7
VELOCITY_SCALE_S = 0.01  # s, typical position error over velocity error, for the condition of W_N
FRICTION_TRAVEL = 1e-3  # m, position error over which the expected direction of friction changes
SIMULATED_PERIODS, CORRECTIONS = 6, 5  # longest plan that is simulated, and how often it is corrected
SHORTER = 0.5  # factor of a correction after one that did not help
CORRECTION_STEP_S = 1e-3  # s, integration step; the corrections need no higher accuracy
SWITCHING_S = 1e-9  # s, length of the interval in which the last voltage is applied, for a dead time
# m/V: final error (velocities in units of 0.1 m/s per mm) that is as costly as 1 V. It matters for plans of so few
# periods that they cannot bring every state to rest.
FINAL_ERROR = 1e-6


class LinearMotion:
    """Discrete-time linear models of machines with different parameters, for voltages that are held over a period."""

    def __init__(self, model: MotionModel, period: float) -> None:
        self._model, self._period = model, period
        self._machine = dataclasses.replace(model.machine, effects=())
        self._extension = (
            model.machine.belt_matrix / model.machine.travel_per_unit
        )  # per belt travel, (belts, n)
        # Coulomb friction, N, is the value of its parameter over a unit, times the force of this unit. The unit is the
        # declared value, because voltages are then bit for bit those of the stored scores; 1 N where that is 0.
        names = [f"{name}.coulomb" for name in model.machine.coordinate_names]
        declared = np.array([model.machine.parameters[name] for name in names])
        self._coulomb_columns = [list(model.machine.parameters).index(name) for name in names]
        self._coulomb_unit = np.where(declared, declared, model.machine.travel_per_unit)
        self._force_of_unit = np.where(declared, model.coulomb, 1.0)

    def matrices(self, parameters: ParameterRows, position: ToolPositions) -> tuple[Array, Array, Array]:
        """Linearize the machines without Coulomb friction and effects, and discretize them with zero-order hold.

        Viscous friction and motor constants are taken from the declared machine; masses, belts and radii from
        `parameters`.

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
        stiffness, mass = np.split(
            np.array([value + np.zeros(len(parameters)) for value in values]).T, [len(belts)], 1
        )
        rates = np.zeros((len(parameters), 3 * n + drives, 3 * n + drives))
        rates[:, :n, n : 2 * n] = np.eye(n)
        rates[:, n : 2 * n, :n] = -np.einsum("bk,ki,kj->bij", stiffness, self._extension, self._extension)
        rates[:, n : 2 * n, n : 2 * n] = -np.diag(model.viscous)
        rates[:, n : 2 * n, 2 * n : 2 * n + drives] = model.drive
        rates[:, n : 2 * n, 2 * n + drives :] = np.eye(n)
        rates[:, n : 2 * n] /= mass[:, :, None]
        discrete = _exponential(rates * self._period)[:, : 2 * n]
        return (
            discrete[:, :, : 2 * n],
            discrete[:, :, 2 * n : 2 * n + drives],
            discrete[:, :, 2 * n + drives :],
        )

    def opposing_friction(
        self, state: TravelStates, error: TravelStates, parameters: ParameterRows
    ) -> CoordinateForces:
        """Predict the Coulomb friction during the motion to the goal, as one constant force per coordinate.

        Constant forces allow a plan with a linear model. At speeds far above 20 mm/s, the force opposes the
        present motion. At speeds far below, it opposes the motion towards the goal, and is smaller within
        about 1 mm of it. `error` is the state minus the goal state.
        """
        n = len(self._model.mass)
        level = self._force_of_unit * (parameters[:, self._coulomb_columns] / self._coulomb_unit)
        moving = np.tanh(state[:, n:] / FRICTION_COMPENSATION_SPEED)
        ahead = -np.tanh(error[:, :n] / FRICTION_TRAVEL)
        return np.asarray(-level * (moving + (1.0 - np.abs(moving)) * ahead))


def _exponential(matrices: Array) -> Array:
    """Return the exponentials of many small matrices (B, m, m), by a Taylor series and repeated squaring."""
    # scipy.linalg.expm gives the same to 1e-11, but works on one matrix at a time: measured on the matrices of the
    # H-frame (14 x 14), it takes 3.5 times as long for 64 machines and 8 times as long for 512.
    power = step = matrices / 2**HALVINGS
    result = np.eye(step.shape[1]) + step
    for degree in range(2, TAYLOR_DEGREE + 1):
        power = power @ step / degree
        result = result + power
    for _ in range(HALVINGS):
        result = result @ result
    return result


def state_scale(states: int) -> Array:
    """Return the units of 2 n states that condition the reachability Gramian well, m and m/s, shape (2 n,).

    They are 1 m for belt travel and 100 m/s for velocity: in a scaled state (state / units) an error of 1 mm
    is as large as one of 0.1 m/s.
    """
    return np.repeat([1.0, 1.0 / VELOCITY_SCALE_S], states // 2)


def scaled_matrices(A: Array, *inputs: Array) -> tuple[Array, ...]:
    """Convert the matrices of discrete-time linear systems to scaled states: belt travel / 1 m, velocity / 100 m/s.

    Args:
        A: System matrices of the state, belt travel of n coordinates, m, and its velocity, m/s, shape (..., 2 n, 2 n).
        *inputs: Input matrices, m and m/s per unit of the inputs, shape (..., 2 n, inputs).

    Returns:
        The converted A, shape (..., 2 n, 2 n), then each converted input matrix, shape (..., 2 n, inputs).
    """
    scale = state_scale(A.shape[-1])
    return A / scale[:, None] * scale, *(matrix / scale[:, None] for matrix in inputs)


def reachability(A: Array, B: Array, longest: int) -> Iterator[tuple[Array, Array, Array]]:
    """Yield the responses of linear systems over N = 1, 2, ... periods to voltages and to their initial state.

    They give the voltages with the least sum of squares that bring a state error z to zero in N periods:
    u_j = -B' A'^(N-1-j) W_N^-1 A^N z in period j = 0, ..., N - 1.

    Args:
        A: System matrices of any number of machines or operating points, shape (points, 2 n, 2 n).
        B: Input matrices of the voltages, shape (points, 2 n, drives).
        longest: Largest number of periods N.

    Yields:
        pulse: Response A^(N-1) B of the state after N periods to the voltages of the first one, with scaled states
            (belt travel / 1 m, velocity / 100 m/s), shape (points, 2 n, drives).
        gramian: Reachability Gramian W_N, the sum of A^j B B' A'^j for j < N, shape (points, 2 n, 2 n).
        power: Response A^N of the state after N periods to the initial state, shape (points, 2 n, 2 n).
    """
    A, B = scaled_matrices(A, B)
    gramian, power = np.zeros_like(A), np.broadcast_to(np.eye(A.shape[1]), A.shape)
    for _ in range(longest):
        pulse = power @ B
        gramian, power = gramian + pulse @ pulse.transpose(0, 2, 1), power @ A
        yield pulse, gramian, power


class PlannedTransfers(NamedTuple):
    """First voltages of K transfers (motions to rest at the goal) of each machine.

    Attributes:
        volts: Voltages of the first period, V, not limited, shape (B, K, drives).
        gains: Derivatives of `volts` with respect to the state, V/m and Vs/m, shape (B, K, drives, 2 n).
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
            raise InputError(
                f"durations of transfers are {list(durations)}; they must be positive and ascending"
            )
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

    def plan(
        self, state: TravelStates, goal: ToolPositions, parameters: ParameterRows, last_volts: Volts
    ) -> PlannedTransfers:
        """Plan motions from the present states to rest at the goals, one for each of the planner's K durations.

        Plans of up to SIMULATED_PERIODS = 6 periods are corrected by simulations of the machines with their
        effects. The last voltages still act during the dead time of the drives. `PlannedTransfers` states the shapes.
        """
        scale = self._scale
        error = state - self._model.goal_state(goal)
        force = self._linear.opposing_friction(state, error, parameters)
        pulse, gramian, costates = self._costates(self._linear.matrices(parameters, goal), force)
        first = pulse[:, self._durations - 1].transpose(0, 1, 3, 2)
        gains = first @ costates[..., :-1] / scale
        planned = np.einsum("bkij,bj->bki", costates[..., :-1], error / scale) + costates[..., -1]
        count = len(self._simulated)
        best, smallest = planned[:, :count], np.full((len(state), count), np.inf)
        correction, step_length = np.zeros_like(best), np.ones_like(smallest)
        for _ in range(CORRECTIONS + 1 if count else 0):  # the last correction is simulated as well
            final = self._final_states(pulse, planned[:, :count], state, parameters, last_volts)
            final_error = (final - self._model.goal_state(goal)[:, None]) / scale
            # A simulation that diverges counts as an error of 1 m or 100 m/s.
            final_error = np.nan_to_num(final_error, nan=1.0, posinf=1.0, neginf=-1.0)
            distance = np.linalg.norm(final_error, axis=2)
            # A plan that ends farther away than the one before is not used; the next correction is then shorter.
            closer = distance < smallest
            best = np.where(closer[..., None], planned[:, :count], best)
            smallest = np.minimum(distance, smallest)
            full_correction = np.linalg.solve(gramian[:, :count], final_error[..., None])[..., 0]
            correction = np.where(closer[..., None], full_correction, correction)
            step_length = np.where(closer, 1.0, SHORTER * step_length)
            planned[:, :count] = best - step_length[..., None] * correction
        planned[:, :count] = best
        return PlannedTransfers(np.einsum("bkij,bkj->bki", first, planned), gains)

    def _costates(self, matrices: tuple[Array, Array, Array], force: Array) -> tuple[Array, Array, Array]:
        """Compute the costates of all transfers, against a constant force on each coordinate (B, n), N.

        A plan with the costate c applies (A^(j-1) B)' c in the j-th period before its end.
        """
        A, B, E = matrices
        force_response = np.einsum("bij,bj->bi", E, force) / self._scale  # to the force in one period
        # Responses by number of periods: A^N to the initial state, and the accumulated one to the force.
        powers, accumulated = [np.broadcast_to(np.eye(A.shape[1]), A.shape)], [np.zeros_like(force_response)]
        pulses, gramians = [], []
        for pulse, gramian, power in reachability(A, B, int(self._durations[-1])):
            pulses.append(pulse)
            gramians.append(gramian + FINAL_ERROR**2 * np.eye(A.shape[1]))
            accumulated.append(accumulated[-1] + np.einsum("bij,bj->bi", powers[-1], force_response))
            powers.append(power)
        chosen = np.stack(gramians, axis=1)[:, self._durations - 1]
        final = np.concatenate([np.stack(powers, axis=1), np.stack(accumulated, axis=1)[..., None]], axis=3)
        return np.stack(pulses, axis=1), chosen, -np.linalg.solve(chosen, final[:, self._durations])

    def _final_states(
        self, pulse: Array, costates: Array, state: Array, parameters: Array, last_volts: Array
    ) -> Array:
        """Simulate the plans that end soon, within the voltage limits; return the states at their ends (B, k, 2 n)."""
        periods, rated = int(self._simulated[-1]), self._model.rated
        remaining = self._simulated[:, None] - 1 - np.arange(periods)
        by_period = np.where((remaining >= 0)[..., None, None], pulse[:, np.maximum(remaining, 0)], 0.0)
        volts = (
            np.einsum("bkjis,bki->bkjs", by_period, costates)
            .clip(-rated, rated)
            .reshape(-1, periods, len(rated))
        )
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
            longest_step=CORRECTION_STEP_S,
            parallel=False,
        )
        ends = states[:, -periods:].reshape(len(state), count, periods, -1)[
            :, np.arange(count), self._simulated - 1
        ]
        return np.asarray(ends * self._units)
