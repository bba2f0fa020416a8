"""Closed loops of a controller and simulated machines, without environments."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from hframe_gym.arrays import Array
from hframe_gym.controllers import Controller
from hframe_gym.dynamics import rollout
from hframe_gym.machine import Machine, rest_state

PERIOD = 0.01  # control period, s
PREVIEW = 10  # previewed goals


@dataclass(frozen=True)
class ClosedLoop:
    """Recorded closed loop of B stages over m control periods.

    Attributes:
        error: Distance to the goal at the start and after each control period, m, shape (B, m + 1).
        actions: Actions, shape (B, m, 2).
    """

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
    measure: Callable[[Array], Array] | None = None,
) -> ClosedLoop:
    """Run a controller on stages that start at rest.

    Args:
        controller: Controller; it is reset first.
        machine: Machine; effects with a memory or a dead time are not supported.
        start: Tool positions at the start, m, shape (B, 2).
        goal: Constant goals, m, shape (B, 2), or moving goals at the start of each period and ahead, shape
            (B, periods + 1 + PREVIEW, 2).
        changes: Parameters of the stages that differ from the machine's, by name, each of shape (B,).
        periods: Number of control periods, m.
        measure: Measurements for full states (B, 8). Default: the full state.

    Returns:
        Errors and actions.
    """
    parameters = np.tile(list(machine.parameters.values()), (len(start), 1))
    for name, values in (changes or {}).items():
        parameters[:, list(machine.parameters).index(name)] = values
    state = np.array([rest_state(machine, point) for point in start])
    rated = np.array([d.rated_voltage for d in machine.drives])
    controller.reset()
    errors, actions = [], []
    for k in range(periods + 1):
        present_goal = goal if goal.ndim == 2 else goal[:, k]
        errors.append(np.linalg.norm(state[:, :2] - present_goal, axis=1))
        if k == periods:
            break
        observation = {
            "observation": state if measure is None else measure(state),
            "desired_goal": present_goal,
        }
        if goal.ndim == 3:
            observation["preview"] = goal[:, k + 1 : k + 1 + PREVIEW].reshape(len(start), -1)
        actions.append(controller.act(observation))
        volts = np.repeat((actions[-1] * rated)[:, None], 2, axis=1)
        times = PERIOD * np.arange(2)
        state = rollout(machine, times, volts, parameters=parameters, start=state, velocities=True)[:, -1]
    return ClosedLoop(np.stack(errors, axis=1), np.stack(actions, axis=1))


def random_stages(machine: Machine, count: int, seed: int) -> dict[str, Array]:
    """Sample parameters (count,) by name, in the ranges of the randomization "default"."""
    rng = np.random.default_rng(seed)
    stiffness_ratio = rng.uniform(0.7, 1.3, count)
    changes = {}
    for name, value in machine.parameters.items():
        key = name.rpartition(".")[2]
        ratio_range = {"rest_length": (0.85, 1.2), "coulomb": (0.5, 2.0), "mass": (0.9, 1.2)}.get(key)
        if key == "EA":
            changes[name] = value * stiffness_ratio
        elif ratio_range is not None:
            changes[name] = value * rng.uniform(*ratio_range, count)
    return changes


def random_points(count: int, seed: int) -> Array:
    """Sample points (count, 2) of the workspace, m."""
    return np.random.default_rng(seed).uniform([-0.25, -0.16], [0.25, 0.16], (count, 2))


def circles(count: int, seed: int, periods: int = 120, radius: float = 0.025, speed: float = 0.3) -> Array:
    """Sample goals (count, periods + 1 + PREVIEW, 2), m, that start at rest and follow circles."""
    rng = np.random.default_rng(seed)
    center, phase = rng.uniform([-0.2, -0.12], [0.2, 0.12], (count, 2)), rng.uniform(0.0, 2.0 * np.pi, count)
    time = PERIOD * np.arange(periods + 1 + PREVIEW)
    ramp = np.minimum(time / 0.2, 1.0)
    distance = speed * (0.2 * (ramp**3 - 0.5 * ramp**4) + np.maximum(time - 0.2, 0.0))
    angle = phase[:, None] + distance / radius
    return center[:, None] + radius * np.stack([np.cos(angle), np.sin(angle)], axis=2)
