"""Linear models of batches of different machines, for example with estimated parameters, and reachability.

`LinearMotion`   Linear models of B machines with different parameters, and the friction that opposes their
                 motion.
`reachability`   Response to voltages, and Gramian, from which voltages to rest in N periods follow.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np

from ...arrays import Array, CoordinateForces, ParameterRows, ToolPositions, TravelStates
from ...dynamics import Equations, MotionPoint
from .motion_model import FRICTION_COMPENSATION_SPEED, MotionModel

# Of the matrix exponential; the period over 2^7 is far below that of any belt mode.
TAYLOR_DEGREE, HALVINGS = 8, 7
VELOCITY_SCALE_S = 0.01  # s, typical position error over velocity error, for the condition of W_N
FRICTION_TRAVEL = 1e-3  # m, position error over which the expected direction of friction changes


class LinearMotion:
    """Discrete-time linear models of machines with different parameters, for voltages held over a period."""

    def __init__(self, model: MotionModel, period: float) -> None:
        self._model, self._period = model, period
        self._machine = dataclasses.replace(model.machine, effects=())
        # Extension per belt travel, (belts, n).
        self._extension = model.machine.belt_matrix / model.machine.travel_per_unit
        # Coulomb friction, N, is the value of its parameter over a unit, times the force of this unit. The
        # unit is the declared value, because voltages are then bit for bit those of the stored scores; 1 N
        # where that is 0.
        owners, factors = zip(
            *(model.machine.untied(f"{name}.coulomb") for name in model.machine.coordinate_names), strict=True
        )
        declared = np.array([model.machine.parameters[name] for name in owners])
        self._coulomb_columns = [list(model.machine.parameters).index(name) for name in owners]
        self._coulomb_unit = np.where(declared, declared, model.machine.travel_per_unit / np.array(factors))
        self._force_of_unit = np.where(declared, model.coulomb, 1.0)

    def matrices(self, parameters: ParameterRows, position: ToolPositions) -> tuple[Array, Array, Array]:
        """Linearize the machines without Coulomb friction and effects; discretize them with zero-order hold.

        Viscous friction and motor constants are taken from the declared machine; masses, belts and radii from
        `parameters`. The belts have the stiffness that they have at `position`.

        Returns:
            A: System matrices, shape (B, 2 n, 2 n).
            B: Input matrices of the voltages, m/V and m/(Vs), shape (B, 2 n, drives).
            E: Input matrices of a force on each coordinate, m/N and m/(Ns), shape (B, 2 n, n).
        """
        model, n, drives = self._model, len(self._model.mass), len(self._model.rated)
        by_name = dict(zip(model.machine.parameters, parameters.T, strict=True))
        equations = Equations(self._machine, model.machine.with_tied(by_name))
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
    # scipy.linalg.expm gives the same to 1e-11, but works on one matrix at a time: measured on the matrices
    # of the H-frame (14 x 14), it takes 3.5 times as long for 64 machines and 8 times as long for 512.
    power = step = matrices / 2**HALVINGS
    result = np.eye(step.shape[1]) + step
    for degree in range(2, TAYLOR_DEGREE + 1):
        power = power @ step / degree
        result = result + power
    for _ in range(HALVINGS):
        result = result @ result
    return result


def state_scale(states: int) -> Array:
    """Return units of the 2 n states, m and m/s, shape (2 n,), that condition the reachability Gramian well.

    They are 1 m for belt travel and 100 m/s for velocity: in a scaled state (state / units) an error of 1 mm
    is as large as one of 0.1 m/s.
    """
    return np.repeat([1.0, 1.0 / VELOCITY_SCALE_S], states // 2)


def scaled_matrices(A: Array, *inputs: Array) -> tuple[Array, ...]:
    """Scale the states of discrete-time linear systems: belt travel / 1 m, velocity / 100 m/s.

    Args:
        A: System matrices of the state, belt travel of n coordinates, m, and its velocity, m/s,
            shape (..., 2 n, 2 n).
        *inputs: Input matrices, m and m/s per unit of the inputs, shape (..., 2 n, inputs).

    Returns:
        The converted A, shape (..., 2 n, 2 n), then each converted input matrix, shape (..., 2 n, inputs).
    """
    scale = state_scale(A.shape[-1])
    return A / scale[:, None] * scale, *(matrix / scale[:, None] for matrix in inputs)


def reachability(A: Array, B: Array, longest: int) -> Iterator[tuple[Array, Array, Array]]:
    """Yield the responses of linear systems over N = 1, 2, ... periods to voltages and to the initial state.

    With them, the voltages u_j = -B' A'^(N-1-j) W_N^-1 A^N z in the periods j = 0, ..., N - 1 bring a state
    error z to zero in N periods; no others have a smaller sum of squares.

    Args:
        A: System matrices of any number of machines or operating points, shape (points, 2 n, 2 n).
        B: Input matrices of the voltages, shape (points, 2 n, drives).
        longest: Largest number of periods N.

    Yields:
        pulse: Response A^(N-1) B of the state after N periods to the voltages of the first one, with scaled
            states (belt travel / 1 m, velocity / 100 m/s), shape (points, 2 n, drives).
        gramian: Reachability Gramian W_N, the sum of A^j B B' A'^j for j < N, shape (points, 2 n, 2 n).
        power: Response A^N of the state after N periods to the initial state, shape (points, 2 n, 2 n).
    """
    A, B = scaled_matrices(A, B)
    gramian, power = np.zeros_like(A), np.broadcast_to(np.eye(A.shape[1]), A.shape)
    for _ in range(longest):
        pulse = power @ B
        gramian, power = gramian + pulse @ pulse.transpose(0, 2, 1), power @ A
        yield pulse, gramian, power
