"""Kinematics of a machine: positions at rest with unstretched belts."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .machine import Machine

Array = NDArray[np.float64]


def rest_state(machine: Machine, position: ArrayLike | None = None) -> Array:
    """State (2 n,) at rest with unstretched belts, from the positions of the coordinates that carry the tool.

    position: the linear coordinates' positions in order, m (default zeros); rotary ones follow from s = 0.
    """
    n = len(machine.coordinates)
    q = np.zeros(n)
    linear = [i for i, c in enumerate(machine.coordinates) if c.kind == "linear"]
    if position is not None:
        q[linear] = np.asarray(position, float)
    rotary = [i for i in range(n) if i not in linear and machine.coordinate_names[i] not in machine.sprung]
    if rotary and machine.belts:
        G = np.array([machine.row(b.extension) for b in machine.belts]) * machine.radii
        q[rotary] = np.linalg.lstsq(G[:, rotary], -G[:, linear] @ q[linear], rcond=None)[0]
    return np.concatenate([q, np.zeros(n)])
