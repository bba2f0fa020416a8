"""Where the numbers of a machine's tables stand in its rows of parameters."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..machine import Machine

Array = NDArray[np.float64]


def column(machine: Machine, name: str) -> tuple[int, float]:
    """Place in `Machine.parameters` of the parameter behind a number of the tables, and the factor between them.

    The factor is 1 but for a number that is tied to another (`Machine.ties`).
    """
    if name in machine.ties:
        owner, factor = machine.ties[name]
        place, more = column(machine, owner)
        return place, factor * more
    return list(machine.parameters).index(name), 1.0


def numbers(machine: Machine, name: str, values: Array) -> Array:
    """A number of the tables (k,) by its full name, from parameters values (k, P or more)."""
    place, factor = column(machine, name)
    return factor * values[:, place]


def per_travel(machine: Machine, values: Array) -> Array:
    """Own unit per metre of travel (k, coordinates): 1 for a linear one, else 1 / radius, rad/m."""
    units = np.ones((len(values), len(machine.coordinates)))
    for i, c in enumerate(machine.coordinates):
        if c.kind == "rotary":
            units[:, i] = 1.0 / numbers(machine, f"{c.name}.radius", values)
    return units
