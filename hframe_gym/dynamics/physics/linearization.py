"""Linearization of the equations of motion about rest: stiffness, state space and natural frequencies.

The derivatives are exact to rounding, because the equations are differentiated by a complex step: for an
analytic function f, f'(x) = Im f(x + i h) / h up to an error of order h^2. There is no cancellation, so that
h can be tiny.

References:
    Squire and Trapp (1998), Using Complex Variables to Estimate Derivatives of Real Functions.
"""

from __future__ import annotations

import dataclasses
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...arrays import Array
from ...machine import Machine
from ...parallel import single_threaded_linear_algebra
from .equations import Equations

_SHORTEST_PART = 0.01  # of the longest step
# Voltages that jump by 4 V and act 0.43 ms later: 6 um of error at 0.125 ms, 0.3 um at 0.05 ms.
_STEP_WITH_DELAY = 0.4
_MAX_PHASE = 0.75  # rad per integration step; the 20th-order H-frame has 0.73 at 0.5 ms
# Complex step; its square vanishes beside every number of interest, and its products do not underflow.
_STEP = 1e-40
_RIGID_EIGENVALUE = 1e-9  # eigenvalues below this fraction of the largest one belong to rigid-body modes


class StateSpace(NamedTuple):
    """Linear model x' = A x + B u, y = C x + D u: deviations from rest at an operating point.

    Attributes:
        A: System matrix, shape (states, states). States are all positions (m, rad), then all velocities (m/s,
            rad/s).
        B: Input matrix, shape (states, drives); inputs are the commands of the drives, V for voltage drives.
        C: Output matrix, shape (sensors, states); outputs are sensor readings in their units.
        D: Feedthrough matrix, shape (sensors, drives); zero unless a sensor measures a current or an
            acceleration.
    """

    A: Array
    B: Array
    C: Array
    D: Array


def stiffness_matrix(machine: Machine, position: ArrayLike | None = None) -> Array:
    """Return the stiffness matrix of the belts: the negative derivative of the belt forces by the positions.

    It equals G' diag(k) G, where G is the extension of each belt per unit of each coordinate and k the
    stiffness of each belt at the operating point. It is differentiated by a complex step, exact to rounding
    (Squire and Trapp 1998).

    Args:
        machine: Machine; its effects are left out. Without belts the result is zero.
        position: One or several operating points with unstretched belts: position of every coordinate, m or
            rad, shape (..., coordinates). Default: one operating point, all positions zero.

    Returns:
        Stiffness, shape (..., coordinates, coordinates), row: force, column: displacement. N/m between linear
        coordinates, Nm/rad between rotary ones, N/rad (equal to N) between a linear and a rotary one.
    """
    equations, q = _operating_point(machine, position)
    # (..., coordinate that is stepped, coordinates)
    stepped = q[..., None, :] + 1j * _STEP * np.eye(q.shape[-1])
    point = equations.point(stepped)
    forces = equations.in_units(equations.belt_forces(point, equations.belt_states(point)))
    forces = np.broadcast_to(forces, stepped.shape)  # without belts they are scalars
    # row: force on a coordinate, column: displaced coordinate
    return -np.swapaxes(forces.imag, -1, -2) / _STEP


def linearize(machine: Machine, position: ArrayLike | None = None) -> StateSpace:
    """Linearize the equations of motion about rest, without Coulomb friction and effects.

    A drive with a torque law, such as a servo (`Machine.drive_laws`), is linear near its set point; the
    states of its controller, such as an integral, are held constant. The back-EMF of a drive acts as viscous
    friction of its coordinate. The equations are differentiated by a complex step, exact to rounding (Squire
    and Trapp 1998). `StateSpace` states the shape of each matrix.

    Args:
        position: Operating point with unstretched belts: position of every coordinate, m or rad,
            shape (coordinates,). Default: zeros.

    References:
        Sollmann, Jouaneh and Lavender (2010), eq. 20-24.
    """
    equations, q = _operating_point(machine, position)
    count, drives = len(q), len(machine.drives)
    # One row per argument of the equations of motion: a step of each position, velocity and voltage in turn.
    steps = 1j * _STEP * np.eye(2 * count + drives)
    # (coordinates or sensors, 2 * coordinates + drives)
    derivatives, outputs = (v.T.imag / _STEP for v in evaluate_beside_rest(equations, q, steps))
    # The derivatives of the positions are the velocities.
    rates = np.hstack([np.zeros((count, count)), np.eye(count)])
    A = np.vstack([rates, derivatives[:, : 2 * count]])
    B = np.vstack([np.zeros((count, drives)), derivatives[:, 2 * count :]])
    return StateSpace(A, B, outputs[:, : 2 * count], outputs[:, 2 * count :])


def evaluate_beside_rest(
    equations: Equations, position: Array, deviations: NDArray[Any]
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Evaluate accelerations and sensor readings at deviations from rest, without Coulomb friction.

    Args:
        position: Position of every coordinate at rest, m or rad, shape (n,).
        deviations: Deviations of n positions and n velocities, m or rad and per s, and voltages, V, real or
            complex, shape (rows, 2 n + drives).

    Returns:
        Accelerations, m/s^2 or rad/s^2, shape (rows, n), and readings in the sensors' units,
        shape (rows, sensors).
    """
    n, rows = len(position), len(deviations)
    positions, velocities = position + deviations[:, :n], deviations[:, n : 2 * n]
    point, voltages = equations.point(positions, velocities), list(deviations[:, 2 * n :].T)
    no_direction = np.zeros_like  # of motion, for every speed, so that Coulomb friction is 0
    belt_accelerations = equations.accelerations(point, voltages, no_direction)
    accelerations = [a * equations.per_radius(i) for i, a in enumerate(belt_accelerations)]
    motor_voltages = equations.motor_voltages(voltages)
    currents = [equations.current(j, point, motor_voltages) for j in range(len(voltages))]
    readings = equations.sensor_readings(list(positions.T), list(velocities.T), accelerations, currents)
    return tuple(  # type: ignore[return-value]
        np.array([np.broadcast_to(value, rows) for value in values]).reshape(-1, rows).T
        for values in (accelerations, readings)
    )


def mode_frequencies(machine: Machine, position: ArrayLike | None = None) -> Array:
    """Return the undamped natural frequencies of masses on the belts, Hz, ascending, shape (coordinates,).

    They are sqrt(eigenvalues of M^-1 K) / (2 pi) with the masses M and the stiffness matrix K, and exactly
    zero for rigid-body modes, which stretch no belt.

    Args:
        machine: Machine with any number of belts; its effects are left out.
        position: Operating point, as for `linearize`, m or rad, shape (coordinates,). Default: zeros.
    """
    from scipy.linalg import eigh  # SciPy takes most of the time of `import hframe_gym`

    mass_matrix = np.diag([c.mass for c in machine.coordinates])
    squared = eigh(stiffness_matrix(machine, position), mass_matrix, eigvals_only=True)
    # (rad/s)^2; eigenvalues far below it are rounding errors of rigid-body modes
    scale = max(squared.max(), 1.0)
    return np.sqrt(np.where(squared < _RIGID_EIGENVALUE * scale, 0.0, squared)) / (2 * np.pi)


def belt_modes(machine: Machine) -> list[float]:
    """Return the vibration frequencies of the masses on the belts, Hz, ascending, without effects.

    These are the positive `mode_frequencies` at position 0; there are none without elastic belts.
    """
    return [float(frequency) for frequency in mode_frequencies(machine) if frequency > 0.0]


def resolved_step(machine: Machine, longest_step: float, *, delays: bool = True) -> float:
    """Return an integration step, s, short enough for the fastest vibration, dampers and delays.

    Steps that are too long for a stiff belt change the frequency of its vibration, and much longer ones make
    the integrator diverge. The step is therefore at most 0.75 / the highest rate (rad/s): the highest natural
    frequency of the belts at position 0, the rate of parts that effects add, with their damping
    (`Effect.fastest`), or the largest eigenvalue of the linear model where a drive follows a set point. For
    voltages that act with a delay, it is at most 0.4 times the longest step: they change inside a step, whose
    error falls with the square of its length. Dampers of contacts (`Effect.damping`) need no shorter step.

    The step is between a hundredth of `longest_step`, s, and `longest_step`. A machine that needs shorter
    steps has a wrong mass or stiffness, and its simulation then ends with an error instead of running out of
    memory.

    Args:
        longest_step: Step of a machine that needs no shorter one, s.
        delays: False if delays shorten no step. Of voltages of 12 V that change every 10 ms and act 2.3 ms
            later, a step of 0.5 ms makes 20 um of error; 0.2 ms makes 4 um and takes 2.5 times as long.
    """
    delayed = delays and any(effect.definition.delay is not None for effect in machine.effects)
    usual = longest_step * _STEP_WITH_DELAY if delayed else longest_step
    return max(_resolving_step(machine, usual), _SHORTEST_PART * longest_step)


def _resolving_step(machine: Machine, longest_step: float) -> float:
    """Return the step of `resolved_step` without its lower limit, and without delays."""
    rates = [e.definition.fastest(machine, e) for e in machine.effects if e.definition.fastest]
    if machine.drive_laws:
        rates.append(float(np.abs(np.linalg.eigvals(linearize(machine).A)).max()))
    else:  # called before every simulation, hence without the complex step
        rates.append(machine.highest_frequency)
    fastest = max(rates)
    return longest_step if longest_step * fastest <= _MAX_PHASE else _MAX_PHASE / fastest


def _operating_point(machine: Machine, position: ArrayLike | None) -> tuple[Equations, Array]:
    """Return the equations of a machine without its effects, and the operating point as an array."""
    equations = Equations(dataclasses.replace(machine, effects=()))
    count = len(machine.coordinates)
    return equations, np.zeros(count) if position is None else np.asarray(position, float)


def matrix_exponential(matrix: Array) -> Array:
    """Compute the exponential of a `matrix`, dimensionless, shape (n, n); threads do not change any bit."""
    from scipy.linalg import expm

    with single_threaded_linear_algebra():
        return np.asarray(expm(matrix))
