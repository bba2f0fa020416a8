"""Kinematics of a machine with unstretched belts."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from .components import Array
from .machine import Machine

_STRETCHES = 1e-9  # m per unit of the leading coordinate; a motion that extends a belt by more is not rigid


def rest_state(machine: Machine, position: ArrayLike | None = None) -> Array:
    """Return the state at rest with unstretched belts.

    Args:
        machine: Machine.
        position: Positions of the linear coordinates in their order, m, shape (linear coordinates,). Default: zeros.
            The angles of the pulleys follow from zero extension of every belt.

    Returns:
        Positions, m or rad, then zero velocities, shape (2 * coordinates,).
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
    """Return the independent motions of a machine that stretch no belt.

    With belts each linear coordinate leads one motion and the pulleys follow; without belts each coordinate moves
    independently.

    Args:
        machine: Machine.

    Returns:
        By leading coordinate, the motion of every coordinate per unit of the leading one, shape (coordinates,). A
        linear coordinate that cannot move without stretching a belt is left out.
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
            if np.max(np.abs(G @ motion)) < _STRETCHES:
                motions[coordinate.name] = motion
    return motions
