"""A controller on a rig of the independent simulator, in closed loop: full state in, voltages held for a period."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hframe_gym.controllers import Controller
from hframe_gym.envs.tasks import Task
from hframe_gym.machine import Machine
from tests.reference_simulator import Array, Rig, Stage

PERIOD_S, DURATION_S = 0.01, 1.5
SAMPLES = 10  # a control period
# A nanometre in an episode, and many times the speed of the oracle's tolerances.
RTOL, ATOL = 1e-7, 1e-10


@dataclass(frozen=True)
class Driven:
    """B episodes, n samples: time_s (n,); of the tool, m, error (B, n) to its goal and contour (B, n) to its path, None
    where there is none."""

    time_s: Array
    error: Array
    contour: Array | None


def drive(controller: Controller, rig: Rig, machine: Machine, task: Task, episodes: int, seed: int) -> Driven:
    """A rig from rest through episodes of a task.

    machine: as declared, for the workspace and the drives' rated voltages.  seed: of starts and goals.
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
        off = task.contour(plan, tool, elapsed)
        contour[:, k] = np.nan if off is None else off
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
                observation["preview"] = np.hstack([task.goal(plan, elapsed + ahead) for ahead in task.ahead_s])
            seen = {key: values.astype(np.float32) for key, values in observation.items()}
            volts = np.clip(controller.act(seen), -1.0, 1.0) * rated
        for stage, held in zip(stages, volts, strict=True):
            stage.step(held, time_s[k + 1])
    return Driven(time_s, error, None if np.isnan(contour).all() else contour)
