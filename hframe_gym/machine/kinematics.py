"""Rigid kinematics of a machine: positions and motions that stretch no belt."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from .components import Array
from .machine import Machine

_RIGID_EXTENSION = 1e-9  # m per unit of the leading coordinate; a motion that extends a belt by more is not rigid


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
