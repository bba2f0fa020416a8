"""Linearization of a machine to state space, and its natural frequencies (eq. 20-24 for the 8th-order model)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .components import Array
from .machine import Machine

_RIGID = 1e-9  # eigenvalues below this fraction of the largest one belong to rigid-body modes


class StateSpace(NamedTuple):
    """Linear model x' = A x + B u, y = C x + D u.

    Attributes:
        A: System matrix, shape (states, states). States are all positions, then all velocities, in m, rad and per s.
        B: Input matrix, shape (states, drives); inputs are voltages, V.
        C: Output matrix, shape (sensors, states).
        D: Feedthrough matrix, shape (sensors, drives); zero.
    """

    A: Array
    B: Array
    C: Array
    D: Array


def stiffness_matrix(machine: Machine, position: Array | None = None) -> Array:
    """Return the stiffness matrix K = G^T diag(k) G of the belts.

    Args:
        machine: Machine.
        position: Positions at which the belts are unstretched, m or rad, shape (coordinates,). Default: zeros.

    Returns:
        Stiffness, N/m, N/rad or Nm/rad, shape (coordinates, coordinates).
    """
    count = len(machine.coordinates)
    travel = np.zeros(count) if position is None else np.asarray(position) * machine.travel_per_unit
    K = np.zeros((count, count))
    for belt, row in zip(machine.belts, machine.belt_matrix, strict=True):
        stiffness = belt.EA / (belt.rest_length + machine.coefficients(belt.length) @ travel)
        K += stiffness * np.outer(row, row)
    return K


def linearize(machine: Machine, position: Array | None = None) -> StateSpace:
    """Linearize a machine about rest, without Coulomb friction and effects.

    Args:
        machine: Machine.
        position: Positions at which the belts are unstretched, m or rad, shape (coordinates,). Default: zeros.

    Returns:
        The state-space matrices.

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
    """Return the undamped natural frequencies of a machine.

    Args:
        machine: Machine.
        position: Positions at which the belts are unstretched, m or rad, shape (coordinates,). Default: zeros.

    Returns:
        Frequencies, Hz, ascending, shape (coordinates,); zeros for the rigid-body modes.
    """
    from scipy.linalg import eigh  # SciPy takes most of the time of `import hframe_gym`

    mass_matrix = np.diag([c.mass for c in machine.coordinates])
    squared = eigh(stiffness_matrix(machine, position), mass_matrix, eigvals_only=True)
    scale = max(squared.max(), 1.0)
    return np.sqrt(np.where(squared < _RIGID * scale, 0.0, squared)) / (2 * np.pi)
