"""Stages in a closed loop, stepped by the kernel alone, so that a controller's tests need nothing above the machine."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hframe_gym.controllers import Controller
from hframe_gym.dynamics.kernel import in_blocks, kernel_for
from hframe_gym.dynamics.simulation import parameter_batch
from hframe_gym.machine import Machine, rest_state

Array = NDArray[np.float64]
STEPS = 40  # of the integrator, a control period of 10 ms
PERIOD = 0.01  # s
PREVIEW = 10  # goals ahead


@dataclass(frozen=True)
class ClosedLoop:
    """error (B, m + 1), m, of the tool after each control period; actions (B, m, 2)."""

    error: Array
    actions: Array


def closed_loop(
    controller: Controller,
    machine: Machine,
    start: Array,
    goal: Array,
    *,
    changes: Mapping[str, Array] | None = None,
    periods: int = 120,
    sense: Callable[[Array], Array] | None = None,
) -> ClosedLoop:
    """Run stages of a machine, with other parameters in changes (B,) by name, from rest at start (B, 2).

    goal (B, 2), or (B, periods + 1 + PREVIEW, 2) of one that moves, at the beginning of each period.
    """
    kernel = kernel_for(machine)
    count, n = len(start), len(machine.coordinates)
    table = parameter_batch(machine, dict(changes or {}))
    parameters = in_blocks(np.ascontiguousarray(np.broadcast_to(table, (count, table.shape[1]))))
    scale = np.tile(machine.radii, 2)
    travel = np.array([rest_state(machine, point) for point in start]) * scale
    state = in_blocks(np.hstack([travel, np.zeros((count, 1))]))
    derived = np.zeros((len(state), len(kernel.layout.derived), state.shape[2]))
    kernel.prepare_blocks(parameters, PERIOD / STEPS, 0, len(state), derived)
    rated = np.array([d.rated_voltage for d in machine.drives])
    controller.reset()
    errors, actions = [], []
    for k in range(periods + 1):
        now = goal if goal.ndim == 2 else goal[:, k]
        values = state.transpose(0, 2, 1).reshape(-1, 2 * n + 1)[:count, : 2 * n] / scale
        errors.append(np.linalg.norm(values[:, :2] - now, axis=1))
        if k < periods:
            seen = {"observation": values if sense is None else sense(values), "desired_goal": now}
            if goal.ndim == 3:
                seen["preview"] = goal[:, k + 1 : k + 1 + PREVIEW].reshape(count, -1)
            actions.append(controller.act(seen))
            volts = in_blocks(actions[-1] * rated)
            kernel.advance_blocks(state, parameters, derived, volts, PERIOD / STEPS, STEPS, 0, len(state))
    return ClosedLoop(np.stack(errors, axis=1), np.stack(actions, axis=1))


def random_stages(machine: Machine, count: int, seed: int) -> dict[str, Array]:
    """Parameters (count,) by name, drawn as the environment does by default."""
    rng = np.random.default_rng(seed)
    shared = rng.uniform(0.7, 1.3, count)
    changes = {}
    for name, value in machine.parameters.items():
        key = name.rpartition(".")[2]
        span = {"rest_length": (0.85, 1.2), "coulomb": (0.5, 2.0), "mass": (0.9, 1.2)}.get(key)
        if key == "EA":
            changes[name] = value * shared
        elif span is not None:
            changes[name] = value * rng.uniform(*span, count)
    return changes


def random_points(count: int, seed: int) -> Array:
    """Points (count, 2) of the workspace, m."""
    return np.random.default_rng(seed).uniform([-0.25, -0.16], [0.25, 0.16], (count, 2))


def circles(count: int, seed: int, periods: int = 120, radius: float = 0.025, speed: float = 0.3) -> Array:
    """Goals (count, periods + 1 + PREVIEW, 2) on circles that begin at rest, m."""
    rng = np.random.default_rng(seed)
    centre, phase = rng.uniform([-0.2, -0.12], [0.2, 0.12], (count, 2)), rng.uniform(0.0, 2.0 * np.pi, count)
    t = PERIOD * np.arange(periods + 1 + PREVIEW)
    u = np.minimum(t / 0.2, 1.0)
    way = speed * (0.2 * (u**3 - 0.5 * u**4) + np.maximum(t - 0.2, 0.0))
    angle = phase[:, None] + way / radius
    return centre[:, None] + radius * np.stack([np.cos(angle), np.sin(angle)], axis=2)
