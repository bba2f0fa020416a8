"""The spaces of the environment, and what each entry of `observation` is.

observation      positions of x, y and the driven coordinates, then their velocities    m, rad, m/s, rad/s
achieved_goal    x, y of the tool                                                        m
desired_goal     x, y of the goal                                                        m
action           one number a drive, share of its rated voltage                          [-1, 1]
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from ..machine import Machine, rest_state

BEYOND = 0.05  # m: how far beyond its range a position is still reported
SPEED_FACTOR = 3.0  # of the drives' no-load speed: far more than any motion that a drive can cause


@dataclass(frozen=True)
class Entry:
    """One number of `observation`."""

    name: str
    unit: str
    coordinate: str
    velocity: bool
    low: float
    high: float


def workspace(machine: Machine) -> NDArray[np.float64]:
    """Where the tool can go, (2, 2) m: rows x and y, columns low and high.

    Raises ValueError when the machine is not a stage with x, y, their ranges and two drives.
    """
    for name in ("x", "y"):
        if name not in machine.coordinate_names:
            raise ValueError(f"machine {machine.name!r} has no coordinate {name!r}; HFrame needs a stage with x and y")
        if machine.coordinate(name).range is None:
            raise ValueError(f"machine {machine.name!r}: coordinate {name!r} has no range; HFrame needs one")
    if len(machine.drives) != 2:
        raise ValueError(f"machine {machine.name!r} has {len(machine.drives)} drives; HFrame needs two")
    return np.array([machine.coordinate(name).range for name in ("x", "y")], dtype=np.float64)


def entries(machine: Machine) -> tuple[Entry, ...]:
    """The full state of x, y and the driven coordinates: positions, then velocities."""
    ranges = workspace(machine)
    speed = 0.0  # m/s of belt, with no load at rated voltage
    for d in machine.drives:
        c = machine.coordinate(d.coordinate)
        radius = c.radius if c.kind == "rotary" else 1.0
        speed = max(speed, SPEED_FACTOR * d.rated_voltage / (d.Ke * d.gear_ratio) * radius)
    names = ["x", "y"] + [d.coordinate for d in machine.drives if d.coordinate not in ("x", "y")]
    positions, velocities = [], []
    for name in names:
        c = machine.coordinate(name)
        if name in ("x", "y"):
            low, high = ranges[("x", "y").index(name)] + np.array([-BEYOND, BEYOND])
            fastest = speed
        else:
            high = _furthest(machine, name, ranges)
            low, fastest = -high, speed / c.radius
        positions.append(Entry(name, c.unit("position"), name, False, float(low), float(high)))
        velocities.append(Entry(f"{name} velocity", c.unit("speed"), name, True, -fastest, fastest))
    return (*positions, *velocities)


def _furthest(machine: Machine, name: str, ranges: NDArray[np.float64]) -> float:
    """Half as much again as the angle that a driven coordinate has at the furthest corner, rad."""
    linear = [c.name for c in machine.coordinates if c.kind == "linear"]
    index = machine.coordinate_names.index(name)
    total = 0.0
    for axis, edges in zip(("x", "y"), ranges, strict=True):
        unit = rest_state(machine, [float(c == axis) for c in linear])[index]
        total += abs(unit) * float(np.abs(edges).max())
    return 1.5 * total


def observation_space(machine: Machine) -> spaces.Dict:
    """Dict of bounded float32 boxes: observation, achieved_goal, desired_goal."""
    all_entries = entries(machine)
    ranges = workspace(machine)
    boxes = {
        "observation": (np.array([e.low for e in all_entries]), np.array([e.high for e in all_entries])),
        "achieved_goal": (ranges[:, 0] - BEYOND, ranges[:, 1] + BEYOND),
        "desired_goal": (ranges[:, 0] - BEYOND, ranges[:, 1] + BEYOND),
    }
    return spaces.Dict(
        {
            key: spaces.Box(low.astype(np.float32), high.astype(np.float32), dtype=np.float32)
            for key, (low, high) in boxes.items()
        }
    )


def action_space(machine: Machine) -> spaces.Box:
    """Box(-1, 1) of float32, one number a drive: share of its rated voltage."""
    return spaces.Box(-1.0, 1.0, (len(machine.drives),), np.float32)
