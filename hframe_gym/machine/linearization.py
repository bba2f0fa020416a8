"""Rigid kinematics and linearization of a machine: rest states, stiffness, state space and modes.

Equation numbers refer to Sollmann, Jouaneh and Lavender (2010).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from .components import Array
from .machine import Machine

_RIGID_EIGENVALUE = 1e-9  # eigenvalues below this fraction of the largest one belong to rigid-body modes
_RIGID_EXTENSION = 1e-9  # m per unit of the leading coordinate; a motion that extends a belt by more is not rigid


class StateSpace(NamedTuple):
    """Linear model x' = A x + B u, y = C x + D u.

    Attributes:
        A: System matrix, shape (states, states). States are all positions (m, rad), then all velocities (m/s, rad/s).
        B: Input matrix, shape (states, drives); inputs are voltages, V.
        C: Output matrix, shape (sensors, states).
        D: Feedthrough matrix, shape (sensors, drives); zero.
    """

    A: Array
    B: Array
    C: Array
    D: Array


def stiffness_matrix(machine: Machine, position: Array | None = None) -> Array:
    """Return the stiffness matrix K = G^T diag(k) G of the belts for small displacements of the coordinates.

    G is the extension of each belt per unit of each coordinate, `Machine.belt_matrix`; k is the stiffness of each belt.

    Args:
        machine: Machine.
        position: Positions of unstretched belts, m or rad, shape (coordinates,); they determine the lengths and
            therefore k. Default: zeros.

    Returns:
        Stiffness, shape (coordinates, coordinates): N/m between linear coordinates, Nm/rad between rotary ones, N/rad
        (equal to N) between both kinds.
    """
    count = len(machine.coordinates)
    travel = np.zeros(count) if position is None else np.asarray(position) * machine.travel_per_unit
    K = np.zeros((count, count))
    for belt, row in zip(machine.belts, machine.belt_matrix, strict=True):
        stiffness = belt.EA / (belt.rest_length + machine.coefficients(belt.length) @ travel)
        K += stiffness * np.outer(row, row)
    return K


def linearize(machine: Machine, position: Array | None = None) -> StateSpace:
    """Linearize the equations of motion about rest, without Coulomb friction and effects.

    The back-EMF of a drive acts as viscous friction of its coordinate.

    Args:
        machine: Machine.
        position: Operating point with unstretched belts, m or rad, shape (coordinates,). Default: zeros.

    Returns:
        State-space matrices. States: positions, then velocities, in the coordinates' units; inputs: drive voltages, V;
        outputs: sensor readings in the channels' units.

    References:
        Sollmann, Jouaneh and Lavender (2010), eq. 20-24.
    """
    count = len(machine.coordinates)
    mass = np.array([c.mass for c in machine.coordinates])
    viscous = np.array([c.viscous for c in machine.coordinates])
    drive_gain = np.zeros((count, len(machine.drives)))
    for column, drive in enumerate(machine.drives):
        row = machine.coordinate_names.index(drive.coordinate)
        drive_gain[row, column] = drive.gain
        viscous[row] += drive.back_emf
    A = np.block(
        [
            [np.zeros((count, count)), np.eye(count)],
            [-stiffness_matrix(machine, position) / mass[:, None], -np.diag(viscous / mass)],
        ]
    )
    B = np.vstack([np.zeros_like(drive_gain), drive_gain / mass[:, None]])
    C = np.hstack([machine.sensor_matrix, np.zeros_like(machine.sensor_matrix)])
    return StateSpace(A, B, C, np.zeros((len(machine.sensors), len(machine.drives))))


def mode_frequencies(machine: Machine, position: Array | None = None) -> Array:
    """Return the undamped natural frequencies: the square roots of the eigenvalues of M^-1 K over 2 pi.

    Args:
        machine: Machine.
        position: Operating point with unstretched belts, m or rad, shape (coordinates,). Default: zeros.

    Returns:
        Frequencies, Hz, ascending, shape (coordinates,); exactly zero for rigid-body modes, which stretch no belt.
    """
    from scipy.linalg import eigh  # SciPy takes most of the time of `import hframe_gym`

    mass_matrix = np.diag([c.mass for c in machine.coordinates])
    squared = eigh(stiffness_matrix(machine, position), mass_matrix, eigvals_only=True)
    scale = max(squared.max(), 1.0)
    return np.sqrt(np.where(squared < _RIGID_EIGENVALUE * scale, 0.0, squared)) / (2 * np.pi)


def rest_state(machine: Machine, position: ArrayLike | None = None) -> Array:
    """Return the state at rest with unstretched belts for given positions of the carriages.

    Args:
        machine: Machine.
        position: Positions of the linear coordinates in the machine's order, m, shape (linear coordinates,); a single
            value applies to all of them. Default: zeros. The pulley angles follow from zero extension of every belt
            (least squares); coordinates that a spring holds, such as the yaw of a bridge, are at zero.

    Returns:
        Positions, m or rad, then zero velocities, shape (2 * coordinates,).

    Raises:
        ValueError: If there are several positions, but not one per linear coordinate.
    """
    count = len(machine.coordinates)
    q = np.zeros(count)
    linear = [i for i, c in enumerate(machine.coordinates) if c.kind == "linear"]
    if position is not None:
        q[linear] = np.asarray(position, float)
    pulleys = [i for i in range(count) if i not in linear and machine.coordinate_names[i] not in machine.spring_loaded]
    if pulleys and machine.belts:
        G = machine.belt_matrix
        q[pulleys] = np.linalg.lstsq(G[:, pulleys], -G[:, linear] @ q[linear], rcond=None)[0]
    return np.concatenate([q, np.zeros(count)])


def rigid_motions(machine: Machine) -> dict[str, Array]:
    """Return the rigid-body motions of a machine: independent motions that stretch no belt.

    With belts there is one motion per linear coordinate, and the pulleys follow it without stretching the belts.
    Without belts each coordinate moves independently.

    Args:
        machine: Machine.

    Returns:
        By name of the leading coordinate: motion of every coordinate per unit of the leading one (m or rad per m or
        rad), shape (coordinates,). A linear coordinate that cannot move without stretching a belt has no entry.
    """
    count = len(machine.coordinates)
    if not machine.belts:
        return {name: np.eye(count)[i] for i, name in enumerate(machine.coordinate_names)}
    G = machine.belt_matrix
    rotary = [i for i, c in enumerate(machine.coordinates) if c.kind == "rotary"]
    motions = {}
    for index, coordinate in enumerate(machine.coordinates):
        if coordinate.kind == "linear":
            motion = np.eye(count)[index]
            motion[rotary] = np.linalg.lstsq(G[:, rotary], -G[:, index], rcond=None)[0]
            if np.max(np.abs(G @ motion)) < _RIGID_EXTENSION:
                motions[coordinate.name] = motion
    return motions
