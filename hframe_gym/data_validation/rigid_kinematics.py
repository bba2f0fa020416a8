"""The machine with belts that do not stretch: which ways it can move, what each channel reads by the others."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..machine import Machine

Array = NDArray[np.float64]


def directions(machine: Machine) -> dict[str, Array]:
    """Ways to move without stretching a belt: by coordinate, the motion (n,) of all per unit of that one, own units.

    With belts the linear coordinates lead and the pulleys follow; without belts each coordinate moves by itself.
    """
    count = len(machine.coordinates)
    if not machine.belts:
        return {name: np.eye(count)[i] for i, name in enumerate(machine.coordinate_names)}
    G = np.array([machine.row(b.extension) for b in machine.belts]) * machine.radii
    rotary = [i for i, c in enumerate(machine.coordinates) if c.kind == "rotary"]
    found = {}
    for i, c in enumerate(machine.coordinates):
        if c.kind == "linear":
            motion = np.eye(count)[i]
            motion[rotary] = np.linalg.lstsq(G[:, rotary], -G[:, i], rcond=None)[0]
            if np.max(np.abs(G @ motion)) < 1e-9:
                found[c.name] = motion
    return found


def readings(machine: Machine) -> Array:
    """Reading of each sensor per unit of each direction, (sensors, directions)."""
    return machine.sensor_matrix @ np.array(list(directions(machine).values())).reshape(-1, len(machine.coordinates)).T


def from_others(outputs: Array, j: int, machine: Machine) -> Array | None:
    """What channel j should read (n,) by the other channels, up to a constant; None where they do not tell."""
    M = readings(machine)
    others = [k for k in range(len(M)) if k != j and np.isfinite(outputs[:, k]).any()]
    if not others or M.shape[1] == 0:
        return None
    size = np.linalg.norm(M[others], axis=1)
    scaled = M[others] / size[:, None]
    weights = M[j] @ np.linalg.pinv(scaled)
    if not np.allclose(weights @ scaled, M[j], atol=1e-9 * max(1.0, float(np.abs(M[j]).max()))):
        return None
    return (outputs[:, others] / size) @ weights
