"""Run a controller in closed loop on a rig of the independent simulator: full state, held voltages."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hframe_gym.controllers import Controller
from hframe_gym.envs import Task
from hframe_gym.machine import Machine
from tests.reference_simulator import Array, Rig, Stage

PERIOD_S, DURATION_S = 0.01, 1.5
SAMPLES = 10  # per control period
# These tolerances cost a nanometer per episode and are many times faster than those of the oracle.
RTOL, ATOL = 1e-7, 1e-10


@dataclass(frozen=True)
class Driven:
    """Result of closed-loop episodes.

    Attributes:
        time_s: Sample times, s, shape (n,).
        error: Distance of the tool from its goal, m, shape (episodes, n).
        contour: Distance of the tool from its path, m, shape (episodes, n); None if the task has no path.
    """

    time_s: Array
    error: Array
    contour: Array | None


def drive(controller: Controller, rig: Rig, machine: Machine, task: Task, episodes: int, seed: int) -> Driven:
    """Run episodes of a task on a rig, from rest.

    Args:
        controller: Controller with full-state feedback.
        machine: Declared machine, for the workspace and the drives' rated voltages.
        seed: Seed of starts and goals.
    """
    workspace = np.array([machine.coordinate(axis).range for axis in ("x", "y")])
    starts, plan = task.begin(workspace, np.random.default_rng(seed).random((episodes, task.draws)))
    stages = [Stage(rig, start, rtol=RTOL, atol=ATOL) for start in starts]
    rated = np.array([d.rated_voltage for d in machine.drives])
    count = round(DURATION_S / PERIOD_S) * SAMPLES
    time_s = np.linspace(0.0, DURATION_S, count + 1)
    error, contour = np.empty((2, episodes, count + 1))
    volts = np.zeros((episodes, len(rated)))
    controller.reset()
    for k, now in enumerate(time_s):
        position = np.array([stage.position for stage in stages])
        tool, elapsed = position[:, :2], np.full(episodes, now)
        error[:, k] = np.linalg.norm(tool - task.goal(plan, elapsed), axis=1)
        distance = task.contour(plan, tool, elapsed)
        contour[:, k] = np.nan if distance is None else distance
        if k == count:
            break
        if k % SAMPLES == 0:
            velocity = np.array([stage.velocity for stage in stages])
            observation = {
                "observation": np.hstack([position, velocity]),
                "achieved_goal": tool,
                "desired_goal": task.goal(plan, elapsed),
            }
            if task.ahead_s:
                observation["preview"] = np.hstack(
                    [task.goal(plan, elapsed + ahead) for ahead in task.ahead_s]
                )
            batch = {key: values.astype(np.float32) for key, values in observation.items()}
            volts = np.clip(controller.act(batch), -1.0, 1.0) * rated
        for stage, held in zip(stages, volts, strict=True):
            stage.step(held, time_s[k + 1])
    return Driven(time_s, error, None if np.isnan(contour).all() else contour)
