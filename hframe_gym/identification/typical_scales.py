"""What is typical of a machine in these runs, by unit: forces, speeds, ways, currents, stretches."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..machine import Machine
from .estimation import typical_force

Array = NDArray[np.float64]


@dataclass(frozen=True)
class TypicalScales:
    """By coordinate, typical sizes by unit, own units; `wide` for what belongs to no coordinate."""

    by_coordinate: Mapping[str, Mapping[str, float]]
    wide: Mapping[str, float]

    def of(self, coordinate: str) -> Mapping[str, float]:
        return {**self.wide, **self.by_coordinate.get(coordinate, {})}


def references(machine: Machine, positions: Array, velocities: Array, inputs: Sequence[Array]) -> TypicalScales:
    """References from the machine's motion along all runs, positions and velocities (n, coordinates), inputs (n, k)."""
    force = typical_force(machine)
    top = np.maximum(np.percentile(np.abs(velocities), 99, axis=0), 1e-9)
    span = np.maximum(np.ptp(positions, axis=0), 1e-9)
    table: dict[str, dict[str, float]] = {}
    for i, c in enumerate(machine.coordinates):
        own = force * (c.radius if c.kind == "rotary" else 1.0)
        speed, way = float(top[i]), float(span[i])
        table[c.name] = {
            "force": own,
            "speed": speed,
            "position": way,
            "viscous": own / speed,
            "drag": own / speed**2,
            "stiffness": own / way,
        }
    volts = np.concatenate(list(inputs))
    for j, d in enumerate(machine.drives):
        i = machine.coordinate_names.index(d.coordinate)
        current = (volts[:, j] - d.Ke * d.gear_ratio * velocities[:, i]) / d.resistance
        table[d.coordinate]["A"] = max(float(np.abs(current).max()), 1e-9)
    wide: dict[str, float] = {}
    if machine.belts:
        G = np.array([machine.row(b.extension) for b in machine.belts]) * machine.radii
        stretch = positions @ G.T
        stiffness = np.array([b.EA / b.rest_length for b in machine.belts])
        largest = max(float(np.percentile(np.abs(stretch), 99)), 1e-9)
        wide = {"m": largest, "N": float(np.abs(stretch * stiffness).max()), "1/m^2": 1.0 / largest**2}
    return TypicalScales(table, wide)
