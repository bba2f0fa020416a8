"""The spaces of the environment, and what each entry of `observation` is.

observation      positions of x, y and the driven coordinates, then their velocities     m, rad, m/s, rad/s
achieved_goal    x, y of the tool                                                        m
desired_goal     x, y of the goal                                                        m
preview          x, y of the goal at each of the task's times ahead, nearest first       m (tasks whose goal moves)
privileged       the full true state and what was randomised, for a critic in training   (with privileged=True)
action           one number a drive, share of its rated voltage                          [-1, 1]
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from ..machine import Machine, rest_state

BEYOND = 0.05  # m: how far beyond its range a position is still reported
SPEED_FACTOR = 3.0  # of the drives' no-load speed: far more than any motion that a drive can cause


@dataclass(frozen=True)
class SignalSpec:
    """One number of `observation` (or `privileged`).  coordinate: whose position or velocity it is, or ""."""

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


def entries(machine: Machine) -> tuple[SignalSpec, ...]:
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
        positions.append(SignalSpec(name, c.unit("position"), name, False, float(low), float(high)))
        velocities.append(SignalSpec(f"{name} velocity", c.unit("speed"), name, True, -fastest, fastest))
    return (*positions, *velocities)


def _furthest(machine: Machine, name: str, ranges: NDArray[np.float64]) -> float:
    """Half as much again as a coordinate's angle at the furthest corner, at least `BEYOND` of travel, rad."""
    linear = [c.name for c in machine.coordinates if c.kind == "linear"]
    index = machine.coordinate_names.index(name)
    total = 0.0
    for axis, edges in zip(("x", "y"), ranges, strict=True):
        unit = rest_state(machine, [float(c == axis) for c in linear])[index]
        total += abs(unit) * float(np.abs(edges).max())
    c = machine.coordinate(name)
    return max(1.5 * total, BEYOND / (c.radius if c.kind == "rotary" else 1.0))


def privileged_entries(machine: Machine, drawn: Mapping[str, tuple[float, float]]) -> tuple[SignalSpec, ...]:
    """Positions of all coordinates, their velocities, and the drawn parameters as shares of their nominal values.

    drawn: by name, the bounds of each as such a share.
    """
    ranges = workspace(machine)
    known = {e.coordinate for e in entries(machine)}
    others = [name for name in machine.coordinate_names if name not in known]
    state = list(entries(machine))
    fastest = max(e.high for e in state if e.velocity and e.unit == "m/s")
    for name in others:
        c = machine.coordinate(name)
        radius = c.radius if c.kind == "rotary" else 1.0
        furthest = _furthest(machine, name, ranges)
        state.append(SignalSpec(name, c.unit("position"), name, False, -furthest, furthest))
        state.append(SignalSpec(f"{name} velocity", c.unit("speed"), name, True, -fastest / radius, fastest / radius))
    state.sort(key=lambda e: e.velocity)
    return (*state, *(SignalSpec(name, "1", "", False, *bounds) for name, bounds in drawn.items()))


def observation_space(
    machine: Machine,
    previews: int = 0,
    *,
    observed: Sequence[SignalSpec] | None = None,
    privileged: Sequence[SignalSpec] = (),
) -> spaces.Dict:
    """Dict of bounded float32 boxes: observation (those observed, or the full state), achieved_goal, desired_goal and,
    where there are any, preview (2 * previews,) and privileged."""
    ranges = workspace(machine)
    goal = (ranges[:, 0] - BEYOND, ranges[:, 1] + BEYOND)
    boxes = {
        "observation": _edges(entries(machine) if observed is None else observed),
        "achieved_goal": goal,
        "desired_goal": goal,
    }
    if previews:
        boxes["preview"] = (np.tile(goal[0], previews), np.tile(goal[1], previews))
    if privileged:
        boxes["privileged"] = _edges(privileged)
    return spaces.Dict(
        {
            key: spaces.Box(low.astype(np.float32), high.astype(np.float32), dtype=np.float32)
            for key, (low, high) in boxes.items()
        }
    )


def _edges(listed: Sequence[SignalSpec]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    return np.array([e.low for e in listed]), np.array([e.high for e in listed])


def action_space(machine: Machine) -> spaces.Box:
    """Box(-1, 1) of float32, one number a drive: share of its rated voltage."""
    return spaces.Box(-1.0, 1.0, (len(machine.drives),), np.float32)
