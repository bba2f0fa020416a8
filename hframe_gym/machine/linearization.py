"""Linearisation of a machine to state space, and its modes (eq. 20-24 for the paper's 8th-order model)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh

from .machine import Machine


class StateSpace(NamedTuple):
    """x' = A x + B u, y = C x + D u; state: all positions, then all velocities, in the coordinates' units."""

    A: NDArray[np.float64]
    B: NDArray[np.float64]
    C: NDArray[np.float64]
    D: NDArray[np.float64]


def stiffness_matrix(machine: Machine, position: NDArray[np.float64] | None = None) -> NDArray[np.float64]:
    """K = G' diag(k) G at a position (n,) with unstretched belts, N/m, N/rad or Nm/rad."""
    travel = np.zeros(len(machine.coordinates)) if position is None else np.asarray(position) * machine.radii
    K = np.zeros((len(travel), len(travel)))
    for belt in machine.belts:
        row = machine.row(belt.extension) * machine.radii
        k = belt.EA / (belt.rest_length + machine.row(belt.length) @ travel)
        K += k * np.outer(row, row)
    return K


def linearize(machine: Machine, position: NDArray[np.float64] | None = None) -> StateSpace:
    """State space of the machine without Coulomb friction and effects, belts unstretched at `position` (n,)."""
    n = len(machine.coordinates)
    mass = np.array([c.mass for c in machine.coordinates])
    viscous = np.array([c.viscous for c in machine.coordinates])
    drive = np.zeros((n, len(machine.drives)))
    for j, d in enumerate(machine.drives):
        i = machine.coordinate_names.index(d.coordinate)
        drive[i, j] = d.gain
        viscous[i] += d.back_emf
    A = np.block(
        [
            [np.zeros((n, n)), np.eye(n)],
            [-stiffness_matrix(machine, position) / mass[:, None], -np.diag(viscous / mass)],
        ]
    )
    B = np.vstack([np.zeros_like(drive), drive / mass[:, None]])
    C = np.hstack([machine.sensor_matrix, np.zeros_like(machine.sensor_matrix)])
    return StateSpace(A, B, C, np.zeros((len(machine.sensors), len(machine.drives))))


def mode_frequencies(machine: Machine, position: NDArray[np.float64] | None = None) -> NDArray[np.float64]:
    """Undamped natural frequencies, Hz, ascending, rigid modes included as zeros."""
    mass = np.diag([c.mass for c in machine.coordinates])
    squares = eigh(stiffness_matrix(machine, position), mass, eigvals_only=True)
    scale = max(squares.max(), 1.0)
    return np.sqrt(np.where(squares < 1e-9 * scale, 0.0, squares)) / (2 * np.pi)
